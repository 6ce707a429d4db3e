"""Commands of `tissue_sim`: a module for each, with `add_arguments` and `run`, imported when it is used."""

# Module and summary of each. Commands of the bench and of ROS are beside what they run.
COMMANDS = {
    "demo": ("tissue_sim.ros.demo", "run the node, a scripted haptic bridge and the viewer"),
    "phantom": ("tissue_sim.commands.phantom", "write a CT of no patient, to try `tissue_sim build` on"),
    "build": ("tissue_sim.commands.build", "make an organ from a CT, a mask or a surface mesh"),
    "abdomen": ("tissue_sim.commands.abdomen", "make a scene of liver, kidneys and spleen that breathe"),
    "info": ("tissue_sim.commands.info", "print what an organ file holds"),
    "export": ("tissue_sim.commands.export", "write an organ's surface or skeleton for other programs"),
    "solve": ("tissue_sim.commands.solve", "settled displacements under given loads"),
    "calibrate": ("tissue_sim.commands.calibrate", "fit an organ to finite elements of its shape, and judge it"),
    "bench": ("tissue_sim.bench.command", "measure speed, accuracy and stability"),
    "replay": ("tissue_sim.ros.bags.replay", "run recorded bags again and compare"),
    "view": ("tissue_sim.ros.viewer.view", "show a running node in the browser"),
    "policy": ("tissue_sim.ros.policy", "print what DDS Security has to allow a running node and its clients"),
    "bridge": ("tissue_sim.ros.bridge.play", "play a scripted haptic bridge to a running node"),
}
