"""Runs in the loop: what disturbs plants, what a recording has of them, and its log."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loops import BALL, close_loop, make_plan, set_start
from matplotlib.figure import Figure
from pydrake.systems.analysis import Simulator

from drake_aigto import (
    ModelPredictiveController,
    Planner,
    PlanOptions,
    Scenario,
    TrackingController,
    World,
)
from drake_aigto.control import ClosedLoopRun, Disturbance, run_in_loop
from drake_aigto.errors import ControlError, ResultsFileError
from drake_aigto.show import figures_of_run, format_run, plot_run
from drake_aigto.world import STIFFNESS, find_model, read_given

POLE = Scenario.named("cart_pole/soft_06")
NOISE = np.array([1e-3, 1e-2])  # [m, m/s]
KICK = Disturbance(kick=np.array([0.3, 1.5]), kick_time=0.5)


@cache
def make_pole_planner() -> Planner:
    return Planner(POLE, PlanOptions(renewals=4))


def make_pole_controller() -> ModelPredictiveController:
    return ModelPredictiveController(make_pole_planner(), period=0.02, horizon="shrinking")


@cache
def replan() -> ClosedLoopRun:
    return run_in_loop(make_pole_controller(), POLE, make_pole_planner().world, KICK)


def track(disturbance: Disturbance | None = None, **options: Any) -> ClosedLoopRun:
    return run_in_loop(
        TrackingController(make_plan(), period=0.01), BALL, None, disturbance, **options
    )


@cache
def track_undisturbed() -> ClosedLoopRun:
    return track()


def test_without_disturbance_a_plan_keeps_its_promise_off_a_stiff_wall_and_is_shown_as_a_line() -> (
    None
):
    run = track_undisturbed()
    assert run.method == "tracking" and not run.ticks and not run.switches
    assert run.promised == make_plan().cost
    # The wall is late by a tenth of a millisecond, which costs a few percent of next to nothing.
    assert run.cost == pytest.approx(run.promised, rel=0.06)
    assert run.replay.bounce_times == pytest.approx(
        [contact.time for contact in make_plan().best.contacts], abs=1e-3
    )
    assert run.replay.energy_ratio == pytest.approx(BALL.restitution**2, abs=1e-3)
    assert 0 < run.replay.max_penetration < 1e-3
    shown = repr(run)
    assert "\n" not in shown and len(shown) < 400
    for told in (f"cost={run.cost:.4g}", f"promised={run.promised:.4g}", "bounces: 1", "energy"):
        assert told in shown
    assert "interrupted" not in shown


@pytest.mark.slow
def test_the_record_is_of_what_a_diagram_does() -> None:
    diagram, plant = close_loop(POLE.model, make_pole_controller())
    simulator = Simulator(diagram)
    simulator.get_mutable_integrator().set_target_accuracy(1e-8)
    context = set_start(plant, simulator.get_mutable_context(), POLE)
    simulator.AdvanceTo(KICK.kick_time)
    plant.SetVelocities(context, plant.GetVelocities(context) + KICK.kick)
    simulator.AdvanceTo(0.6)
    x = plant.GetPositionsAndVelocities(context)
    replay = replan().replay
    recorded = np.hstack([replay.positions, replay.velocities])
    (row,) = np.flatnonzero(np.isclose(replay.times, 0.6, rtol=0, atol=1e-12))
    np.testing.assert_allclose(recorded[row], x, atol=1e-3)


def test_a_start_that_is_given_by_names_is_moved_by_its_offset() -> None:
    scenario = Scenario.named("finger_and_box/push")
    world = World.from_scenario(scenario)
    offset = np.linspace(-0.01, 0.01, world.num_velocities)
    _, true = Disturbance(start_offset=offset).apply(world, scenario)
    named = world.place(scenario).initial_position
    np.testing.assert_allclose(world.subtract(true.initial_position, named), offset, atol=1e-12)


def test_a_kick_is_a_jump_and_a_plan_that_changes_its_mind_is_kept() -> None:
    run = replan()
    times, v = run.replay.times, run.replay.velocities
    before, after = np.flatnonzero(times == KICK.kick_time)
    np.testing.assert_allclose(v[after] - v[before], KICK.kick, atol=1e-12)
    (switch,) = run.switches
    assert switch.time == KICK.kick_time
    assert [tick.time for tick in run.ticks if tick.has_switched] == [switch.time]
    # The plan that is taken begins where the plant is, and the plant goes there.
    np.testing.assert_allclose(switch.after.states[0, 2:], v[after], atol=1e-9)
    end = run.replay.positions[-1]
    gone, came = (path.states[-1, :2] for path in (switch.before, switch.after))
    assert np.linalg.norm(end - came) < 0.1 * np.linalg.norm(end - gone)
    drawn = list(figures_of_run(run))
    assert [caption for _, caption in drawn if "0.50 s" in caption]
    axes = Figure().subplots()
    plot_run(axes, run, coordinate=1)
    labels = axes.get_legend_handles_labels()[1]
    assert {"simulation in Drake", "plan taken at 0.50 s"} <= set(labels)


@pytest.mark.slow
def test_what_is_true_is_what_was_asked_for() -> None:
    plain = track_undisturbed()
    heavy = track(Disturbance(mass_factor=1.2, restitution_factor=0.9))
    (energy,), (more,) = (run.replay.energies_before for run in (plain, heavy))
    assert more == pytest.approx(1.2 * energy, rel=0.05)
    assert heavy.replay.energy_ratio == pytest.approx(0.81, abs=1e-3)
    near = track(Disturbance(wall_shift=0.01, start_offset=np.array([0.002])), duration=0.6)
    assert near.replay.bounce_times[0] < plain.replay.bounce_times[0] - 1e-3
    assert near.replay.positions[0, 0] == BALL.initial_position[0] + 0.002
    cut = track(Disturbance(saturation=np.array([0.2]), start_offset=np.array([0.1])), duration=0.1)
    assert np.max(np.abs(cut.controls)) == 0.2
    noisy, again, other = (
        track(Disturbance(noise=NOISE, seed=seed), duration=0.1) for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(again.controls, noisy.controls)
    assert np.any(other.controls != noisy.controls)
    told = format_run(noisy)
    assert "noise of [0.001, 0.01] (seed 0)" in told and max(map(len, told.splitlines())) <= 100


@pytest.mark.parametrize("mass", [None, 2.0])
def test_true_masses_are_multiples_also_of_the_mass_that_a_scenario_gives(
    mass: float | None,
) -> None:
    scenario = dataclasses.replace(BALL, mass=mass)
    world = World.from_scenario(scenario)
    true, _ = Disturbance(mass_factor=1.5).apply(world, scenario)
    expected = 1.5 * world.sphere_mass
    assert true.calc_mass_matrix(scenario.initial_position).item() == pytest.approx(expected)
    context = true.plant.GetMyContextFromRoot(true.create_context())
    assert true.plant.CalcMassMatrix(context).item() == pytest.approx(expected)
    true.check(scenario)


def test_true_walls_are_as_stiff_as_was_asked_for() -> None:
    world = (planner := make_pole_planner()).world
    true, _ = Disturbance(stiffness_factor=0.5).apply(world, planner.scenario)
    for shape in world.shapes[0]:
        (found,), (given,) = (read_given(w.scene_graph, shape, STIFFNESS) for w in (true, world))
        assert found == 0.5 * given


def test_true_friction_is_that_of_contacts_and_joints() -> None:
    for name, field in (("hopper/hop", "friction"), ("cart_pole/dry", "dry_friction")):
        scenario = Scenario.named(name)
        world = World.from_scenario(scenario)
        true_world, true = Disturbance(friction_factor=0.5).apply(world, scenario)
        given = {"friction": scenario.friction, "dry_friction": scenario.dry_friction}[field]
        if given is not None:
            np.testing.assert_allclose(getattr(true, field), 0.5 * np.asarray(given))
        found, own = (
            each[0].friction_coefficients(each[1])
            for each in ((true_world, true), (world, scenario))
        )
        np.testing.assert_allclose(found, 0.5 * own, rtol=1e-15)
        true_world.check(true)


@pytest.mark.parametrize("name", ["pushed_block/slide", "finger_and_ball/roll"])
def test_each_contact_has_its_own_true_friction(name: str) -> None:
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    known = world.friction_coefficients(scenario)
    assert known.any()  # The block's pusher has none, and keeps none.
    for factor in (0.8, 1.25):
        true_world, true = Disturbance(friction_factor=factor).apply(world, scenario)
        found = true_world.friction_coefficients(true)
        np.testing.assert_allclose(found, factor * known, rtol=1e-14)


def test_ctrl_c_keeps_what_is_there(tmp_path: Path) -> None:
    def press(line: str) -> None:
        if "simulating, 0.3" in line:
            raise KeyboardInterrupt

    run = track(progress=press)
    assert run.is_interrupted and 0.29 < run.duration < 0.32
    run.save(tmp_path / "run.json")
    log = json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))
    assert log["simulation"] is True and log["is_interrupted"] is True
    assert log["replay"]["positions"][-1] == run.replay.positions[-1].tolist()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mass_factor": 0.0}, r"^mass_factor: got 0\.0, expected a number above 0"),
        ({"kick": [1.0, 2.0], "kick_time": 0.1}, "^kick: got 2 numbers, expected 1, or none"),
        ({"saturation": [0.0]}, r"^saturation: got \[0\.0\], expected limits above zero"),
        ({"noise": [-1.0, 0.0]}, "^noise: got .*, expected standard deviations"),
        ({"start_offset": [np.nan]}, "^start_offset: got .*, expected a row of finite numbers"),
        ({"kick": [1.0], "kick_time": 9.0}, r"^kick_time: got 9\.0, expected after the start, bef"),
        ({"kick": [1.0], "kick_time": 0.0}, r"^kick_time: got 0\.0, expected after the start, bef"),
        ({"delay": 9.0}, "^delay: got 9 s, expected less than the run's"),
        ({"restitution_factor": 1.2}, "^restitution_factor: got 1.2 times 1, expected"),
        ({"friction_factor": 1.2}, "^friction_factor: got no friction, expected friction in"),
    ],
)
def test_disturbances_that_make_no_sense_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ControlError, match=message):
        track(Disturbance(**changes))


def test_walls_that_can_not_be_disturbed_so_are_refused() -> None:
    for scenario, disturbance, message in (
        (POLE, Disturbance(restitution_factor=0.9), "compliant walls, which have none"),
        (Scenario.named("acrobot/swing_up"), Disturbance(wall_shift=0.1), "got no wall"),
        (Scenario.named("room_with_block/around"), Disturbance(wall_shift=0.01), "of a block"),
    ):
        with pytest.raises(ControlError, match=message):
            disturbance.apply(World.from_scenario(scenario), scenario)
    with pytest.raises(ControlError, match=r"^duration: got 0, expected seconds above zero"):
        track(duration=0)
    with pytest.raises(ControlError, match=r"^joints of the plant: got rail_x"):
        run_in_loop(TrackingController(make_plan()), POLE)


def test_a_wall_that_stands_nearer_is_nearer_by_so_much() -> None:
    world = make_pole_planner().world
    true, _ = Disturbance(wall_shift=0.03).apply(world, POLE)
    q = POLE.initial_position
    moved = world.calc_signed_distance(q) - true.calc_signed_distance(q)
    np.testing.assert_allclose(moved, 0.03, atol=1e-12)


def test_walls_farther_away_are_all_so_where_one_is_out_of_reach_then(tmp_path: Path) -> None:
    scenario = Scenario.named("corridor/lossy")
    text = find_model(scenario.model).read_text(encoding="utf-8")
    limits = "<limit><lower>-0.02</lower><upper>1.5</upper></limit></axis>"
    path = tmp_path / "corridor.sdf"
    path.write_text(text.replace("</axis>", limits), encoding="utf-8")
    scenario = dataclasses.replace(scenario, model=str(path))
    world, q = World.from_scenario(scenario), scenario.initial_position
    assert world.num_contacts == 2
    true, _ = Disturbance(wall_shift=-0.05).apply(world, scenario)
    assert [contact.name for contact in true.contacts] == [world.contacts[1].name]
    np.testing.assert_allclose(
        true.calc_signed_distance(q), world.calc_signed_distance(q)[1:] + 0.05, atol=1e-12
    )


def test_a_log_reads_back_to_the_same_run(tmp_path: Path) -> None:
    for run in (replan(), track(Disturbance(noise=NOISE), duration=0.1)):
        run.save(path := tmp_path / "run.json")
        again = ClosedLoopRun.load(path)
        for name in ("method", "scenario", "disturbance", "replay", "plan", "ticks", "switches"):
            assert getattr(again, name) == getattr(run, name), name
        np.testing.assert_array_equal(again.controls, run.controls)
        assert not again.controls.flags.writeable
        assert format_run(again) == format_run(run)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": "other"}, r"run\.json is not the log of a run in the loop: expected an object"),
        ({"version": 1}, r"^log .*run\.json: got version 1, expected version 2"),
        ({"promised": "a lot"}, r"is damaged: got run\.promised: got 'a lot', expected a number"),
        ({"more": 1}, "is damaged: got run: got unknown more"),
    ],
)
def test_a_log_that_is_none_is_refused(
    changes: dict[str, Any], message: str, tmp_path: Path
) -> None:
    replan().save(path := tmp_path / "run.json")
    data = json.loads(path.read_text(encoding="utf-8"))
    path.write_text(json.dumps({**data, **changes}), encoding="utf-8")
    with pytest.raises(ResultsFileError, match=message):
        ClosedLoopRun.load(path)
