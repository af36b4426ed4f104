"""Local optima of polynomial programs with equality rows and bounds, by banded Newton steps.

Only `compile_nlp` and `solve_with_drake` load pydrake.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
