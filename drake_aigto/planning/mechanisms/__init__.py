"""Mechanisms, and soft walls: what proposes and closes their motions."""
