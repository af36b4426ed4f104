"""The world and the question: models, readings of plants, contact geometry, scenarios."""

import lazy_loader

# Loaded when first used: a command that names scenarios needs no plant.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
