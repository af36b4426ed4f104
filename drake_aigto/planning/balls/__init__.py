"""Balls between rigid walls: what proposes and closes their contact sequences."""
