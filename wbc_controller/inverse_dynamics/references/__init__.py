"""References of tasks and contacts: commanded changes, trajectories, ramps and their samples."""
