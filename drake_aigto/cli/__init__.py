"""The command line: parse, load, call, print. A file for each command or few."""

import lazy_loader

# Loaded when first used: a command waits for none of the others.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
