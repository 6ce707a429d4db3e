"""Commands of `tissue_sim`: a module for each, with `add_arguments` and `run`, imported when it is used."""

# Module and summary of each. Commands of the bench and of ROS are beside what they run.
COMMANDS = {
    "demo": ("tissue_sim.ros.demo", "run the node, a scripted haptic bridge and the viewer"),
    "phantom": ("tissue_sim.commands.phantom", "write a synthetic CT for trying `tissue_sim build`"),
    "build": ("tissue_sim.commands.build", "make an organ from a CT, a mask or a surface mesh"),
    "abdomen": ("tissue_sim.commands.abdomen", "make a scene of a breathing liver, kidneys and spleen"),
    "info": ("tissue_sim.commands.info", "print the contents of an organ file or a scene"),
    "export": (
        "tissue_sim.commands.export",
        "write an organ's surface, or frames of a bag, for other programs",
    ),
    "solve": ("tissue_sim.commands.solve", "compute the equilibrium displacements under given loads"),
    "calibrate": ("tissue_sim.commands.calibrate", "fit an organ to finite elements of its shape, and evaluate it"),
    "identify": ("tissue_sim.commands.identify", "fit an organ's stiffness to measured presses"),
    "learn": ("tissue_sim.commands.learn", "learn a policy for a task, on many copies of an organ"),
    "bench": ("tissue_sim.bench.command", "measure speed, accuracy and stability"),
    "replay": ("tissue_sim.ros.bags.replay", "compute recorded bags again and compare"),
    "view": ("tissue_sim.ros.viewer.view", "show a running node in the browser"),
    "camera": ("tissue_sim.ros.camera.command", "publish an endoscope's images of a running node"),
    "policy": ("tissue_sim.ros.policy", "print the DDS Security policy of a running node and its clients"),
    "drive": ("tissue_sim.ros.bridge.drive", "let a learned policy move a tool of a running node"),
    "bridge": ("tissue_sim.ros.bridge.play", "simulate a haptic bridge that follows a script"),
}
