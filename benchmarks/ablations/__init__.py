"""What finds the bounce: the planner with one part changed at a time."""
