"""Boxes with several faces: the face in force stands for all, and changes on the way around."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest
from phase_solutions import Solved, optimise
from rigid_worlds import Array
from unfolded_flights import MODELS, Flight

from drake_aigto import Scenario, World
from drake_aigto.errors import OptionsError
from drake_aigto.planning import PhaseProblem
from drake_aigto.transcription import Facing, Touch, find_facings

# Contacts of room_with_block: the block keeps q out of [0.4, 0.6]².
RIGHT, LEFT, BACK, FRONT = 4, 5, 6, 7  # faces towards +x, −x, +y, −y


@cache
def room() -> World:
    return World.from_scenario(make_scenario([0.1, 0.1], [0, 0], [0.9, 0.9]))


def make_scenario(q: Any, v: Any, goal: Any, steps: int = 40) -> Scenario:
    return Scenario(
        model=MODELS.format("room_with_block"),
        initial_position=q,
        initial_velocity=v,
        goal_position=goal,
        time_step=1 / steps,
    )


def faces_along(path: list[list[float]], *touches: Touch) -> list[int]:
    times = np.linspace(0, 1, len(path))
    return [facing.contact for facing in find_facings(room(), times, np.array(path), touches)]


def test_the_block_is_where_the_tests_have_it() -> None:
    q = np.array([0.7, 0.35])
    names = [contact.name for contact in room().contacts[4:]]
    assert [name.split()[-2] for name in names] == ["+x", "-x", "+y", "-y"]
    np.testing.assert_allclose(room().calc_signed_distance(q)[4:], [0.1, -0.3, -0.25, 0.05])


def test_a_path_is_in_front_of_few_faces() -> None:
    assert faces_along([[0.1, 0.1], [0.3, 0.9]]) == [LEFT]
    # Past a corner either face does, and no third one is needed.
    assert faces_along([[0.1, 0.1], [0.1, 0.9], [0.9, 0.9]]) == [LEFT, BACK]
    assert faces_along([[0.1, 0.1], [0.9, 0.1]]) == [FRONT]
    around = [[0.1, 0.5], [0.1, 0.9], [0.9, 0.9], [0.9, 0.1], [0.1, 0.1]]
    assert faces_along(around) == [LEFT, BACK, RIGHT, FRONT]


@pytest.mark.parametrize(("height", "side"), [(0.53, BACK), (0.47, FRONT)])
def test_a_path_through_the_block_goes_around_the_nearer_side(height: float, side: int) -> None:
    path = [[0.1, height], [0.9, height]]
    assert faces_along(path) == [LEFT, side, RIGHT]
    facings = find_facings(room(), np.array([0.0, 2.0]), np.array(path))
    turns = [facing.start for facing in facings]
    # It comes in at x = 0.4 and is nearer to the side from 0.47 on.
    assert turns == pytest.approx([0.0, 2 * (0.47 - 0.1) / 0.8, 2 * (0.53 - 0.1) / 0.8], abs=0.02)


def test_a_touched_face_is_the_one_in_force() -> None:
    path = [[0.2, 0.2], [0.4, 0.5], [0.2, 0.8]]
    assert faces_along(path, Touch.bounce(0.5, LEFT)) == [LEFT]
    along = [[0.2, 0.9], [0.5, 0.6], [0.55, 0.6], [0.9, 0.9]]
    assert faces_along(along, Touch(1 / 3, 2 / 3, BACK)) == [BACK]


def test_worlds_without_boxes_have_no_faces_to_choose() -> None:
    world = World.from_scenario(
        Scenario(
            model=MODELS.format("room"),
            initial_position=[0.1, 0.1],
            initial_velocity=[0, 0],
            goal_position=[0.5, 0.5],
        )
    )
    assert find_facings(world, np.array([0.0, 1.0]), np.array([[0.1, 0.1], [0.9, 0.9]])) == ()


def clearances(found: Solved) -> Array:
    """Returns them between knots, too: positions are parabolas there."""
    state, _ = found.trajectory.to_piecewise()
    times = np.linspace(0, 1, 801)
    return np.array([room().calc_clearance(state.value(t)[:2, 0])[-1] for t in times])


def test_a_flight_goes_around_the_block_as_close_as_it_may() -> None:
    scenario = make_scenario([0.1, 0.5], [1.0, 0.0], [0.9, 0.52])
    found = optimise(room(), scenario)
    facings = found.facings
    assert [facing.contact for facing in facings] == [LEFT, BACK, RIGHT]
    # The turns are free, so that nothing keeps it from passing the corners closely.
    motion = found.trajectory
    knots = np.searchsorted(motion.times, [facing.start - 1e-12 for facing in facings[1:]])
    nearest = np.linalg.norm(motion.positions[knots] - [[0.4, 0.6], [0.6, 0.6]], axis=1)
    assert np.min(nearest) < 1e-6
    assert np.min(clearances(found)) > -1e-6
    assert np.min(clearances(found)) < 1e-3
    # Around the other side it is farther, for the goal is higher.
    other = optimise(
        room(),
        scenario,
        facings=[Facing(0.0, LEFT), Facing(0.35, FRONT), Facing(0.65, RIGHT)],
    )
    assert other.cost > 1.05 * found.cost
    assert np.min(clearances(other)) > -1e-6


def test_a_bounce_off_the_block_unfolds() -> None:
    # Mirrored at x = 0.4; along y nothing is in the way.
    flights = Flight(0.1, 0.5, 0.8 - 0.2, 1.0), Flight(0.3, 0.4, 0.6, 1.0)
    scenario = make_scenario([0.1, 0.3], [0.5, 0.4], [0.2, 0.6])
    found = optimise(room(), scenario, Touch.bounce(0.5, LEFT))
    assert found.cost == pytest.approx(sum(flight.cost for flight in flights), rel=2e-3)
    (touch,) = found.sequence
    assert touch.contact == LEFT
    assert np.min(clearances(found)) > -1e-9
    replay = found.replay()
    assert replay.cost == pytest.approx(found.cost, rel=1e-6)
    assert replay.bounce_contacts == (LEFT,)


def test_a_face_is_touched_within_its_edges() -> None:
    # By itself it would pass the face's height at y = 0.65, above the corner.
    scenario = make_scenario([0.1, 0.65], [0.8, 0.0], [0.1, 0.65])
    found = optimise(room(), scenario, Touch.bounce(0.4, LEFT))
    (touch,) = found.sequence
    k = int(np.argmin(np.abs(found.trajectory.times - touch.start)))
    np.testing.assert_allclose(found.trajectory.positions[k], [0.4, 0.6], atol=1e-6)


@pytest.mark.parametrize(
    ("facings", "message"),
    [
        ([], "got faces of one box from [] s on, expected the first from 0 s, and increasing"),
        ([Facing(0.2, LEFT)], "got faces of one box from [0.2] s on"),
        ([Facing(0.0, LEFT), Facing(1.0, BACK)], "got faces of one box from [0.0, 1.0] s on"),
        ([Facing(0.0, 0)], "got contacts [0], expected those of [4, 5, 6, 7], the faces of boxes"),
        ([Facing(0.0, 8)], "got contacts [8], expected those of [4, 5, 6, 7], the faces of boxes"),
        (
            [Facing(0.0, BACK)],
            "got another face than ball against block, -x face, which is touched, expected that "
            "one at 0.5 s",
        ),
    ],
)
def test_faces_that_leave_out_the_box_are_refused(facings: list[Facing], message: str) -> None:
    scenario = make_scenario([0.1, 0.1], [0, 0], [0.2, 0.2])
    with pytest.raises(OptionsError) as error:
        PhaseProblem(room(), scenario, [Touch.bounce(0.5, LEFT)], facings)
    assert str(error.value).startswith(f"facings: {message}")
