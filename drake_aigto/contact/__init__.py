"""Contact: laws, impact maps, forces of closed contacts and saltation, as numbers and kernels.

Dynamics with the forces of a law are a `Mechanism`, by sums of products, or a `TreeMechanism`, by
recursion (`make_mechanism`): simulations evaluate their tables, and shooting differentiates them.
"""

import lazy_loader

# Loaded when first used: Numba, behind the kernels, takes a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
