"""Names of the coordinates of a world, and places of its walls in them."""

from __future__ import annotations

import numpy as np
from pydrake.multibody.tree import PrismaticJoint

from drake_aigto.arrays import Bools, Floats
from drake_aigto.world import Scenario, TaskCost, World


def coordinate_names(world: World) -> list[str]:
    """Returns a name for each coordinate: its axis where axes tell them apart, or its joint's."""
    plant = world.plant
    context = plant.CreateDefaultContext()
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    moving = sorted(
        (joint for joint in joints if joint.num_positions()), key=lambda j: j.position_start()
    )
    axes = [
        joint.frame_on_parent().CalcPoseInWorld(context).rotation() @ joint.translation_axis()
        for joint in moving
        if isinstance(joint, PrismaticJoint)
    ]
    letters = ["xyz"[int(np.argmax(axis))] for axis in axes if np.max(axis) > 1 - 1e-9]
    if len(set(letters)) == len(moving):
        return letters
    names = plant.GetPositionNames(add_model_instance_prefix=False, always_add_suffix=False)
    return [name.replace("_", " ") for name in names]


def coordinate_unit(world: World, coordinate: int) -> str:
    """Returns the unit of a coordinate."""
    return "rad" if world.is_hinge[coordinate] else "m"


def moves_straight(world: World) -> bool:
    """Returns whether all that moves keeps to straight lines, as balls on sliders do."""
    return world.has_constant_inertia and not np.any(world.is_hinge)


def has_goal(world: World, scenario: Scenario) -> Bools:
    """Returns which coordinates a scenario wants at their goal, at the end or always, (nq,)."""
    cost = TaskCost.of(world, scenario)
    is_weighted = np.diag(cost.QT) > 0
    if scenario.reference_positions is None:
        is_weighted = is_weighted | (cost.Q > 0)
    return is_weighted | scenario.hard_goal


def find_goal(world: World, scenario: Scenario, end: Floats) -> Floats:
    """Returns the goal of a motion that ends at q, shape (nq,).

    Of an angle whose turns do not count, it is the one nearest to q; without a weight, q itself.
    """
    nearest = end - TaskCost.of(world, scenario).goal_errors(end)
    goal = scenario.goal_position if scenario.angles == "exact" else nearest
    return np.where(has_goal(world, scenario), goal, end)


def solid_regions(world: World, coordinates: tuple[int, int], window: Floats) -> list[Floats]:
    """Returns where solids are in the plane of two coordinates, as polygons.

    There the sphere would be inside: φ(q) < 0 for all faces of the solid, φ being affine. Solids
    that other coordinates matter to have no place in this plane, and are left out, as are all of a
    mechanism, whose φ is not affine. What is looked at is a window, opposite corners of shape
    (2, 2) [m].

    Returns:
        for each solid that is there, its corners in order, shape (k, 2) [m].
    """
    if not world.has_constant_inertia:
        return []
    distances, slopes = world.constant_inertia.offset, world.constant_inertia.jacobian
    others = np.setdiff1d(np.arange(world.num_positions), coordinates)
    regions = []
    for faces in world.solids:
        if np.any(slopes[list(faces)][:, others]):
            continue
        (x0, y0), (x1, y1) = window
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        for face in faces:
            corners = _cut(corners, distances[face], slopes[face, list(coordinates)])
        if len(corners):
            regions.append(corners)
    return regions


def wall_places(world: World, coordinate: int) -> list[tuple[int, float, float]]:
    """Returns the walls across one coordinate: contact, place [m], and the side it faces, ±1.

    Of solids with one face only: those with several end somewhere along other coordinates. Links
    that turn meet walls at no one place of a coordinate.
    """
    if not world.has_constant_inertia:
        return []
    distances, slopes = world.constant_inertia.offset, world.constant_inertia.jacobian
    alone = [faces[0] for faces in world.solids if len(faces) == 1]
    return [
        (i, -distances[i] / slopes[i, coordinate], float(np.sign(slopes[i, coordinate])))
        for i in alone
        if slopes[i, coordinate] and np.count_nonzero(slopes[i]) == 1
    ]


def _cut(corners: Floats, distance: float, slope: Floats) -> Floats:
    """Returns the part of a convex polygon where distance + slope · corner ≤ 0."""
    kept: list[Floats] = []
    heights = distance + corners @ slope
    for i, (corner, height) in enumerate(zip(corners, heights, strict=True)):
        if height <= 0:
            kept.append(corner)
        after, later = corners[(i + 1) % len(corners)], heights[(i + 1) % len(corners)]
        if height * later < 0:
            kept.append(corner + height / (height - later) * (after - corner))
    return np.array(kept).reshape(-1, 2)
