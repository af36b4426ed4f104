"""What is left of plans where the world is other than they think."""
