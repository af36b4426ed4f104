"""What people would use instead, on the same scenarios and under the same verdict."""

from drake_aigto.baselines.gradient import gradient_from_random, gradient_from_zero

__all__ = ["gradient_from_random", "gradient_from_zero"]
