"""Contact sequences: read off AIGO's boxes, and turned into guesses for a local solver."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from drake_aigto.transcription import Transcription

if TYPE_CHECKING:
    import numpy.typing as npt

# A knot counts as a contact if it comes this much nearer to the wall than start and goal.
_NEARER = 0.25

Knots = tuple[int, ...]


def contact_knots(transcription: Transcription, x: npt.NDArray[np.float64]) -> Knots:
    """Returns the contact sequence of decision variables: the knot that is deepest, or none.

    The rows need not hold: AIGO's box centers are read before any polish. One contact is all that
    the literal transcription needs, as one knot at the wall gives an impulse of any size; further
    visits to the wall are slack of the penalties.
    """
    scenario, world = transcription.scenario, transcription.world
    distances = np.min(transcription.signed_distances(x), axis=1)
    ends = (scenario.initial_position, scenario.goal_position)
    near = _NEARER * min(float(np.min(world.calc_signed_distance(q))) for q in ends)
    deepest = int(np.argmin(distances[1:-1])) + 1
    return (deepest,) if distances[deepest] < near else ()


def ballistic_guess(
    transcription: Transcription, x: npt.NDArray[np.float64], knots: Knots
) -> npt.NDArray[np.float64]:
    """Returns a guess that flies straight from the start over the contacts to the goal, u = 0.

    Only the contacts' knots, and where along the wall they are, are taken from x.

    Args:
        transcription: whose decision variables these are.
        x: AIGO's box center, shape (n,).
        knots: of the contacts, increasing.
    """
    scenario = transcription.scenario
    positions, _, controls = transcription.split(x)
    last = len(positions) - 1
    stops = {0: scenario.initial_position, last: scenario.goal_position}
    stops |= {k: _onto_wall(transcription, positions[k]) for k in knots}
    path = np.vstack(
        [scenario.initial_position]
        + [
            np.linspace(stops[first], stops[second], second - first + 1)[1:]
            for first, second in pairwise(sorted(stops))
        ]
    )
    steps = np.diff(path, axis=0) / transcription.time_step()
    velocities = np.vstack([steps, steps[-1:]])
    return np.concatenate([path.ravel(), velocities.ravel(), np.zeros(controls.size)])


def _onto_wall(transcription: Transcription, q: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Returns the nearest q with φ(q) = 0, exact for an affine φ."""
    J = transcription.world.calc_contact_jacobian(q)
    moved: npt.NDArray[np.float64] = q - np.linalg.pinv(J) @ (
        transcription.world.calc_signed_distance(q)
    )
    return moved
