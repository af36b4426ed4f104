"""From a scenario to a plan: search, refinement, and replay on rigid walls."""

from typing import Any

import lazy_loader

# Loaded when first used.
_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Names of the past, and what stands for them now.
_GONE = {
    **dict.fromkeys(("Center", "MechanismBoxes"), "Guess and Guesses: mechanisms have no boxes"),
    **dict.fromkeys(("MECHANISM_LADDER", "MechanismRung"), "PlanOptions(starts=…)"),
    "Renewal": "Guesses.renew",
}


def __getattr__(name: str) -> Any:
    """Returns a public name; of one that is gone, says where it is now."""
    if name in _GONE:
        raise ImportError(f"drake_aigto.planning.{name} is gone: use {_GONE[name]}.")
    return _find(name)
