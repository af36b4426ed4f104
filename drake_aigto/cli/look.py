"""``drake-aigto look`` and ``list``: what is understood of a model, and what is shipped."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import matplotlib.image
import numpy as np
from pydrake import geometry
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.systems.sensors import CameraInfo

from drake_aigto import show
from drake_aigto import world as worlds
from drake_aigto.cli.command_line import make_parser
from drake_aigto.cli.flags import FINE, add_command, add_scenario, load_scenario
from drake_aigto.errors import ModelError, OptionsError
from drake_aigto.plain import check_writable

_EXAMPLES = """\
drake-aigto look robot.urdf                                   # joints, actuators, contacts
drake-aigto look robot.xml --collisions none --png robot.png  # and a picture
drake-aigto look cart_pole/soft_06
"""
_COMPLETION = """\
_drake_aigto() {{
  local words="{commands}"
  case "${{COMP_WORDS[1]}}" in
{cases}
  esac
  COMPREPLY=($(compgen -W "$words" -- "${{COMP_WORDS[COMP_CWORD]}}"))
}}
complete -o default -F _drake_aigto drake-aigto"""
_PIXELS = 960, 720
_VIEW = 0.8  # Angle of view [rad].
_BACK = 1.6  # Distance of the camera, in sizes of the model: all of it is in the picture.
_UP = 0.25  # Height of the camera above what it looks at, in its distance.
_LEAST_SIZE = 0.2  # Of a model of one point [m].


def add_list(commands: Any) -> None:
    """Adds the command that lists what is shipped."""
    examples = "drake-aigto list           # then: drake-aigto plan NAME\ndrake-aigto list cart\n"
    text = "list the shipped scenarios, how long a plan takes, and what each of them shows"
    command = add_command(commands, "list", _list, text, examples)
    command.add_argument("part", metavar="TEXT", nargs="?", default="", help="of a name")


def _list(options: argparse.Namespace) -> int:
    """Prints names and first lines of scenarios."""
    told = {n: text for n, text in worlds.scenario_summaries().items() if options.part in n}
    if not told:
        raise OptionsError("TEXT", got=repr(options.part), expected="a part of a scenario's name")
    width = max(map(len, told))
    seconds = worlds.scenario_seconds()
    print(f"{'scenario':{width}}  CPU s  what it shows")
    for name, text in told.items():
        print(f"{name:{width}}  {f'{seconds[name]:g}' if name in seconds else '-':>5}  {text}")
    return FINE


def add_completion(commands: Any) -> None:
    """Adds the command that prints what a shell completes."""
    examples = "drake-aigto completion >> ~/.bashrc   # zsh: ~/.zshrc, after bashcompinit\n"
    text = "print what makes bash complete commands, flags and scenarios"
    add_command(commands, "completion", _complete, text, examples)


def _complete(_: argparse.Namespace) -> int:
    """Prints a function of bash with the words of each command."""
    commands, names = make_parser().commands.choices, " ".join(worlds.scenario_names())
    cases = [
        f'    {name}) words="{" ".join(each.flags())} {names}";;' for name, each in commands.items()
    ]
    print(_COMPLETION.format(commands=" ".join(commands), cases="\n".join(cases)))
    return FINE


def add_look(commands: Any) -> None:
    """Adds the command that tells what is understood of a model."""
    text = "show how a model's file or a scenario is understood, before any planning"
    look = add_command(commands, "look", _look, text, _EXAMPLES)
    add_scenario(look)
    look.add_argument("--png", metavar="FILE", help="draw the model, at its start")


def _look(options: argparse.Namespace) -> int:
    """Prints tables, and draws the model if that is asked for."""
    check_writable(options.png)
    if options.scenario.endswith(worlds.MODELS):
        ends: dict[str, Any] = {"initial_position": 0, "goal_position": 0}
        given = load_scenario(options, worlds.Scenario(model=options.scenario, **ends))
        world, scenario, notes = _read_model(given, "contact" in options)
    else:
        scenario, notes = load_scenario(options), []
        world = worlds.World.from_model(scenario, scenario.initial_position)
        scenario = world.place(scenario)
    print("\n".join(_tell(world, scenario, notes)))
    if options.png:
        drawn = _draw(world, options.png)
        print(f"wrote {options.png}" if drawn else "no picture: there is no shape to draw")
    return FINE


def _read_model(
    given: worlds.Scenario, is_asked: bool
) -> tuple[worlds.World, worlds.Scenario, list[str]]:
    """Returns a model's world, its scenario, and notes.

    No contact law was asked for where only a compliant one fits: that of bodies that float.
    """
    try:
        return worlds.World.from_model(given), given, []
    except ModelError as error:
        soft = dataclasses.replace(given, contact="compliant")
        if is_asked:
            raise
        try:
            world = worlds.World.from_model(soft)
        except ModelError:
            raise error from None
        why = "--contact rigid says why that does not read it"
        return world, soft, [f"read with contact: compliant ({why})"]


def _tell(world: worlds.World, scenario: worlds.Scenario, notes: Sequence[str]) -> Iterator[str]:
    """Yields lines about a world."""
    plant = world.plant
    masses = sum(body.default_mass() for body in worlds.list_moving(plant))
    yield f"{scenario.model}: {plant.num_positions()} coordinates, {masses:.4g} kg that move"
    yield from _table(
        ("joint", "kind", "unit", "from", "to", "damping", "friction"), _joints(world)
    )
    bounds = world.limits.control_items(plant, scenario)
    names = [
        name
        for name in worlds.name_controls(plant, world.num_actuators)
        if not any(b.startswith(name) for b in bounds)
    ]
    yield ""
    yield "actuators"
    yield from (f"  {text}" for text in (*bounds, *(f"{name} without limit" for name in names)))
    header = "contact", "stiffness", "dissipation", "friction", "restitution"
    yield from _table(header, dict.fromkeys(_contacts(world, scenario)))
    for title, lines in (("left out", world.ignored), ("notes", [*notes, *world.notes])):
        if lines:
            yield from ("", title, *(f"  {line}" for line in lines))


def _joints(world: worlds.World) -> Iterator[tuple[str, ...]]:
    """Yields a row for each coordinate."""
    plant, (lower, upper) = world.plant, world.limits.position
    for joint in map(plant.get_joint, plant.GetJointIndices()):
        q, v = joint.position_start(), joint.velocity_start()
        damping = joint.default_damping_vector()
        is_vector = joint.num_positions() == joint.num_velocities()  # Else it has no limits.
        for k in range(joint.num_velocities()):
            ends = (lower[q + k], upper[q + k]) if is_vector else (-np.inf, np.inf)
            dry = 0.0 if world.dry_friction is None else world.dry_friction[v + k]
            numbers = (f"{number:.4g}" for number in (*ends, damping[k], dry))
            yield joint.name(), joint.type_name(), world.units[v + k], *numbers


def _contacts(world: worlds.World, scenario: worlds.Scenario) -> Iterator[tuple[str, ...]]:
    """Yields a row for each contact; those of all corners of a shape are the same."""
    is_rigid, restitutions = scenario.contact == "rigid", world.restitutions(scenario)
    for i, (contact, shapes) in enumerate(zip(world.contacts, world.shapes, strict=True)):
        given = [
            [worlds.read_property(world.scene_graph, shape, name) for shape in shapes]
            for name in (worlds.STIFFNESS, worlds.DISSIPATION)
        ]
        texts = ["none" if None in pair else " | ".join(f"{x:.3g}" for x in pair) for pair in given]
        friction = world.rubbing.model_coefficients[i]
        restitution = f"{restitutions[i]:.3g}" if is_rigid else "-"
        yield worlds.name_alike(contact.name), *texts, f"{friction:.3g}", restitution


def _table(header: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> Iterator[str]:
    """Yields lines of a table, after an empty one; none without rows."""
    lines = [header, *rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    if len(lines) > 1:
        yield ""
        for line in lines:
            cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
            yield "  ".join(cells).rstrip()


def _draw(world: worlds.World, path: str) -> bool:
    """Writes a picture of a world at its default positions, seen along y; returns whether.

    Half spaces are left out: they would fill it.
    """
    actors = [actor for actor in show.read_actors(world) if not actor.is_half_space]
    if not actors:
        return False
    context = world.plant.GetMyContextFromRoot(world.create_context())
    poses = [actor.pose(world.plant, context) for actor in actors]
    scene_graph = geometry.SceneGraph()
    source, (width, height) = scene_graph.RegisterSource("look"), _PIXELS
    for actor, pose in zip(actors, poses, strict=True):
        drawn = geometry.GeometryInstance(pose, actor.shape, actor.name)
        look = geometry.PerceptionProperties()
        if actor.color is not None:
            look.AddProperty("phong", "diffuse", actor.color)
        drawn.set_perception_properties(look)
        scene_graph.RegisterAnchoredGeometry(source, drawn)
    scene_graph.AddRenderer("look", geometry.MakeRenderEngineVtk(geometry.RenderEngineVtkParams()))
    query: Any = scene_graph.get_query_output_port().Eval(scene_graph.CreateDefaultContext())
    places = np.array([pose.translation() for pose in poses])
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    size = max(_LEAST_SIZE, float(np.ptp(places, axis=0).max()))
    back = np.array([0.0, -1.0, _UP]) * _BACK * (size + _LEAST_SIZE) / np.tan(_VIEW / 2) / 2
    forward = -back / np.linalg.norm(back)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    R = RotationMatrix(np.column_stack([right, np.cross(forward, right), forward]))
    info = CameraInfo(width, height, _VIEW)
    clipping = geometry.ClippingRange(0.01, 100.0 * (size + 1.0))
    core = geometry.RenderCameraCore("look", info, clipping, RigidTransform())
    pose = RigidTransform(R, middle + back)
    image = query.RenderColorImage(
        geometry.ColorRenderCamera(core), scene_graph.world_frame_id(), pose
    )
    matplotlib.image.imsave(path, np.ascontiguousarray(image.data), format="png")
    return True
