"""What controllers ask of their ports and periods."""

from __future__ import annotations

import numpy as np
from pydrake.systems.framework import Context, InputPort, System

from drake_aigto.arrays import Floats
from drake_aigto.errors import ControlError


def check_period(period: float) -> float:
    """Returns a period as a number above zero.

    Raises:
        ControlError: it is none.
    """
    if not (isinstance(period, int | float) and 0 < period < np.inf):
        raise ControlError("period", got=period, expected="seconds above zero")
    return float(period)


def read_start(system: System, port: InputPort, context: Context) -> Floats:
    """Returns the state that a controller is told first.

    Raises:
        ControlError: nothing is connected, or it is not finite.
    """
    if not port.HasValue(context):
        raise ControlError(
            f"the input port {port.get_name()} of {system.GetSystemPathname()}",
            got="nothing that is connected to it",
            expected="q and v of the plant",
            remedy="Connect the plant's state output port, or an estimator's.",
        )
    x: Floats = port.Eval(context)
    if not np.all(np.isfinite(x)):
        raise ControlError("the state at the start", got=x.tolist(), expected="finite numbers")
    return x
