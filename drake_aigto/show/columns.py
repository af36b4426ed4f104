"""Trajectories of plans as tables: a row for each knot."""

from __future__ import annotations

import csv
import io
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.errors import OptionsError
from drake_aigto.planning import Plan
from drake_aigto.world import World, name_controls


def read_columns(plan: Plan, world: World | None = None) -> dict[str, Floats]:
    """Returns a plan's knots, name with unit → numbers, shape (N+1,) each.

    Controls and forces are held from a knot to the next; at the last one they are NaN.
    """
    world, path = plan.find_world(world), plan.trajectory
    t, m = path.times, range(world.num_contacts)
    names = world.plant.GetPositionNames(add_model_instance_prefix=False)
    rates = world.plant.GetVelocityNames(add_model_instance_prefix=False)
    driven = name_controls(world.plant, world.num_actuators, has_prefix=False)
    last = np.full((1, 1), np.nan)
    columns = {"time": t}
    for kind, labels, rows in (
        ("position", names, path.positions),
        ("velocity", rates, path.velocities),
        ("control", driven, path.controls),
        ("force", [world.contacts[i].name for i in m], path.forces),
        ("impulse", [world.contacts[i].name for i in m], path.impulses),
    ):
        filled = rows if len(rows) == len(t) else np.vstack([rows, last.repeat(rows.shape[1], 1)])
        columns |= {f"{kind} {n}": c for n, c in zip(labels, filled.T, strict=True)}
    return columns


def to_dataframe(plan: Plan, world: World | None = None) -> Any:
    """Returns the same as a DataFrame, whose index is the time.

    Raises:
        OptionsError: there is no pandas.
    """
    try:
        import pandas
    except ImportError:
        remedy = "pip install 'drake_aigto[tables]', or write `drake-aigto plan … --csv FILE`."
        raise OptionsError("a DataFrame", "no pandas", "the extra `tables`", remedy) from None
    return pandas.DataFrame(read_columns(plan, world)).set_index("time")


def to_csv(plan: Plan, world: World | None = None) -> str:
    """Returns the same as lines of comma-separated values."""
    columns, written = read_columns(plan, world), io.StringIO()
    table = csv.writer(written, lineterminator="\n")
    table.writerow(columns)
    table.writerows(zip(*(map(repr, column.tolist()) for column in columns.values()), strict=True))
    return written.getvalue()
