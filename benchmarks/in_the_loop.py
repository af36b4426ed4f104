"""A cart-pole between soft walls in the loop: other masses and walls, noise, and a kick.

    python -m benchmarks.in_the_loop [--count 100] [--seed 2026]

The plan for `cart_pole/soft_06` on plants whose two masses and two walls are off by up to 10 %
each, whose state is told with noise every 10 ms, and that are kicked once, in Drake's Simulator,
until the scenario ends. Methods: the plan's control alone, `TrackingController`,
`ModelPredictiveController` without and with searches every 100 ms, and the latter on the true
plant's own model without noise, which is the yardstick. Costs are integrated along what happened.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem, OutputPort
from pydrake.systems.primitives import (
    Adder,
    LogVectorOutput,
    TrajectorySource,
)
from pydrake.trajectories import PiecewisePolynomial

from benchmarks.measure import Spread
from drake_aigto import (
    MechanismOptions,
    ModelPredictiveController,
    Plan,
    Planner,
    Scenario,
    TrackingController,
    World,
)
from drake_aigto.control import TickStatus
from drake_aigto.world import TaskCost, package_map
from drake_aigto.world.files import find_model

SCENARIO = "cart_pole/soft_06"
PERIOD = 0.01  # [s]
OFF = 0.1  # Masses and walls are off by up to this part.
NOISE = np.array([2e-3, 5e-3, 1e-2, 3e-2])  # standard deviations of what is told [m, rad, 1/s]
KICK = np.array([0.3, 1.5])  # standard deviations of the kick [m/s, rad/s]
SEARCH_EVERY = 10  # ticks
_LONGEST = 10.0  # of a scenario [s]
OPTIONS = MechanismOptions(renewals=24, search_steps=30)
BEST = "knows the truth"


@dataclass(frozen=True)
class Truth:
    """What a plan does not know.

    Attributes:
        masses: of cart and pole [kg].
        walls: where the left and the right one are [m].
        kick_time: when both velocities jump [s].
        kick: by how much.
        seed: of the noise.
    """

    masses: tuple[float, float]
    walls: tuple[float, float]
    kick_time: float
    kick: Any
    seed: int

    @classmethod
    def draw(cls, rng: np.random.Generator, duration: float) -> Truth:
        """Returns one by chance."""
        factors = 1 + rng.uniform(-OFF, OFF, 4)
        return cls(
            masses=(1.0 * factors[0], 0.1 * factors[1]),
            walls=(-0.6 * factors[2], 0.6 * factors[3]),
            kick_time=float(rng.uniform(0.1, 0.7) * duration),
            kick=KICK * rng.normal(size=2),
            seed=int(rng.integers(2**31)),
        )


def build_plant(truth: Truth | None, scenario: Scenario) -> tuple[DiagramBuilder, Any]:
    """Returns a builder with the plant of a truth, or the model's own."""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    parser = Parser(plant)
    parser.package_map().AddMap(package_map())
    walls = Path(find_model(scenario.model)).read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory() as folder:
        if truth is not None:
            walls = _change(walls, truth, Path(folder))
        parser.AddModelsFromString(walls, "sdf")
    plant.Finalize()
    return builder, plant


def _change(walls: str, truth: Truth, folder: Path) -> str:
    """Returns the model of a truth, whose cart-pole is in a file of the folder."""
    uri = "package://drake_aigto_models/cart_pole.sdf"
    robot = Path(find_model(uri)).read_text(encoding="utf-8")
    changes = {
        "<mass>1.0</mass>": f"<mass>{truth.masses[0]}</mass>",
        "<mass>0.1</mass>": f"<mass>{truth.masses[1]}</mass>",
    }
    file = folder / "cart_pole.sdf"
    file.write_text(_replace(robot, changes), encoding="utf-8")
    radius = 0.04
    changes = {
        uri: file.as_uri(),
        "<pose>-0.64 0 0 0 0 0</pose>": f"<pose>{truth.walls[0] - radius} 0 0 0 0 0</pose>",
        "<pose>0.64 0 0 0 0 0</pose>": f"<pose>{truth.walls[1] + radius} 0 0 0 0 0</pose>",
    }
    return _replace(walls, changes)


def _replace(text: str, changes: dict[str, str]) -> str:
    for old, new in changes.items():
        if old not in text:
            raise LookupError(f"the model has no {old}")
        text = text.replace(old, new)
    return text


@dataclass(frozen=True)
class Outcome:
    """A run.

    Attributes:
        cost: J of what happened.
        seconds: of wall time, of each tick that planned after the first.
        switches: how often another plan was taken.
    """

    cost: float
    seconds: tuple[float, ...]
    switches: int


def run(controller: LeafSystem, truth: Truth, scenario: Scenario, is_noisy: bool) -> Outcome:
    """Returns what a controller makes of a truth."""
    builder, plant = build_plant(truth, scenario)
    builder.AddSystem(controller)
    if controller.num_input_ports():
        state = plant.get_state_output_port()
        told = _add_noise(builder, state, truth) if is_noisy else state
        builder.Connect(told, controller.get_input_port(0))
    control = controller.get_output_port(0)
    builder.Connect(control, plant.get_actuation_input_port())
    logs = [LogVectorOutput(port, builder) for port in (plant.get_state_output_port(), control)]
    simulator = Simulator(builder.Build())
    simulator.get_mutable_integrator().set_maximum_step_size(PERIOD / 4)
    root = simulator.get_mutable_context()
    context = plant.GetMyMutableContextFromRoot(root)
    start = scenario.initial_position, scenario.initial_velocity
    plant.SetPositionsAndVelocities(context, np.concatenate(start))
    statuses: dict[float, TickStatus] = {}

    def watch(root: Any) -> None:
        if isinstance(controller, ModelPredictiveController):
            port = controller.GetOutputPort("status")
            status = port.Eval(controller.GetMyContextFromRoot(root))
            statuses[status.time] = status

    simulator.set_monitor(watch)
    simulator.AdvanceTo(truth.kick_time)
    plant.SetVelocities(context, plant.GetVelocities(context) + truth.kick)
    simulator.AdvanceTo(scenario.duration)
    ticks = list(statuses.values())[1:]
    switches = sum(tick.reason.startswith("switched") for tick in ticks)
    cost = _calc_cost(plant, scenario, *(log.FindLog(root) for log in logs))
    return Outcome(cost, tuple(tick.seconds for tick in ticks), switches)


def _add_noise(builder: DiagramBuilder, state: OutputPort, truth: Truth) -> OutputPort:
    """Returns the port of a state with noise, another one every period."""
    times = np.arange(0.0, _LONGEST, PERIOD)
    noise = NOISE * np.random.default_rng(truth.seed).normal(size=(len(times), len(NOISE)))
    held = PiecewisePolynomial.ZeroOrderHold(times, noise.T)
    source, adder = builder.AddSystem(TrajectorySource(held)), builder.AddSystem(Adder(2, 4))
    builder.Connect(source.get_output_port(), adder.get_input_port(0))
    builder.Connect(state, adder.get_input_port(1))
    return adder.get_output_port()


def _calc_cost(plant: Any, scenario: Scenario, states: Any, controls: Any) -> float:
    """Returns J along what was logged, which is every step."""
    task, times = TaskCost.of(World.from_scenario(scenario), scenario), states.sample_times()
    q, v = np.split(states.data().T, 2, axis=1)
    rates = task.running(times, q, v, controls.data().T)
    return float(np.trapezoid(rates, times) + task.final(q[-1], v[-1]))


def make_controllers(plan: Plan, planner: Planner, truth: Truth) -> dict[str, LeafSystem]:
    """Returns the methods' controllers."""
    true = World.from_diagram(build_plant(truth, planner.scenario)[0].Build())
    again: dict[str, Any] = {"period": PERIOD, "horizon": "shrinking"}
    search = {**again, "search_every": SEARCH_EVERY}
    return {
        "open loop": TrajectorySource(plan.trajectory.to_piecewise()[1]),
        "tracking": TrackingController(plan, period=PERIOD),
        "warm": ModelPredictiveController(planner, **again),
        "warm, search": ModelPredictiveController(planner, **search),
        BEST: ModelPredictiveController(Planner(planner.scenario, OPTIONS, true), **search),
    }


def report(outcomes: dict[str, list[Outcome]]) -> str:
    """Returns a table: costs above those of the one that knows, and how long ticks take."""
    known = np.array([each.cost for each in outcomes[BEST]])
    lines = [f"{'method':<16} mean above  median (quartiles)      switches  ms a tick, 99 %"]
    for name, runs in outcomes.items():
        above = np.array([each.cost for each in runs]) - known
        spread = Spread.of(above)
        line = f"{name:<16} {above.mean():10.2f}  {spread.median:6.2f}"
        line += f" ({spread.low:6.2f} … {spread.high:6.2f})"
        seconds = [second for each in runs for second in each.seconds]
        if seconds:
            middle, late = 1e3 * np.percentile(seconds, [50, 99])
            line += f"  {sum(each.switches for each in runs):8d}  {middle:5.1f} {late:6.1f}"
        lines.append(line)
    lines.append(f"costs of {BEST!r}: {Spread.of(known).show()}")
    return "\n".join(lines)


def main() -> int:
    """Runs all methods on the same truths, and prints a table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--count", type=int, default=100, help="of truths")
    parser.add_argument("--seed", type=int, default=2026, help="of the truths")
    options = parser.parse_args()
    scenario = Scenario.named(SCENARIO)
    plan, planner = Planner(scenario).plan(), Planner(scenario, OPTIONS)
    rng = np.random.default_rng(options.seed)
    outcomes: dict[str, list[Outcome]] = {}
    for number in range(options.count):
        truth = Truth.draw(rng, scenario.duration)
        for name, controller in make_controllers(plan, planner, truth).items():
            outcomes.setdefault(name, []).append(run(controller, truth, scenario, name != BEST))
        print(f"{number + 1} of {options.count}", file=sys.stderr, flush=True)
    print(report(outcomes))
    return 0


if __name__ == "__main__":
    sys.exit(main())
