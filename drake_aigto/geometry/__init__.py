"""Geometry of pairs of shapes in space, in compiled code: distance, witness points, derivatives."""

import lazy_loader

# Loaded when first used: Numba takes a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
