"""What the paper does, as it does it, and what simulations make of it (AIGTO Sec. III and IV)."""

import lazy_loader

# Loaded when first used: a plan needs no table.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
