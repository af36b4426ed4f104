"""The best costs that are known of the questions, and the controls that have them.

They are in `known.json`, beside this file: our own, whatever found them, and no optima that anybody
has proved. What finds a lower one may offer it.

The search for the best known: many tries of a method on every question, apart from any plan.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path

import numpy as np

from benchmarks.robots.judge import Control, judge
from benchmarks.robots.methods import METHODS
from benchmarks.robots.worlds import Question, scenario_of
from benchmarks.study.study import read_results, refuse_damaged
from drake_aigto.output import write_text
from drake_aigto.plain import from_plain, to_plain

PATH = Path(__file__).with_name("known.json")
_KIND = "best known"
_DECIMALS = 5  # of controls and times in the file [N], [s]


@dataclass(frozen=True)
class Known:
    """The best that is known of a question.

    Attributes:
        cost: the judge's, of the controls.
        found_by: the method.
        controls: held one after the other, each of nu numbers [N], [N m].
        times: between which they are held [s]; none: equal ones.
        tries: method → how many of its tries were made in search of it.
    """

    cost: float = np.inf
    found_by: str = ""
    controls: tuple[tuple[float, ...], ...] = ()
    times: tuple[float, ...] = ()
    tries: Mapping[str, int] = field(default_factory=dict)

    def control(self, question: Question) -> Control:
        """Returns the control that has this cost."""
        values = np.array(self.controls)
        even = Control.even(values, scenario_of(question).duration)
        return even._replace(times=np.array(self.times)) if self.times else even

    def offered(self, question: Question, found_by: str, control: Control) -> Known:
        """Returns what is known once a control is, too."""
        values = np.round(control.values, _DECIMALS)
        even = Control.even(values, scenario_of(question).duration)
        is_even = np.allclose(control.times, even.times, rtol=0.0, atol=1e-9)
        rounded = even if is_even else Control(np.round(control.times, _DECIMALS), values)
        score = judge(question, rounded).score
        if not score < self.cost:
            return self
        return replace(
            self,
            cost=score,
            found_by=found_by,
            controls=tuple(map(tuple, values.tolist())),
            times=() if is_even else tuple(rounded.times.tolist()),
        )

    def tried(self, method: str, count: int) -> Known:
        """Returns the same, with so many tries of a method made."""
        return self.merged(Known(tries={method: count}))

    def merged(self, other: Known) -> Known:
        """Returns the better one, with the tries of both."""
        better = self if self.cost <= other.cost else other
        names = sorted({*self.tries, *other.tries})
        tries = {name: max(self.tries.get(name, 0), other.tries.get(name, 0)) for name in names}
        return replace(better, tries=tries)


Table = dict[str, dict[int, Known]]  # Section → number of the question → best known.


def load_known() -> Table:
    """Returns all that is known.

    Raises:
        ResultsFileError: the file is damaged.
    """
    if not PATH.exists():
        return {}
    data = read_results(PATH, _KIND)
    with refuse_damaged(PATH):
        return {
            section: {
                int(number): from_plain(Known, each, f"{section} {number}")
                for number, each in rows.items()
            }
            for section, rows in data["questions"].items()
        }


def find_known(table: Table, question: Question) -> Known:
    """Returns what is known of a question; an infinite cost if nothing is."""
    return table.get(question.section, {}).get(question.number, Known())


def keep(question: Question, known: Known) -> None:
    """Writes what is known of one question; what others wrote of it meanwhile counts, too."""
    table = load_known()
    known = find_known(table, question).merged(known)
    table.setdefault(question.section, {})[question.number] = known
    rows = [
        f"{json.dumps(section)}: {{\n"
        + ",\n".join(f'"{number}": {json.dumps(to_plain(row[number]))}' for number in sorted(row))
        + "\n}"
        for section, row in sorted(table.items())
    ]
    text = ",\n".join(rows)
    write_text(PATH, f'{{"kind": "{_KIND}", "questions": {{\n{text}\n}}}}\n')


_BATCH = 50  # tries between two writings of the file


def search(
    questions: list[Question], method: str, tries: int, seconds: float, tell: Callable[[str], None]
) -> None:
    """Gives each question a number of tries of a method, those of earlier searches included.

    All questions have some tries before any has more, so that the search may end at any time.

    Args:
        questions: of which the best is searched.
        method: of `METHODS`.
        tries: for each question.
        seconds: after which no more are made.
        tell: called with a line where something better was found.
    """
    end = time.perf_counter() + seconds
    for most in range(_BATCH, tries + _BATCH, _BATCH):
        for question in questions:
            if time.perf_counter() > end:
                return
            before = find_known(load_known(), question)
            if before.tries.get(method, 0) < min(most, tries):
                known = _try(question, before, method, min(most, tries))
                keep(question, known)
                if known.cost < before.cost:
                    name = f"{question.section} {question.number}"
                    tell(f"{name}: {before.cost:.4f} → {known.cost:.4f}")


def _try(question: Question, known: Known, method: str, most: int) -> Known:
    """Returns what is known after a number of tries."""
    done = known.tries.get(method, 0)
    for attempt in islice(METHODS[method].run(question, done), most - done):
        # What is promised is a little off: what would be far worse isn't judged.
        if attempt.promised < 1.05 * known.cost:
            known = known.offered(question, method, attempt.control)
    return known.tried(method, most)
