"""Trajectories with impacts: held controls, states and impulses at knots, to JSON and back."""

from drake_aigto.trajectory.trajectory import Trajectory, check_control

__all__ = ["Trajectory", "check_control"]
