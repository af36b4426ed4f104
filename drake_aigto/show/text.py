"""Words for quantities, shared by the tables and by plans as text."""

from __future__ import annotations

from collections.abc import Iterable

from drake_aigto.planning import Candidate
from drake_aigto.world import Scenario, World

WIDTH = 100
# Below it, in the task's scale, a cost is 0 but for rounding; nothing is so many percent of it.
NO_COST = 1e-9
_AGAINST = " against "


def task_items(scenario: Scenario) -> list[str]:
    """Returns where a scenario starts and ends."""
    return [
        f"q(0) = {_numbers(scenario.initial_position)} m",
        f"v(0) = {_numbers(scenario.initial_velocity)} m/s",
        f"goal {_numbers(scenario.goal_position)} m",
    ]


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


def friction_items(scenario: Scenario, world: World) -> list[str]:
    """Returns what friction of the model a scenario leaves out of simulations, if there is any."""
    largest = float(max(world.frictions.values(), default=0.0))
    if scenario.friction is None or not largest:
        return []
    return [f"left out of the simulation, as asked: the model's, μ = {largest:g} at the most"]


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


def _numbers(values: Iterable[float]) -> str:
    texts = [f"{value:g}" for value in values]
    return texts[0] if len(texts) == 1 else f"({', '.join(texts)})"
