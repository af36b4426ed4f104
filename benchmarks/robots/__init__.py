"""How good are plans for robots? Peers on the same questions, and judges apart from the planner."""
