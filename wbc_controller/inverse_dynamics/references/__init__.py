"""References: commanded changes, trajectories, ramps."""
