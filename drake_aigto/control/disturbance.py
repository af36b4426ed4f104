"""Differences between a plant and its model, and a kick on the way."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np
from pydrake.multibody.tree import BodyIndex
from pydrake.systems.framework import Context

from drake_aigto.arrays import ArrayRecord, Floats, read_only
from drake_aigto.errors import ControlError
from drake_aigto.world import Scenario, World


def _as_row(name: str, value: object) -> Floats:
    """Returns a read-only array (n,) of finite floats, n ≥ 0."""
    row = np.atleast_1d(np.array(value, dtype=float))
    if row.ndim != 1 or not np.all(np.isfinite(row)):
        raise ControlError(name, got=row.tolist(), expected="a row of finite numbers")
    return read_only(row)


@dataclass(frozen=True, eq=False)
class Disturbance(ArrayRecord):
    """Differences of a plant in the loop from its model. The default is none.

    Letters: n coordinates. An empty array stands for zeros.

    Attributes:
        start_offset: of q(0) from the scenario's, shape (n,) [m, rad].
        mass_factor: of the masses of all links that move, and of their inertias.
        wall_shift: how much nearer each wall stands, along its normal [m].
        restitution_factor: of the scenario's restitution.
        friction_factor: of all friction, where contacts have one μ, and of that in joints.
        kick: by how much v jumps, shape (n,) [m/s, rad/s].
        kick_time: when it does, before the run ends [s].
        noise: standard deviations of the estimate of q and v, shape (2n,), drawn anew
            at each of the controller's periods [m, rad, 1/s].
        seed: of the noise.
    """

    start_offset: Floats = field(default_factory=lambda: np.empty(0))
    mass_factor: float = 1.0
    wall_shift: float = 0.0
    restitution_factor: float = 1.0
    friction_factor: float = 1.0
    kick: Floats = field(default_factory=lambda: np.empty(0))
    kick_time: float = 0.0
    noise: Floats = field(default_factory=lambda: np.empty(0))
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks what does not depend on a world, and makes the arrays read-only.

        Raises:
            ControlError: numbers that are not finite, or out of their range.
        """
        for name in ("start_offset", "kick", "noise"):
            object.__setattr__(self, name, _as_row(name, getattr(self, name)))
        for name in ("mass_factor", "restitution_factor", "friction_factor", "kick_time"):
            value = getattr(self, name)
            is_above = value > 0 if name == "mass_factor" else value >= 0
            if not (is_above and np.isfinite(value)):
                expected = "a number above 0" if name == "mass_factor" else "a number of at least 0"
                raise ControlError(name, got=value, expected=expected)
        if not np.isfinite(self.wall_shift):
            raise ControlError("wall_shift", got=self.wall_shift, expected="a finite number [m]")
        if np.any(self.noise < 0):
            raise ControlError("noise", got=self.noise.tolist(), expected="standard deviations")

    def apply(self, world: World, scenario: Scenario) -> tuple[World, Scenario]:
        """Returns the true world and scenario; masses are those of `scale_masses`.

        Raises:
            ControlError: sizes that are not the world's, a restitution that is not the scenario's
                or would be above 1, contacts that rub differently, or walls that can't stand
                nearer.
            ModelError: a wall moves (`World.with_wall_moved`).
        """
        self._check_sizes(world)
        changes: dict[str, object] = {}
        if self.start_offset.any():
            changes["initial_position"] = scenario.initial_position + self.start_offset
        if self.restitution_factor != 1:
            changes["restitution"] = self._find_restitution(world, scenario)
        if self.friction_factor != 1:
            changes |= self._find_friction(world, scenario)
        true = dataclasses.replace(scenario, **changes)  # type: ignore[arg-type]
        if "dry_friction" in changes:
            world = World.from_scenario(true)
        return (self._move_walls(world) if self.wall_shift else world), true

    def _check_sizes(self, world: World) -> None:
        n = world.num_positions
        for name, size in (("start_offset", n), ("kick", n), ("noise", 2 * n)):
            got = len(getattr(self, name))
            if got not in (0, size):
                raise ControlError(
                    name, got=f"{got} number{'s' * (got > 1)}", expected=f"{size}, or none"
                )

    def _find_restitution(self, world: World, scenario: Scenario) -> float:
        """Returns the true one."""
        own = [c.name for c in world.contacts if c.restitution is not None]
        got = None
        if scenario.contact == "compliant":
            got = "walls that yield, which have none"
        elif own or not world.contacts:
            got = f"{own[0]}, which has its own" if own else "no wall"
        elif (e := self.restitution_factor * scenario.restitution) <= 1:
            return e
        raise ControlError(
            "restitution_factor",
            got=got or f"{self.restitution_factor:g} times {scenario.restitution:g}",
            expected="rigid walls with the scenario's restitution, and no more than 1 in the end",
        )

    def _find_friction(self, world: World, scenario: Scenario) -> dict[str, object]:
        """Returns what the true scenario has in place of its friction."""
        coefficients = world.friction_coefficients(scenario)
        known, found = np.unique(coefficients[coefficients > 0]), dict[str, object]()
        if len(known) == 1:
            found["friction"] = self.friction_factor * float(known[0])
        if world.dry_friction is not None:
            found["dry_friction"] = self.friction_factor * world.dry_friction
        if len(known) > 1 or not found:
            raise ControlError(
                "friction_factor",
                got=" and ".join(f"μ = {mu:g}" for mu in known) or "nothing that rubs",
                expected="friction in joints, or contacts with one μ",
            )
        return found

    def _move_walls(self, world: World) -> World:
        """Returns a world whose walls stand nearer."""
        if not world.contacts:
            raise ControlError("wall_shift", got="no wall", expected="walls")
        for faces in world.solids:
            if len(faces) > 1:
                raise ControlError(
                    "wall_shift",
                    got=f"{world.contacts[faces[0]].name}, one of {len(faces)} faces of a block",
                    expected="walls that have one face, and can stand nearer",
                )
        walls = [pair[1] for pair in world.shapes]
        for wall in dict.fromkeys(walls):
            world = world.with_wall_moved(walls.index(wall), self.wall_shift)
        return world

    def scale_masses(self, world: World, root: Context) -> None:
        """Gives links their true masses, in this context only."""
        if self.mass_factor == 1:
            return
        plant = world.plant
        context = plant.GetMyMutableContextFromRoot(root)
        for index in range(plant.num_bodies()):
            body = plant.get_body(BodyIndex(index))
            if not plant.IsAnchored(body):
                body.SetMass(context, self.mass_factor * body.get_mass(context))

    def draw_noise(self, count: int) -> Floats:
        """Returns the noise of q and v at each of a count of periods, shape (count, 2n)."""
        return self.noise * np.random.default_rng(self.seed).normal(size=(count, len(self.noise)))
