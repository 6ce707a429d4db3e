"""Services: pause, step, simulation_interfaces."""
