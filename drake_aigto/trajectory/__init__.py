"""Trajectories with impacts: held controls, states and impulses at knots, to JSON and back."""

from drake_aigto.trajectory.records import ArrayRecord, read_only
from drake_aigto.trajectory.trajectory import Trajectory, check_control

__all__ = ["ArrayRecord", "Trajectory", "check_control", "read_only"]
