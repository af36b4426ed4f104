"""Slides, rolls and impacts with friction, against what calculus says of them."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from pydrake.multibody.parsing import Parser
from pydrake.multibody.plant import AddMultibodyPlantSceneGraph
from pydrake.systems.framework import DiagramBuilder

from drake_aigto import Scenario, World, replay_event_driven
from drake_aigto.arrays import Floats
from drake_aigto.contact import Mobility, calc_impulse
from drake_aigto.simulation import Replay

_RADIUS, _MU, _G = 0.1, 0.3, 9.81
_NOTHING = """<inertial><mass>0</mass>
  <inertia><ixx>0</ixx><iyy>0</iyy><izz>0</izz></inertia></inertial>"""
_MATERIAL = f"""<drake:proximity_properties>
  <drake:point_contact_stiffness>2e9</drake:point_contact_stiffness>
  <drake:mu_dynamic>{_MU}</drake:mu_dynamic><drake:mu_static>{_MU}</drake:mu_static>
  </drake:proximity_properties>"""
_FREE = "<limit><effort>0</effort></limit>"


def list_forms() -> list[tuple[str, float]]:
    """Returns what is compared, and the largest error of each, in SI units."""
    return [*_list_slides(), *_list_rolls(), *_list_bounces(), *_list_rods()]


def _build(turns: bool) -> World:
    """Returns a solid ball of 1 kg above the ground, q = (x, z, turn about y) or without the last.

    A motor pushes it along x.
    """
    ball = f"""<link name="ball"><inertial><mass>1</mass><inertia><ixx>0.004</ixx><iyy>0.004</iyy>
      <izz>0.004</izz></inertia></inertial><collision name="ball"><geometry><sphere>
      <radius>{_RADIUS}</radius></sphere></geometry>{_MATERIAL}</collision></link>"""
    kind = f"<axis><xyz>0 1 0</xyz>{_FREE}</axis>" if turns else ""
    text = f"""<?xml version="1.0"?><sdf version="1.9" xmlns:drake="drake.mit.edu">
      <model name="disc">{ball}
      <link name="slide">{_NOTHING}</link><link name="lift">{_NOTHING}</link>
      <joint name="x" type="prismatic"><parent>world</parent><child>slide</child>
        <axis><xyz>1 0 0</xyz></axis></joint>
      <joint name="z" type="prismatic"><parent>slide</parent><child>lift</child>
        <axis><xyz>0 0 1</xyz>{_FREE}</axis></joint>
      <joint name="turn" type="{"revolute" if turns else "fixed"}"><parent>lift</parent>
        <child>ball</child>{kind}</joint>
      <link name="ground"><collision name="ground"><geometry><plane><normal>0 0 1</normal></plane>
        </geometry>{_MATERIAL}</collision></link>
      <joint name="still" type="fixed"><parent>world</parent><child>ground</child></joint>
      </model></sdf>"""
    builder = DiagramBuilder()
    plant, _ = AddMultibodyPlantSceneGraph(builder, time_step=0.0)
    Parser(plant).AddModelsFromString(text, "sdf")
    plant.Finalize()
    plant.SetDefaultPositions([0.0, 2 * _RADIUS, *[0.0] * turns])
    return World.from_diagram(builder.Build())


def _replay(world: World, q: list[float], v: list[float], push: float, e: float = 0.0) -> Replay:
    """Returns what a push does in a second."""
    scenario = Scenario(
        initial_position=q,
        initial_velocity=v,
        goal_position=q,
        goal_weight=np.ones(len(q)),
        restitution=e,
    )
    return replay_event_driven(world, scenario, np.array([0.0, 1.0]), np.array([[push]]))


def _list_slides() -> Iterator[tuple[str, float]]:
    world, rest = _build(turns=False), [0.0, _RADIUS]
    found = _replay(world, rest, [2.0, 0.0], 0.0)
    way = 2.0**2 / (2 * _MU * _G)
    yield "a block slides v^2/(2 mu g) and stops", _off(found, [way, _RADIUS], [0.0, 0.0])
    found = _replay(world, rest, [0.0, 0.0], 0.99 * _MU * _G)
    yield "a block that is pushed by less than mu m g stays", _off(found, rest, [0.0, 0.0])
    found = _replay(world, rest, [0.0, 0.0], _MU * _G + 1.0)
    yield "a block that is pushed by more goes", _off(found, [0.5, _RADIUS], [1.0, 0.0])


def _list_rolls() -> Iterator[tuple[str, float]]:
    """Yields balls that slip at first: v = 5/7 v0 + 2/7 r w0 after |s0| / (3.5 mu g)."""
    world = _build(turns=True)
    for spin, what in ((0.0, "a ball rolls once 2/7 of its slip are lost"), (-60.0, "backspin")):
        found = _replay(world, [0.0, _RADIUS, 0.0], [1.5, 0.0, spin], 0.0)
        slip = 1.5 - _RADIUS * spin
        rolling, until = 1.5 - 2 / 7 * slip, abs(slip) / (3.5 * _MU * _G)
        way = (1.5 + rolling) / 2 * until + (1.0 - until) * rolling
        ways = np.abs(found.positions[-1, :2] - [way, _RADIUS])
        speeds = np.abs(found.velocities[-1] - [rolling, 0.0, rolling / _RADIUS])
        name = "a ball with backspin returns" if spin else what
        yield name, float(max(*ways, *speeds))


def _list_bounces() -> Iterator[tuple[str, float]]:
    """Yields balls that fall and spin: s/3.5 is lost at most, mu (1 + e) of the speed of fall."""
    world = _build(turns=True)
    for spin, mode in ((-20.0, "slips"), (12.0, "sticks")):
        found = _replay(world, [0.0, 0.3, 0.0], [1.0, 0.0, spin], 0.0, e=0.6)
        fall, slip = math.sqrt(2 * _G * 0.2), 1.0 - _RADIUS * spin
        lost = math.copysign(min(abs(slip) / 3.5, _MU * 1.6 * fall), slip)
        after = [1.0 - lost, 0.6 * fall, spin + lost / (0.4 * _RADIUS)]
        row = np.flatnonzero(np.diff(found.times) == 0)[0] + 1
        error = float(np.max(np.abs(found.velocities[row] - after)))
        yield f"a ball that falls, spins and {mode} as it hits", error


def _list_rods() -> Iterator[tuple[str, float]]:
    """Yields the ends of a uniform rod that hits the ground at an angle, Routh's example.

    Of unit mass, at an angle f to the ground: a = 1 + 3 cos^2 f, b = 3 sin f cos f and
    c = 1 + 3 sin^2 f.
    """
    rate, e = -1.0, 0.5
    for angle, slip, mu, what in (
        (1.2, 3.0, 0.2, "slips on"),
        (1.2, 0.2, 0.9, "sticks"),
        (0.6, -0.05, 0.2, "slips back"),
    ):
        sin, cos = math.sin(angle), math.cos(angle)
        a, b, c = 1 + 3 * cos**2, 3 * sin * cos, 1 + 3 * sin**2
        if what == "slips on":
            normal = -(1 + e) * rate / (a - mu * b)
            tangent = -mu * normal
        elif what == "sticks":
            normal = (-(1 + e) * rate * c + b * slip) / (a * c - b**2)
            tangent = -(slip + b * normal) / c
        else:  # What slips backward is pushed on by the impact itself, and then slips forward.
            e = 0.0
            until = -slip / (b + mu * c)
            left = rate + (a + mu * b) * until
            normal = until - left / (a - mu * b)
            tangent = mu * until - mu * (normal - until)
        found = calc_impulse(Mobility(a, b, c), rate, slip, e, mu)
        error = max(abs(found.normal - normal), abs(found.tangent - tangent))
        yield f"Routh: the end of a rod that {what}", error


def _off(found: Replay, q: list[float], v: list[float]) -> float:
    """Returns how far the end of a replay is off."""
    end: Floats = np.concatenate([found.positions[-1] - q, found.velocities[-1] - v])
    return float(np.max(np.abs(end)))
