"""Contact: laws, impact maps, forces of closed contacts and saltation, as numbers and kernels."""

import lazy_loader

# Loaded when first used: Numba, behind the kernels, takes a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
