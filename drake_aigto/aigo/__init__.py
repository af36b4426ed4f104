"""Analytical Integral Global Optimization: boxes shrink onto a low point of their own mean."""

import lazy_loader

# Loaded when first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
