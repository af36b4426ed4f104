"""Friction in Meshcat: cones that tell stick from slip by their shape, and impulses within them."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from meshcat_pages import clips, objects
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import Meshcat
from pydrake.math import RotationMatrix

from drake_aigto import Scenario, World
from drake_aigto.show import ROOT, Motion, plot_friction, publish
from drake_aigto.transcription import Touch

GONE = 2e-3
WEIGHT, PULL = 9.81, 1.5  # [N]
FOLDER = f"{ROOT}/motions/1"


@cache
def read(name: str) -> tuple[World, Scenario, float]:
    """Returns the world of a scenario, the scenario, and μ."""
    scenario = Scenario.named(name)
    world = World.from_scenario(scenario)
    return world, scenario, float(world.friction_coefficients(scenario).max())


def drag() -> Motion:
    """Returns a block of 1 kg: pulled in vain, sliding from 0.3 s on, without weight from 0.7 s."""
    times = np.linspace(0.0, 1.0, 101)
    q = np.column_stack([np.maximum(0.0, times - 0.3), np.full(101, 0.15)])
    v = np.column_stack([times > 0.305, np.zeros(101)]).astype(float)
    knots = np.array([0.0, 0.3, 0.7, 1.0])
    controls, forces = np.array([[PULL], [5.0], [0.0]]), np.array([[WEIGHT], [WEIGHT], [0.0]])
    return Motion("plan", times, q, v, knots, controls, forces)


def seen(meshcat: Meshcat, path: str, times: list[float]) -> list[float]:
    """Returns how large an object is at these times."""
    keys, scales = clips(meshcat, "scale")[f"{FOLDER}/{path}"]
    return [float(np.interp(time, keys, scales[:, 0])) for time in times]


def point(meshcat: Meshcat, path: str, time: float) -> np.ndarray:
    """Returns where an object's z axis points at the last key before a time."""
    keys, quaternions = clips(meshcat, "quaternion")[f"{FOLDER}/{path}"]
    x, y, z, w = quaternions[np.searchsorted(keys, time) - 1]
    return RotationMatrix(Quaternion(w, x, y, z)).matrix()[:, 2]


def test_a_lasting_contact_has_a_filled_cone_while_it_sticks_and_ribs_while_it_slips(
    meshcat: Meshcat,
) -> None:
    world, scenario, mu = read("sliding_block/to_rest")
    publish([drag()], meshcat, world, scenario)
    cones = f"{FOLDER}/friction/0/force"
    shown = objects(meshcat)
    parts = {path.removeprefix(cones) for path in shown if path.startswith(cones)}
    assert parts == {"/stick", "/slip/rim", *(f"/slip/rib_{i}" for i in range(4))}
    cone = shown[f"{cones}/stick"]
    assert cone["materials"][0]["opacity"] < 0.5
    at = [0.1, 0.5, 0.8]
    assert seen(meshcat, "friction/0/force/stick", at) == pytest.approx([1, 0, 0], abs=GONE)
    assert seen(meshcat, "friction/0/force/slip", at) == pytest.approx([0, 1, 0], abs=GONE)
    assert point(meshcat, "friction/0/force/slip", 0.5) == pytest.approx([0, 0, 1])
    # What sticks takes the pull, what slips is at the edge of its cone.
    for time, friction in ((0.1, PULL), (0.5, mu * WEIGHT)):
        force = np.array([-friction, 0.0, WEIGHT])
        arrow = point(meshcat, "contacts/0/force", time)
        assert arrow == pytest.approx(force / np.linalg.norm(force), abs=1e-9)


@pytest.mark.parametrize("sticks", [True, False])
def test_an_impulse_is_seen_for_a_moment_with_the_cone_of_how_it_ends(
    meshcat: Meshcat, sticks: bool
) -> None:
    world, scenario, mu = read("billiard/spin_shot")
    contact, q = 3, np.array([0.5, 0.9, 0.0])
    J, T = world.calc_contact_jacobian(q)[contact], world.rubbing.calc_tangent_jacobian(q)[contact]
    after = 0.5 * J if sticks else 0.5 * J + T
    before = after - np.linalg.solve(world.calc_mass_matrix(q), 1.2 * J - 0.9 * mu * 1.2 * T)
    times = np.array([0.0, 0.4, 0.4, 1.0])
    places = np.array([q - 0.4 * before, q, q, q + 0.6 * after])
    velocities = np.array([before, before, after, after])
    struck = Motion("plan", times, places, velocities, impacts=(Touch.bounce(0.4, contact),))
    publish([struck], meshcat, world, scenario)
    folder, (mode, other) = f"friction/{contact}/impulse", ("stick", "slip")[:: 2 * sticks - 1]
    at = [0.39, 0.41, 0.69, 0.71]
    for part in ("arrow", mode):
        assert seen(meshcat, f"{folder}/{part}", at) == pytest.approx([0, 1, 1, 0], abs=GONE)
    assert not [path for path in objects(meshcat) if f"{folder}/{other}" in path]
    # The ball's two sliders carry its mass: its momentum changes along the impulse.
    change = np.append((after - before)[:2], 0.0)
    arrow = point(meshcat, f"{folder}/arrow", 0.5)
    assert arrow == pytest.approx(change / np.linalg.norm(change), abs=1e-9)
    cosine = arrow @ point(meshcat, f"{folder}/{mode}", 0.5)
    assert np.tan(np.arccos(cosine)) == pytest.approx(0.9 * mu)


def test_what_does_not_rub_has_no_cones(meshcat: Meshcat) -> None:
    world, scenario, _ = read("billiard/spin_shot")
    still = Motion("plan", np.array([0.0, 1.0]), np.full((2, 3), 0.5), np.zeros((2, 3)))
    publish([still], meshcat, world, scenario)
    assert not [path for path in objects(meshcat) if "/friction/" in path]


def test_a_figure_has_the_friction_of_rigid_contact_that_lasts() -> None:
    world, scenario, mu = read("sliding_block/to_rest")
    plot_friction(axes := Figure().subplots(), drag(), world, scenario)
    line, rings, crosses = axes.lines
    assert axes.get_ylabel() == "friction [N]"
    times, friction = np.asarray(line.get_xdata()), np.abs(np.asarray(line.get_ydata()))
    for first, last, size in ((0.0, 0.29, PULL), (0.31, 0.69, mu * WEIGHT), (0.71, 1.0, 0.0)):
        held = (times > first) & (times < last)
        np.testing.assert_allclose(friction[held], size, atol=1e-9)
    assert np.max(rings.get_xdata()) < 0.31 < 0.7 > np.max(crosses.get_xdata())


def test_a_figure_has_impulses_beside_forces_on_an_axis_of_their_own() -> None:
    world, scenario, mu = read("sliding_block/to_rest")
    slid, row = drag(), 50
    struck = dataclasses.replace(
        slid,
        times=np.insert(slid.times, row, 0.5),
        positions=np.insert(slid.positions, row, slid.positions[row], axis=0),
        velocities=np.insert(slid.velocities, row, [1.0, -2.0], axis=0),
        impacts=(Touch.bounce(0.5, 0),),
    )
    plot_friction((figure := Figure()).subplots(), struck, world, scenario)
    forces, impulses = figure.axes
    assert [forces.get_ylabel(), impulses.get_ylabel()] == ["friction [N]", "friction [N s]"]
    (bar,) = impulses.patches
    assert isinstance(bar, Rectangle)
    assert bar.get_height() == pytest.approx(2 * mu * 2.0)  # of 1 kg that fell at 2 m/s
    assert len(forces.lines) == 3
