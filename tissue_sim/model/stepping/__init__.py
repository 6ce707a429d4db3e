"""One tick: inputs, time integration, guard, recovery, and organs that are coupled."""
