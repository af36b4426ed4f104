"""Words for quantities, tasks and contacts, the same in tables, in text and in figures."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from functools import cache
from pathlib import PurePath
from string import ascii_lowercase
from typing import Any

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import RigidLaw, contact_law
from drake_aigto.errors import ScenarioError
from drake_aigto.planning import Candidate
from drake_aigto.progress import list_some
from drake_aigto.simulation import Arrival, PlannedContact, Replay
from drake_aigto.world import Scenario, World, name_alike, scenario_names

WIDTH = 100
# Below it, in the task's scale, a cost is 0 but for rounding; no percentage of it says anything.
NO_COST = 1e-9
_SAME_COST = 1e-4  # Costs that differ by this part or less are called the same.
_MOST_CONTACTS = 12
_MOST_CHANGED = 3  # fields in which a question differs from a shipped one
_AGAINST, _WITH = " against ", " with "
# Between these, numbers are written without an exponent; what angles are multiples of, in π.
_SMALLEST, _LARGEST, _PARTS_OF_PI = 1e-2, 1e6, 12
_SAME_ANGLE = 1e-6  # as scenarios have π [rad]
# What a task asks for, shown beside its start and goal; weights are shown elsewhere.
_SHOWN = (
    *("hard_goal", "periodic", "angles", "duration_range", "reference_times", "contact"),
    *("position_lower", "position_upper", "velocity_lower", "velocity_upper"),
    *("control_lower", "control_upper", "control_norm"),
)


def plan_name(scenario: Scenario, world: World) -> str:
    """Returns the shipped scenario that this one is, or nearly, and what differs; or the model.

    Of those with the same model, it is the one that differs in the fewest fields, up to three.
    """
    if world.model is None:
        return "a diagram of one's own"
    own, found = world.place(scenario).to_plain(), list[tuple[int, str]]()
    for name, each in _shipped().items():
        if each.model != scenario.model:
            continue
        try:  # Places by name are those of this world, as its own are by now.
            shipped = world.place(each).to_plain()
        except ScenarioError:
            continue
        changed = [k for k in dict.fromkeys([*own, *shipped]) if own.get(k) != shipped.get(k)]
        if len(changed) <= _MOST_CHANGED:
            words = [f"{key.replace('_', ' ')} {own.get(key, 'as usual')}" for key in changed]
            found.append((len(changed), f"{name}, {join_words(words)}" if words else name))
    return min(found, default=(0, PurePath(world.model).stem))[1]


@cache
def _shipped() -> dict[str, Scenario]:
    """Returns the shipped scenarios, by name."""
    return {name: Scenario.named(name) for name in scenario_names()}


def task_items(scenario: Scenario, world: World | None = None) -> list[str]:
    """Returns where a scenario starts and ends, and what its task asks for besides.

    Without a world, all coordinates are lengths.
    """
    of_positions = of_velocities = ["m"] * len(scenario.initial_position)
    if world is not None:
        of_positions, of_velocities = list(world.units_of_positions), list(world.units)
    of_velocities = [f"{unit}/s" for unit in of_velocities]
    items = [
        f"q(0) = {_numbers(scenario.initial_position, of_positions)}",
        f"v(0) = {_numbers(scenario.initial_velocity, of_velocities)}",
        f"goal {_numbers(scenario.goal_position, of_positions)}",
    ]
    if scenario.goal_velocity is not None:
        items.append(f"goal velocity {_numbers(scenario.goal_velocity, of_velocities)}")
    for name in (name for name in scenario.extras if name in _SHOWN):
        value, words = getattr(scenario, name), name.replace("_", " ")
        if name == "reference_times":
            words = f"a reference at {len(value)} times"
        elif name == "periodic":
            far = (f"{key} by {join_words(list(map(str, by)))}" for key, by in value.items())
            words = f"periodic, advancing {join_words(list(far))}" if value else "periodic"
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
    """Returns how far a run ends off the goal: lengths, angles, and speeds if these are weighed.

    Coordinates count whose end matters (`TaskCost.is_asked`).
    """
    if not world.is_hinge.any() and scenario.is_plain:
        return [length_text(run.goal_error)]
    motion = run.trajectory if isinstance(run, Candidate) else run
    return _arrival_texts(Arrival.of(world, scenario, motion.positions, motion.velocities))


def _arrival_texts(arrival: Arrival) -> list[str]:
    """Returns by how much a motion misses its goal, in the units of what misses."""
    sizes = (arrival.distance, arrival.angle, arrival.speed, arrival.turn_rate)
    words = zip(sizes, (length_text, angle_text) * 2, ("", "", "/s", "/s"), strict=True)
    return [f"{as_text(size)}{per}" for size, as_text, per in words if size is not None]


def goal_items(arrival: Arrival, effort: float | None = None) -> list[str]:
    """Returns whether a motion reaches its goal, and if not, what holds it back.

    `effort` is the share of the cost that its control takes, if known.
    """
    off = f"it ends {join_words(_arrival_texts(arrival))} off"
    if arrival.is_reached:
        return [f"reached: {off}"]
    if arrival.active_bounds:
        return [f"not reached: {off}", f"held back by {join_words(arrival.active_bounds)}"]
    share = "" if effort is None else f", of which control takes {100 * effort:.0f} %"
    return [
        f"not reached: {off}",
        f"no bound is active: the weights trade it for a lower cost{share}",
    ]


def miss_text(run: Candidate | Replay, scenario: Scenario, world: World) -> str:
    """Returns the same as words."""
    return join_words(miss_texts(run, scenario, world))


def join_words(texts: Sequence[str]) -> str:
    """Returns "a, b and c"."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def contact_names(world: World) -> list[str]:
    """Returns what touches what, such as "ball against left wall", for each contact."""
    return [contact.name.replace("_", " ").replace(",", "") for contact in world.contacts]


def touch_names(world: World) -> list[str]:
    """Returns what is touched; and what by, if that is not always the same.

    Shapes in space, whose names begin with their models', are named by those if no two are of one.
    """
    names = contact_names(world)
    models = [[side.partition("::")[0] for side in name.split(_WITH)] for name in names]
    if all(len(pair) == 2 and pair[0] != pair[1] for pair in models):
        return [_WITH.join(pair) for pair in models]
    pairs = [name.partition(_AGAINST) for name in names]
    is_one = len({by for by, _, _ in pairs}) == 1 and all(touched for *_, touched in pairs)
    return [touched for *_, touched in pairs] if is_one else names


def name_touch(contact: tuple[float, int] | None, names: Sequence[str]) -> str:
    """Returns what is touched when; contacts have names."""
    return f"{names[contact[1]]} at {contact[0]:.3f} s" if contact else "nothing"


def contact_texts(candidate: Candidate, world: World) -> Iterator[str]:
    """Yields a candidate's contacts, and what they do to its kinetic energy."""
    if not candidate.contacts:
        yield "none"
        return
    names = contact_names(world)
    for contact in candidate.contacts[:_MOST_CONTACTS]:
        where = f"{names[contact.index]} at " if len(names) > 1 else ""
        change = f" (Δv {contact.velocity_change:.2f} m/s)"
        yield f"{where}{_when(contact)} s{'' if world.is_hinge.any() else change}"
    if (more := len(candidate.contacts) - _MOST_CONTACTS) > 0:
        yield f"{more} more"
    moving = sum(contact.energy_ratio is not None for contact in candidate.contacts)
    if resting := len(candidate.contacts) - moving:
        begin = "begins" if resting == 1 else "begin"
        yield f"{resting} {begin} at rest" if moving else "from rest"
    if moving:
        all_of_them = " in all" if moving > 1 else ""
        yield f"kinetic energy after / before {energy_text(candidate.energy_ratio)}{all_of_them}"


def sequence_text(candidate: Candidate, world: World) -> str:
    """Returns which contacts a candidate has when, in short."""
    times = list_some(map(_when, candidate.contacts), " s")
    if len(world.contacts) > 1:
        times = " at ".join(["".join(letter(c.index) for c in candidate.contacts), times])
    contacts = times if candidate.contacts else "none"
    return f"no control: {contacts}" if candidate.is_idle else contacts


def letter(contact: int) -> str:
    """Returns the letter of a contact, with a number after the alphabet is used up."""
    again, index = divmod(contact, len(ascii_lowercase))
    return f"{ascii_lowercase[index]}{again or ''}"


def _when(contact: PlannedContact) -> str:
    """Returns the time of a bounce, or the times of a contact that lasts [s]."""
    times = [f"{time:.3f}" for time in (contact.time, contact.last_time)]
    return "–".join(dict.fromkeys(times))


def name_simulator(replay: Replay, names: Sequence[str]) -> str:
    """Returns where a control was simulated, and whether with feedback; contacts have names."""
    tracked = "" if replay.feedback is None else ", with its feedback,"
    if replay.simulator == "drake":
        return f"on Drake's plant{tracked}"
    if replay.simulator == "integrated" or not names:
        return f"by integration{tracked}"
    return f"on a rigid wall{tracked}" if len(names) == 1 else f"on rigid walls{tracked}"


def join_items(items: Iterable[str]) -> str:
    """Returns items as one text, with no-break spaces where lines are not to break."""
    return ", ".join(item.replace(" ", "\u00a0") for item in items)


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


def question_facts(
    scenario: Scenario, world: World, duration: float | None = None
) -> Iterator[tuple[str, str]]:
    """Yields what was asked; a free duration is the plan's."""
    T = duration if duration and scenario.duration_range else scenario.duration
    span = f"T = {T:.6g} s in {scenario.num_steps} steps"
    mass = [] if scenario.mass is None else [f"mass {scenario.mass:g} kg"]
    items = [*task_items(scenario, world), *mass, *law_items(scenario, world)]
    yield "scenario", join_items([*items, span])
    yield from list_fact("pairs", _list_pairs(world) if world.num_contacts > 1 else ())
    yield from list_fact("friction", friction_items(scenario, world))
    yield from list_fact("control", world.limits.control_items(world.plant, scenario))
    yield from list_fact("left out", world.ignored)
    yield from list_fact("notes", world.notes)


def _list_pairs(world: World) -> Iterator[str]:
    """Yields contacts with their letters, and their restitution if the model has one.

    Those of all corners of a solid, or of both ends of a capsule, are one item.
    """
    names = map(name_alike, contact_names(world))
    items = enumerate((n, c.restitution) for n, c in zip(names, world.contacts, strict=True))
    for (name, own), alike in itertools.groupby(items, key=lambda item: item[1]):
        letters = [letter(number) for number, _ in alike]
        ends = "–".join(dict.fromkeys((letters[0], letters[-1])))
        yield f"{ends} {name}" + ("" if own is None else f" (restitution {own:g})")


def list_fact(label: str, items: Iterable[str]) -> Iterator[tuple[str, str]]:
    """Yields a fact of items, if there are any."""
    if text := join_items(items):
        yield label, text


def cost_text(cost: float, digits: int = 2, scale: float = 1.0) -> str:
    """Returns a cost, or 0 where nothing but rounding is left of it at a task's scale."""
    if abs(cost) < NO_COST * scale:
        return "0"
    if not _SMALLEST <= abs(cost) < _LARGEST:
        return f"{cost:.{digits}e}"
    return f"{cost:.{max(0, digits - int(np.floor(np.log10(abs(cost)))))}f}"


def describe_difference(cost: float, replay: Replay) -> str:
    """Returns by how much a simulation's cost differs from a plan's, and what explains it."""
    off = replay.cost - cost
    if abs(off) <= max(_SAME_COST * cost, NO_COST):
        return ""
    # Of plans that cost next to nothing, a percentage says nothing.
    part = f", {100 * off / cost:+.2f} %" if cost > max(NO_COST, abs(off) / 10) else ""
    # Walls that give a little delay what follows a contact.
    why = f"; its compliance explains up to {replay.compliance_cost:.1e}"
    return f" ({off:+.1e}{part}{why if replay.compliance_cost else ''})"


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


def pi_text(radians: float) -> str:
    """Returns an angle as a number, or as a fraction of π if it is one to rounding."""
    part = Fraction(radians / np.pi).limit_denominator(_PARTS_OF_PI)
    if not part or abs(radians - part * np.pi) > _SAME_ANGLE:
        return f"{radians:g}"
    times = {1: "", -1: "-"}.get(part.numerator, str(part.numerator))
    return f"{times}π" + (f"/{part.denominator}" if part.denominator > 1 else "")


def way_text(way: float, world: World) -> str:
    """Returns the norm of a way of all coordinates, in the unit of them all."""
    if len(set(world.is_hinge.tolist())) > 1:
        return f"{way:.1e} {world.position_unit}"
    return angle_text(way) if world.is_hinge.all() else length_text(way)


def time_text(seconds: float) -> str:
    """Returns a short time."""
    return f"{1e3 * seconds:.2f} ms"


def energy_text(ratio: float | None) -> str:
    """Returns a ratio of kinetic energies; None without contact that begins in motion."""
    if ratio is None:
        return "-"
    return ">1e6" if ratio > 1e6 else f"{ratio:.2g}"


def run_texts(run: Candidate, digits: int = 2) -> tuple[str, str, str, str]:
    """Returns a run's cost, largest defect, deepest penetration, and energy ratio."""
    cost, defect = cost_text(run.cost, digits, run.scales.cost), f"{run.max_defect:.0e}"
    return cost, defect, length_text(run.max_penetration), energy_text(run.energy_ratio)


def _numbers(values: Floats, units: Sequence[str]) -> str:
    """Returns numbers with their unit: one for all, or of each where they differ; 0 of zeros."""
    texts = [
        pi_text(value) if unit == "rad" else f"{value:g}"
        for value, unit in zip(values, units, strict=True)
    ]
    if len(texts) == 1:
        return f"{texts[0]} {units[0]}"
    if len(set(units)) == 1:
        return f"({', '.join(texts)}) {units[0]}"
    if not np.any(values):
        return "0"
    pairs = zip(texts, units, strict=True)
    return f"({', '.join(f'{text} {unit}'.strip() for text, unit in pairs)})"
