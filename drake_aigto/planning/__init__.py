"""From a result to a plan: trajectories, and their replay on rigid walls."""
