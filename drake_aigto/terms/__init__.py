"""Programs as sums of products of one-variable functions: their data, and how they are parsed.

Only parsers of programs (`parse_costs`, `parse_rows` and shared code) load pydrake.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
