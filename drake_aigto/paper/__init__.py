"""The methods of the paper, with its formulation, and their simulations (AIGTO Sec. III, IV)."""

import lazy_loader

# Loaded when first used: a plan needs no table.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
