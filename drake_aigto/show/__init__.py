"""What people see: text tables, figures, Meshcat, reports."""

import lazy_loader

# Loaded when first used: tables need neither matplotlib nor Meshcat.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
