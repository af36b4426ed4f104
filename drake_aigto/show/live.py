"""A plan that follows as start, velocity, goal, walls and weights are dragged, in Meshcat."""

from __future__ import annotations

import atexit
import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any, ClassVar, NamedTuple

import numpy as np
from matplotlib.colors import to_rgb
from pydrake.geometry import Meshcat, Rgba
from pydrake.math import RigidTransform

from drake_aigto.arrays import Floats, interpolate
from drake_aigto.errors import AigtoError, OptionsError
from drake_aigto.planning import Candidate, Plan, Planner, PlanOptions
from drake_aigto.show.background import BackgroundPlanner, LiveAnswer, LiveQuestion
from drake_aigto.show.film import ROOT, look_at, open_meshcat
from drake_aigto.show.motion import Motion, color_of, positions_at
from drake_aigto.show.shapes import coordinate_names, find_goal, has_goal, moves_straight
from drake_aigto.show.stage import Stage
from drake_aigto.show.words import cost_text, run_texts, touch_names
from drake_aigto.world import Scales, Scenario, uncolored

_MOST_GHOSTS = 3  # candidates beside the best
_PAUSE = 0.7  # that the end stands before the motion starts again [s]
_KICKED = -0.5  # what a kick leaves of each velocity
_PARTS = 200  # of a slider's range
# What sliders reach: beyond start and goal, in ways between them, and of angles [rad]; and of
# velocities, in largest ways over the duration.
_BEYOND, _AROUND, _FASTEST = 0.8, np.pi, 3.0
_WALL, _DECADES = 0.5, 2.0  # how far walls move, in such ways; powers of ten that weights change by
_GHOST, _LINE = 0.25, 3.0  # how much ghosts cover; width of ways [px]
_VIEW, _TILT = np.deg2rad(12.0), np.deg2rad(8.0)
_ENDS = {"start": Rgba(0.3, 0.3, 0.3, 0.25), "goal": Rgba(0.0, 0.62, 0.35, 0.3)}
_KICK, _AGAIN = "kick", "start again"
_SEARCHING = "searching: a better plan may follow"
_ASKED = ("initial_position", "initial_velocity", "goal_position")
_WEIGHTS = ("control_weight", "goal_weight")


class _Slider(NamedTuple):
    """One number of the question: of an array, the one of this entry."""

    name: str
    field: str
    entry: int
    low: float
    high: float


class Live:
    """A scenario whose plan follows sliders in Meshcat.

    Sliders are start, velocity and goal of each coordinate, how much nearer each flat wall stands,
    and powers of ten that the weights of control and goal are multiplied by.

    The best candidate moves, solid; up to three others are ghosts, and labels name them all with
    their costs. Plans are made in a thread of their own: what stood stands until the next one is
    there; where there is none, a label says why. While sliders move, each plan is found near the
    last one; once they rest, the whole search follows, as a label says. The button "kick" is
    `kick`; "start again" goes back to what the sliders say.

    On a terminal, `run` plays until Ctrl-C; in a notebook, `start` plays in the background until
    `stop`, and the cell shows the scene.

    Attributes:
        url: where Meshcat shows it, once it is open.
        planner: without Drake's replay, which takes longer than most plans. Walls that moved have
            a new one.
        plan: what is shown; None before the first plan.
        message: why there is no plan for what was asked last; "" if there is one.
        labels: of what is shown, the best candidate's first.
        latency: from when the sliders asked until the first plan was shown [s].
        PERIOD: from look to look at the sliders [s].
    """

    PERIOD: ClassVar[float] = 0.02

    def __init__(
        self, scenario: Scenario, say: Callable[[str], None] | None = None, port: int | None = None
    ) -> None:
        """Reads the scenario's world; `say` gets each message. Nothing is opened yet.

        Raises:
            OptionsError: bodies of the scenario float.
        """
        self.planner = Planner(scenario, PlanOptions(confirm=False))
        world = self.planner.world
        if world.num_positions != world.num_velocities:
            got, expected = "bodies that float", "coordinates that sliders can set"
            raise OptionsError("the scenario", got=got, expected=expected)
        alone = [faces[0] for faces in world.solids if len(faces) == 1]
        fixed = map(world.plant.IsAnchored, map(world.find_wall, alone))
        # One contact of each: several balls may touch a wall.
        walls = {world.shapes[c][1]: c for c, is_so in zip(alone, fixed, strict=True) if is_so}
        self._walls = list(walls.values())
        self._background = BackgroundPlanner(self.planner, self._walls)
        self.plan: Plan | None = None
        self.message, self.latency = "", np.nan
        self._say, self._port = say or (lambda text: None), port
        self._ended, self._opened = threading.Event(), threading.Event()
        self._refusal: OptionsError | None = None  # of the thread that `start` waits for
        self._thread: threading.Thread | None = None
        self._clicks: dict[str, int] = {}
        self._began = time.monotonic()
        self._motions: list[Motion] = []
        self.labels: list[str] = []
        self._shown: LiveQuestion | None = None
        self._texts: list[str] = []  # About what is shown.
        self._drawn: dict[str, Rgba] = {}  # By path.

    def run(self, seconds: float = np.inf) -> None:
        """Plays until Ctrl-C, `stop`, or for some time [s].

        Raises:
            OptionsError: from `open`.
        """
        self.open()
        self._say(f"Open the controls at {self.url} to drag sliders; press Ctrl-C to stop.")
        end = time.monotonic() + seconds
        with contextlib.suppress(KeyboardInterrupt):
            while not self._ended.wait(self.PERIOD) and time.monotonic() < end:
                self.look()
        self.stop()
        del self.meshcat  # In its own thread.

    def start(self) -> Live:
        """Plays in the background; returns itself, which a notebook shows.

        Raises:
            OptionsError: from `open`.
        """
        self._thread = threading.Thread(target=self._play, daemon=True)
        self._thread.start()
        atexit.register(self.stop)
        self._opened.wait()
        if self._refusal:
            raise self._refusal
        return self

    def _play(self) -> None:
        """Runs, and hands a refusal to the thread that waits for it."""
        try:
            self.run()
        except OptionsError as error:
            self._refusal = error
            self._opened.set()

    def stop(self) -> None:
        """Ends it, and waits until nothing is shown any more."""
        self._ended.set()
        self._background.stop()
        if self._thread and self._thread is not threading.current_thread():
            self._thread.join()

    def _repr_html_(self) -> str:
        """Returns Meshcat in a frame, which this process serves until the scene is closed."""
        if self._ended.is_set() or not self._opened.is_set():
            state = "is closed" if self._ended.is_set() else "is not open: call start()"
            return f"<p>The live scene {state}.</p>"
        look = "width: 100%; height: 560px; border: 0"
        return f'<iframe src="{self.url}" style="{look}"></iframe>'

    def open(self) -> Meshcat:
        """Opens Meshcat, which this thread alone may use from now on, and asks for the first plan.

        Raises:
            OptionsError: its port is in use, or the scene was closed by `stop`.
        """
        if self._ended.is_set():
            raise OptionsError("the live scene", got="closed", expected="a new `Live` to open")
        self.meshcat = meshcat = open_meshcat(self._port)
        self.url = meshcat.web_url()
        scenario = self.planner.scenario
        self._weights = {name: getattr(scenario, name) for name in _WEIGHTS}
        self._first = {
            **{name: getattr(scenario, name) for name in _ASKED},
            **{name: np.zeros(1) for name in _WEIGHTS},
            "walls": np.zeros(len(self._walls)),
        }
        self._sliders = list(self._find_sliders())
        for each in self._sliders:
            step, value = (each.high - each.low) / _PARTS, self._first[each.field][each.entry]
            meshcat.AddSlider(each.name, each.low, each.high, step, value)
        for button in (_KICK, _AGAIN):
            meshcat.AddButton(button)
        for path in ("/Background", "/Grid", "/Axes"):
            meshcat.SetProperty(path, "visible", False)
        self._set_stage()
        self._slid = self._read()
        self._ask(self._slid)
        self._opened.set()
        return meshcat

    def look(self) -> None:
        """Looks once at sliders, buttons and answers, and moves what moves."""
        while not self._background.answers.empty():
            self._show(self._background.answers.get())
        asked = self._read()
        if self._is_clicked(_AGAIN) or any(np.any(asked[k] != self._slid[k]) for k in asked):
            self._ask(asked)
        elif self._is_clicked(_KICK):
            self.kick()
        self._slid = asked
        more = [f"no plan: {self.message}"] if self.message else []
        more += [_SEARCHING] if self.is_searching else []
        self._label([*self._texts, *more])
        self._move()

    @property
    def is_searching(self) -> bool:
        """Whether a plan, or a better one, may follow without another question."""
        return self._background.is_searching

    def kick(self) -> None:
        """Turns velocities round and halves them where the motion is now, and plans from there."""
        if self._motions:
            motion, now = self._motions[0], np.array([self._now()])
            rows = motion.positions, motion.velocities
            (q,), (v,) = (interpolate(now, motion.times, each) for each in rows)
            kicked = {"initial_position": q, "initial_velocity": _KICKED * v}
            self._ask({**self._slid, **kicked}, is_kicked=True)

    def _find_sliders(self) -> Iterator[_Slider]:
        """Yields a slider for each coordinate's start and velocity, and for goals that count."""
        scenario, world = self.planner.scenario, self.planner.world
        start, goal = scenario.initial_position, scenario.goal_position
        way = float(np.max(np.abs(goal - start)[~world.is_hinge], initial=0.0)) or 1.0
        if not world.is_hinge.any():
            way = Scales.of(world, scenario).length
        beyond = np.where(world.is_hinge, _AROUND, _BEYOND * way)
        low, high = np.minimum(start, goal) - beyond, np.maximum(start, goal) + beyond
        limits = world.bounds(scenario)
        low, high = np.maximum(low, limits.position[0]), np.minimum(high, limits.position[1])
        fast = _FASTEST * np.where(world.is_hinge, _AROUND, way) / scenario.duration
        fast = np.maximum(fast, 1.5 * np.abs(scenario.initial_velocity))
        slow, fast = np.maximum(-fast, limits.velocity[0]), np.minimum(fast, limits.velocity[1])
        asked = has_goal(world, scenario)
        for i, (name, unit) in enumerate(zip(coordinate_names(world), world.units, strict=True)):
            yield _Slider(f"start {name} [{unit}]", "initial_position", i, low[i], high[i])
            yield _Slider(f"speed {name} [{unit}/s]", "initial_velocity", i, slow[i], fast[i])
            if asked[i] and scenario.periodic is None:
                yield _Slider(f"goal {name} [{unit}]", "goal_position", i, low[i], high[i])
        names = touch_names(world)
        for i, contact in enumerate(self._walls):
            name = f"{names[contact]} nearer [m]"
            yield _Slider(name, "walls", i, -_WALL * way, _WALL * way)
        for field in _WEIGHTS:
            yield _Slider(f"{field.replace('_', ' ')} × 10^", field, 0, -_DECADES, _DECADES)

    def _set_stage(self) -> None:
        """Shows what stands still, and has the camera see all that sliders can reach."""
        world, scenario = self.planner.world, self.planner.scenario
        corners = [scenario.initial_position, scenario.goal_position]
        for end in ("low", "high"):
            q = np.array(scenario.initial_position)
            for each in self._sliders:
                if each.field == "initial_position" and not world.is_hinge[each.entry]:
                    q[each.entry] = getattr(each, end)
            corners.append(q)
        self._stage = stage = Stage(world, np.array(corners))
        # Of what stands still: its path, its pose, and how that moves with each wall, (walls, 3).
        self._still = []
        for actor in (actor for actor in stage.actors if not actor.moves):
            path = f"{ROOT}/world/{actor.name}"
            self.meshcat.SetObject(path, actor.shape, actor.color or Rgba(0.6, 0.6, 0.6))
            normals = [
                (world.find_wall(contact).index() == actor.index)
                * stage.touch(contact, corners[0])[1]
                for contact in self._walls
            ]
            pose = stage.pose(actor, corners[0])
            self._still.append((path, pose, np.reshape(normals, (-1, 3))))
        self._put_walls(self._first["walls"])
        tilt = -_TILT if abs(stage.X_WT.rotation().matrix()[2, 2]) > 0.5 else _TILT
        look_at(self.meshcat, stage.X_WT, (stage.low, stage.high), (_VIEW, tilt, 0.0))

    def _put_walls(self, nearer: Floats) -> None:
        """Shows what stands still, walls nearer than in the model [m]."""
        for path, pose, normals in self._still:
            self.meshcat.SetTransform(path, RigidTransform(nearer @ normals) @ pose)

    def _read(self) -> dict[str, Floats]:
        """Returns what the sliders say."""
        read = {name: np.array(values) for name, values in self._first.items()}
        for each in self._sliders:
            read[each.field][each.entry] = self.meshcat.GetSliderValue(each.name)
        return read

    def _is_clicked(self, button: str) -> bool:
        """Returns whether a button was pressed since the last look."""
        before, now = self._clicks.get(button, 0), self.meshcat.GetButtonClicks(button)
        self._clicks[button] = now
        return now > before

    def _ask(self, read: dict[str, Floats], is_kicked: bool = False) -> None:
        """Asks for a plan of what the sliders say."""
        changed: dict[str, Any] = {name: read[name] for name in _ASKED}
        for name in _WEIGHTS:
            changed[name] = self._weights[name] * 10.0 ** read[name][0]
        self._background.ask(changed, read["walls"], is_kicked)

    def _show(self, answer: LiveAnswer) -> None:
        """Shows an answer: a plan from its start, or a message beside what stands."""
        if isinstance(answer.plan, AigtoError):
            self.message = str(answer.plan)
            self._say(f"no plan: {self.message}")
            return
        self.planner, plan = answer.planner, answer.plan
        world = self.planner.world
        self.plan, self.message = plan, ""
        self._put_walls(answer.question.walls)
        shown = [plan.best, *self._rivals(plan)]
        self._motions = [Motion.from_trajectory(each.trajectory, world) for each in shown]
        goal = find_goal(world, plan.scenario, plan.trajectory.positions[-1])
        for name, q in (("start", plan.scenario.initial_position), ("goal", goal)):
            self._put(name, q, _ENDS[name])
        for number in range(1 + _MOST_GHOSTS):
            path, is_there = f"candidates/{number}", number < len(self._motions)
            self.meshcat.SetProperty(f"{ROOT}/{path}", "visible", is_there)
            if not is_there:
                continue
            color = Rgba(*to_rgb(color_of(number)), _GHOST if number else 1.0)
            self._put(path, self._motions[number].positions[0], color)
            for k, way in enumerate(self._stage.trace(self._motions[number].positions)):
                line = self._stage.X_WT.multiply(way.T)
                self.meshcat.SetLine(f"{ROOT}/{path}/ways/{k}", line, _LINE, color)
        self._texts = self._describe(plan)
        if answer.question is not self._shown:
            self._shown, now = answer.question, time.monotonic()
            self.latency = now - self._shown.asked
            # Else it goes on from where it was: sliders are dragged.
            self._began = now if self._shown.is_kicked else self._began

    def _rivals(self, plan: Plan) -> list[Candidate]:
        """Returns the best candidates that are feasible and touch something else."""
        found, seen = [], [[contact.index for contact in plan.best.contacts]]
        for each in plan.candidates[1:]:
            touches = [contact.index for contact in each.contacts]
            if each.is_feasible and touches not in seen:
                found.append(each)
                seen.append(touches)
        return found[:_MOST_GHOSTS]

    def _describe(self, plan: Plan) -> list[str]:
        """Returns what is shown, its cost, what that is worth, and whether the goal is reached."""
        names, texts = touch_names(self.planner.world), []
        for number, each in enumerate((plan.best, *self._rivals(plan))):
            touches = ", ".join(dict.fromkeys(names[c.index] for c in each.contacts))
            kind, replayed = f"ghost {number}" if number else "plan", each.replay.cost
            cost, defect, deepest, energy = run_texts(each)
            texts += [
                f"{kind}: cost {cost}, touches {touches or 'nothing'}",
                f"{kind}: simulated {cost_text(replayed, 2, each.scales.cost)}, energy {energy}",
                f"{kind}: defect {defect}, penetration {deepest}",
            ]
        return texts if plan.reached else [*texts, "the plan does not reach its goal"]

    def _label(self, texts: list[str]) -> None:
        """Shows texts among the sliders, as buttons that do nothing."""
        if texts != self.labels:
            for text in self.labels:
                self.meshcat.DeleteButton(text)
            self.labels = list(dict.fromkeys(texts))
            for text in self.labels:
                self.meshcat.AddButton(text)

    def _put(self, path: str, q: Floats, color: Rgba) -> None:
        """Shows all that moves at q, in a color; solid links keep their own."""
        for actor in (actor for actor in self._stage.actors if actor.moves):
            own = color.a() == 1.0 and not moves_straight(self.planner.world)
            place, seen = f"{ROOT}/{path}/{actor.name}", (own and actor.color) or color
            if self._drawn.get(place) != seen:
                self.meshcat.SetObject(place, actor.shape if own else uncolored(actor.shape), seen)
                self._drawn[place] = seen
            self.meshcat.SetTransform(place, self._stage.pose(actor, q))

    def _now(self) -> float:
        """Returns the time of the motion that is shown just now [s]."""
        end = float(self._motions[0].times[-1])
        return min(end, (time.monotonic() - self._began) % (end + _PAUSE))

    def _move(self) -> None:
        """Moves candidates to where they are now."""
        for number, motion in enumerate(self._motions):
            (q,) = positions_at(motion, np.array([self._now()]))
            for actor in (actor for actor in self._stage.actors if actor.moves):
                path = f"{ROOT}/candidates/{number}/{actor.name}"
                self.meshcat.SetTransform(path, self._stage.pose(actor, q))
