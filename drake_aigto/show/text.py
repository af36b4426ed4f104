"""Words for quantities, shared by the tables and by plans as text."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import RigidLaw, contact_law
from drake_aigto.planning import Candidate
from drake_aigto.simulation import Replay
from drake_aigto.world import Scenario, TaskCost, World

WIDTH = 100
# Below it, in the task's scale, a cost is 0 but for rounding; no percentage of it says anything.
NO_COST = 1e-9
_AGAINST = " against "
# What a task asks for, shown beside its start and goal; weights are shown elsewhere.
_SHOWN = (
    *("hard_goal", "angles", "duration_range", "reference_times", "contact"),
    *("position_lower", "position_upper", "velocity_lower", "velocity_upper"),
    *("control_lower", "control_upper", "control_norm"),
)


def task_items(scenario: Scenario, world: World | None = None) -> list[str]:
    """Returns where a scenario starts and ends, and what its task asks for besides.

    Without a world, all coordinates are lengths.
    """
    is_hinge = np.zeros(scenario.initial_position.shape, bool) if world is None else world.is_hinge
    items = [
        f"q(0) = {_numbers(scenario.initial_position, is_hinge)}",
        f"v(0) = {_numbers(scenario.initial_velocity, is_hinge, '/s')}",
        f"goal {_numbers(scenario.goal_position, is_hinge)}",
    ]
    if scenario.goal_velocity is not None:
        items.append(f"goal velocity {_numbers(scenario.goal_velocity, is_hinge, '/s')}")
    for name in (name for name in scenario.extras if name in _SHOWN):
        value, words = getattr(scenario, name), name.replace("_", " ")
        if name == "reference_times":
            words = f"a reference at {len(value)} times"
        elif isinstance(value, str):
            words = f"{value} {words}"
        elif value is not True:
            words = f"{words} {weight_text(value)}"
        items.append(words)
    return items


def weight_text(weight: float | Floats) -> str:
    """Returns one number, or those of a diagonal or a matrix."""
    short: Any = {"float_kind": lambda value: f"{value:g}"}
    return np.array2string(np.array(weight), separator=", ", formatter=short)


def miss_texts(run: Candidate | Replay, scenario: Scenario, world: World) -> list[str]:
    """Returns how far a run ends off the goal: lengths, angles, and speeds if these are weighed."""
    if not world.is_hinge.any() and scenario.is_plain:
        return [length_text(run.goal_error)]
    cost = TaskCost.of(world, scenario)
    motion = run.trajectory if isinstance(run, Candidate) else run
    errors = {"": cost.goal_errors(motion.positions[-1])}
    if np.any(cost.QTv) or (scenario.hard_goal and scenario.goal_velocity is not None):
        errors["/s"] = motion.velocities[-1] - cost.goal_velocity
    return [
        f"{as_text(float(np.linalg.norm(error[which])))}{per}"
        for per, error in errors.items()
        for which, as_text in ((~world.is_hinge, length_text), (world.is_hinge, angle_text))
        if which.any()
    ]


def miss_text(run: Candidate | Replay, scenario: Scenario, world: World) -> str:
    """Returns the same as words."""
    *texts, last = miss_texts(run, scenario, world)
    return f"{', '.join(texts)} and {last}" if texts else last


def contact_names(world: World) -> list[str]:
    """Returns what touches what, such as "ball against left wall", for each contact."""
    return [contact.name.replace("_", " ").replace(",", "") for contact in world.contacts]


def wall_names(world: World) -> list[str]:
    """Returns what is touched, such as "left wall", for each contact."""
    return [name.split(_AGAINST)[1] for name in contact_names(world)]


def touch_names(world: World) -> list[str]:
    """Returns what is touched; and what by, if that is not always the same."""
    names = contact_names(world)
    return wall_names(world) if len({name.split(_AGAINST)[0] for name in names}) == 1 else names


def law_items(scenario: Scenario, world: World) -> list[str]:
    """Returns what contacts push with: restitution, or stiffness and dissipation, if any do."""
    if not world.contacts:
        return []
    law = contact_law(world, scenario)
    if isinstance(law, RigidLaw):
        return [f"restitution {scenario.restitution:g}"]
    values = {"stiffness": (law.stiffness, "N/m"), "dissipation": (law.dissipation, "s/m")}
    return [f"{name} {_range_text(*value)}" for name, value in values.items()]


def _range_text(values: Floats, unit: str = "") -> str:
    """Returns what values are, or from what to what they go."""
    ends = dict.fromkeys(f"{value:.4g}" for value in (np.min(values), np.max(values)))
    return f"{' to '.join(ends)} {unit}"


def friction_items(scenario: Scenario, world: World) -> list[str]:
    """Returns which friction acts, and which of the model's a scenario leaves out, if any."""
    items = []
    if world.dry_friction is not None:
        forces = ", ".join(f"{force:g}" for force in world.dry_friction)
        speed = f"below {world.stiction_speed:g} m/s it sticks"
        items.append(f"dry, of coordinates at most {forces} N or N m, {speed}")
    largest = float(max(world.frictions.values(), default=0.0))
    if scenario.friction == 0 and largest:
        left_out = f"left out of the simulation, as asked: the model's, μ = {largest:g} at the most"
        return [*items, left_out]
    acting = world.friction_coefficients(scenario)
    return [*items, f"μ = {_range_text(acting[acting > 0]).strip()}"] if acting.any() else items


def cost_text(cost: float, digits: int = 2, scale: float = 1.0) -> str:
    """Returns a cost, or 0 where nothing but rounding is left of it at a task's scale."""
    return f"{cost:.{digits}e}" if abs(cost) >= NO_COST * scale else "0"


def length_text(meters: float) -> str:
    """Returns a length in the unit that it is best read in."""
    if meters >= 0.1:
        return f"{meters:.2f} m"
    if meters >= 1e-4:
        return f"{1e3 * meters:.1f} mm"
    return f"{1e6 * meters:.1f} µm" if meters >= 1e-8 else "0 m"


def angle_text(radians: float) -> str:
    """Returns an angle in the unit that it is best read in."""
    return f"{length_text(radians)[:-1]}rad"


def time_text(seconds: float) -> str:
    """Returns a short time."""
    return f"{1e3 * seconds:.2f} ms"


def energy_text(ratio: float | None) -> str:
    """Returns a ratio of kinetic energies; None without contact."""
    if ratio is None:
        return "-"
    return ">1e6" if ratio > 1e6 else f"{ratio:.2g}"


def run_texts(run: Candidate, digits: int = 2) -> tuple[str, str, str, str]:
    """Returns a run's cost, largest defect, deepest penetration, and energy ratio."""
    cost, defect = cost_text(run.cost, digits, run.scales.cost), f"{run.max_defect:.0e}"
    return cost, defect, length_text(run.max_penetration), energy_text(run.energy_ratio)


def _numbers(values: Iterable[float], is_hinge: Bools, per: str = "") -> str:
    """Returns numbers with their unit: one for all, or of each where they differ."""
    units = [f"rad{per}" if hinge else f"m{per}" for hinge in is_hinge]
    texts = [f"{value:g}" for value in values]
    if len(texts) == 1:
        return f"{texts[0]} {units[0]}"
    if len(set(units)) == 1:
        return f"({', '.join(texts)}) {units[0]}"
    pairs = zip(texts, units, strict=True)
    return f"({', '.join(f'{text} {unit}' for text, unit in pairs)})"
