"""Motions, planned or simulated, for figures and playback; and trajectories of plans as tables."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats, Ints, LockedArrays, interpolate
from drake_aigto.contact import (
    CompliantLaw,
    RigidLaw,
    calc_pushes,
    calc_slips,
    contact_law,
    stack_rows,
)
from drake_aigto.dynamics import calc_friction_share
from drake_aigto.errors import OptionsError
from drake_aigto.planning import Plan
from drake_aigto.simulation import Replay, find_contacts
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Touch
from drake_aigto.world import Scenario, World, name_controls

# Okabe and Ito's colors, which the color-blind can tell apart; the darkest first.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")

PLAN_LABEL = "plan (not a simulation)"
SIMULATION_LABELS = {
    "event-driven": "simulation: exactly rigid",
    "integrated": "simulation: walls as springs",
    "drake": "simulation: compliant (Drake)",
}

# Rows that are nearer to an impact than this part of the motion are at it.
_AT = 1e-12
# Between rows farther apart than this a motion is filled in [s].
_LONGEST_STEP = 0.01
_SAME_TIME = 1e-9  # rounding [s]


@dataclass(frozen=True, eq=False)
class Motion(LockedArrays):
    """One motion of a world, in rows so close that straight lines join them.

    Letters: K rows; N intervals of the control; m contacts. Arrays are read-only.

    Attributes:
        label: says what it is, and whether it is a plan or a simulation.
        times: shape (K,) [s]. Never decreasing; an impact has two rows of equal time.
        positions: shape (K, nq) [m].
        velocities: shape (K, nv) [m/s].
        control_times: knots of the control, shape (N+1,) [s], or None.
        controls: held between them, shape (N, nu) [N], or None.
        forces: of the walls where a planned contact lasts, held likewise, shape (N, m) [N], or
            None.
        touches: the planned contacts, in the order of time.
        impacts: when what is touched, planned or simulated, in the order of time.
    """

    label: str
    times: Floats
    positions: Floats
    velocities: Floats
    control_times: Floats | None = None
    controls: Floats | None = None
    forces: Floats | None = None
    touches: tuple[Touch, ...] = ()
    impacts: tuple[Touch, ...] = ()

    @classmethod
    def from_trajectory(
        cls, trajectory: Trajectory, world: World, label: str = PLAN_LABEL
    ) -> Motion:
        """Returns a planned motion: v_k before each knot's impulse, what that makes of it after.

        Without friction, that is v_k + M⁻¹ Jᵀ p_k; with it, the slope of the parabola to the next
        knot, as in `Trajectory.to_piecewise`.
        """
        jumps = world.calc_velocity_change(trajectory.positions, trajectory.impulses)
        if world.frictions:
            struck = np.flatnonzero(np.any(trajectory.impulses[:-1] > 0, axis=1))
            slopes = trajectory.to_piecewise()[0]
            after = [slopes.value(t)[world.num_positions :, 0] for t in trajectory.times[struck]]
            jumps[struck] = np.reshape(after, (-1, world.num_velocities))
            jumps[struck] -= trajectory.velocities[struck]
        touches = tuple(
            Touch(c.time, c.last_time, c.index) for c in find_contacts(world, trajectory)
        )
        before_and_after = np.stack([trajectory.velocities, trajectory.velocities + jumps], axis=1)
        return cls(
            label,
            *_fill_in(
                world,
                np.repeat(trajectory.times, 2),
                np.repeat(trajectory.positions, 2, axis=0),
                before_and_after.reshape(-1, world.num_velocities),
            ),
            trajectory.times,
            trajectory.controls,
            trajectory.forces,
            touches,
            impacts=touches,
        )

    @classmethod
    def from_replay(cls, replay: Replay, world: World, label: str | None = None) -> Motion:
        """Returns a simulated motion; without a label, it names the simulator."""
        label = SIMULATION_LABELS[replay.simulator] if label is None else label
        rows = _fill_in(world, replay.times, replay.positions, replay.velocities)
        bounces = zip(replay.bounce_times, replay.bounce_contacts, strict=True)
        return cls(label, *rows, impacts=tuple(Touch.bounce(*bounce) for bounce in bounces))

    @classmethod
    def from_path(cls, label: str, world: World, times: Floats, states: Floats) -> Motion:
        """Returns a planned motion through states (K, nq + nv) at times (K,) [s]."""
        return cls(label, *_fill_in(world, times, *world.split(states)))

    def since(self, time: float) -> Motion:
        """Returns where it goes from a time on [s]."""
        kept = self.times >= time - _SAME_TIME
        rows = {name: getattr(self, name)[kept] for name in ("times", "positions", "velocities")}
        return dataclasses.replace(self, **rows)

    def under(self, times: Floats, controls: Floats) -> Motion:
        """Returns the same motion with the control that it is a simulation of."""
        return dataclasses.replace(self, control_times=times, controls=controls)


def motions_of_plan(plan: Plan, world: World | None = None) -> list[Motion]:
    """Returns a plan's trajectory and what simulations made of its control, each labeled."""
    world = plan.find_world(world)
    planned = Motion.from_trajectory(plan.trajectory, world)
    replays = [Motion.from_replay(r, world, simulation_label(r, world)) for r in plan.replay]
    return [planned, *replays]


def simulation_label(replay: Replay, world: World) -> str:
    """Returns what a simulation is, its walls named if there are any."""
    if world.contacts:
        return SIMULATION_LABELS[replay.simulator]
    return "simulation: Drake" if replay.simulator == "drake" else "simulation: integrated"


def color_of(index: int) -> str:
    """Returns the color of the motion at this place in a list, the same in every picture."""
    return PALETTE[index % len(PALETTE)]


def time_span(motions: Sequence[Motion]) -> tuple[float, float]:
    """Returns when the first of the motions begins and the last ends [s]."""
    return min(m.times[0] for m in motions), max(m.times[-1] for m in motions)


def _fill_in(
    world: World, times: Floats, positions: Floats, velocities: Floats
) -> tuple[Floats, Floats, Floats]:
    """Returns the rows with more between those far apart, on cubics that have both ends' slopes.

    Bodies that float are on cubics in the tangent space of the row before.
    """
    h = np.diff(times)
    counts = np.maximum(np.ceil(h / _LONGEST_STEP), 1).astype(int)
    i = np.repeat(np.arange(len(h)), counts)
    part = np.arange(len(i)) - np.repeat(np.cumsum(counts) - counts, counts)
    s, h = (part / counts[i])[:, np.newaxis], h[i][:, np.newaxis]
    # Where h = 0 there is one row, s = 0.
    rise = world.subtract(positions[i + 1], positions[i]) / np.where(h > 0, h, 1.0)
    v0, v1 = velocities[i], velocities[i + 1]
    way = h * s * ((1 - s) ** 2 * v0 + s * (3 - 2 * s) * rise - s * (1 - s) * v1)
    q = world.add(positions[i], way)
    v = (1 - s) * (1 - 3 * s) * v0 + 6 * s * (1 - s) * rise + s * (3 * s - 2) * v1
    return (
        np.append(times[i] + (s * h)[:, 0], times[-1]),
        np.vstack([q, positions[-1:]]),
        np.vstack([v, velocities[-1:]]),
    )


def find_row(path: Motion | Trajectory, time: float) -> int:
    """Returns the row as something is touched at that time: of the two of an impact the first."""
    return min(int(np.searchsorted(path.times, time)), len(path.times) - 1)


def calc_approach_speed(
    world: World, path: Motion | Trajectory, time: float, contact: int
) -> float:
    """Returns how fast a path approaches what it is about to touch at that time [m/s]."""
    row = find_row(path, time)
    slope = world.calc_contact_jacobian(path.positions[row])[contact]
    return max(0.0, -float(slope @ path.velocities[row]))


def find_held(motion: Motion) -> Ints:
    """Returns which interval of the control each row of a motion is in, shape (K,)."""
    assert motion.control_times is not None
    rows = np.searchsorted(motion.control_times, motion.times, side="right") - 1
    return np.clip(rows, 0, len(motion.control_times) - 2)


def positions_at(motion: Motion, times: Floats) -> Floats:
    """Returns q at times (d,) [s], shape (d, nq)."""
    return interpolate(times, motion.times, motion.positions)


def calc_contact_forces(motion: Motion, world: World, scenario: Scenario) -> Floats:
    """Returns what contacts push with at each row of a motion, shape (K, m) [N].

    Soft ones by their law, wherever the motion comes from; rigid ones as a plan has them, and not
    at all in simulations, which know their impulses alone.
    """
    law = contact_law(world, scenario)
    if isinstance(law, CompliantLaw):
        return calc_pushes(world, law, motion.positions, motion.velocities)
    if motion.forces is None:
        return np.zeros((len(motion.times), world.num_contacts))
    return motion.forces[find_held(motion)]


class Friction(NamedTuple):
    """Forces [N], or impulses [N s], of m contacts along a motion of K rows.

    Contacts stick where |s| < v_s; s of an impact is what it leaves.
    """

    normals: Floats  # f, shape (K, m)
    tangents: Floats  # against sliding, shape (K, m)
    largest: Floats  # μ f, shape (K, m)
    sticks: Bools  # shape (K, m)


def calc_friction(motion: Motion, world: World, scenario: Scenario) -> tuple[Friction, Friction]:
    """Returns forces while contacts last, and impulses of rigid impacts.

    Friction of compliant walls is −μ f σ(s / v_s); of rigid ones, while a plan's contact lasts, by
    −μ f sign(s), and where they stick by what keeps T v̇ + Ṫ v = 0, within ±μ f; of lasting contact
    in simulations nothing is known (`calc_contact_forces`). Impulses, of walls with friction
    alone, are read off the velocity before and after an impact, and stand in the row after it.
    """
    law = contact_law(world, scenario)
    forces = calc_contact_forces(motion, world, scenario)
    if not law.has_friction:
        nothing = np.zeros_like(forces)
        smooth = Friction(forces, nothing, nothing, nothing > 0)
        return smooth, smooth._replace(normals=nothing)
    slips = calc_slips(world, law, motion.positions, motion.velocities)
    sticks, largest = np.abs(slips) < world.stiction_speed, law.friction * forces
    impulses = np.zeros((2, *slips.shape))
    if isinstance(law, RigidLaw):
        held = sticks & (largest > 0)
        tangents = _hold(motion, world, forces, -largest * np.sign(slips), largest, held)
        impulses = _calc_impulses(motion, world) * (law.friction > 0)
    else:
        tangents = -largest * calc_friction_share(slips, world.stiction_speed)
    lasting = Friction(forces, tangents, largest, sticks)
    return lasting, Friction(impulses[0], impulses[1], law.friction * impulses[0], sticks)


def _hold(
    motion: Motion, world: World, forces: Floats, tangents: Floats, largest: Floats, held: Bools
) -> Floats:
    """Returns the tangents (K, m) [N], where contacts are held those that keep them from sliding.

        T M⁻¹ Tᵀ f_t = −(T v̇₀ + Ṫ v),    |f_t| ≤ μ f

    Here v̇₀ is without friction of what is held.
    """
    if motion.controls is None or not held.any():
        return tangents
    tangents = np.where(held, 0.0, tangents)
    controls = motion.controls[find_held(motion)]
    for row in np.flatnonzero(held.any(axis=1)):
        q, v, contacts = motion.positions[row], motion.velocities[row], np.flatnonzero(held[row])
        T = world.rubbing.calc_tangent_jacobian(q)
        free = world.calc_acceleration(q, v, controls[row], forces[row], tangents[row] @ T)
        sliding = T[contacts] @ free + world.rubbing.calc_tangent_bias(q, v)[contacts]
        kicks = np.linalg.solve(world.calc_mass_matrix(q), T[contacts].T)
        asked = np.linalg.lstsq(T[contacts] @ kicks, -sliding)[0]
        most = largest[row, contacts]
        tangents[row, contacts] = np.clip(asked, -most, most)
    return tangents


def _calc_impulses(motion: Motion, world: World) -> Floats:
    """Returns normal and tangential impulses, shape (2, K, m) [N s]."""
    found = np.zeros((2, len(motion.times), world.num_contacts))
    for time in {touch.start for touch in motion.impacts}:
        rows = np.flatnonzero(np.abs(motion.times - time) <= _AT * motion.times[-1])
        contacts = np.unique([t.contact for t in motion.impacts if t.start == time])
        if len(rows):
            # They make of the first row's velocity the last one's.
            q, change = motion.positions[rows[0]], np.subtract(*motion.velocities[rows[[-1, 0]]])
            kicks = np.linalg.solve(world.calc_mass_matrix(q), stack_rows(world, q, contacts).T)
            found[:, rows[-1], contacts] = np.linalg.lstsq(kicks, change)[0].reshape(2, -1)
    return found


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
