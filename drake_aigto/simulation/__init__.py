"""Judges: a control alone, or with feedback, simulated by exact laws and in Drake; and verdicts."""

import lazy_loader

# Loaded when first used: Numba, behind the kernels, takes a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
