"""Optimal control of any mechanism by multiple shooting, between compliant or rigid walls.

Differential dynamic programming (Mayne 1966) in the Gauss-Newton form, on motions that need not
be roll-outs, with bounded controls (Tassa, Mansard & Todorov 2014) and an augmented Lagrangian for
all other bounds. NumPy and Numba only.
"""

import lazy_loader

# Loaded when first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
