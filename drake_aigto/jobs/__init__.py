"""Work side by side: many plans, or any jobs, on processes of this machine or on Dask's workers."""

import lazy_loader

# Loaded when first used: jobs of other kinds need no planner.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
