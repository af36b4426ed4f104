"""Judge of controls for shipped robots: it shares only the scenario with the planner."""
