"""Programs over knots that users add to, and what they added, for AIGO and local solvers."""

from __future__ import annotations

import copy
import dataclasses
from abc import abstractmethod
from collections.abc import Hashable
from functools import partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydrake.solvers import Binding, MathematicalProgram
from pydrake.symbolic import Expression, Formula

from drake_aigto.arrays import Bools, Floats, Ints
from drake_aigto.errors import ProgramError
from drake_aigto.transcription.additions import (
    NO_ADDITIONS,
    SLACK,
    AddedRow,
    Addition,
    Additions,
    Part,
    Place,
    make_rows,
    read_binding,
)
from drake_aigto.transcription.consistency import check_bounds_of, check_linear, check_start
from drake_aigto.transcription.knot_program import KnotProgram, numbers_of
from drake_aigto.transcription.rows import SharedEvaluator, as_expression, shared_cost
from drake_aigto.world import Scenario, World

_NO_OTHERS = (
    "Write it as an expression of these: an inequality of several variables is given one of its "
    "own."
)

_Self = TypeVar("_Self", bound="OpenProgram")


class OpenProgram(KnotProgram):
    """A program that users add to, by the calls that MultipleShooting has or to `prog()` itself.

    `closed` is the program with what they added, for AIGO and local solvers.
    """

    def __init__(self, world: World, scenario: Scenario) -> None:
        """Lays out the variables."""
        # Costs and constraints of the program itself, and additions of users.
        self._additions = self._added = NO_ADDITIONS
        self._rows: list[AddedRow] = []
        self._frozen_count: tuple[int, int] | None = None
        super().__init__(world, scenario)

    @property
    @abstractmethod
    def _always_met(self) -> tuple[str, ...]:
        """The names of linear rows of its own that every motion meets."""

    @abstractmethod
    def _add_scenario(self) -> None:
        """Adds the initial state, the scenario's costs, and rows."""

    def _add_all(self) -> None:
        self._add_scenario()
        self._bind_costs(self._additions)
        for row in self._rows:
            for read in row.reads:
                self._attach(row.row, self._variables_at(read))
            if row.slacks.size:
                slacks = self._variables_at(row.slacks)
                self._bound(slacks, *row.bounds, row.row.get_description())

    def AddRunningCost(self, g: Any, description: str = "running cost") -> None:
        """Adds Σ_{k<N} h_k g(x_k, u_k), where h_k is the time from knot k to the next.

        Args:
            g: polynomial in the placeholders `state()` and `input()`.
            description: its name in the program and in costs by name.

        Raises:
            ProgramError: g reads other variables, or a plan was made already.
        """
        self._add(Additions(running=self._read(shared_cost(as_expression(g), description))))

    def AddFinalCost(self, e: Any, description: str = "final cost") -> None:
        """Adds e(x_N), polynomial in the placeholders `state()`.

        Raises:
            ProgramError: e reads other variables, or a plan was made already.
        """
        added = self._read(shared_cost(as_expression(e), description), reads_control=False)
        self._add(Additions(final=added))

    def AddConstraintToAllKnotPoints(
        self, f: Formula | NDArray[Any], description: str | None = None
    ) -> None:
        """Adds a constraint on placeholders at every knot, as MultipleShooting does.

        Constraints that read the control act at k < N; the state is that before an impact.

        Args:
            f: a formula, or an array of them.
            description: its name in verdicts; its text if None.

        Raises:
            ProgramError: f reads other variables than `state()` and `input()`, or a plan was made
                already.
        """
        for formula in np.ravel(np.asarray(f, dtype=object)):
            scratch = MathematicalProgram()
            scratch.AddDecisionVariables(list(formula.GetFreeVariables()))
            binding = scratch.AddConstraint(formula)
            binding.evaluator().set_description(description or str(formula))
            shared = SharedEvaluator(binding.evaluator(), tuple(binding.variables()))
            self._add(Additions(everywhere=self._read(shared)))

    def _add(self, more: Additions) -> None:
        """Adds a cost or constraint on every knot, as users wrote it."""
        if self._frozen_count is not None:
            raise _late()
        self._bind_costs(more)
        for each in more.everywhere:
            for k in each.knots(len(self._u)):
                self._attach(each.evaluator, self._variables_at(each.read(self._parts, k)))
        self._added = self._added.joined(more)

    def additions(self) -> Additions:
        """Returns all additions of users so far.

        Raises:
            ProgramError: what was added is on variables that are not of the state or the control,
                or the program's own costs and constraints are not all there.
        """
        foreign = self._foreign_bindings()
        if not (foreign or self._added):
            return self._additions
        places, expected = self._places(), "variables of state(k) and input(k)"
        at_knots = tuple(
            read_binding(each.evaluator(), each.variables(), places, expected, _NO_OTHERS)
            for each in foreign
        )
        found = Additions(at_knots=at_knots).joined(self._additions).joined(self._added)
        return self._at_own_knots(found)

    def _at_own_knots(self, additions: Additions) -> Additions:
        """Returns additions with the times of the knots here, and the scales."""
        length, T = self.length_scale(), self.scenario.duration
        scales: dict[Part, float] = {"q": length, "v": length / T}
        scales["u"] = self.inertia() * length / T**2
        return dataclasses.replace(additions, times=self.GetSampleTimes(), scales=scales)

    def closed(self: _Self) -> _Self:
        """Returns this transcription with additions of users, as AIGO and local solvers take it.

        Inequalities of several variables have a variable of their own there.

        Raises:
            ProgramError: see `additions`; or they contradict each other or the start.
            UnsupportedTermError: a constraint whose formula Drake does not give.
        """
        additions = self.additions()
        return self if additions is self._additions else self.with_additions(additions)

    def with_additions(self: _Self, additions: Additions) -> _Self:
        """Returns a copy of this transcription, as it was made, with these additions.

        Raises:
            ProgramError: they contradict each other or the start.
            UnsupportedTermError: a constraint whose formula Drake does not give.
        """
        other = copy.copy(self)
        other._forget_program()
        other._layout = self._layout.copy()
        additions = self._at_own_knots(additions)
        check_bounds_of(additions)
        check_start(additions, self.scenario.initial_position, self.scenario.initial_velocity)
        other._take(additions)
        names = {*self._always_met, *(each.name for each in additions.constraints)}
        check_linear(other.prog(), names)
        return other

    def _take(self, additions: Additions) -> None:
        """Lays out the variables that additions need; the program has them from its making on."""
        self._additions, self._added, self._rows = additions, NO_ADDITIONS, []
        for each in additions.constraints:
            knots = each.knots(len(self._u))
            reads = np.array([each.read(self._parts, k) for k in knots])
            stages = np.array(
                [max(k if p.knot is None else p.knot for p in each.places) for k in knots]
            )
            new = partial(self._layout.new, SLACK)
            self._rows += make_rows(each, additions, reads, stages, new)

    @property
    def structure(self) -> Hashable:
        """All that rows and costs depend on besides the world, users, and `parameters`."""
        rows = tuple((row.bounds, row.unit) for row in self._rows)
        return super().structure, rows

    def freeze(self) -> None:
        """Refuses additions from now on, to `prog()` itself by `check_frozen`."""
        self._frozen_count = self._num_foreign()

    def check_frozen(self) -> None:
        """Refuses additions since it was frozen.

        Raises:
            ProgramError: something was.
        """
        if self._frozen_count not in (None, self._num_foreign()):
            raise _late()

    def _num_foreign(self) -> tuple[int, int]:
        """Returns the numbers of variables, costs and constraints that users added."""
        prog = self._made
        if prog is None:
            return 0, 0
        bindings = len(prog.GetAllCosts()) + len(prog.GetAllConstraints())
        return prog.num_vars() - self._layout.size, bindings - self._num_bound

    def _foreign_bindings(self) -> list[Binding]:
        """Returns the costs and constraints that were added to `prog()` itself."""
        if self._made is None:
            return []
        bindings = [*self._made.GetAllCosts(), *self._made.GetAllConstraints()]
        foreign = [each for each in bindings if each.evaluator() not in self._own]
        if len(bindings) - len(foreign) != self._num_bound:
            raise ProgramError(
                "the program's own costs and constraints",
                got=f"{len(bindings) - len(foreign)} of them",
                expected=f"the {self._num_bound} that it was made with",
                remedy="Add to it, but neither remove from it nor bind its own rows again.",
            )
        for evaluator, numbers in self._own.items():
            if numbers_of(evaluator) != numbers:
                raise ProgramError(
                    f"the program's own '{evaluator.get_description()}'",
                    got="other bounds or coefficients than it was made with",
                    expected="what the scenario and the world say",
                    remedy="Change those, or add a constraint or cost of your own.",
                )
        return foreign

    @property
    def _parts(self) -> dict[Part, Ints]:
        return {"q": self._q, "v": self._v, "u": self._u}

    @property
    def _placeholders(self) -> dict[Part, NDArray[Any]]:
        world = self.world
        return {"q": world.positions, "v": world.velocities, "u": world.controls}

    def _places(self) -> dict[int, Place]:
        """Returns the place of each variable of the state and the control, by its id."""
        return {
            self._variables[indices[k, i]].get_id(): Place(part, i, k)
            for part, indices in self._parts.items()
            for k, i in np.ndindex(*indices.shape)
        }

    def _read(self, shared: SharedEvaluator, reads_control: bool = True) -> tuple[Addition]:
        """Returns additions on every knot, or on the last one, in placeholders."""
        places = {
            variable.get_id(): Place(part, i)
            for part, variables in self._placeholders.items()
            for i, variable in enumerate(variables)
            if reads_control or part != "u"
        }
        expected = "the placeholders state() and input()" if reads_control else "those of state()"
        remedy = "What is about one knot goes to prog()."
        return (read_binding(shared.evaluator, shared.placeholders, places, expected, remedy),)

    def _bind_costs(self, additions: Additions) -> None:
        for each in additions.running:
            read = [self._placeholders[place.part][place.coordinate] for place in each.places]
            g = as_expression(each.evaluator.Eval(np.array(read))[0])
            self._bind_stages(shared_cost(self._duration * g, each.name))
        last = self.num_samples() - 1
        for each in (*additions.final, *filter(lambda each: each.is_cost, additions.at_knots)):
            self._attach(each.evaluator, self._variables_at(each.read(self._parts, last)))

    def _stage_indices(self, k: int) -> Ints:
        slacks = [row.slacks[row.stages == k] for row in self._rows if row.slacks.size]
        return np.concatenate([super()._stage_indices(k), *slacks])

    def vector_of(self, positions: Floats, velocities: Floats, controls: Floats) -> Floats:
        """Returns all decision variables, for arrays as `split` returns them."""
        x = super().vector_of(positions, velocities, controls)
        for row in self._rows:
            row.fill(x)
        return x


def _late() -> ProgramError:
    return ProgramError(
        "the program of this planner",
        got="a cost or constraint after the first plan",
        expected="all of them before",
        remedy="Make a new Planner.",
    )


_START = "initial state"


class MotionProgram(OpenProgram):
    """Costs and constraints of users on the knots of a motion that shooting integrates.

    Its variables are q_k, v_k and u_k at the scenario's time steps, k = 0 … N; only x_0 is given.
    """

    @property
    def _always_met(self) -> tuple[str, ...]:
        return (_START,)

    @property
    def _duration(self) -> Expression:
        return Expression(self._dt)

    def _is_bounded(self) -> Bools:
        return np.zeros(self.world.num_contacts, dtype=bool)

    def _add_scenario(self) -> None:
        start = self.scenario.initial_state
        self._bound(self.state(0), start, start, _START)

    def _stage(self, k: int) -> list[tuple[NDArray[Any], NDArray[Any]]]:
        pairs = [(self.state(), self.state(k))]
        return [*pairs, (self.input(), self.input(k))] if k < len(self._u) else pairs

    def defects(self, x: Floats) -> dict[str, float]:
        """Returns {}: a program without rows has none."""
        return {}

    def impulses(self, x: Floats) -> Floats:
        """Returns zeros, shape (N+1, m) [N s]: the program knows no contact."""
        return np.zeros((len(self._q), self.world.num_contacts))
