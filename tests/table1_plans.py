"""Plans of Table I's rows, of few time steps, that several tests look at."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

from drake_aigto import PlanOptions, Scenario
from drake_aigto.planning import Plan, plan

COARSE: dict[str, Any] = {"time_step": 0.02}
UNCONFIRMED = PlanOptions(confirm=False)


def table1(row: int, **fields: Any) -> Scenario:
    return dataclasses.replace(Scenario.named(f"table1/{row}"), **fields)


@cache
def bounce_plan() -> Plan:
    return plan(table1(1, **COARSE))
