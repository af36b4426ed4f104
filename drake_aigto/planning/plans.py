"""Plans: trajectory, verdict, candidates and statistics. Immutable, JSON."""

from __future__ import annotations

import dataclasses
import importlib
import json
import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from drake_aigto.certify import PlanBound
from drake_aigto.errors import AigtoError, DamagedDataError, ModelError, PlanFileError
from drake_aigto.plain import LEFT_OUT, from_plain, read_json, to_plain, write_text
from drake_aigto.planning.candidate import Candidate, Replays, Veto
from drake_aigto.planning.feedback import Feedback
from drake_aigto.planning.options import SearchOptions
from drake_aigto.planning.tracked import confirm_in_drake, perturb, replay_own
from drake_aigto.simulation import BOUNDS, CLEARANCE, EDGES, HARD_GOAL, Arrival, Replay, confirms
from drake_aigto.trajectory import Trajectory
from drake_aigto.transcription import largest_defect
from drake_aigto.world import Fingerprint, Scenario, World

_LOG = logging.getLogger(__name__)

FORMAT = "drake_aigto plan"
FORMAT_VERSION = 4

# A plan is not idle where the uncontrolled motion costs at most this part of the task's scale: what
# its replay adds by rounding.
_NOTHING = 1e-6
# What saves at most this part of what the uncontrolled motion costs is hardly better than that.
_HARDLY = 1e-2


@dataclass(frozen=True)
class PlanStats:
    """Iterations and seconds of a plan.

    Attributes:
        aigo_steps: inner iterations of AIGO, all candidates; 0 of mechanisms.
        polished: number of candidates that are feasible after their polish.
        seconds: wall time by part of the road.
        box_contacts: numbers of contacts of the last box of each rung, before any polish; None for
            a rung that was left out.
        flight_left_out: lower bound of a free flight's cost, if it was left out because of that.
        searches: mechanisms: how many guesses were closed.
        found: in how many of those that did not begin with it the best motion was found: what was
            found once may not be the best there is.
    """

    aigo_steps: int
    polished: int
    seconds: Mapping[str, float]
    box_contacts: tuple[int | None, ...] = ()
    flight_left_out: float | None = None
    searches: int = 0
    found: int = 0

    def __str__(self) -> str:
        """Returns the size of the search in words."""
        if not self.searches:
            return f"{self.aigo_steps} iterations of AIGO"
        if self.found > 1:
            return f"found {self.found} times in {self.searches} searches"
        times = f"once in {self.searches}" if self.found else f"in none of {self.searches} other"
        return f"found {times} searches: more renewals or another seed may find a better motion"


class PlanningError(AigtoError, RuntimeError):
    """Failure to find a plan; the message says what was tried.

    Attributes:
        plan: the best that does not hold, if there is one.
        is_proven: whether it is proven that no motion can reach the goal.
    """

    plan: Plan | None = None
    is_proven: bool = False


@dataclass(frozen=True)
class Plan:
    """A plan for a scenario, and the verdict on it.

    Attributes:
        scenario: the question.
        transcription: its name.
        candidates: all of them, the best first.
        replay: simulations of the best one's control.
        stats: iterations and seconds.
        made_in: fingerprint of its world.
        is_interrupted: whether Ctrl-C ended the search before it was done.
        bound: lower bound of the cost of any plan; None unless requested by the options.
        options: that it was made with; None: not known.
        world: that it was made in, while it is in memory: files and copies in other processes do
            not have it (`find_world`).
    """

    scenario: Scenario
    transcription: str
    candidates: tuple[Candidate, ...]
    replay: Replays
    stats: PlanStats
    made_in: Fingerprint
    is_interrupted: bool = False
    bound: PlanBound | None = None
    options: SearchOptions | None = field(default=None, metadata=LEFT_OUT)
    world: World | None = field(default=None, compare=False, repr=False, metadata=LEFT_OUT)

    def __post_init__(self) -> None:
        """Refuses a plan without candidates."""
        if not self.candidates:
            raise PlanFileError("candidates", got="none", expected="at least one")

    def __repr__(self) -> str:
        """Returns a line without arrays: the cost, its simulations and its verdict."""
        best, ratio = self.best, self.best.energy_ratio
        facts = [
            f"cost={self.cost:.4g}",
            *(f"{replay.simulator}={replay.cost:.4g}" for replay in self.replay),
            f"holds={self.holds}",
            # A file's plan has no world yet, and building one takes a while.
            *([] if self.world is None else [f"reached={self.reached}"]),
            best.describe_contacts(),
            f"largest defect {largest_defect(self.defects, best.scales):.1e}",
            f"deepest penetration {best.max_penetration + 0.0:.2g} m",
            *([] if ratio is None else [f"energy ratio {ratio:.4g}"]),
            *(
                [f"with feedback: errors grow {best.growth.factor:.1e} times"]
                if best.gains and best.growth
                else []
            ),
            *(["interrupted"] if self.is_interrupted else []),
            *([self.idleness] if self.idleness else []),
        ]
        return f"Plan({', '.join(facts)})"

    def __getstate__(self) -> dict[str, Any]:
        """Returns the state for copies and other processes: all but the world."""
        return {**self.__dict__, "world": None}

    @property
    def best(self) -> Candidate:
        """The chosen candidate."""
        return self.candidates[0]

    @property
    def additions(self) -> tuple[str, ...]:
        """Names of costs and constraints of users (`Planner.transcription`)."""
        named = {**self.best.added_costs, **self.best.replay.violations}
        own = BOUNDS, HARD_GOAL, CLEARANCE, EDGES
        return tuple(name for name in named if name not in own)

    @property
    def cost(self) -> float:
        """J of the scenario's task (`TaskCost`), and costs of users, of the chosen trajectory."""
        return self.best.cost

    @property
    def lower_bound(self) -> float | None:
        """A lower bound of the cost under any control; None if none was found."""
        return self.bound.lower_bound if self.bound else None

    @property
    def gap(self) -> float | None:
        """Relative gap between that and the simulated cost (`PlanBound.gap`)."""
        return self.bound.gap(self.replay.event_driven.cost) if self.bound else None

    @property
    def trajectory(self) -> Trajectory:
        """The chosen trajectory."""
        return self.best.trajectory

    @property
    def defects(self) -> Mapping[str, float]:
        """Its largest violation of each kind of row (m, m/s)."""
        return self.best.defects

    @property
    def holds(self) -> bool:
        """Whether it `keeps_promise`, and is better than the uncontrolled motion."""
        return self.keeps_promise and not self.is_beaten

    @property
    def keeps_promise(self) -> bool:
        """Whether every replay that was run confirms the chosen trajectory (`replay.confirms`)."""
        return self.best.holds(self.replay)

    def find_arrival(self, world: World | None = None) -> Arrival:
        """Returns how near its goal the chosen trajectory ends.

        Raises:
            ModelError: from `find_world`.
        """
        t = self.trajectory
        ends = t.positions, t.velocities, t.controls
        return Arrival.of(self.find_world(world), self.scenario, *ends)

    @property
    def reached(self) -> bool:
        """Whether the chosen trajectory ends at its goal, of which `holds` says nothing."""
        return self.find_arrival().is_reached

    @property
    def is_beaten(self) -> bool:
        """Whether the uncontrolled motion, if confirmed, costs less between rigid walls."""
        idle, replay = self.idle, self.replay.event_driven
        if idle is None or not (idle.is_feasible and idle.holds(Replays(idle.replay, idle.drake))):
            return False
        is_known = replay.added_costs.keys() == idle.added_costs.keys()
        free = dataclasses.replace(replay, violations={})
        return is_known and not confirms(idle.cost, free, idle.scales)

    @property
    def idleness(self) -> str:
        """Words for a plan that is hardly better than the uncontrolled motion; else none.

        In simulation, it then saves no more than 1 % of what that costs. A task whose uncontrolled
        motion costs nothing asks for nothing else, and a hard goal that it misses for more.
        """
        if self.idle is None or HARD_GOAL in self.idle.replay.broken:
            return ""
        if abs(self.idle.replay.cost) <= _NOTHING * self.best.scales.cost:
            return ""
        if self.best.is_idle:
            return "does nothing"
        saved = self.idle.replay.cost - self.replay.event_driven.cost
        is_little = saved <= _HARDLY * abs(self.idle.replay.cost)
        return "hardly better than doing nothing" if is_little and self.holds else ""

    @property
    def vetoes(self) -> tuple[Veto, ...]:
        """The candidates that promise less, and the first simulation that contradicts each."""
        found = []
        for candidate in self.candidates[1:]:
            replays = (candidate.replay, *filter(None, [candidate.drake]), *candidate.perturbed)
            against = [replay for replay in replays if not candidate.is_confirmed_by(replay)]
            if candidate.is_feasible and candidate.cost < self.cost and against:
                found.append(Veto(candidate, against[0]))
        return tuple(found)

    @property
    def idle(self) -> Candidate | None:
        """The uncontrolled motion, which a plan has to beat; None if the search left it out."""
        return next((candidate for candidate in self.candidates if candidate.is_idle), None)

    def find_world(self, world: World | None = None) -> World:
        """Returns the world of the plan: its own, its model's, or the given one.

        Raises:
            ModelError: it was made in a diagram of the user, which is needed; or the given world or
                the model has changed.
            ScenarioError: the scenario does not fit the given world.
        """
        world = world or self.world or self._build_world()
        if world is self.world:
            return world
        remedy = "Give the world that the plan was made in."
        if world.model is not None and world.model == self.made_in.model:
            remedy = f"Plan again: {world.model} is not as it was when the plan was made."
        self.made_in.check(world.fingerprint, remedy)
        world.check(self.scenario)
        return world

    def _build_world(self) -> World:
        """Returns the world of the model that the plan was made in."""
        if self.made_in.model is None:
            raise ModelError(
                "the plan was made in a diagram of one's own",
                expected="that diagram, which no file has",
                remedy="In Python, load the plan, and give world=World.from_diagram(diagram).",
            )
        return World.from_scenario(dataclasses.replace(self.scenario, model=self.made_in.model))

    def plot(self, world: World | None = None) -> Any:
        """Returns a Matplotlib figure of the motion and its numbers over time (`show.plot`)."""
        return view("plot", self, world)

    def animate(self, path: str | os.PathLike[str], **look: Any) -> Any:
        """Writes a GIF, WebP or MP4 of the motion, and returns its path (`show.animate`)."""
        return view("animate", self, path, **look)

    def to_dataframe(self, world: World | None = None) -> Any:
        """Returns the trajectory as a pandas DataFrame (`show.to_dataframe`)."""
        return view("to_dataframe", self, world)

    def _repr_html_(self) -> str:
        """Returns verdicts and a picture, for a notebook."""
        return str(view("to_html", self))

    def replayed(self, world: World | None = None, confirm: bool = True) -> Plan:
        """Returns the plan with new simulations of its control.

        Args:
            world: see `find_world`.
            confirm: whether its control is also run on Drake's plant.

        Raises:
            ModelError: from `find_world`.
        """
        world, scenario, t, best = self.find_world(world), self.scenario, self.trajectory, self.best
        feedback = None
        perturbed: tuple[Replay, ...] = ()
        if best.gains and best.growth:
            feedback = Feedback(world, scenario, t, best.gains)
            perturbed = perturb(world, scenario, feedback, best.growth)
        replays = replay_own(world, scenario, t, feedback)
        drakes = confirm_in_drake(world, scenario, t, feedback) if confirm else []
        alone = (*replays[1:], *drakes[1:])
        replay = Replays(replays[0], drakes[0] if confirm else None, alone, perturbed)
        return dataclasses.replace(self, replay=replay, world=world)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes a JSON file that `load` reads back to the same numbers, whole or not at all.

        Raises:
            OutputFileError: the file can't be written.
        """
        head = {"format": FORMAT, "version": FORMAT_VERSION}
        data = {**head, **to_plain(self), "options": to_plain(self.options)}
        write_text(path, json.dumps(data) + "\n")

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Plan:
        """Reads a plan file.

        Raises:
            PlanFileError: no such file, cut short, not a plan, or of another version.
        """
        data = read_json(path, "plan file", PlanFileError)
        _check_version(path, data)
        try:
            return _read(data)
        except (AigtoError, AttributeError, TypeError) as error:
            raise PlanFileError(
                f"plan file {path} is damaged", got=error, remedy="Plan again."
            ) from error


def _check_version(path: str | os.PathLike[str], data: Any) -> None:
    """Removes the format and its version from a plan file's data, and refuses others."""
    if not isinstance(data, dict) or data.pop("format", None) != FORMAT:
        raise PlanFileError(
            f"{path} is not a plan file",
            expected=f"an object with the format {FORMAT!r}",
            remedy="Write one with `drake-aigto plan SCENARIO --json FILE`.",
        )
    version = data.pop("version", None)
    if version != FORMAT_VERSION:
        raise PlanFileError(
            f"plan file {path}",
            got=f"version {version!r}",
            expected=f"version {FORMAT_VERSION}",
            remedy="Plan again with this version of drake_aigto.",
        )


def _read(data: dict[str, Any]) -> Plan:
    """Returns the plan of a file; its options are those of its transcription.

    Other versions may have others: these are left out, with a warning, as the plan stays the same.
    """
    if "options" not in data:
        raise DamagedDataError("plan.options", got="nothing", expected="a value")
    options = data.pop("options")
    plan = from_plain(Plan, data, "plan")
    if options is None:
        return plan
    kind = SearchOptions.kind_of(plan.transcription)
    if unknown := options.keys() - {each.name for each in dataclasses.fields(kind)}:
        names = ", ".join(sorted(unknown))
        _LOG.warning("options of another version of drake_aigto are left out: %s", names)
    known = {name: options[name] for name in options.keys() - unknown}
    return dataclasses.replace(plan, options=from_plain(kind, known, "plan.options"))


# What shows a plan, by the name of its method, the one road from it to pictures: `show`, which this
# can't import, fills it on first use.
VIEWS: dict[str, Callable[..., Any]] = {}


def view(name: str, *arguments: Any, **look: Any) -> Any:
    """Returns what a view makes of a plan."""
    if not VIEWS:
        importlib.import_module("drake_aigto.show").fill_views()
    return VIEWS[name](*arguments, **look)
