"""Lower bounds: how far an answer is from the best one, at most."""

import lazy_loader

# Loaded when first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
