"""Annealing within the first box: of any scale, and nowhere else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from box_programs import compile_program
from pydrake.solvers import ExpressionCost, MathematicalProgram

from drake_aigto.aigo import BoundedAnnealing, Box, BoxSearch, FaceFlow, Pace, minimize
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError
from drake_aigto.transcription import RigidTranscription
from drake_aigto.transcription.rows import NONPENETRATION, RESTITUTION
from drake_aigto.world import Scenario, World


def valley(scale: float) -> BoxPolynomial:
    """Returns a well in x₀, whose middle depends on x₁, a slope in x₁, and nothing of x₂."""
    prog = MathematicalProgram()
    x = prog.NewContinuousVariables(3, "x")
    cost = ExpressionCost(
        scale * ((x[0] + 1) ** 4 + 0.5 * (x[0] + 1) ** 2 + x[1] + 0.1 * (x[0] + 1) * x[1])
    )
    prog.AddCost(cost, vars=cost.vars())
    return compile_program(prog)


BOX = Box(np.array([0.1, 0.5, -1.0]), np.array([2.0, 1.5, 0.25]))


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_the_scale_of_a_cost_does_not_matter(scale: float) -> None:
    result = minimize(valley(scale), BOX, BoundedAnnealing())
    plain = minimize(valley(1.0), BOX, BoundedAnnealing())
    assert result.is_converged
    np.testing.assert_allclose(result.box.center, plain.box.center, atol=1e-4)
    # x₁ falls to its bound.
    np.testing.assert_allclose(result.box.center[:2], [-0.9, -1.0], atol=0.05)


def test_no_box_leaves_the_first_one_nor_grows_where_the_cost_is_flat() -> None:
    result = minimize(valley(1.0), BOX, BoundedAnnealing())
    for iterate in result.history:
        box = iterate.box
        assert np.all(box.half_width <= BOX.half_width * (1 + 1e-12))
        assert np.all(np.abs(box.center - BOX.center) <= BOX.half_width * (1 + 1e-12))
    np.testing.assert_allclose(result.box.half_width[2], 0.25)


def test_held_variables_stay() -> None:
    held = Box(BOX.center, np.array([2.0, 0.0, 0.25]))
    result = minimize(valley(1.0), held, BoundedAnnealing())
    assert result.box.center[1] == 0.5 and result.box.half_width[1] == 0.0
    assert result.box.center[0] == pytest.approx(-1.05, abs=0.02)


def test_options_are_checked() -> None:
    with pytest.raises(OptionsError, match="cooling: got 1, expected a number above 0 and below 1"):
        BoundedAnnealing(cooling=1.0)
    with pytest.raises(OptionsError, match="max_newton_steps: got 0, expected 1 or more"):
        BoundedAnnealing(max_newton_steps=0)


@pytest.mark.parametrize(
    "row", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)]
)
def test_the_default_search_finds_the_bounce_that_face_flow_misses(row: int) -> None:
    scenario = dataclasses.replace(Scenario.named(f"table1/{row}"), time_step=0.02)
    world = World.from_scenario(scenario)
    transcription = RigidTranscription(world, scenario)
    f = compile_program(transcription.penalized(), transcription.elimination_order())
    # Light restitution rows, as hot boxes have them in plans.
    unit = transcription.cost_scale()
    rows = {c.evaluator().get_description() for c in transcription.prog().GetAllConstraints()}
    known = {RESTITUTION: 2.0, NONPENETRATION: 3e3}
    weights = {name: unit * known.get(name, 3e2) for name in rows & set(f.weights)}
    box = Box(*transcription.initial_box())
    flow, both = (
        search.run(f.with_weights(weights), box).best
        for search in (BoxSearch(first=(FaceFlow(pace=Pace.EACH),)), BoxSearch())
    )
    assert np.max(transcription.impulses(flow.x)) < 0.01
    assert np.max(transcription.impulses(both.x)) > 1.0
    assert both.cost < 0.5 * flow.cost
