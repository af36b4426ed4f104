"""What a gradient solver makes of the same scenario, to be shown beside a plan."""

from __future__ import annotations

from drake_aigto.baselines import run_baseline
from drake_aigto.paper import LiteralOptions, gradient_from_zero, make_literal_problem
from drake_aigto.show.motion import PLAN_LABEL, SIMULATION_LABELS, Motion
from drake_aigto.simulation.replay import replay_event_driven
from drake_aigto.world import Scenario, World

_ONE_WALL, _SEVERAL = "SNOPT from zero", "SNOPT from a random guess"
_RIGID = SIMULATION_LABELS["event-driven"]
# Of `run_baseline`: no clock ends the only guess, and any result does.
_SECONDS, _ANY_COST = 3600.0, 1e300


def gradient_motions(world: World, scenario: Scenario, seed: int = 0) -> list[Motion]:
    """Returns what SNOPT plans without AIGO, and what a rigid simulation makes of its control.

    With one contact, of the paper's literal transcription with φ free, from a guess of zeros: the
    plan and its simulation. With several, of the rigid transcription from one random guess: the
    simulation, as the rows of such plans are seldom met.

    Args:
        world: that the scenario fits.
        scenario: the question.
        seed: of the random guess.
    """
    if world.num_contacts == 1:
        return _literal_motions(world, scenario)
    found = run_baseline("snopt", world, scenario, _SECONDS, seed, _ANY_COST)
    assert found.times is not None and found.controls is not None
    replay = replay_event_driven(world, scenario, found.times, found.controls)
    simulated = Motion.from_replay(replay, f"{_SEVERAL}: {_RIGID}")
    return [simulated.under(found.times, found.controls)]


def _literal_motions(world: World, scenario: Scenario) -> list[Motion]:
    options = LiteralOptions(nonpenetration=False, local_solver="snopt")
    run = gradient_from_zero(make_literal_problem(world, scenario, options))
    planned = Motion.from_trajectory(run.trajectory, world, f"{_ONE_WALL}: {PLAN_LABEL}")
    simulated = Motion.from_replay(run.replay, f"{_ONE_WALL}: {_RIGID}")
    return [planned, simulated.under(run.trajectory.times, run.trajectory.controls)]
