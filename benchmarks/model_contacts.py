"""Plans with contact for models that other people made, simulated by MuJoCo as well.

    pip install 'drake_aigto[models]'
    python -m benchmarks.model_contacts
    python -m benchmarks.model_contacts hopper     # those whose name contains a word
    python -m benchmarks.model_contacts --rows build/legs.jsonl --markdown docs/models.md

Legs on a vertical rail: of a planar MJCF the root may move up and down, and the joints of one or
two legs move; all others are fixed. By one rule for all, fixed beforehand, they start at rest with
their lowest foot 0.1 m above the floor, every joint 0.1 rad inside of its limits, and are to be
there again after 0.6 s: they fall, bounce on a floor of 20 kN/m without friction, and come up.

MuJoCo simulates the same control on the same file, with its contact matched: its constraint is a
spring of the same stiffness where the impedance d is small,

    f = (a_ref − a₀) / (A + R),   R = (1 − d)/d Â,   a_ref = −k/d x,

so that with `solref` = (−k (1 − d) Â, 0) and d = 1e-4 what is left of A and a₀ is 1e-4 of the rest.
Â is the inverse weight that MuJoCo takes for the foot's body.

Friction and rigid impacts are not compared. MuJoCo's friction is a constraint of the same
impedance: with the small d that makes the normal force a spring, it is 1 / d times too soft for
Coulomb's law. It has no impacts of rigid bodies. Plans with either are simulated on Drake's plant.
"""

from __future__ import annotations

import argparse
import importlib
import json
import time
from collections.abc import Iterator, Sequence
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.models import find_models
from benchmarks.mujoco_judge import MujocoJudge
from drake_aigto import Plan, Scenario, World, plan
from drake_aigto.errors import AigtoError
from drake_aigto.output import write_text
from drake_aigto.simulation import HeldControl, Replay, replay_with

STIFFNESS = 2e4  # Of feet and floor together [N/m].
HEIGHT = 0.1  # Of the lowest foot at start and goal [m].
INSIDE = 0.1  # Of limits of joints at start and goal [rad].
DURATION, TIME_STEP = 0.6, 0.02  # [s]
IMPEDANCE = 1e-4  # MuJoCo's least.
_TITLE = "## Plans with contact"
_STEP = 5e-5  # Of MuJoCo's simulation [s].


class Leg(NamedTuple):
    """Legs of a model on a rail.

    Attributes:
        model: end of its path.
        root: the slider that moves up and down.
        moving: joints that move beside it, globs.
        feet: geoms that touch the floor, globs.
    """

    model: str
    root: str
    moving: tuple[str, ...]
    feet: tuple[str, ...]


LEGS = (
    Leg("assets/hopper.xml", "rootz", ("thigh_joint", "leg_joint"), ("foot_geom",)),
    Leg("assets/walker2d.xml", "rootz", ("thigh_joint", "leg_joint"), ("foot_geom",)),
    Leg("assets/half_cheetah.xml", "rootz", ("bthigh", "fthigh"), ("bfoot", "ffoot")),
    Leg("assets/half_cheetah.xml", "rootz", ("bthigh", "bshin"), ("bfoot",)),
    Leg("suite/hopper.xml", "rootz", ("hip", "knee"), ("foot",)),
    Leg("suite/walker.xml", "rootz", ("right_hip", "right_knee"), ("right_foot",)),
    Leg("suite/cheetah.xml", "rootz", ("bthigh", "fthigh"), ("bfoot", "ffoot")),
    Leg("suite/cheetah.xml", "rootz", ("fthigh", "fshin"), ("ffoot",)),
)


def make_scenario(leg: Leg, path: Path, joints: Sequence[str]) -> tuple[Scenario, World]:
    """Returns the question of a leg, and its world."""
    kept = {leg.root, *(each for each in joints if any(fnmatchcase(each, g) for g in leg.moving))}
    fields: dict[str, Any] = {
        "model": str(path),
        "fixed_joints": [each for each in joints if each not in kept],
        "collisions": [*leg.feet, "floor", "ground"],
        "material": {"*": {"stiffness": 2 * STIFFNESS, "dissipation": 0.0}},
        "contact": "compliant",
        "friction": 0.0,
        "allow_ignored": ["pairs"],
    }
    ends: dict[str, Any] = {"initial_position": 0, "initial_velocity": 0, "goal_position": 0}
    world = World.from_model(Scenario(**ends, **fields))
    names = [name.removesuffix("_q") for name in world.plant.GetPositionNames()]
    root = next(i for i, name in enumerate(names) if name.removesuffix("_x").endswith(leg.root))
    lower, upper = world.limits.position
    start = np.clip(world.plant.GetDefaultPositions(), lower + INSIDE, upper - INSIDE)
    start[root] += HEIGHT - world.calc_signed_distance(start).min()
    moves = np.where(np.arange(start.size) == root, HEIGHT, INSIDE)
    push = float(np.abs(world.calc_bias(start, np.zeros(start.size))).max()) * HEIGHT
    scenario = Scenario(
        initial_position=start,
        initial_velocity=np.zeros(start.size),
        goal_position=start,
        goal_weight=100.0 / moves**2,
        control_weight=np.full(world.num_actuators, 1.0 / push**2),
        duration=DURATION,
        time_step=TIME_STEP,
        **fields,
    )
    return scenario, World.from_scenario(scenario)


def match_contact(leg: Leg, model: Any) -> None:
    """Gives MuJoCo's model of a leg springs without friction where it touches the floor."""
    mujoco: Any = importlib.import_module("mujoco")
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_LIMIT)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
    model.geom_margin[:] = model.geom_gap[:] = 0.0
    model.geom_condim[:], model.geom_priority[:] = 1, 0
    model.geom_contype[:] = model.geom_conaffinity[:] = 0
    for i in range(model.ngeom):
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, i) or ""
        if name in ("floor", "ground"):
            model.geom_conaffinity[i] = 1
        elif any(fnmatchcase(name, foot) for foot in leg.feet):
            model.geom_contype[i] = model.geom_priority[i] = 1
            weight = model.body_invweight0[model.geom_bodyid[i], 0]
            model.geom_solref[i] = -STIFFNESS * (1 - IMPEDANCE) * weight, 0.0
            model.geom_solimp[i] = IMPEDANCE, IMPEDANCE, 1e-3, 0.5, 2.0


def simulate(leg: Leg, found: Plan, world: World) -> Replay:
    """Returns what a plan's control does in MuJoCo."""
    motion, judge = found.trajectory, MujocoJudge(partial(match_contact, leg), _STEP)
    control = HeldControl(motion.times, motion.controls)
    return replay_with(judge, world, world.place(found.scenario), control)


def study(leg: Leg, path: Path) -> dict[str, Any]:
    """Returns what became of one leg's question."""
    mujoco: Any = importlib.import_module("mujoco")
    joints = [each.name for each in mujoco.MjSpec.from_file(str(path)).joints]
    row: dict[str, Any] = {"model": leg.model, "moving": ", ".join(leg.moving)}
    try:
        scenario, world = make_scenario(leg, path, joints)
        start = time.perf_counter()
        found = plan(scenario, world=world)
    except AigtoError as error:
        return row | {"plan": f"{error}"}
    row["seconds"] = time.perf_counter() - start
    replay = simulate(leg, found, world)
    motion = found.trajectory
    way = np.linalg.norm(np.ptp(motion.positions, axis=0))
    off = replay.positions[-1] - motion.positions[-1]
    steps = world.calc_signed_distance(motion.positions).min(axis=1)
    return row | {
        "plan": "holds" if found.holds else "does not hold",
        "cost": found.cost,
        "off goal [%]": 100 * found.best.goal_error / way,
        "penetration [mm]": -1e3 * min(0.0, float(steps.min())),
        "in MuJoCo [mm]": 1e3 * replay.max_penetration,
        "MuJoCo ends off [%]": 100 * float(np.linalg.norm(off) / way),
    }


def find_legs(words: Sequence[str]) -> Iterator[tuple[Leg, Path]]:
    """Yields legs with the files of their models, of the collections that are installed."""
    known = [path for _, path in find_models()]
    for leg in LEGS:
        for path in known:
            if path.as_posix().endswith(leg.model) and any(w in str(leg) for w in words or [""]):
                yield leg, path


def format_section(rows: Sequence[dict[str, Any]]) -> str:
    """Returns the section of a page."""
    header = list(dict.fromkeys(key for row in rows for key in row))
    cells = [header, ["---"] * len(header)]
    for row in rows:
        values = [row.get(key, "") for key in header]
        cells.append([f"{x:.2g}" if isinstance(x, float) else str(x) for x in values])
    text = (__doc__ or "").partition("\n\nLegs on")[2]
    return "\n".join(
        [_TITLE, "", f"Legs on{text.rstrip()}", "", *(f"| {' | '.join(line)} |" for line in cells)]
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """Prints a line for each leg."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("words", nargs="*", help="only legs with one of these in their names")
    parser.add_argument("--rows", metavar="FILE", help="keep rows here, and go on from there")
    parser.add_argument("--markdown", metavar="FILE", help="end this page with the table")
    options = parser.parse_args(arguments)
    kept = Path(options.rows) if options.rows else None
    lines = kept.read_text(encoding="utf-8").splitlines() if kept and kept.exists() else []
    rows = list(map(json.loads, lines))
    known = {(row["model"], row["moving"]) for row in rows}
    for leg, path in find_legs(options.words):
        if (leg.model, ", ".join(leg.moving)) in known:
            continue
        rows.append(study(leg, path))
        line = json.dumps(rows[-1], default=float)
        print(line, flush=True)
        if kept:
            with kept.open("a", encoding="utf-8") as file:
                file.write(f"{line}\n")
    if options.markdown:
        page = Path(options.markdown).read_text(encoding="utf-8").partition(f"\n{_TITLE}")[0]
        write_text(options.markdown, f"{page.rstrip()}\n\n{format_section(rows)}\n")


if __name__ == "__main__":
    main()
