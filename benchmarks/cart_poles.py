"""Published cart-poles between soft walls, held upright for 40 s by planning again every 5 ms.

    python -m benchmarks.cart_poles [--only C3 MIQP Benders] [--count 100] [--seconds 40]
        [--workers 1] [--minutes 10]

Plants, walls, bounds and weights are those of the published examples:

- C3: Aydinoglu, Wei, Huang, Posa, T-RO 2024 (arXiv 2304.11259), `cartpole_softwalls`; 100 Hz.
- MIQP: Marcucci and Tedrake, T-AC 2021, `cart_pole_with_walls`; 57 Hz by Gurobi, median.
- Benders: Lin, 2024 (arXiv 2406.00780), `cart_pole`; "oftentimes" 1000 Hz.

There the plant is the linear model, or PyBullet's; here it is Drake's MultibodyPlant with its own
contact, in `Simulator`. What C3 and MIQP add to the state is added here every 50 ms, to velocities;
Benders' torques on the pole are drawn every 5 ms, and its walls wander. Controllers know the still
walls only. Starts are by chance, and the states that are told have noise.

Beside `ModelPredictiveController` runs an LQR about upright, cut to the bounds, which knows of no
wall: a weak peer, and the one that needs no solver. A run counts as upright if the pole leans by
less than 45 degrees from one second after the start to the end.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.controllers import LinearQuadraticRegulator
from pydrake.systems.framework import BasicVector, Context, DiagramBuilder, LeafSystem

from benchmarks.collections.cart_poles import (
    PROBLEMS,
    STEPS,
    CartPole,
    add_plant,
    linearize,
    make_scenario,
    make_world,
)
from benchmarks.script import machine, read_flags, run_all, run_as
from drake_aigto import ModelPredictiveController, Planner, PlanOptions
from drake_aigto.control import TickStatus

PERIOD = 0.005  # [s]
_SHOVED = 0.05  # between jumps of velocities [s]
_UPRIGHT, _SETTLED = np.pi / 4, 1.0
# Of the estimate of q and v.
_NOISE = np.array([1e-4, 1e-4, 1e-3, 1e-3])
_OPTIONS = PlanOptions(renewals=8, search_steps=STEPS, confirm=False)


class Regulator(LeafSystem):
    """An LQR, sampled every period and cut to the bounds."""

    def __init__(self, problem: CartPole) -> None:
        """Computes the gain."""
        super().__init__()
        weights, effort = problem.weights
        self._gain, _ = LinearQuadraticRegulator(*linearize(problem), np.diag(weights), [[effort]])
        self._force = problem.force
        self._estimate = self.DeclareVectorInputPort("estimated_state", 4)
        held = self.DeclareDiscreteState(1)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._sample)
        self.DeclareStateOutputPort("control", held)

    def _sample(self, context: Context, values: Any) -> None:
        u = -self._gain @ self._estimate.Eval(context)
        values.set_value(np.clip(u, -self._force, self._force))


class Noisy(LeafSystem):
    """What is told of a state: with noise, another one every period."""

    def __init__(self, rng: np.random.Generator) -> None:
        """Draws as it is asked, in the order of time."""
        super().__init__()
        self._rng = rng
        self._state = self.DeclareVectorInputPort("state", 4)
        noise = self.DeclareDiscreteState(4)
        self.DeclarePeriodicDiscreteUpdateEvent(PERIOD, 0.0, self._draw)
        self._noise = noise
        self.DeclareVectorOutputPort("estimate", 4, self._write)

    def _draw(self, context: Context, values: Any) -> None:
        values.set_value(_NOISE * self._rng.normal(size=4))

    def _write(self, context: Context, output: BasicVector) -> None:
        noise = context.get_discrete_state(self._noise).value()
        output.SetFromVector(self._state.Eval(context) + noise)


@dataclass(frozen=True)
class Outcome:
    """A run."""

    is_upright: bool  # whether the pole stayed so
    touches: int  # how often the tip came to a wall
    seconds: tuple[float, ...]  # of wall time, of each tick after the first
    mean: float  # of the squared angle [rad²]


def run(problem: CartPole, controller: LeafSystem, seed: int, seconds: float) -> Outcome:
    """Returns what becomes of a cart-pole from a start by chance."""
    return _Run(problem, controller, seed).advance(seconds)


class _Run:
    """A cart-pole under a controller in Drake's Simulator, shoved about."""

    def __init__(self, problem: CartPole, controller: LeafSystem, seed: int) -> None:
        self._problem, self._controller = problem, controller
        self._rng = np.random.default_rng(seed)
        self._moves = problem.wander > 0
        builder = DiagramBuilder()
        self._plant = plant = add_plant(builder, problem, self._moves)
        self._model = plant.GetModelInstanceByName("cart_pole")
        noisy = builder.AddSystem(Noisy(np.random.default_rng(seed + 1)))
        builder.AddSystem(controller)
        builder.Connect(plant.get_state_output_port(self._model), noisy.get_input_port())
        builder.Connect(noisy.get_output_port(), controller.get_input_port(0))
        u = plant.get_actuation_input_port(self._model)
        builder.Connect(controller.GetOutputPort("control"), u)
        self._simulator = Simulator(builder.Build())
        self._simulator.get_mutable_integrator().set_maximum_step_size(PERIOD)
        self._simulator.get_mutable_integrator().set_target_accuracy(1e-4)
        self._context = plant.GetMyMutableContextFromRoot(self._simulator.get_mutable_context())
        start = np.array(problem.start) * self._rng.uniform(0.8, 1.2, 4) * self._rng.choice([-1, 1])
        plant.SetPositionsAndVelocities(self._context, self._model, start)
        self._walls = np.zeros(2)

    def advance(self, seconds: float) -> Outcome:
        """Returns what became of it after so long."""
        ticks = list(self._go(seconds))
        angles = np.array([x[1] for x, _ in ticks])
        touched = np.array([clear <= 0 for _, clear in ticks])
        late = angles[int(_SETTLED / PERIOD) :]
        return Outcome(
            is_upright=bool(late.size and np.max(np.abs(late)) < _UPRIGHT),
            touches=int(np.sum(touched[1:] & ~touched[:-1])),
            seconds=tuple(self._seconds),
            mean=float(np.mean(late**2)) if late.size else np.inf,
        )

    def _go(self, seconds: float) -> Iterator[tuple[Any, float]]:
        """Yields q and v, and how far the tip is from the walls, until the pole has fallen."""
        self._seconds: list[float] = []
        for tick in range(1, round(seconds / PERIOD) + 1):
            self._disturb(tick)
            self._simulator.AdvanceTo(tick * PERIOD)
            self._note()
            x = self._plant.GetPositionsAndVelocities(self._context, self._model)
            tip = x[0] - self._problem.length * np.sin(x[1])
            left, right = self._problem.walls + self._walls
            yield x, min(tip - left, right - tip)
            if abs(x[1]) > np.pi / 2:
                break

    def _note(self) -> None:
        if isinstance(self._controller, ModelPredictiveController):
            context = self._controller.GetMyContextFromRoot(self._simulator.get_context())
            status: TickStatus = self._controller.GetOutputPort("status").Eval(context)
            if status.time > 0:
                self._seconds.append(status.seconds)

    def _disturb(self, tick: int) -> None:
        problem, plant, rng = self._problem, self._plant, self._rng
        if problem.shove and tick % round(_SHOVED / PERIOD) == 0:
            v = plant.GetVelocities(self._context, self._model)
            plant.SetVelocities(self._context, self._model, v + problem.shove * rng.normal(size=2))
        forces = np.zeros(plant.num_velocities())
        if problem.torque:
            forces[plant.GetJointByName("pole_joint").velocity_start()] = (
                problem.torque * rng.normal()
            )
        plant.get_applied_generalized_force_input_port().FixValue(self._context, forces)
        if self._moves:
            self._move_walls(problem.wander * rng.normal(size=2))

    def _move_walls(self, velocities: Any) -> None:
        """Has walls wander about where they belong."""
        plant = self._plant
        for side, name in enumerate(("left", "right")):
            joint = plant.GetJointByName(f"{name}_joint")
            self._walls[side] = joint.get_translation(self._context)
            joint.set_translation_rate(self._context, velocities[side] - self._walls[side])


@cache
def _make_planner(name: str) -> Planner:
    problem = PROBLEMS[name]
    return Planner(make_scenario(problem), _OPTIONS, make_world(problem))


def compare(job: tuple[str, int], seconds: float) -> dict[str, Outcome]:
    """Returns what both controllers make of the same disturbances.

    Args:
        job: the plant's name, and the seed.
        seconds: that each run lasts.
    """
    name, seed = job
    problem = PROBLEMS[name]
    mpc = ModelPredictiveController(_make_planner(name), PERIOD, iterations=2, surprise=np.inf)
    controllers = {"MPC": mpc, "LQR": Regulator(problem)}
    return {
        method: run(problem, controller, 2 * seed, seconds)
        for method, controller in controllers.items()
    }


def main() -> int:
    """Runs both controllers on the same disturbances, and prints a table."""
    options = read_flags(
        __doc__,
        only=([*PROBLEMS], "", {"nargs": "*", "choices": [*PROBLEMS]}),
        count=(100, "of runs of each"),
        seconds=(40.0, "that each lasts"),
    )
    print(machine())
    print(
        "plant     controller  upright     mean angle  touches a run  ms a tick, 99 %", flush=True
    )
    for name in options.only:
        jobs = [(name, seed) for seed in range(options.count)]
        found = run_all(partial(compare, seconds=options.seconds), jobs, options)
        for method in found[0] if found else ():
            print(f"{name:<8}  {report(method, [each[method] for each in found])}", flush=True)
    return 0


def report(method: str, outcomes: list[Outcome]) -> str:
    """Returns a row of the table."""
    upright = sum(each.is_upright for each in outcomes)
    angle = np.rad2deg(np.sqrt(np.mean([each.mean for each in outcomes if each.is_upright] or [0])))
    touches = np.mean([each.touches for each in outcomes])
    row = f"{method:<10}  {upright:3d} of {len(outcomes):3d}  {angle:6.2f} deg  {touches:9.1f}"
    if times := [1e3 * second for each in outcomes for second in each.seconds]:
        middle, late = np.percentile(times, [50, 99])
        row += f"      {middle:6.2f} {late:6.2f}"
    return row


if __name__ == "__main__":
    run_as("benchmarks.cart_poles")
