"""The planner's own polish, for what others propose."""

from __future__ import annotations

from collections.abc import Iterable

from drake_aigto.arrays import Floats
from drake_aigto.baselines.baseline import Recorder
from drake_aigto.errors import AigtoError
from drake_aigto.planning import RigidProblem
from drake_aigto.transcription import TouchSequence


def offer_polished(
    recorder: Recorder, problem: RigidProblem, sequences: Iterable[TouchSequence], x: Floats
) -> None:
    """Polishes sequence after sequence until it is over, and offers the controls.

    As plans are polished: with the time steps of AIGO's boxes, and once more with the scenario's
    what is cheaper than all before.

    Args:
        recorder: of the question.
        problem: that the planner makes of it.
        sequences: of contacts.
        x: the problem's decision variables; where its path goes is where polishes start.
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
