"""Plans between rigid walls in which contact lasts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from drake_aigto import Planner, Scenario
from drake_aigto.planning import PlanOptions, lay_out
from drake_aigto.transcription import Touch

MODELS = Path(__file__).parents[1] / "models"


@pytest.mark.slow
def test_carts_are_pushed_apart_one_after_the_other() -> None:
    plan = Planner(Scenario.named("three_carts/apart"), PlanOptions(confirm=False)).plan()
    assert plan.holds
    assert plan.cost < 147.0
    assert sorted(contact.index for contact in plan.best.contacts) == [0, 1]
    for contact in plan.best.contacts:
        assert contact.last_time > contact.time + 0.05
    forces = plan.trajectory.forces
    assert forces is not None
    assert np.all(forces > -1e-6)
    assert np.max(forces) > 1.0


@pytest.mark.slow
def test_carts_in_a_row_press_both_contacts_at_once(tmp_path: Path) -> None:
    """The first one is driven: one cart at a time, plans cost 155."""
    model = (MODELS / "three_carts.sdf").read_text()
    driven, passive = "<effort>20</effort>", "<effort>0</effort>"
    (tmp_path / "row.sdf").write_text(model.replace(driven, passive).replace(passive, driven, 1))
    scenario = Scenario(
        model=str(tmp_path / "row.sdf"),
        initial_position=[-3.0, 0.0, 2.5],
        initial_velocity=[0.0, 0.0, 0.0],
        goal_position=[-1.0, 2.0, 4.5],
        duration=3.0,
        time_step=0.05,
        restitution=0.0,
        control_weight=0.1,
        velocity_weight=[0.1, 0.1, 0.1],
        goal_weight=[100.0, 100.0, 100.0],
        goal_velocity_weight=[10.0, 10.0, 10.0],
    )
    options = PlanOptions(renewals=0, starts=6, confirm=False)
    plan = Planner(scenario, options).plan()
    assert plan.holds
    assert plan.cost < 40.0
    forces = plan.trajectory.forces
    assert forces is not None
    assert np.any((forces > 0.1).all(axis=1))


def test_touches_that_last_are_held_until_they_end_or_another_one_begins() -> None:
    touches = (Touch(0.2, 0.5, 1), Touch.bounce(0.4, 0), Touch(0.6, 0.7, 1), Touch(0.8, 1.0, 0))
    times, phases = lay_out(touches, 20, 1.0, (1.0, 1.0), 2)
    np.testing.assert_array_equal(phases.contacts, [1, 0, 1, -1, 0])
    np.testing.assert_array_equal(phases.held[:, 0], [False] * 5 + [True])
    np.testing.assert_array_equal(phases.held[:, 1], [False, True, False, True, False, False])
    np.testing.assert_allclose(times[phases.knots], [0.2, 0.4, 0.6, 0.7, 0.8])
    assert times[-1] == pytest.approx(1.0)
    few, short = lay_out(touches, 3, 1.0, (1.0, 1.0), 2)
    assert len(short.contacts) == 2
    assert len(few) == 4


def test_touches_that_last_may_overlap_and_those_that_end_together_do_so_at_once() -> None:
    touches = (Touch(0.1, 0.8, 0), Touch(0.2, 0.4, 1), Touch(0.5, 0.805, 1))
    times, phases = lay_out(touches, 20, 1.0, (1.0, 1.0), 2)
    np.testing.assert_array_equal(phases.contacts, [0, 1, -1, 1, -1])
    np.testing.assert_array_equal(phases.held[:, 0], [False, True, True, True, True, False])
    np.testing.assert_array_equal(phases.held[:, 1], [False, False, True, False, True, False])
    np.testing.assert_allclose(times[phases.knots], [0.1, 0.2, 0.4, 0.5, 0.8])
