"""Equations of motion: M, h and B, kinematics, φ and J with their derivatives.

A mechanism is asked by numbers: `calc_mass_matrix`, `calc_bias`, `calc_acceleration`, and for its
contacts `calc_signed_distance`, `calc_contact_jacobian`, `calc_contact_bias`. Sums of products are
behind them here (`EquationsOfMotion`), and arrays where M, J and h are constant
(`ConstantDynamics`). Where expressions are needed, as by boxes, they are attributes.
"""

import lazy_loader

# Loaded when first used: Numba, behind the kernels, takes a second.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
