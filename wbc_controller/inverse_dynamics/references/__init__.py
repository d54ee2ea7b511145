"""References of tasks and contacts: changes by command, trajectories, ramps, and their values at any time."""
