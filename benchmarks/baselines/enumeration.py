"""Contact sequences listed by hand, what `plan` never does; and polishes, as those of plans are."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator

import numpy as np

from benchmarks.baselines.baseline import Baseline, Recorder
from drake_aigto.arrays import Floats
from drake_aigto.errors import AigtoError
from drake_aigto.planning import BallTask, make_ball_task
from drake_aigto.transcription import Touch, TouchSequence
from drake_aigto.world import World

_MOST_BOUNCES = 6
# At even parts s of the duration bounces are at T s^p: evenly, towards the start, towards the end.
_POWERS = (1.0, 2.0, 0.5)


class Enumeration(Baseline):
    """Every sequence of up to six bounces, at a few sets of times, polished as the planner's are.

    Polishes move the times, so that a few sets are enough. Contacts that last are not listed.
    """

    name = "enumeration"

    def search(self, recorder: Recorder, generator: np.random.Generator) -> None:
        """Goes through the list, which ends; there is no chance in it."""
        problem = make_ball_task(recorder.world, recorder.scenario)
        sequences = list_sequences(recorder.world, recorder.scenario.duration)
        offer_polished(recorder, problem, sequences, problem.box.center)


def list_sequences(world: World, duration: float) -> Iterator[TouchSequence]:
    """Yields all bounces within a duration [s] in all orders, evenly spread and shorter ones first.

    None follows itself where there are several contacts.
    """
    yield ()
    for power, number in itertools.product(_POWERS, range(1, _MOST_BOUNCES + 1)):
        times = duration * (np.arange(1, number + 1) / (number + 1)) ** power
        for contacts in itertools.product(range(world.num_contacts), repeat=number):
            repeats = any(one == other for one, other in itertools.pairwise(contacts))
            if world.num_contacts == 1 or not repeats:
                yield tuple(map(Touch.bounce, times.tolist(), contacts))


def offer_polished(
    recorder: Recorder, problem: BallTask, sequences: Iterable[TouchSequence], x: Floats
) -> None:
    """Polishes sequence after sequence of contacts until it is over, and offers the controls.

    As plans are polished: with the time steps of AIGO's boxes, and once more with the scenario's
    what is cheaper than all before. They start where the path of x goes, the problem's variables.
    """
    start = problem.transcription.GetSampleTimes(), problem.transcription.split(x)[0]
    for sequence in filter(problem.fits, sequences):
        if recorder.is_over:
            return
        cost, path = recorder.cost, start
        try:
            for num_steps in (None, recorder.scenario.num_steps):
                phases, y = problem.polish_along(path, sequence, num_steps)
                found = phases.trajectory(y)
                if recorder.offer(found.times, found.controls) >= cost:
                    break
                path, sequence = (found.times, found.positions), phases.contact_sequence(y)
        except AigtoError:
            continue  # Touches that no motion has.
