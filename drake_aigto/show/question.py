"""What was asked, on a page: cost and equations, task, law of contact, weights."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from drake_aigto.show.page import Page
from drake_aigto.show.text import (
    contact_names,
    friction_items,
    law_items,
    task_items,
    weight_text,
)
from drake_aigto.world import Scenario, World

PROBLEM = """\
minimize over u   ∫₀ᵀ w_u ‖u(t)‖² dt + w_f ‖q(T) − q_goal‖²
subject to        M v̇ + h(q, v) = B u + J(q)ᵀ λ,    0 ≤ φ(q) ⊥ λ ≥ 0,    q(0), v(0) given
                  J v⁺ = −e J v⁻  where a wall is hit"""


# Of tasks that ask for more than that, with e_q and e_v the errors of q and v.
_COST = """\
minimize over u   ∫₀ᵀ uᵀ R u + e_qᵀ Q e_q + e_vᵀ Q_v e_v dt
                  + e_q(T)ᵀ Q_T e_q(T) + e_v(T)ᵀ Q_vT e_v(T)"""
_SOFT = """\
subject to        M v̇ + h(q, v) = B u + J(q)ᵀ λ,    λ = k x max(0, 1 + d ẋ),    x = max(0, −φ(q)),
                  q(0), v(0) given"""
_WEIGHTS = {
    "R": "control_weight",
    "Q": "position_weight",
    "Q_v": "velocity_weight",
    "Q_T": "goal_weight",
    "Q_vT": "goal_velocity_weight",
}


def add_question(
    page: Page, scenario: Scenario, world: World, additions: Sequence[str] = ()
) -> None:
    """Adds what was asked, with the names of costs and constraints besides the scenario's."""
    page.heading("The question")
    page.code(_describe_problem(scenario))
    rows = [
        ("task", ", ".join(task_items(scenario, world))),
        ("duration", _describe_duration(scenario)),
        *(tuple(item.split(" ", 1)) for item in law_items(scenario, world)),
        ("weights", _describe_weights(scenario)),
        ("contacts", ", ".join(contact_names(world)) or "none"),
        ("model", world.model or "a diagram of one's own"),
    ]
    if scenario.mass is not None:
        rows.append(("mass", f"{scenario.mass:g} kg"))
    if left_out := friction_items(scenario, world):
        rows.append(("friction", "; ".join(left_out)))
    if additions:
        rows.append(("costs and constraints besides", ", ".join(additions)))
    page.table(("", ""), rows)


def _describe_duration(scenario: Scenario) -> str:
    """Returns how long a motion lasts, or may."""
    span = f"{scenario.duration:g} s"
    if scenario.duration_range is not None:
        span = "from {:g} to {:g} s,".format(*scenario.duration_range)
    return f"{span} in {scenario.num_steps} steps"


def _describe_problem(scenario: Scenario) -> str:
    """Returns the cost and the equations of a task."""
    if scenario.is_plain:
        return PROBLEM
    rigid = PROBLEM[PROBLEM.index("subject to") :]
    return "\n".join([_COST, rigid if scenario.contact == "rigid" else _SOFT])


def _describe_weights(scenario: Scenario) -> str:
    """Returns the weights of the cost that are not zero."""
    if scenario.is_plain:
        return f"w_u = {scenario.control_weight:g}, w_f = {scenario.goal_weight:g}"
    found = ((symbol, getattr(scenario, name)) for symbol, name in _WEIGHTS.items())
    return "; ".join(f"{symbol} = {weight_text(w)}" for symbol, w in found if np.any(w))
