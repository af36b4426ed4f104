"""What a robot's task asks for: fields of a scenario that AIGTO's has none of."""

from __future__ import annotations

import dataclasses
import pickle
import re
from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
import pytest
from marks import slow
from mechanisms import build
from pydrake.common.value import AbstractValue
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder
from pydrake.systems.primitives import ConstantValueSource
from pydrake.trajectories import PiecewisePolynomial
from refusals import check_refused
from replay_worlds import make_scenario, make_task, shipped, shipped_world

from benchmarks.baselines import BASELINES, run_baseline
from benchmarks.optima import block_optimum, masses_optimum, walls_optimum
from drake_aigto import ModelPredictiveController, Plan, Planner, PlanOptions, Scenario, World
from drake_aigto.control import run_in_loop
from drake_aigto.errors import ControlError, ScenarioError
from drake_aigto.paper import (
    LiteralWithForces,
    RigidWithForces,
    SingleShooting,
    bounce_costs,
    make_literal_task,
    plan_literal,
    rigid_optimum,
)
from drake_aigto.planning import Candidate, Origin, PhaseProblem, PlanStats, Replays, make_ball_task
from drake_aigto.show import (
    Page,
    add_question,
    add_verdict,
    angle_text,
    format_plan,
    miss_text,
    simulation_label,
    task_items,
)
from drake_aigto.simulation import Replay
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import RigidTranscription
from drake_aigto.world import Scales, TaskCost

ENDS: dict[str, Any] = {
    "initial_position": [1.0, 0.2],
    "initial_velocity": [0.0, 0.5],
    "goal_position": [0.0, 3.0],
}


def test_a_plain_task_is_written_as_ever_and_one_that_asks_for_more_says_only_that() -> None:
    plain = Scenario(**ENDS)
    more = dataclasses.replace(plain, hard_goal=True, duration_range=(0.5, 2.0))
    added = {"hard_goal": True, "duration_range": [0.5, 2.0]}
    assert more.to_plain() == {**plain.to_plain(), **added}
    assert plain.is_plain
    assert not more.is_plain
    assert Scenario.from_plain(plain.to_plain()) == plain
    assert eval(repr(more)) == more
    assert "angles" not in repr(more)


@pytest.mark.parametrize("value", [2.0, [2.0], [[2.0]], np.full((1, 1), 2.0)])
def test_a_weight_of_one_coordinate_is_a_number(value: Any) -> None:
    scenario = Scenario(**ENDS, goal_weight=value)
    assert scenario.goal_weight == 2.0
    assert scenario.is_plain


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({"goal_weight": [1.0, 2.0]}, "goal_weight"),
        ({"control_weight": [1.0, 2.0]}, "control_weight"),
        ({"goal_velocity_weight": 1.0}, "goal_velocity_weight"),
        ({"goal_velocity": [0.0, 0.0], "hard_goal": True}, "goal_velocity"),
        ({"hard_goal": True}, "hard_goal"),
        ({"angles": "modulo"}, "angles"),
        ({"contact": "compliant"}, "contact"),
        ({"position_weight": [0.0, 1.0]}, "position_weight"),
        ({"velocity_weight": 1.0}, "velocity_weight"),
        ({"control_lower": -1.0}, "control_lower"),
        ({"position_upper": [5.0, np.inf]}, "position_upper"),
        ({"control_norm": 9.0}, "control_norm"),
        ({"duration_range": (0.5, 1.0)}, "duration_range"),
    ],
)
def test_who_plans_plain_tasks_refuses_what_it_would_ignore(
    given: dict[str, Any], name: str
) -> None:
    scenario = Scenario(**ENDS, **given)
    with pytest.raises(ScenarioError, match=rf"^{name}: got .* What plans for balls would ignore"):
        scenario.check_plain()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"angles": "wrapped"}, "angles: got 'wrapped', expected one of 'exact', 'modulo', 'chor"),
        ({"contact": None}, "contact: got None, expected one of 'rigid', 'compliant'"),
        ({"hard_goal": 1}, "hard_goal: got 1, expected true or false"),
        ({"goal_weight": None}, "goal_weight: got None (NoneType), expected a number"),
        ({"goal_weight": [1.0, -1.0]}, "goal_weight: got -1, expected at least 0"),
        ({"control_weight": [1.0, 0.0]}, "control_weight: got 0, expected more than 0"),
        ({"position_weight": [[1.0, 0.0], [0.0, 1.0]]}, "position_weight: got an array of shape"),
        (
            {"goal_weight": [[1.0, 2.0], [0.0, 1.0]]},
            "expected a number, one for each coordinate, or a symmetric matrix. Of any other",
        ),
        ({"goal_weight": [[1.0, 0.0]]}, "goal_weight: got a matrix [[1.0, 0.0]], expected"),
        ({"goal_weight": [[1.0, [0.0]]]}, "goal_weight: got [0.0] (list), expected a number"),
        ({"goal_weight": [[1.0, 0.0], [0.0]]}, "goal_weight: got [[1.0, 0.0], [0.0]], expected"),
        (
            {"goal_velocity_weight": [[0.0, 1.0], [1.0, 0.0]]},
            "goal_velocity_weight: got a matrix with the eigenvalue -1, expected none below 0",
        ),
        ({"control_norm": 0.0}, "control_norm: got 0, expected more than 0"),
        ({"duration_range": [2.0, 1.0]}, "duration_range: got from 2 to 1 s, expected the least"),
        ({"duration_range": [0.0, 1.0]}, "duration_range: got 0 s, expected more than 0 s"),
        ({"duration_range": 1.0}, "duration_range: got [1.0], expected the least and the most"),
        ({"duration_range": [2.0, 3.0]}, "duration: got 1 s, expected within duration_range, 2 to"),
        ({"control_lower": np.nan}, "control_lower: got nan, expected a finite number"),
        (
            {"position_lower": [0.0, 2.0], "position_upper": 1.0},
            "position_lower: got 2, with position_upper = 1, expected a lower bound that is not",
        ),
        ({"velocity_lower": np.inf}, "velocity_lower: got inf, with velocity_upper = inf"),
        (
            {"control_lower": [0.0, 0.0], "control_upper": [1.0, 1.0, 1.0]},
            "control_lower: got 2 numbers, and 3 in control_upper, expected as many in both",
        ),
        (
            {"goal_velocity": [1.0, 0.0]},
            "goal_velocity: got goal_velocity_weight = 0.0, hard_goal = False, veloc",
        ),
        ({"reference_times": [0.0, 1.0]}, "reference_times: got them alone, expected times, with"),
        (
            {"reference_positions": [[0.0, 0.0]], "position_weight": 1.0},
            "reference_times: got none, expected times, with reference_positions",
        ),
        (
            {"reference_times": [0.0], "reference_velocities": [[0.0, 0.0]]},
            "reference_velocities: got velocity_weight = 0.0, expected a weight that counts",
        ),
        (
            {
                "reference_times": [1.0, 0.0],
                "reference_positions": [[0.0, 0.0]] * 2,
                "position_weight": 1.0,
            },
            "reference_times: got [1.0, 0.0], expected increasing times",
        ),
        (
            {
                "reference_times": [0.0, 1.0],
                "reference_positions": [[0.0, 0.0]] * 3,
                "position_weight": 1.0,
            },
            "reference_positions: got 3 rows, expected 2, one for each time",
        ),
        (
            {"contact": "compliant", "restitution": 0.5},
            "restitution: got 0.5 with compliant contact, expected none",
        ),
    ],
)
def test_a_task_that_contradicts_itself_is_refused(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        Scenario(**ENDS, **given)


SWING: dict[str, Any] = {
    "initial_position": [0.1, 0.2],
    "initial_velocity": [0.0, 0.5],
    "goal_position": [0.0, 3.0],
    "goal_weight": [1.0, 2.0],
}
TURNED = 3.002 + 2 * np.pi  # A turn and 2 mrad beyond the goal.


@cache
def cart_pole() -> World:
    return World.from_scenario(Scenario.named("cart_pole/soft_06"))


def end_at(q: Any, v: Any, scenario: Scenario) -> Replay:
    q, v = np.array(q), np.array(v)
    ends = np.stack([scenario.initial_position, q]), np.stack([scenario.initial_velocity, v])
    return Replay(
        simulator="event-driven",
        cost=1.0,
        goal_error=float(TaskCost.of(cart_pole(), scenario).goal_error(q)),
        max_penetration=0.0,
        bounce_times=(),
        bounce_contacts=(),
        energies_before=(),
        energies_after=(),
        compliance_error=0.0,
        compliance_cost=0.0,
        matched_speeds=(),
        times=np.array([0.0, scenario.duration]),
        positions=ends[0],
        velocities=ends[1],
    )


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ({}, "1.0 mm and 6.29 rad"),
        ({"angles": "modulo"}, "1.0 mm and 2.0 mrad"),
        ({"angles": "chordal"}, "1.0 mm and 2.0 mrad"),
        (
            {"angles": "modulo", "goal_velocity_weight": [0.0, 1.0]},
            "1.0 mm, 2.0 mrad and 0.50 rad/s",
        ),
        # Where coordinates without weight end, nobody asked.
        ({"angles": "modulo", "goal_weight": [0.0, 1.0]}, "2.0 mrad"),
        ({"hard_goal": True, "goal_velocity": [0.25, -0.5]}, "1.0 mm, 6.29 rad, 0 m/s and 0 rad/s"),
    ],
)
def test_a_miss_is_told_in_the_units_of_what_misses(more: dict[str, Any], expected: str) -> None:
    scenario = Scenario(**{**SWING, **more})
    run = end_at([1e-3, TURNED], [0.25, -0.5], scenario)
    assert miss_text(run, scenario, cart_pole()) == expected


@pytest.mark.parametrize(
    ("radians", "text"),
    [(1.234, "1.23 rad"), (0.05, "50.0 mrad"), (3e-6, "3.0 µrad"), (0.0, "0 rad")],
)
def test_an_angle_is_told_in_the_unit_it_is_best_read_in(radians: float, text: str) -> None:
    assert angle_text(radians) == text


def test_a_world_knows_the_unit_of_its_coordinates() -> None:
    names = ("throwing_ball", "pendulum", "cart-pole")
    assert [build(name).position_unit for name in names] == ["m", "rad", "m, rad"]


def test_a_task_says_all_that_it_asks_for() -> None:
    scenario = Scenario(
        **SWING,
        goal_velocity=[0.0, 1.0],
        hard_goal=True,
        angles="modulo",
        duration_range=(0.5, 2.0),
        control_lower=-20.0,
        position_upper=[1.0, np.inf],
        contact="compliant",
    )
    assert task_items(scenario, cart_pole()) == [
        "q(0) = (0.1 m, 0.2 rad)",
        "v(0) = (0 m/s, 0.5 rad/s)",
        "goal (0 m, 3 rad)",
        "goal velocity (0 m/s, 1 rad/s)",
        "hard goal",
        "modulo angles",
        "duration range [0.5, 2]",
        "position upper [1, inf]",
        "control lower -20",
        "compliant contact",
    ]


def make_plan(scenario: Scenario) -> Plan:
    """Returns a plan that ends a millimeter, a turn and two milliradians off the goal."""
    run = end_at([1e-3, TURNED], [0.0, 0.0], scenario)
    still = np.zeros((2, 2))
    trajectory = Trajectory(run.times, run.positions, still, still[:1, :1], still, still[:1])
    candidate = Candidate(
        origin=Origin("boxes"),
        start_cost=2.0,
        start_defects={"dynamics": 0.0},
        trajectory=trajectory,
        cost=1.0,
        goal_error=run.goal_error,
        defects={"dynamics": 0.0},
        max_penetration=0.0,
        contacts=(),
        replay=run,
        scales=Scales.of(cart_pole(), scenario),
    )
    replays, stats, made_in = Replays(run, None), PlanStats(1, 1, {}), cart_pole().fingerprint
    return Plan(scenario, "mechanism", (candidate,), replays, stats, made_in)


def test_a_plan_of_a_mechanism_is_written() -> None:
    scenario = Scenario(**SWING, velocity_weight=[0.0, 1.0], angles="modulo", contact="compliant")
    plan = make_plan(scenario)
    text = format_plan(plan, cart_pole())
    assert text.count("ends 1.0 mm and 2.0 mrad off the goal") == 2
    assert "1.0 mm 2.0 mrad  none" in text  # In the table of candidates.
    assert "restitution" not in text and "stiffness 200 N/m, dissipation 0 s/m" in text
    assert max(map(len, text.splitlines())) <= 100
    again = dataclasses.replace(plan, scenario=dataclasses.replace(scenario, contact="rigid"))
    assert "restitution 1" in format_plan(again, cart_pole())


@pytest.mark.parametrize(
    ("more", "reached", "told"),
    [
        ({"angles": "modulo"}, True, "reached: it ends 1.0 mm and 2.0 mrad off"),
        ({}, False, "the weights trade it for a lower cost, of which control takes 0 %"),
        (
            {"velocity_upper": [0.0, np.inf]},
            False,
            "6.29 rad off, held back by velocity of cart_pole_soft_06_rail_v at most 0 (sc",
        ),
        (
            {"angles": "modulo", "goal_velocity": [0.0, 3.0], "goal_velocity_weight": [0.0, 1.0]},
            False,
            "not reached: it ends 1.0 mm, 2.0 mrad and 3.00 rad/s off",
        ),
    ],
)
def test_a_plan_that_keeps_its_promise_may_miss_its_goal_and_says_what_for(
    more: dict[str, Any], reached: bool, told: str
) -> None:
    plan = dataclasses.replace(make_plan(Scenario(**{**SWING, **more})), world=cart_pole())
    assert plan.reached is reached and f"reached={reached}" in repr(plan)
    lines = " ".join(format_plan(plan).split())
    assert told in lines, lines
    page = Page("")
    add_verdict(page, plan, cart_pole())
    assert f'{"holds" if reached else "fails"}">{"✓" if reached else "✗"} Goal ' in page.to_html()
    loaded = dataclasses.replace(plan, world=None)
    assert "reached" not in repr(loaded)  # Its world would have to be built.


def test_where_nothing_touches_no_wall_is_told_of() -> None:
    scenario = Scenario.named("acrobot/swing_up")
    world, page = World.from_scenario(scenario), Page("A question")
    add_question(page, scenario, world)
    asked = page.to_html()
    assert "pairs</th><td>none" in asked and "restitution" not in asked
    replay = end_at([0.0, 3.0], [0.0, 0.0], Scenario(**SWING))
    assert simulation_label(replay, world) == "simulation: integrated"
    assert simulation_label(replay, cart_pole()) == "simulation: exactly rigid"


@pytest.mark.parametrize("name", ["cart_pole/soft_10", *slow("cart_pole/rigid_10")])
def test_a_reference_goes_on_from_tick_to_tick(name: str) -> None:
    weights: dict[str, Any] = {
        "control_weight": 1e-3,
        "goal_weight": [0.0, 0.0],
        "goal_velocity_weight": [0.0, 0.0],
        "position_weight": [20.0, 1.0],
        "velocity_weight": [1.0, 0.1],
    }
    scenario = dataclasses.replace(
        Scenario.named(name),
        initial_position=[0.0, 0.0],
        initial_velocity=[0.0, 0.0],
        goal_position=[0.9, 0.0],
        angles="exact",
        duration=1.0,
        time_step=0.05,
        reference_times=[0.0, 3.0],
        reference_positions=[[0.0, 0.0], [0.9, 0.0]],
        reference_velocities=[[0.3, 0.0], [0.3, 0.0]],
        **weights,
    )
    options = PlanOptions(renewals=0, starts=3, finalists=1, confirm=False, threads=1)
    controller = ModelPredictiveController(Planner(scenario, options), period=0.05)
    run = run_in_loop(controller, scenario, duration=1.5)
    assert run.replay.positions[-1, 0] == pytest.approx(0.45, abs=0.03)
    without = dataclasses.replace(scenario, **NO_REFERENCE)
    path = PiecewisePolynomial.FirstOrderHold([0.0, 3.0], [[0, 0.9], [0, 0], [0.3, 0.3], [0, 0]])
    by_port, own = follow(Planner(without, options), path, 0.5), Planner(scenario, options)
    assert by_port == pytest.approx(follow(own, None, 0.5), rel=1e-3)


NO_REFERENCE: dict[str, Any] = {
    "reference_times": None,
    "reference_positions": None,
    "reference_velocities": None,
}


def follow(planner: Planner, path: PiecewisePolynomial | None, until: float) -> float:
    """Returns where a cart is that follows a trajectory by its port, or its scenario's."""
    controller = ModelPredictiveController(planner, period=0.05)
    builder = DiagramBuilder()
    plant: Any = builder.AddSystem(planner.world.diagram.Clone())
    builder.AddSystem(controller)
    builder.Connect(plant.GetOutputPort("state"), controller.get_input_port_estimated_state())
    builder.Connect(controller.get_output_port_control(), plant.GetInputPort("actuation"))
    if path is not None:
        source = builder.AddSystem(ConstantValueSource(AbstractValue.Make(path)))
        builder.Connect(source.get_output_port(), controller.GetInputPort("reference_path"))
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(until)
    context = plant.GetMyContextFromRoot(simulator.get_context())
    return float(plant.GetOutputPort("state").Eval(context)[0])


@pytest.mark.parametrize(
    ("path", "message"),
    [
        (
            PiecewisePolynomial.FirstOrderHold([0.0, 9.0], np.zeros((2, 2))),
            "^reference_path: got 2 by 1 numbers, expected q and v, 4 by 1",
        ),
        (
            PiecewisePolynomial.FirstOrderHold([0.0, 1.4], np.zeros((4, 2))),
            r"^reference_path: got one that ends at 1\.4 s, expected one until 1\.5 s",
        ),
    ],
)
def test_a_reference_that_does_not_fit_is_refused(path: Any, message: str) -> None:
    with pytest.raises(ControlError, match=message):
        follow(Planner(Scenario.named("cart_pole/soft_06")), path, 0.01)


Q_START, V_START, GOAL = [0.3, 0.2], [0.0, 0.0], [-0.2, 3.0]
TURNS = np.arange(-3, 4)
RUNNING: dict[str, Any] = {"position_weight": [2.0, 3.0], "velocity_weight": [0.1, 0.2]}
FINAL: dict[str, Any] = {
    "goal_weight": [[4.0, 1.0], [1.0, 5.0]],
    "goal_velocity_weight": [[2.0, -1.0], [-1.0, 3.0]],
}


@cache
def pole_and_cart() -> World:
    return build("cart-pole")


def ask_cost(**fields: Any) -> Scenario:
    given = {"goal_weight": [1.0, 1.0], **fields}
    return Scenario(initial_position=Q_START, initial_velocity=V_START, goal_position=GOAL, **given)


def cost_of(**fields: Any) -> TaskCost:
    return TaskCost.of(pole_and_cart(), ask_cost(**fields))


def motion(number: int = 7) -> tuple[Any, Any, Any, Any]:
    rng = np.random.default_rng(3)
    t = np.linspace(0.0, 1.0, number)
    return (
        t,
        rng.normal(size=(number, 2)),
        rng.normal(size=(number, 2)),
        rng.normal(size=(number, 1)),
    )


def test_a_plain_task_costs_what_it_always_did() -> None:
    world = World.from_scenario(Scenario.named("room/bank_shot"))
    scenario = Scenario.named("room/bank_shot")
    cost, rng = TaskCost.of(world, scenario), np.random.default_rng(1)
    t, (q, v, u) = np.arange(5.0), rng.normal(size=(3, 5, 2))
    effort = scenario.control_weight * np.sum(u**2, axis=1)
    miss = scenario.goal_weight * np.sum((q - scenario.goal_position) ** 2, axis=1)
    np.testing.assert_allclose(cost.running(t, q, v, u), effort, rtol=4e-16)
    np.testing.assert_allclose(cost.final(q, v), miss, rtol=4e-16)
    np.testing.assert_allclose(
        cost.goal_error(q), np.linalg.norm(q - scenario.goal_position, axis=1), rtol=4e-16
    )


def test_only_what_the_goal_weighs_is_off_it() -> None:
    scenario = Scenario.named("billiard/spin_shot")
    cost = TaskCost.of(World.from_scenario(scenario), scenario)
    assert cost.is_asked.tolist() == [True, True, False]
    q = scenario.goal_position + np.array([0.3, -0.4, 7.0])
    assert cost.goal_error(q) == pytest.approx(0.5)
    weightless = dataclasses.replace(scenario, goal_weight=np.zeros(3))
    assert TaskCost.of(World.from_scenario(scenario), weightless).is_asked.all()


def test_every_term_is_the_formulas() -> None:
    times, rows, speeds = [0.2, 0.8], [[0.0, 1.0], [2.0, -1.0]], [[1.0, 0.0], [0.0, 4.0]]
    cost = cost_of(
        **RUNNING,
        **FINAL,
        control_weight=0.5,
        goal_velocity=[1.0, -1.0],
        reference_times=times,
        reference_positions=rows,
        reference_velocities=speeds,
    )
    for t, q, v, u in zip(*motion(), strict=True):
        share = np.clip((t - 0.2) / 0.6, 0.0, 1.0)
        e_q = q - ((1 - share) * np.array(rows[0]) + share * np.array(rows[1]))
        e_v = v - ((1 - share) * np.array(speeds[0]) + share * np.array(speeds[1]))
        running = (
            0.5 * u[0] ** 2 + e_q @ np.diag([2.0, 3.0]) @ e_q + e_v @ np.diag([0.1, 0.2]) @ e_v
        )
        np.testing.assert_allclose(cost.running(t, q, v, u), running, rtol=1e-14)
        (a, b), (c, d) = q - GOAL, v - np.array([1.0, -1.0])
        final = 4 * a * a + 2 * a * b + 5 * b * b + 2 * c * c - 2 * c * d + 3 * d * d
        np.testing.assert_allclose(cost.final(q, v), final, rtol=1e-13)


def test_without_a_reference_the_way_is_weighed_about_the_goal() -> None:
    cost = cost_of(**RUNNING, goal_velocity=[0.5, 1.0])
    t, _, _, u = motion()
    rest = np.broadcast_to(GOAL, (7, 2)), np.broadcast_to([0.5, 1.0], (7, 2))
    np.testing.assert_array_equal(cost.running(t, *rest, u), 1e-3 * u[:, 0] ** 2)


@pytest.mark.parametrize("angles", ["modulo", "chordal"])
def test_turns_count_only_where_angles_are_exact(angles: Any) -> None:
    t, q, v, u = motion()
    weights = {**RUNNING, "goal_weight": [4.0, 5.0]}
    turned = q + np.array([0.0, 2 * np.pi]) * TURNS[:, np.newaxis]
    cost, exact = cost_of(**weights, angles=angles), cost_of(**weights)
    for each in (cost, exact):
        ratios = np.array(
            [
                each.running(t, turned, v, u) / each.running(t, q, v, u),
                each.final(turned, v) / each.final(q, v),
            ]
        )
        is_same = np.abs(ratios - 1) < 1e-12
        assert is_same.tolist() == [[each is cost or turn == 0 for turn in TURNS]] * 2
    np.testing.assert_allclose(cost.goal_error(turned), cost.goal_error(q), rtol=1e-12)
    assert np.all(np.abs(cost.goal_errors(turned)[:, 1]) <= np.pi)
    slid = q + np.array([2 * np.pi, 0.0])
    assert np.all(cost.final(slid, v) != cost.final(q, v))  # A slider does not turn.


def test_a_chord_squared_is_two_minus_two_cosines_and_nearly_the_angle_where_it_is_small() -> None:
    cost, exact = (cost_of(goal_weight=[0.0, 1.0], angles=each) for each in ("chordal", "exact"))
    angles = np.linspace(-3.0, 3.0, 13)
    q = GOAL + np.stack([angles, angles], axis=1)
    np.testing.assert_allclose(cost.final(q, q), 2 - 2 * np.cos(angles), atol=1e-14)
    small = GOAL + np.array([0.0, 1e-3])
    # 2 − 2 cos e = e² (1 − e²/12 + …)
    np.testing.assert_allclose(cost.final(small, small), exact.final(small, small), rtol=1e-7)
    assert cost.final(small, small) < exact.final(small, small)


def test_a_cost_is_pickled_equal_and_read_only() -> None:
    cost = cost_of(**RUNNING, **FINAL, angles="modulo")
    again = pickle.loads(pickle.dumps(cost))
    assert again == cost
    assert not again.QT.flags.writeable
    assert again.is_modulo.tolist() == [False, True]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"goal_weight": 1.0}, "goal_weight: got one number, 1, for sliders and hinges alike, exp"),
        (
            {"velocity_weight": 2.0},
            "velocity_weight: got one number, 2, for sliders and hinges alike, expected 2 numbers, "
            "as their units differ. Or weigh by names: velocity_weight: {a_joint: 1}.",
        ),
        ({"goal_weight": [1.0] * 3}, "goal_weight: got 3 values, expected 2, one for each coord"),
        ({"goal_weight": np.eye(3)}, "goal_weight: got 3 values a row, expected 2, one for each"),
        ({"control_weight": [1.0, 1.0]}, "control_weight: got 2 values, expected 1, one for each"),
        (
            {"goal_velocity": [1.0], "goal_velocity_weight": [1.0, 1.0]},
            "goal_velocity: got 1 value, expected 2",
        ),
        (
            {**RUNNING, "reference_times": [0.0], "reference_positions": [[1.0, 2.0, 3.0]]},
            "reference_positions: got 3 values a row, expected 2",
        ),
        (
            {**FINAL, "angles": "chordal"},
            "goal_weight: got [[4.0, 1.0], [1.0, 5.0]] with angles: chordal, expected nothing off",
        ),
    ],
)
def test_a_cost_that_does_not_fit_the_world_is_refused(
    fields: dict[str, Any], message: str
) -> None:
    with pytest.raises(ScenarioError, match=re.escape(message)):
        cost_of(**fields)


def test_weights_and_turns_fit_what_they_count_for() -> None:
    cost_of(goal_weight=0.0)
    cost_of(goal_weight=1.0, hard_goal=True)
    scenario = Scenario.named("table1/1")
    asked = Scenario(**{**scenario.to_plain(), "angles": "modulo"})
    with pytest.raises(ScenarioError, match="angles: got 'modulo', expected 'exact', as no coord"):
        World.from_scenario(scenario).check(asked)


def _run_baseline(name: str, world: World, task: Scenario) -> None:
    run_baseline(name, world, task, seconds=1.0)


# One field of each kind: costs, ends, bounds, contact, and time.
EXTRAS: dict[str, Any] = {
    "velocity_weight": 1.0,
    "hard_goal": True,
    "control_upper": 1.0,
    "contact": "compliant",
    "duration_range": (0.5, 2.0),
}
DOORS: dict[str, Callable[[World, Scenario], Any]] = {
    "plan_literal": lambda world, task: plan_literal(task, world=world),
    "make_literal_task": make_literal_task,
    "make_ball_task": make_ball_task,
    "SingleShooting": SingleShooting,
    "LiteralWithForces": LiteralWithForces,
    "RigidWithForces": RigidWithForces,
    "RigidTranscription": RigidTranscription,
    "PhaseProblem": PhaseProblem,
    "rigid_optimum": rigid_optimum,
    "bounce_costs": lambda world, task: bounce_costs(world, task, [0.5], [1.0]),
    "walls_optimum": walls_optimum,
    "masses_optimum": masses_optimum,
    "block_optimum": block_optimum,
    **{name: partial(_run_baseline, name) for name in BASELINES},
}


@pytest.mark.parametrize("field", EXTRAS)
@pytest.mark.parametrize("door", DOORS)
def test_a_task_that_would_lose_something_is_refused(door: str, field: str) -> None:
    task = make_scenario(**{field: EXTRAS[field]})
    with pytest.raises(ScenarioError, match=rf"^{field}: got .* would ignore it"):
        DOORS[door](shipped_world(), task)


def test_a_planner_refuses_such_weights_for_its_next_plan_too() -> None:
    task = make_task("room", [0.3, 0.7], [0.0, 0.0], time_step=0.1)
    planner = Planner(task, PlanOptions(confirm=False), shipped("room"))
    for name in ("goal_weight", "control_weight"):
        changed: dict[str, Any] = {name: [1.0, 2.0]}
        with pytest.raises(ScenarioError, match=rf"^{name}: got \[1.0, 2.0\], expected one number"):
            planner.plan(**changed)


def test_the_command_line_refuses_what_its_planner_would_ignore(capsys: Any) -> None:
    message = "control_norm: got 9.0, expected its default, None. What plans for balls"
    words = ["--transcription", "literal", "--control-norm", "9"]
    check_refused(["plan", "table1/1", *words], message, capsys)


def test_the_unit_of_costs_of_such_a_task_is_what_it_costs_to_stay() -> None:
    world, task = shipped_world(), make_scenario(2.0, 0.0, goal_weight=3.0, duration=2.0)
    miss = 2.0 - 0.73
    assert (
        Scales.of(world, task).cost
        == 3.0 * max(miss, world.calc_signed_distance(np.array([2.0]))[0]) ** 2
    )
    weighed = dataclasses.replace(task, position_weight=5.0)
    np.testing.assert_allclose(Scales.of(world, weighed).cost, (3.0 + 2.0 * 5.0) * miss**2)
    hard = dataclasses.replace(task, hard_goal=True)
    alone = dataclasses.replace(task, goal_weight=0.0)
    assert Scales.of(world, hard).cost == Scales.of(world, alone).cost > 0
