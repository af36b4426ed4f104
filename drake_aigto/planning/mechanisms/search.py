"""The search for a mechanism's plan: guesses of motions, which shooting closes."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from drake_aigto.errors import TrajectoryError
from drake_aigto.planning.candidate import COASTING, GIVEN, Candidate, Origin
from drake_aigto.planning.mechanisms.closing import Aim
from drake_aigto.planning.mechanisms.guesses import STARTS, Guess, StartName
from drake_aigto.planning.mechanisms.rigid_task import RigidMechanismTask
from drake_aigto.planning.mechanisms.settling import (
    MOST_RENEWED,
    Found,
    KeptMotion,
    are_same,
    best_of,
    calc_chance,
    find_limit,
    is_better,
    keep,
    part_far,
)
from drake_aigto.planning.mechanisms.task import MechanismTask
from drake_aigto.planning.mechanisms.touches import RoundedTouches, round_touches
from drake_aigto.planning.search import Proposal, Search, Stopwatch, scaled
from drake_aigto.shooting import ShootingResult
from drake_aigto.transcription import TouchSequence

_LOG = logging.getLogger(__name__)

_WORDS: dict[StartName, str] = {
    "push": "from a hand that pushes",
    "rest": "from standing still",
    "coast": "from the motion without control",
    "line": "from a line to the goal",
    "turn": "from a line to the goal, the other way round",
    "controls": "from controls",
}
# Renewals per wave: they are drawn from the motions that are kept, and closed together. Starts that
# follow sharp ones, which take least, are in waves of a few: limits come to count among them.
_WAVE, _FEW = 8, 4
# Costs below this part of the task's scale count as zero.
_NOTHING = 1e-12
# How often bounds are narrowed where a simulation exceeds them, at most.
_MOST_NARROWED = 2
# A polish that costs more than this times the motion before, as one whirled by a wall, is broken.
_BROKEN = 1.05
# Polished motions that cost more than this times the best that holds are not simulated.
_SIMULATED = 1.01
# Neighbors are tried of at most 3 of the best motions, which cost at most 1.5 times the best, and
# of at most 6 per wave of proposals: along a wall the number of sequences has no bound. Those with
# a touch less may cost 4 times as much as others at first: something has to do what the touch did.
_MOST_BRANCHED, _PROMISING, _MOST_BRANCHES, _DROPPED = 3, 1.5, 6, 4.0
# Motions of half the duration that a rest extends; first touches without control, beside all.
_MOST_EXTENDED, _FIRST = 4, (1, 2, 3)


class MechanismSearch(Search):
    """Guesses around a few starts, closed by shooting; then renewals of the best motions.

    Between rigid walls, a touch of the best motions is dropped, added, swapped with the next, or,
    with friction, changed to another mode or divided into two after each wave of proposals, until
    no change improves a motion. A polish is left unfinished as soon as it does not promise less
    than the best finalist that holds. Work is cut off by counts, and what is drawn depends on the
    seed alone, not on threads.

    Attributes:
        motions: the best so far.
    """

    task: MechanismTask

    def __init__(self, task: MechanismTask, clock: Stopwatch | None = None) -> None:
        """Starts with no motion."""
        super().__init__(task, clock)
        self.motions: list[KeptMotion] = []
        self._candidates: list[Candidate] = []
        self._tight: list[KeptMotion] = []  # The best motions, in shorter steps.
        self._far: list[KeptMotion] = []  # Those that cost far more, as they were found.
        self._sure: list[KeptMotion] = []  # The best of those that are known as they are.
        self._polished: list[KeptMotion] = []
        self._known: list[KeptMotion] = []  # Those that kept their promise, before and after.
        self._left_out: list[KeptMotion] = []  # As another one that holds costs less.
        self._aim = Aim()
        self._num_of_use = self._num_broken = 0
        self._scales = task.state_scales[: task.world.num_positions]
        self._rigid = task if isinstance(task, RigidMechanismTask) else None
        self._tried: set[RoundedTouches] = set()
        self._branched: list[KeptMotion] = []

    @property
    def candidates(self) -> Sequence[Candidate]:
        """The finalists, as they were judged."""
        return self._candidates

    @property
    def promise(self) -> float:
        """Cost of the best motion so far that violates nothing by much."""
        misses, cost = self.motions[0].rank if self.motions else (True, np.inf)
        return np.inf if misses else cost

    @property
    def found(self) -> int:
        """In how many searches that did not begin with it the best motion was found."""
        return self.motions[0].found if self.motions else 0

    def so_far(self) -> MechanismSearch:
        """Returns the search as it stands, with its best motion alone to be judged."""
        other = super().so_far()
        del other.motions[1:]
        return other

    def list_found(self) -> Sequence[KeptMotion]:
        """Returns the best motions so far."""
        return self.motions

    def propose(self) -> Iterator[Sequence[Proposal]]:
        """Yields guesses, that of a user first, and motions with the first touches without control.

        A fast start touches a wall at once, where springs are too coarse to tell how.
        """
        guesses, count = self.task.guesses, self.task.options.starts
        self.tell(f"shooting from {self.task.num_starts} starts")
        users = [] if self.guess is None else [partial(guesses.follow, self.guess)]
        given = [Proposal(Origin(GIVEN), partial(self._close, each)) for each in users]
        starts = [self._start(number, number < len(guesses.starts)) for number in range(count)]
        sharp = [
            Proposal(
                Origin(f"shooting {_WORDS[each]}, contact sharp{words}"),
                partial(self._close, partial(guesses.plain, each, 0.0, has_states)),
            )
            for each in guesses.sharp_starts
            for words, has_states in (("", True), (", simulated", False))
        ]
        touches = self._rigid.coasting if self._rigid else ()
        ends = sorted({min(end, len(touches)) for end in (*_FIRST, len(touches))} - {0})
        closes = (partial(self._bounce, touches[:end], None) for end in ends)
        first = [Proposal(Origin(COASTING), close) for close in closes]
        waves = (starts[i : i + _FEW] for i in range(0, count, _FEW))
        yield from [[*given, *sharp], *waves] if sharp else [[*given, *starts, *first]]
        if (shorter := self.task.shortened()) is not None:
            search = MechanismSearch(shorter, self.clock)
            search.explore(self._progress)
            self.tell("shooting from motions of half the duration, and rest")
            late = self.task.scenario.duration - shorter.scenario.duration
            kept = search.motions[:_MOST_EXTENDED]
            yield [self._extend(each, wait) for each in kept for wait in (0.0, late)]

    def vary(self) -> Iterator[Sequence[Proposal]]:
        """Yields renewals of the best motions, and new starts in turn."""
        options = self.task.options
        if options.renewals or not self.task.guesses.hurries:
            self._resolve()
        for first in range(0, options.renewals if self.motions else 0, _WAVE):
            cost = self.motions[0].cost
            is_free = not self.task.additions and cost <= _NOTHING * self.task.scales.cost
            if is_free or options.patience * self.chance < 1:
                break
            self._settle()
            best = f"the best costs {self.motions[0].cost:.6g}"
            self.tell(f"renewal {first} of {options.renewals}; {best}")
            yield [self._draw(each) for each in range(first, min(first + _WAVE, options.renewals))]
            self._resolve()

    def _settle(self) -> None:
        """Refines kept motions, whose closings may have ended early, before they are renewed."""
        raw = [each for each in self.motions if self.task.ends_early and not each.is_settled]
        refined = self._close_again(raw, partial(self.task.tighten, least=self.motions[0].cost))
        kept = [old.settled(new) for old, new in zip(raw, refined, strict=True)]
        self.motions = best_of([*kept, *(each for each in self.motions if each not in raw)])

    def _resolve(self) -> None:
        """Closes the kept motions anew in better steps while the best one's are too long."""

        def close(found: ShootingResult) -> ShootingResult:
            guess = Guess(found.times, found.controls, width=0.0, start=found.states[0])
            return self.task.close(guess, self._aim)

        while self.motions and self.task.is_coarse(best := self.motions[0].result):
            self._aim = self.task.refine(best)
            self.tell(f"shooting in {self._aim.substeps} steps of order {self._aim.order}")
            known = [each for each in self.motions if self.task.is_known(each.result)]
            again = self._close_again([each for each in self.motions if each not in known], close)
            if not (finite := [each for each in again if np.isfinite(each.cost)]):
                return
            self.motions = best_of([*finite, *known])

    def _close_again(
        self, motions: Sequence[KeptMotion], close: Callable[[ShootingResult], ShootingResult]
    ) -> list[KeptMotion]:
        wave = [Proposal(each.origin, partial(close, each.result)) for each in motions]
        closed = zip(motions, self._close_at_once(wave), strict=True)
        return [KeptMotion(m.origin, new, self.task.rank(new), m.found) for m, new in closed]

    @property
    def chance(self) -> float:
        """The estimated chance that the next search finds a better motion (`calc_chance`)."""
        return calc_chance(self.motions, self.searches, self.task.rank(self.task.coast))

    def _draw(self, number: int) -> Proposal:
        """Returns a renewal, or every second time a random start."""
        if number % 2:
            return self._start(self.task.options.starts + number // 2)
        rng = self._make_generator(number, is_renewal=True)
        motions = self.motions[: MOST_RENEWED if number % 4 else 1]
        motion = motions[int(rng.integers(len(motions)))]
        propose = partial(self.task.guesses.renew, motion.result, rng)
        return Proposal(motion.origin.renewed(), partial(self._close, propose, motion))

    def _make_generator(self, number: int, is_renewal: bool) -> np.random.Generator:
        return np.random.default_rng([self.task.options.seed, is_renewal, number])

    def _start(self, number: int, is_plain: bool = False) -> Proposal:
        guesses = self.task.guesses
        start = guesses.starts[number % len(guesses.starts)]
        rng = self._make_generator(number, is_renewal=False)
        is_plain &= start in STARTS
        propose = partial(guesses.plain, start) if is_plain else partial(guesses.draw, start, rng)
        words = f"shooting {_WORDS[start]}" + ("" if is_plain else ", perturbed")
        return Proposal(Origin(words), partial(self._close, propose))

    def _extend(self, motion: KeptMotion, late: float) -> Proposal:
        words = "after a wait" if late else "before a rest"
        propose = partial(self.task.guesses.extend, motion.result, late)
        return Proposal(Origin(f"{motion.origin}; {words}"), partial(self._close, propose))

    def _close(self, propose: Callable[[], Guess], parent: KeptMotion | None = None) -> Found:
        """Closes a guess."""
        guess = propose()
        return Found(self.task.close(guess, self._aim), parent, self.task.read(guess))

    def _bounce(self, touches: TouchSequence, parent: KeptMotion | None, by: float = 1.0) -> Found:
        """Closes touches; without a parent at any cost, as many of them begin at a high one."""
        assert self._rigid is not None
        near, most = (parent.result, scaled(by, self._aim.most)) if parent else (None, np.inf)
        return Found(self._rigid.bounce(touches, near, most), parent)

    def close(self, wave: Sequence[Proposal]) -> None:
        """Closes motions, and neighbors of the best until none of these leads to a better one."""
        self._close_wave(wave)
        for _ in range(_MOST_BRANCHES if self._rigid else 0):
            motion = self._find_unbranched()
            if motion is None:
                return
            self._branched.append(motion)
            if neighbors := list(self._list_neighbors(motion)):
                self._close_wave(neighbors)

    def _close_wave(self, wave: Sequence[Proposal]) -> None:
        """Closes motions, and keeps the best; those that cost too much are left unfinished.

        Where half are better than no control, others are not closed with more care: of 3,072 around
        cart-poles between soft walls 403 were, and two of these were kept.
        """
        most = scaled(self.task.close_ratio, find_limit(self.motions, self.task.num_limiting))
        is_patient = 2 * self._num_of_use <= self.searches
        self._aim = self._aim._replace(most=most, is_patient=is_patient)
        super().close(wave)

    def _find_unbranched(self) -> KeptMotion | None:
        """Returns one of the best motions with neighbors that were not tried yet."""
        best = self.motions[:_MOST_BRANCHED]
        for motion in best:
            is_promising = motion.cost <= scaled(_PROMISING, best[0].cost)
            known = (each for each in self._branched if are_same(each, motion, self._scales))
            if is_promising and all(is_better(motion, each) for each in known):
                return motion
        return None

    def _list_neighbors(self, motion: KeptMotion) -> Iterator[Proposal]:
        """Yields the neighbors of a motion that were not tried yet."""
        assert self._rigid is not None
        for change, touches in self._rigid.find_neighbors(motion.result):
            if (key := round_touches(touches, self.task.scenario.duration)) not in self._tried:
                self._tried.add(key)
                origin = motion.origin.changed(change, motion.result.touches)
                by = _DROPPED if change == "dropped" else 1.0
                yield Proposal(origin, partial(self._bounce, touches, motion, by))

    def keep(self, origin: Origin, found: Found) -> None:
        """Keeps a motion if it is among the best, and no better one is near."""
        self._num_of_use += self.task.is_of_use(found.result)
        self.searches += 1
        for each in filter(None, (found.known, found.result)):
            motion = KeptMotion(origin, each, self.task.rank(each))
            if each is found.known:
                self._sure = best_of([*self._sure, motion])[:MOST_RENEWED]
            is_kept = each is found.result or self.task.guesses.hurries
            if is_kept and np.isfinite(motion.cost):
                self.motions = keep(self.motions, motion, found.parent, self._scales)

    def judge(self) -> None:
        """Polishes and judges the best motions."""
        near, self._far = part_far(self.motions)
        self._refine(near)

    def _refine(self, motions: Sequence[KeptMotion]) -> None:
        """Refines motions, the first one if interrupted, and judges the best of these."""
        tight: list[KeptMotion] = []
        with self.clock("polish"), self.ended_by_ctrl_c(lambda: motions):
            for motion in motions[: 1 if self.is_interrupted else None]:
                least = min((each.cost for each in tight if not each.rank[0]), default=np.inf)
                result = self.task.tighten(motion.result, least)
                tight.append(KeptMotion(motion.origin, result, self.task.rank(result)))
        self._tight = best_of(tight) or list(motions[:1])
        self._judge_best()

    def _judge_best(self) -> None:
        """Polishes and judges the motions that remain, one that holds of those near each other.

        It ends once enough finalists hold or cost more than one that does, or those that remain
        promise to. Finalists that broke a promise say nothing of the next ones, also near them, nor
        do motions that are known as they are, no optima: these come first, until one holds. Those
        that cost far more have their turn if none holds for less.
        """
        for motion in (*self._sure, *self._tight):
            if (is_known := self.task.is_known(motion.result)) and self._holding:
                continue
            enough = self.task.finalists + self._num_broken
            is_full = len(self._holding) + len(self._left_out) >= enough
            is_ended = self.is_interrupted and self._polished
            if is_full or is_ended or motion.cost > self._scale_best(self.task.polish_ratio):
                return
            known = (each for each in self._known if are_same(motion, each, self._scales))
            if any(each.result is motion.result for each in self._polished) or any(known):
                continue
            self._polished.append(motion)
            count, polished = len(self._candidates), self._polish(motion)
            rank, judged = self.task.rank(polished), self._candidates[count:]
            most = scaled(max(_BROKEN, self.task.polish_ratio), motion.cost)
            is_broken = is_known or rank > (motion.rank[0], scaled(_BROKEN, motion.cost))
            is_broken |= any(each.replay.cost > most for each in judged)
            self._num_broken += is_broken
            if not is_broken and all(each.is_confirmed for each in judged):
                self._known += [motion, KeptMotion(motion.origin, polished, rank)]
        if self._far and self._far[0].cost < self._scale_best(1.0):
            far, self._far = self._far, []
            self._refine(far)

    @property
    def _holding(self) -> list[float]:
        """Costs of the candidates that passed all their simulations."""
        kept = [each for each in self._candidates if each.is_feasible and each.is_confirmed]
        kept = [each for each in kept if each.holds(self._replays.get(id(each), each.own_replays))]
        return [each.replay.cost for each in kept]

    def _scale_best(self, times: float) -> float:
        """Returns a multiple of the best cost that holds, infinite while there is none."""
        return scaled(times, min(self._holding, default=np.inf))

    def _polish(self, motion: KeptMotion) -> ShootingResult:
        """Adds the candidate of a motion, and returns the polished motion.

        It is polished again within narrower bounds if only simulations exceed them, from starts
        that are off as well, or beside a hard goal that these miss by little.
        """
        start = motion.result
        self.tell(f"polishing a motion that costs {start.cost:.6g}")
        polished, problem = start, self.task
        try:
            for _ in range(1 + _MOST_NARROWED):
                with (
                    self.clock("polish"),
                    self.ended_by_ctrl_c(lambda: [] if self._candidates else [start]),
                ):
                    polished = problem.polish(polished, self._scale_best(1.0))
                most, rank = self._scale_best(_SIMULATED), self.task.rank(polished)
                if polished.is_left or (most < np.inf and not rank <= (False, most)):
                    _LOG.info("  left out: cost %.6g", polished.cost)
                    self._left_out.append(motion)
                    return polished
                with self.clock("replay"):
                    candidate = self.task.judge(motion.origin, motion.result, polished)
                narrower = problem.narrowed(polished, candidate)
                if self.is_interrupted or narrower is None or rank[0]:
                    break
                problem = narrower
        except TrajectoryError as error:
            _LOG.info("  not a candidate: %s", error)
            return polished
        self._candidates.append(candidate)
        told = candidate.describe_contacts(), candidate.cost, candidate.replay.cost
        _LOG.info("  %s: cost %.6g, replayed %.6g", *told)
        return polished

    def add_left_out(self) -> None:
        """Judges candidates left out because of one that a simulation has contradicted since."""
        left_out, self._left_out = self._left_out, []
        for motion in left_out:
            self._polish(motion)
        self._judge_best()

    def rank(self, candidate: Candidate) -> tuple[float, ...]:
        """Orders by feasibility, what the independent replay confirms, and its cost."""
        return not candidate.is_feasible, not candidate.is_confirmed, candidate.replay.cost
