"""What becomes of models that other people made, from four collections.

    pip install 'drake_aigto[models,meshes]'
    python -m benchmarks.models --rows build/models.jsonl --markdown docs/models.md   # all of them
    python -m benchmarks.models reacher acrobot --no-plan     # those whose name contains a word

Each model is read as a new user would: as it is; then, if it is refused, once more with the fields
that the error names. MJCFs are compared with MuJoCo's own M, h, limits and friction at random
states. What can be read is asked to go to a goal at which it can rest, by one rule for all (`aim`),
and what the plan does is simulated by MuJoCo as well. With `--rows` it may be ended by Ctrl-C and
gone on with.
"""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import importlib.util
import json
import site
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pydrake
import yaml

from drake_aigto import Plan, Scenario, World, plan
from drake_aigto.arrays import Floats
from drake_aigto.errors import AigtoError
from drake_aigto.plain import write_text
from drake_aigto.world import FixableError

_MOST_COORDINATES, _KEPT = 4, 2
_MOVES = {True: 0.3, False: 0.1}  # Of a hinge [rad], of a slider [m].
_NEAR, _SLOW = 0.05, 0.1  # Of a move, and of a move per duration: a goal that is reached.
_RESTS = 1e-9  # Of the largest force: what Newton's method leaves of a balance.
_NUM_STATES = 5
_UNLIMITED, _LARGE = 1e9, 1e5  # Of controls and efforts; larger ones count as infinite.
_STEP = 1e-4  # Of MuJoCo's simulation [s].
_HEADER = ("collection", "model", "coordinates", "read", "seconds", "MuJoCo agrees to", "plan")
_INTRODUCTION = """
Models of `dm_control`, `gymnasium`, `example-robot-data` and Drake, read as a new user would: each
as it is, and, if it is refused, once more with the fields of a scenario that its error names
([A model of your own](your_own_model.md#models-that-other-people-made)). Made by
`python -m benchmarks.models --markdown docs/models.md`, with
`pip install 'drake_aigto[models,meshes]'`.

- **coordinates**: how many are left, with joints fixed and links welded as the answer says.
- **read**: as it is; with an answer; or refused, and by what.
- **seconds**: of one processor, until it was read, or until it was refused.
- **MuJoCo agrees to**: the largest relative difference, at five random states, of the mass matrix,
  of bias forces with friction of joints, of limits of joints, and of least and largest efforts,
  between this reading and MuJoCo's of the same MJCF. Contact and fluid are left out.
- **plan**: without contact, from default positions to a goal by one rule for all models, fixed
  beforehand: each driven joint 0.3 rad or 0.1 m farther, and joints that nothing drives where they
  rest then, within one second, or two if there are such joints. Of models with more than four
  coordinates the two driven joints nearest to the base move, and all others are fixed. Where no
  control within the model's limits holds the goal, that is said and nothing is planned. A plan
  *reaches* if it holds, ends within 5 % of each move of the goal, and is slower there than a tenth
  of the move per duration. The last number is how far MuJoCo ends from the plan under the same
  control, relative to the way.
"""


@dataclasses.dataclass
class Row:
    """What became of one model."""

    collection: str
    model: str
    coordinates: str = ""
    read: str = ""
    seconds: float = 0.0
    agrees: str = ""
    plan: str = ""


def find_models() -> Iterator[tuple[str, Path]]:
    """Yields collections and files of models, of the collections that are installed."""
    folders = {
        "dm_control": ("dm_control", "suite/*.xml"),
        "gymnasium": ("gymnasium", "envs/mujoco/assets/*.xml"),
    }
    for collection, (package, glob) in folders.items():
        found = importlib.util.find_spec(package)
        for root in [] if found is None else found.submodule_search_locations or []:
            yield from ((collection, path) for path in sorted(Path(root).glob(glob)))
    sites = [*site.getsitepackages(), *sys.path]
    for root in dict.fromkeys(sites):
        robots = Path(root) / "cmeel.prefix" / "share" / "example-robot-data" / "robots"
        urdfs = sorted(robots.glob("*/*/*.urdf"))
        yield from (("example-robot-data", path) for path in urdfs)
    drake = Path(pydrake.__file__).parent / "share" / "drake" / "examples"
    for suffix in ("sdf", "urdf"):
        yield from (("drake", path) for path in sorted(drake.rglob(f"*.{suffix}")))


def read(row: Row, path: Path) -> tuple[World, Scenario] | None:
    """Reads a model, with the error's answer if it is refused."""
    ends: dict[str, Any] = {"initial_position": 0, "initial_velocity": 0, "goal_position": 0}
    scenario, start = Scenario(model=str(path), **ends), time.process_time()
    try:
        world = World.from_model(scenario)
        row.read = "as it is"
    except AigtoError as error:
        row.seconds = time.process_time() - start
        if not isinstance(error, FixableError):
            row.read = f"refused: {error.what.replace(str(path), path.name)}"
            return None
        scenario = dataclasses.replace(scenario, **error.fields)
        answer = yaml.safe_dump(error.fields, default_flow_style=True, width=10_000).strip()
        answer = answer if len(answer) < 120 else f"{answer[:117]}..."
        try:
            world = World.from_model(scenario)
            row.read = f"with `{answer}`"
        except AigtoError as again:
            row.read = f"refused: {again.what.replace(str(path), path.name)}, after `{answer}`"
            return None
    row.seconds = row.seconds or time.process_time() - start
    row.coordinates = f"{world.num_positions}"
    return world, scenario


def compare(world: World, path: Path) -> float:
    """Returns the largest relative difference from MuJoCo's M, h, friction, limits and efforts."""
    mujoco: Any = importlib.import_module("mujoco")

    model, q_of = _load_mujoco(path, world)
    data: Any = mujoco.MjData(model)
    plant, worst = world.plant, 0.0
    context = plant.CreateDefaultContext()
    for q, v in np.random.default_rng(0).uniform(-1.0, 1.0, (_NUM_STATES, 2, world.num_positions)):
        data.qpos[q_of], data.qvel[q_of] = q, v
        mujoco.mj_forward(model, data)
        M = np.zeros((model.nv, model.nv))
        for column in range(model.nv):
            product = np.zeros(model.nv)
            mujoco.mj_mulM(model, data, product, np.eye(model.nv)[column])
            M[:, column] = product
        M = M[np.ix_(q_of, q_of)]
        plant.SetPositions(context, q)
        h = (data.qfrc_bias - data.qfrc_passive)[q_of]
        dry = 0.0 if world.dry_friction is None else world.dry_friction
        mine = world.calc_bias(q, v) - dry * np.clip(v / world.stiction_speed, -1.0, 1.0)
        worst = max(worst, _differ(plant.CalcMassMatrix(context), M), _differ(mine, h))
    worst = max(worst, _compare_efforts(model, data, world, q_of))
    is_limited = model.jnt_limited.astype(bool)[q_of]
    is_limited &= not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    for row, infinite in zip(world.limits.position, (-np.inf, np.inf), strict=True):
        column = 0 if infinite < 0 else 1
        theirs = np.where(is_limited, model.jnt_range[q_of, column], infinite)
        worst = max(worst, 0.0 if np.allclose(row, theirs, atol=1e-9) else np.inf)
    return worst


def _compare_efforts(model: Any, data: Any, world: World, q_of: list[int]) -> float:
    """Returns the largest relative difference of efforts at joints, of controls as far as they go.

    MuJoCo's are what its own controls of ±1e9 come to: gears, gains and ranges are in them.
    """
    mujoco: Any = importlib.import_module("mujoco")

    efforts = []
    for control in (-_UNLIMITED, _UNLIMITED):
        data.ctrl[:] = control
        mujoco.mj_forward(model, data)
        efforts.append(data.qfrc_actuator[q_of].copy())
    theirs = np.array([np.minimum(*efforts), np.maximum(*efforts)]).clip(-_LARGE, _LARGE)
    mine = world.limits.control.clip(-_LARGE, _LARGE) @ world.actuation.T
    return _differ(mine, theirs)


def _load_mujoco(path: Path, world: World) -> tuple[Any, list[int]]:
    """Returns MuJoCo's model without fluid and contact, and where our coordinates are in it."""
    mujoco: Any = importlib.import_module("mujoco")

    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.density = model.opt.viscosity = 0.0
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    names = [mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, i) for i in range(model.njnt)]
    plant, q_of = world.plant, [0] * world.num_positions
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        if joint.num_positions() == 1:
            known = joint.name() in names
            i = names.index(joint.name()) if known else joint.position_start()
            q_of[joint.position_start()] = int(model.jnt_qposadr[i])
    return model, q_of


def _differ(mine: Any, theirs: Any) -> float:
    return float(np.abs(mine - theirs).max(initial=0.0) / max(1.0, np.abs(theirs).max(initial=0.0)))


def keep_few(world: World, scenario: Any) -> tuple[World, Scenario]:
    """Returns a model with at most four coordinates, by the rule of this study."""
    if world.num_positions <= _MOST_COORDINATES:
        return world, scenario
    plant = world.plant
    depth, moving = {plant.world_body().index(): 0}, []
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    for _ in joints:  # Parents may come after children.
        for joint in joints:
            if (above := joint.parent_body().index()) in depth:
                depth[joint.child_body().index()] = depth[above] + 1
    driven = np.any(world.actuation != 0, axis=1)
    moving = [each for each in joints if each.num_positions()]
    moving.sort(key=lambda each: depth[each.child_body().index()])
    kept = [each.name() for each in moving if driven[each.velocity_start()]][:_KEPT]
    others = [each.name() for each in moving if each.name() not in kept]
    fields: Any = {"fixed_joints": [*scenario.fixed_joints, *others]}
    if scenario.effort_limits:
        limits = scenario.effort_limits.items()
        fields["effort_limits"] = {name: limit for name, limit in limits if name not in others}
    fewer = dataclasses.replace(scenario, **fields)
    return World.from_model(fewer), fewer


def aim(world: World) -> tuple[Floats, Floats, Floats] | None:
    """Returns start, goal, and the control that holds the goal; None where there is no such goal.

    Joints that nothing drives rest at the goal where Newton's method from the start finds that.
    """
    driven = np.any(world.actuation != 0, axis=1)
    start = np.array(world.plant.GetDefaultPositions())
    lower, upper = world.limits.position
    move = np.where(driven, [_MOVES[bool(hinge)] for hinge in world.is_hinge], 0.0)
    start = np.clip(start, lower + 0.0, upper - np.where(np.isfinite(upper), move, 0.0))
    start, goal, still = np.maximum(start, lower), start + move, np.zeros(start.size)
    for q in (start, goal):
        for _ in range(20 * bool((~driven).any())):
            force = world.calc_bias(q, still)[~driven]
            steps = 1e-6 * np.eye(q.size)[~driven]
            slopes = np.array([world.calc_bias(q + step, still)[~driven] - force for step in steps])
            q[~driven] -= np.linalg.lstsq(slopes.T / 1e-6, force, rcond=1e-9)[0]
    force = world.calc_bias(goal, still)
    control = world.inverse_actuation @ force
    is_balanced = np.abs(world.actuation @ control - force).max() <= _RESTS * (
        1.0 + np.abs(force).max()
    )
    inside = np.all((lower <= goal) & (goal <= upper))
    least, most = world.limits.control
    holds = np.all((least <= control) & (control <= most))
    return (start, goal, control) if is_balanced and inside and holds else None


def ask(world: World, scenario: Scenario) -> Plan | None:
    """Plans to a goal that depends on nothing but the model; None where there is none."""
    if (ends := aim(world)) is None:
        return None
    start, goal, hold = ends
    driven = np.any(world.actuation != 0, axis=1)
    duration = 1.0 if driven.all() else 2.0
    move = np.array([_MOVES[bool(hinge)] for hinge in world.is_hinge])
    push = world.inverse_actuation @ (world.calc_mass_matrix(goal) @ (goal - start))
    effort = np.maximum(np.abs(hold), 4.0 * np.abs(push) / duration**2)
    question = dataclasses.replace(
        scenario,
        initial_position=start,
        initial_velocity=np.zeros(start.size),
        goal_position=goal,
        goal_weight=1e3 / move**2,
        goal_velocity_weight=1e2 * (duration / move) ** 2,
        control_weight=1.0 / np.maximum(effort, 1e-6 + 1e-3 * effort.max()) ** 2,
        duration=duration,
        time_step=0.02 * duration,
        ignored_shapes="all",
    )
    return plan(question)


def describe(found: Plan, world: World) -> str:
    """Returns whether a plan holds and reaches its goal."""
    scenario, motion = found.scenario, found.trajectory
    move = np.array([_MOVES[bool(hinge)] for hinge in world.is_hinge])
    off = float(np.max(np.abs(motion.positions[-1] - scenario.goal_position) / move))
    speed = float(np.max(np.abs(motion.velocities[-1]) * scenario.duration / move))
    reaches = found.holds and off <= _NEAR and speed <= _SLOW
    text = "holds and reaches" if reaches else "holds" if found.holds else "does not hold"
    return f"{text}, {100 * off:.1g} % off"


def simulate_in_mujoco(found: Plan, world: World, path: Path) -> float:
    """Returns how far MuJoCo's end of a plan's control is from the plan's, per way."""
    mujoco: Any = importlib.import_module("mujoco")

    model, q_of = _load_mujoco(path, world)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, _STEP
    data: Any = mujoco.MjData(model)
    trajectory: Any = found.trajectory
    data.qpos[q_of] = trajectory.positions[0]
    times, controls = trajectory.times, trajectory.controls
    for k in range(round(times[-1] / _STEP)):
        index = min(np.searchsorted(times, (k + 0.5) * _STEP, side="right") - 1, len(controls) - 1)
        data.qfrc_applied[q_of] = world.actuation @ controls[index]
        mujoco.mj_step(model, data)
    end = trajectory.positions[-1]
    way = np.linalg.norm(end - trajectory.positions[0])
    return float(np.linalg.norm(data.qpos[q_of] - end) / way)


def study(collection: str, path: Path, plans: bool) -> Row:
    """Returns what becomes of one model."""
    row = Row(collection, f"{path.parent.name}/{path.stem}")
    if (got := read(row, path)) is None:
        return row
    world: World = got[0]
    scenario: Any = got[1]
    is_mjcf = path.suffix == ".xml" and importlib.util.find_spec("mujoco") is not None
    with_all = not set(scenario.allow_ignored) - {"pairs", "fluid"}
    with_all &= not (scenario.fixed_joints or scenario.weld or scenario.actuators)
    if is_mjcf and with_all:
        row.agrees = f"{compare(world, path):.0e}"
    if plans:
        try:
            whole, (world, scenario) = world, keep_few(world, scenario)
            start = time.perf_counter()
            if (found := ask(world, scenario)) is None:
                row.plan = "no goal at which it can rest"
                return row
            moving = "" if world is whole else f", {world.num_positions} joints"
            row.plan = f"{describe(found, world)}{moving}, {time.perf_counter() - start:.1f} s"
            if is_mjcf and with_all and world is whole and world.dry_friction is None:
                row.plan += f", MuJoCo {simulate_in_mujoco(found, world, path):.0e}"
        except AigtoError as error:
            row.plan = f"refused: {error.what}"
    return row


def format_rows(rows: Sequence[Row], separator: str) -> list[str]:
    """Returns lines of a table."""
    cells = [
        [f"{value:.2f}" if isinstance(value, float) else str(value) for value in vars(row).values()]
        for row in rows
    ]
    return [separator.join(line) for line in [list(_HEADER), *cells]]


def summarize(rows: Sequence[Row]) -> list[str]:
    """Returns sentences that count rows."""
    as_is = sum(row.read == "as it is" for row in rows)
    answered = sum(row.read.startswith("with") for row in rows)
    planned = sum(row.plan.startswith("holds") for row in rows)
    reach = sum(row.plan.startswith("holds and reaches") for row in rows)
    asked = sum(bool(row.plan) and not row.plan.startswith("no goal") for row in rows)
    slow = max((row.seconds for row in rows if row.read != "as it is"), default=0.0)
    return [
        f"{len(rows)} models: {as_is} are read as they are, {answered} with the fields that one "
        f"error names, {len(rows) - as_is - answered} are refused. "
        f"The slowest refusal takes {slow:.1f} s.",
        f"Of {asked} that have a goal by the rule, {planned} plans hold, and {reach} reach it.",
    ]


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints the table, and writes it as a page if asked."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("words", nargs="*", help="only models whose path has one of these in it")
    parser.add_argument("--no-plan", dest="plans", action="store_false", help="read them only")
    parser.add_argument("--rows", metavar="FILE", help="keep rows here, and go on from there")
    parser.add_argument("--markdown", metavar="FILE", help="write the page here")
    options = parser.parse_args(arguments)
    rows = []
    kept = Path(options.rows) if options.rows else None
    lines = kept.read_text(encoding="utf-8").splitlines() if kept and kept.exists() else []
    known = {path: Row(**row) for path, row in map(json.loads, lines)}
    for collection, path in find_models():
        if not options.words or any(word in str(path) for word in options.words):
            rows.append(known.get(str(path)) or study(collection, path, options.plans))
            print(*format_rows(rows[-1:], "  ")[1:], flush=True)
            if kept and str(path) not in known:
                with kept.open("a", encoding="utf-8") as file:
                    file.write(json.dumps([str(path), vars(rows[-1])]) + "\n")
    print(*summarize(rows), sep="\n")
    if options.markdown:
        lines = format_rows(rows, " | ")
        table = [lines[0], " | ".join(["---"] * len(_HEADER)), *lines[1:]]
        text = [
            "# Models that other people made",
            "",
            *_INTRODUCTION.strip().splitlines(),
            "",
            *summarize(rows),
            "",
            *(f"| {line} |" for line in table),
            "",
        ]
        write_text(options.markdown, "\n".join(text))


if __name__ == "__main__":
    main()
