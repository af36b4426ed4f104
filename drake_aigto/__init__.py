"""Analytical Integral Global Trajectory Optimization (AIGTO) with contact, on Drake."""

import lazy_loader

__version__ = "0.1.0"  # The only place that has it; the build reads it from here.

# Public names are in the stub beside; each is loaded when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
