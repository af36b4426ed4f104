"""Worlds whose physics is written out by hand, and motions that are exact by construction."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from replay_worlds import make_diagram, shipped_world

from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import Transcription
from drake_aigto.world import Scenario, World, models_directory

Array = npt.NDArray[np.float64]

SHIPPED = models_directory() / "point_mass_and_wall.sdf"
AXIS = "<xyz>1 0 0</xyz>"
DIAGONAL = 1 / np.sqrt(2)


def write_model(directory: Path, old: str, new: str) -> str:
    text = SHIPPED.read_text(encoding="utf-8")
    assert old in text
    path = directory / "variant.sdf"
    path.write_text(text.replace(old, new), encoding="utf-8")
    return str(path)


@dataclass(frozen=True, eq=False)
class Physics:
    """M v̇ = u − h + Jᵀ λ, φ = J q + offset: what a world ought to have read, by hand.

    The bias h is constant, and every joint has an actuator.
    """

    world: World
    mass: Array
    bias: Array
    jacobian: Array
    offset: float = 0.0

    @property
    def size(self) -> int:
        return len(self.bias)

    @property
    def lift(self) -> Array:
        """M⁻¹ Jᵀ / (J M⁻¹ Jᵀ): the change of velocity by the wall for one of φ̇."""
        kick = np.linalg.solve(self.mass, self.jacobian)
        return kick / (self.jacobian @ kick)

    @property
    def contact_mass(self) -> float:
        return float(1 / (self.jacobian @ np.linalg.solve(self.mass, self.jacobian)))

    @property
    def along(self) -> Array:
        """A motion along the wall, J t = 0; zero if there is but one coordinate."""
        return np.array([-self.jacobian[1], self.jacobian[0]]) if self.size == 2 else np.zeros(1)

    def place(self, distance: float, along: float = 0.0) -> Array:
        J = self.jacobian
        return J / (J @ J) * (distance - self.offset) + along * self.along

    def scenario(self, q: Any, v: Any, goal: Any, **fields: Any) -> Scenario:
        return Scenario(initial_position=q, initial_velocity=v, goal_position=goal, **fields)


NAMES = ("point mass", "heavy", "shifted", "mirrored", "floor", "two joints", "rail at the wall")


@cache
def physics_of(name: str, directory: Path) -> Physics:
    """Returns a world by name; the directory is for models."""
    one = np.ones((1, 1))
    if name == "point mass":
        return Physics(shipped_world(), one, np.zeros(1), np.ones(1))
    if name == "heavy":
        return Physics(shipped_world(2.5), 2.5 * one, np.zeros(1), np.ones(1))
    if name == "floor":
        world = World.from_diagram(make_diagram(gravity=9.81))
        return Physics(world, 1.5 * one, np.array([1.5 * 9.81]), np.ones(1))
    if name == "shifted":
        model = write_model(
            directory, "<pose>-0.05 0 0 0 0 0</pose>", "<pose>0.15 0 0 0 0 0</pose>"
        )
        return Physics(_load(model, 1.0), one, np.zeros(1), np.ones(1), -0.2)
    if name == "mirrored":
        model = write_model(directory, AXIS, "<xyz>-1 0 0</xyz>")
        return Physics(_load(model, -1.0), one, np.zeros(1), -np.ones(1))
    # A carriage of 0.5 kg on a rail along a, and on it the ball of 1.5 kg, which slides along b.
    a = np.array([DIAGONAL, DIAGONAL]) if name == "two joints" else np.array([0.0, 1.0])
    b = np.array([0.8, 0.6])
    world = World.from_diagram(make_diagram(num_joints=2, gravity=3.0, rail=(a[0], a[1])))
    mass = np.array([[2.0, 1.5 * (a @ b)], [1.5 * (a @ b), 1.5]])
    return Physics(world, mass, 3.0 * np.array([2.0 * a[0], 1.5 * b[0]]), np.array([a[0], b[0]]))


def _load(model: str, q: float) -> World:
    return World.from_scenario(
        Scenario(model=model, initial_position=q, initial_velocity=0.0, goal_position=q)
    )


def make_motion(
    physics: Physics, restitution: float, seed: int, steps: int = 20, dt: float = 0.05
) -> tuple[Scenario, Trajectory]:
    """Returns a scenario, and an exact motion with impacts on knots: parabola by parabola.

    With restitution it touches twice: between the touches φ̈ is what brings it back. Without, once.
    """
    rng = np.random.default_rng(seed)
    first = int(rng.integers(2, steps // 2))
    second = int(rng.integers(first + 1, steps - 1))
    speed = rng.uniform(0.5, 3.0)
    rise = rng.uniform(0.5, 4.0, steps)  # φ̈, away from the wall
    if restitution > 0:
        rise[first:second] = -2 * restitution * speed / ((second - first) * dt)
    slide = rng.uniform(-3, 3, steps)
    accelerations = np.outer(rise, physics.lift) + np.outer(slide, physics.along)
    q, v = np.zeros((steps + 1, physics.size)), np.zeros((steps + 1, physics.size))
    impulses = np.zeros(steps + 1)
    q[first] = physics.place(0.0, rng.uniform(-1, 1))
    v[first] = -speed * physics.lift + rng.uniform(-1, 1) * physics.along
    for k in reversed(range(first)):
        v[k] = v[k + 1] - dt * accelerations[k]
        q[k] = q[k + 1] - dt * (v[k] + v[k + 1]) / 2
    for k in range(first, steps):
        after = v[k]
        if k == first or (k == second and restitution > 0):
            jump = -(1 + restitution) * float(physics.jacobian @ v[k])
            impulses[k] = physics.contact_mass * jump
            after = v[k] + jump * physics.lift
        v[k + 1] = after + dt * accelerations[k]
        q[k + 1] = q[k] + dt * (after + v[k + 1]) / 2
    controls = accelerations @ physics.mass + physics.bias
    scenario = physics.scenario(
        q[0],
        v[0],
        physics.place(0.7, 0.3),
        duration=steps * dt,
        time_step=dt,
        restitution=restitution,
    )
    times = np.arange(steps + 1) * np.float64(dt)
    return scenario, Trajectory(times, q, v, controls, impulses[:, None], np.zeros((steps, 1)))


def indices(transcription: Transcription) -> list[npt.NDArray[np.int64]]:
    everything = np.arange(transcription.prog().num_vars())
    parts = [part.ravel() for part in transcription.split(everything)]
    return [*parts, np.setdiff1d(everything, np.concatenate(parts))]
