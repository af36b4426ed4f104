"""A search over boxes: from the first box, and again from boxes around parts of the best point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from drake_aigto.aigo.algorithm import AigoResult, Algorithm, Box, Status, minimize
from drake_aigto.aigo.annealing import BoundedAnnealing, CenterObjective
from drake_aigto.aigo.coupling import CouplingGraph, Fusion
from drake_aigto.aigo.gradients import FaceFlow
from drake_aigto.arrays import Bools, Floats, Ints, read_only
from drake_aigto.box import BoxPolynomial
from drake_aigto.errors import OptionsError, check_counts

# Gauss-Legendre on [0, 1]: exact for polynomials of degree 16 along a line.
_NODES, _WEIGHTS = (a / 2 for a in np.polynomial.legendre.leggauss(8))
_NODES = _NODES + 0.5

# The flow keeps a box on its better side, which decides between many basins; annealing follows
# narrow valleys, as penalties of stiff dynamics are. One hot and one cold run see different ones.
_FIRST = (
    FaceFlow(is_coupled=False),
    BoundedAnnealing(initial_temperature=1e-3),
    BoundedAnnealing(initial_temperature=1e-5),
)
_RENEWAL = FaceFlow(share=0.5, least_shrink=0.1, final_width=0.2)
_LEAST_WIDTH = 0.1  # of a renewed box, as a part of the first one's
# Largest numbers of variables in a cluster, in turn; between any two, all variables are opened.
_CLUSTER_SIZES = (1, 2, 3, 4)
_MOST_STEPS = 100  # Newton steps after a box has shrunk
_TRIAL_STEPS = 20  # Newton steps of a renewal, before it has to be lower than the best for more
_BOLD_STEPS = 12  # Newton steps of many clusters at once; those that need more are left
_MOST_TERMS = 2e8  # terms evaluated in all that end the search: some five seconds
_IDLE_TERMS = 2e7  # terms evaluated in rounds without a lower f that end the search: half a second
_ROUNDING = 1e-9  # an f that is lower by this part of itself or less does not count as lower
_MIX = 2500  # terms that are evaluated in the time that a mix takes, for each variable
_MIXED = 4  # points that are mixed: the best one, and what renewals of all variables led to
_LEAST_SHIFT = -1.5  # of points near the best one: a power of ten, of the first box's half width
_LONGEST_REST = 7  # turns that a size of clusters is left out after it has failed


@dataclass(frozen=True)
class LowPoint:
    """A point that the search has found.

    Attributes:
        x: the point, shape (n,), read-only.
        cost: f(x).
        origin: which boxes it came from, in words.
        is_polished: whether a polish led to it.
    """

    x: Floats
    cost: float
    origin: str
    is_polished: bool = False


@dataclass(frozen=True)
class SearchResult:
    """The end of a search.

    Attributes:
        best: the candidate of least cost.
        unpolished: the one of least cost that no polish led to.
        candidates: every improvement, in the order in which they were found.
        num_boxes: boxes that were shrunk.
        num_steps: steps of the flow and of Newton's method in all of them.
        num_rounds: rounds of renewal.
        widths: geometric-mean half widths of the first box as it shrank, for each first algorithm.
        was_interrupted: whether Ctrl-C ended it.
    """

    best: LowPoint
    unpolished: LowPoint
    candidates: tuple[LowPoint, ...] = field(repr=False)
    num_boxes: int
    num_steps: int
    num_rounds: int
    widths: tuple[tuple[float, ...], ...] = field(repr=False)
    was_interrupted: bool = False


@dataclass(frozen=True, kw_only=True)
class BoxSearch:
    """Shrinks the first box, then renews boxes of some variables while the others are held.

    One run of AIGO commits every variable once, and a wide box of many variables judges each by
    means over all values of the others, also those that will be ruled out. So boxes are opened
    again, given the values of the other variables: in a round of renewal, connected clusters of
    variables, none coupled to another, are given random boxes inside the first one and all others
    are held. They shrink by a fast face flow, a few Newton steps end in a local minimum, and
    each cluster keeps its new values if f is lower for it. Clusters that are not coupled change f
    independently, so that a round tries as many boxes as there are clusters.

    After a renewal of all variables the best point is mixed with where the last three of them led,
    and then with local minima near it (`Fusion`), which renews clusters of any size at once: around
    loops, many variables have to change together to leave a minimum. That is left out where terms
    read more than four variables.

    Neither face flow nor annealing is better everywhere: measured, the flow solves the family of
    [5], where annealing's boxes collapse onto the middle, and annealing finds the bounces of
    penalized contact, which the flow misses. The search starts from the best of all.

    Attributes:
        first: the algorithms that shrink the first box, each from the start.
        rounds: the most rounds of renewal; 0 for none.
        patience: the search ends after this many rounds in a row without a lower f; fewer where a
            round costs much.
        polished_renewals: of the renewals of all variables, every second is polished, whether it
            is lower or not, up to this number: for an f that approximates the objective of a
            polish, as penalties do for constraints.
        seed: of the renewed boxes and clusters.
    """

    first: tuple[Algorithm, ...] = _FIRST
    rounds: int = 200
    patience: int = 80
    polished_renewals: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
        """Checks the ranges."""
        check_counts(self, rounds=0, patience=1, polished_renewals=0)
        if not self.first:
            raise OptionsError("first", got="no algorithm", expected="one or more")

    def run(
        self,
        f: BoxPolynomial,
        box: Box,
        polish: Callable[[Floats], Floats] | None = None,
        callback: Callable[[LowPoint], None] | None = None,
    ) -> SearchResult:
        """Searches a box for a low point of f; the same input gives the same bits.

        Args:
            f: the cost.
            box: where to search; no point of the answer is outside, unless polish leads there.
            polish: leads to a local minimum; called for the end of each first algorithm, for
                `polished_renewals` and for the end of the search.
            callback: called with every improvement.
        """
        return _SearchRun(self, f, box, polish, callback).run()


class _SearchRun:
    """One run."""

    def __init__(
        self,
        options: BoxSearch,
        f: BoxPolynomial,
        box: Box,
        polish: Callable[[Floats], Floats] | None,
        callback: Callable[[LowPoint], None] | None,
    ) -> None:
        self._options, self._f, self._box = options, f, box
        self._polish, self._callback = polish, callback
        self._lower, self._upper = box.center - box.half_width, box.center + box.half_width
        self._rng = np.random.default_rng(options.seed)
        self._graph = CouplingGraph.of(f)
        self._candidates: list[LowPoint] = []
        self._fusion = Fusion.of(f, _MIXED) if f.num_variables > 1 else None
        self._renewed: list[Floats] = []
        self._best = self._unpolished = self._candidate(box.center, "the middle of the first box")
        self._num_boxes = self._num_steps = self._num_of_all = 0
        self._num_rounds = self._num_mixes = 0

    def run(self) -> SearchResult:
        """Runs the first algorithms and the rounds, and polishes their results."""
        widths, was_interrupted = [], False
        try:
            for algorithm in self._options.first:
                widths.append(self._shrink_first(algorithm))
            self._renew()
        except KeyboardInterrupt:
            was_interrupted = True
        if self._num_rounds and self._polish is not None and not was_interrupted:
            name = f"polish of: {self._best.origin}"
            self._offer(self._polish(self._best.x), name, is_polished=True)
        return SearchResult(
            *(self._best, self._unpolished, tuple(self._candidates)),
            *(self._num_boxes, self._num_steps, self._num_rounds),
            *(tuple(widths), was_interrupted),
        )

    def _minimize(self, box: Box, algorithm: Algorithm) -> AigoResult:
        result = minimize(self._f, box, algorithm)
        if result.status is Status.INTERRUPTED:
            raise KeyboardInterrupt
        return result

    def _shrink_first(self, algorithm: Algorithm) -> tuple[float, ...]:
        """Shrinks the first box; returns its mean half widths."""
        result = self._minimize(self._box, algorithm)
        self._num_boxes += 1
        self._num_steps += result.num_inner_steps
        name = f"{type(algorithm).__name__} from the first box"
        x = np.clip(result.box.center, self._lower, self._upper)
        self._offer(x, name)
        x = self._descend(x, self._box.free)
        self._offer(x, name + ", Newton")
        if self._polish is not None:
            self._offer(self._polish(x), name + ", polished", is_polished=True)
        return tuple(iterate.box.mean_half_width for iterate in result.history)

    def _renew(self) -> None:
        """Runs the rounds, until they no longer lower f."""
        sizes = _Sizes(self._f.num_variables)
        idle, since = 0, self._work
        for number in range(1, self._options.rounds + 1):
            self._num_rounds = number
            improved = self._round(sizes.next(), number)
            sizes.learn(improved)
            idle = 0 if improved else idle + 1
            since = self._work if improved else since
            if idle >= self._options.patience or self._work - since >= _IDLE_TERMS:
                return
            if self._work >= _MOST_TERMS:
                return

    @property
    def _work(self) -> int:
        """Terms evaluated so far, or what takes as long."""
        return self._num_steps * self._f.num_terms + self._num_mixes * self._box.free.size * _MIX

    def _round(self, size: int, number: int) -> bool:
        """Renews the boxes of clusters of a size; returns whether that lowered f."""
        x, free = self._best.x, self._box.free
        labels = self._graph.clusters(size, free, self._rng)
        opened = labels >= 0
        result = self._minimize(self._random_box(x, opened), _RENEWAL)
        self._num_boxes += int(labels.max()) + 1
        self._num_steps += result.num_inner_steps
        y = self._descend(result.box.center, opened, together=labels.max() == 0)
        z = self._best_of_each(x, y, labels)
        name = f"renewal {number} of up to {size} variables"
        improved = self._offer(z, name)
        if labels.max() == 0:
            improved |= self._mix(y, name)
        if self._polish is not None and self._is_polished(size):
            improved |= self._offer(self._polish(y), name + ", polished", is_polished=True)
        return improved

    def _mix(self, y: Floats, name: str) -> bool:
        """Mixes the best point with where renewals led; returns whether that lowered f.

        Then with minima near it, at a distance by chance: they differ here and there only.
        """
        self._renewed = [y, *self._renewed][: _MIXED - 1]
        if self._fusion is None or len(self._renewed) < _MIXED - 1:
            return False
        improved, near = self._mix_with(self._renewed, name), []
        for _ in self._renewed:
            part = 10 ** self._rng.uniform(_LEAST_SHIFT, 0.0)
            shift = part * self._box.half_width * self._rng.normal(size=y.size)
            moved = np.clip(self._best.x + shift, self._lower, self._upper)
            near.append(self._descend(moved, self._box.free, together=False))
        return self._mix_with(near, name) or improved

    def _mix_with(self, others: list[Floats], name: str) -> bool:
        """Offers the best mix of the best point and others; returns whether it is lower."""
        assert self._fusion is not None
        self._num_mixes += 1
        free = self._box.free
        mixed = self._fusion.mix([self._best.x, *others], free, self._rng)
        if np.array_equal(mixed, self._best.x):
            return False
        return self._offer(self._descend(mixed, free), f"{name}, mixed")

    def _is_polished(self, size: int) -> bool:
        """Returns whether a renewal of this size is one of those that are polished."""
        if size < self._f.num_variables:
            return False
        self._num_of_all += 1
        number, odd = divmod(self._num_of_all, 2)
        return not odd and number <= self._options.polished_renewals

    def _random_box(self, x: Floats, opened: Bools) -> Box:
        """Returns random boxes inside the first one for the opened variables."""
        first = self._box
        part, place = self._rng.random((2, x.size))
        part = _LEAST_WIDTH + (1 - _LEAST_WIDTH) * part
        half_width = part * first.half_width
        center = first.center + (2 * place - 1) * (first.half_width - half_width)
        return Box(np.where(opened, center, x), np.where(opened, half_width, 0.0))

    def _descend(self, x: Floats, free: Bools, together: bool = True) -> Floats:
        """Returns a local minimum in the first box, nearly; or of each cluster for itself.

        Newton's method takes few steps after a renewal, and more where that pays.
        """
        objective = CenterObjective(self._f, free, 1e-6, (self._lower, self._upper))
        x = np.clip(x, self._lower, self._upper)
        if not together:
            x, steps = objective.descend_boldly(x, _BOLD_STEPS)
            self._num_steps += steps
            return x
        few = min(_TRIAL_STEPS, _MOST_STEPS) if self._num_rounds else _MOST_STEPS
        found = objective.descend(x, few)
        self._num_steps += found.steps
        if found.steps == few < _MOST_STEPS and found.value < self._best.cost:
            found = objective.descend(found.x, _MOST_STEPS - few, found.damping)
            self._num_steps += found.steps
        return found.x

    def _best_of_each(self, x: Floats, y: Floats, labels: Ints) -> Floats:
        """Returns x with the clusters of y in which f is lower."""
        if labels.max() <= 0:
            return y
        change = np.zeros(labels.max() + 1)
        opened = labels >= 0
        for node, weight in zip(_NODES, _WEIGHTS, strict=True):
            _, gradient, _ = self._f.gradient(x + node * (y - x), np.zeros(x.size))
            with np.errstate(over="ignore", invalid="ignore"):  # Far out f may overflow.
                np.add.at(change, labels[opened], weight * (gradient * (y - x))[opened])
        taken = opened & (change < 0)[labels]
        return np.where(taken, y, x)

    def _offer(self, x: Floats, origin: str, is_polished: bool = False) -> bool:
        """Keeps a point if it is the best; returns whether it is, by more than rounding."""
        before = self._best
        found = self._candidate(x, origin, is_polished)
        if not is_polished and found.cost < self._unpolished.cost:
            self._unpolished = found
        if not found.cost < before.cost:
            return False
        self._best = found
        self._candidates.append(found)
        if self._callback:
            self._callback(found)
        return not found.cost >= before.cost - _ROUNDING * max(1.0, abs(before.cost))

    def _candidate(self, x: Floats, origin: str, is_polished: bool = False) -> LowPoint:
        """Returns a point with its cost, infinite where f has no value."""
        cost = self._f(x)
        return LowPoint(read_only(x), np.inf if np.isnan(cost) else cost, origin, is_polished)


class _Sizes:
    """Goes around the sizes of clusters; one that fails rests, longer each time it fails again."""

    def __init__(self, all_variables: int) -> None:
        """Begins: every second turn is that of all variables."""
        smaller = [size for size in _CLUSTER_SIZES if size < all_variables]
        self._turns = [turn for size in smaller for turn in (all_variables, size)]
        self._turns = self._turns or [all_variables]
        self._rests = dict.fromkeys(self._turns, 0)
        self._waits = dict.fromkeys(self._turns, 0)
        self._at = -1

    def next(self) -> int:
        """Returns the next size that does not rest."""
        while True:
            self._at = (self._at + 1) % len(self._turns)
            size = self._turns[self._at]
            if self._waits[size] == 0:
                return size
            self._waits[size] -= 1

    def learn(self, improved: bool) -> None:
        """Lets a size rest that did not improve."""
        size = self._turns[self._at]
        self._rests[size] = 0 if improved else min(2 * self._rests[size] + 1, _LONGEST_REST)
        self._waits[size] = self._rests[size]
