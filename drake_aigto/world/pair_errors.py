"""Why shapes can't touch, or not as a plan would need it, with what to do about that."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import Any

from pydrake.geometry import Box, GeometryId, HalfSpace, Role, SceneGraph, Sphere
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RigidBody

from drake_aigto.errors import ModelError
from drake_aigto.world.diagram import find_hinges
from drake_aigto.world.model_facts import FixableError

# In names, before a number: ends of a capsule, corners of a solid, marks of a plane.
END, CORNER = " end ", " corner "
_ENDS = rf"({END}|{CORNER})\d+(?= with | against |$)"
MARK = " plane "
# Shapes, and what collides in their place.
_INSTEAD = {
    "Capsule": "capsules by spheres along their axes",
    "Cylinder": "cylinders across the plane of motion by spheres of their radius",
    "Box": "boxes that stand on corners by spheres there, and those that are the ground by planes",
    "Mesh": "meshes by boxes or spheres",
    "Convex": "meshes by boxes or spheres",
    "Ellipsoid": "ellipsoids by spheres",
}
_SOFT = (
    " With contact: compliant, capsules meet spheres, boxes and each other; boxes and meshes "
    "spheres, half spaces and each other; cylinders spheres and half spaces."
)
_MOST_WORK = 30_000  # Samples of all distances, about a second's worth.

IN_PLANE = "Sphere against Box, HalfSpace or Sphere, or Capsule against HalfSpace"

_WITH = " with "
Pair = tuple[GeometryId, GeometryId]


def name_shape(inspector: Any, shape: GeometryId) -> str:
    """Returns the name of a shape, or of that whose end or corner it is."""
    return name_whole(inspector.GetName(shape))


def find_link(plant: MultibodyPlant, inspector: Any, shape: GeometryId) -> RigidBody:
    """Returns the link that a shape is part of in the model, as a mark tells for a plane."""
    frame, name = inspector.GetFrameId(shape), inspector.GetName(shape)
    if frame == inspector.world_frame_id() and isinstance(inspector.GetShape(shape), HalfSpace):
        every = inspector.GetAllGeometryIds()
        marks = (
            each
            for each in every
            if re.fullmatch(rf"{re.escape(name)}{MARK}\d+", inspector.GetName(each))
        )
        frame = next(map(inspector.GetFrameId, marks), frame)
    return plant.GetBodyFromFrameId(frame)


def explain_no_contact(scene_graph: SceneGraph, are_ignored: bool = False) -> str | None:
    """Returns why nothing can touch, of a model that has collision shapes."""
    inspector: Any = scene_graph.model_inspector()
    if not (count := len(inspector.GetAllGeometryIds(Role.kProximity))):
        return None
    if count == 1:
        why = "there is one collision shape"
    elif not inspector.GetCollisionCandidates():
        why = (
            f"Drake lets no two of {count} collision shapes collide (those that are welded "
            "together, or anchored, or on links that a joint connects, or excluded by a "
            "<drake:collision_filter_group>)"
        )
    elif are_ignored:
        why = "shapes that would are ignored"
    else:
        why = f"no motion brings together any two of {count} collision shapes"
    return f"nothing can touch: {why}"


def refuse_pairs(inspector: Any, pairs: list[Pair], expected: str = IN_PLANE) -> ModelError:
    """Returns the error of pairs that are not supported, with the fewest shapes to leave out."""
    of_kind: dict[tuple[str, ...], list[Pair]] = {}
    for pair in pairs:
        kinds = [type(inspector.GetShape(shape)).__name__ for shape in pair]
        known = next((kind for kind in of_kind if sorted(kind) == sorted(kinds)), tuple(kinds))
        of_kind.setdefault(known, []).append(pair)
    listed = [
        f"{' against '.join(kind)}: {name_pairs(inspector, each)}" for kind, each in of_kind.items()
    ]
    out = dict.fromkeys(map(inspector.GetName, _cover(inspector, pairs)))
    names = {name for kind in of_kind for name in kind}
    instead = [text for name, text in _INSTEAD.items() if name in names]
    return FixableError(
        f"contact of {name_pair(inspector, pairs[0])}" if len(pairs) == 1 else "contacts",
        got=" against ".join(next(iter(of_kind))) if len(pairs) == 1 else ". ".join(listed),
        expected=expected,
        remedy=f"Leave shapes out by the scenario's ignored_shapes: [{', '.join(out)}], or the "
        f"pairs by allow_ignored: [pairs]; or replace {'; '.join(instead)}; or exclude pairs with "
        f"a <drake:collision_filter_group>.{_SOFT if expected == IN_PLANE else ''}",
        fields={"allow_ignored": ["pairs"]},
    )


def check_work(plant: MultibodyPlant, scene_graph: SceneGraph, pairs: Sequence[Pair]) -> None:
    """Refuses pairs whose distances would take too long to read, before any is read.

    A distance is sampled at all combinations of two positions of each slider and three of each
    hinge between both bodies (`interpolate`), once for each face of a box; of two spheres its
    square is multiplied out. The cheapest pairs count first.
    """
    inspector: Any = scene_graph.model_inspector()
    work = {pair: _count_samples(plant, inspector, pair) for pair in pairs}
    total, refused = 0, list[Pair]()
    for pair in sorted(pairs, key=work.__getitem__):
        total += work[pair]
        if total > _MOST_WORK:
            refused.append(pair)
    if not refused:
        return
    out = ", ".join(
        names := list(
            dict.fromkeys(
                _name_whole(plant, inspector, shape) for shape in _cover(inspector, refused)
            )
        )
    )
    raise FixableError(
        "contacts",
        got=f"too many, across too many joints: {name_pairs(inspector, refused)}",
        expected="few enough to be read within a second",
        remedy=f"Leave shapes out by the scenario's ignored_shapes: [{out}], or fix joints by its "
        "fixed_joints.",
        fields={"ignored_shapes": names},
    )


def _count_samples(plant: MultibodyPlant, inspector: Any, pair: Pair) -> int:
    """Returns how many samples the distances of one pair take."""
    chains = []
    joints = [plant.get_joint(index) for index in plant.GetJointIndices()]
    inboard = {joint.child_body().index(): joint for joint in joints}
    for shape in pair:
        body, chain = plant.GetBodyFromFrameId(inspector.GetFrameId(shape)), set[int]()
        while joint := inboard.get(body.index()):
            start = joint.position_start()
            chain |= set(range(start, start + joint.num_positions()))
            body = joint.parent_body()
        chains.append(chain)
    is_hinge = find_hinges(plant)
    count = math.prod(3 if is_hinge[i] else 2 for i in chains[0] ^ chains[1])
    shapes = [inspector.GetShape(shape) for shape in pair]
    if any(isinstance(shape, Box) for shape in shapes):
        return 6 * count
    return count**2 if all(isinstance(shape, Sphere) for shape in shapes) else count


def _cover(inspector: Any, pairs: list[Pair]) -> list[GeometryId]:
    """Returns few shapes of which each pair has one; walls stay where they can."""
    partners: dict[GeometryId, set[GeometryId]] = {}
    for one, other in pairs:
        partners.setdefault(one, set()).add(other)
        partners.setdefault(other, set()).add(one)
    walls = {each for each in partners if isinstance(inspector.GetShape(each), Box | HalfSpace)}
    out = list[GeometryId]()
    while any(partners.values()):
        out.append(max(partners, key=lambda each: (len(partners[each]), each not in walls)))
        for other in partners.pop(out[-1]):
            partners[other].discard(out[-1])
    return out


def name_pair(inspector: Any, pair: Pair) -> str:
    """Returns the names of two shapes, capsules for their ends."""
    return _WITH.join(name_shape(inspector, shape) for shape in pair)


def name_alike(name: str) -> str:
    """Returns what contacts of all ends or corners of a shape are called, of one of them."""
    return re.sub(_ENDS, lambda end: f"{end[1].rstrip()}s", name)


def name_whole(name: str) -> str:
    """Returns a contact's name without numbers of ends and corners."""
    return re.sub(_ENDS, "", name)


def is_of_pair(name: str, glob: str) -> bool:
    """Returns whether a pair's name, with or without numbers of ends, either way, fits a glob."""
    whole = name_whole(name)
    return any(
        fnmatchcase(each, glob) for each in (name, whole, _WITH.join(whole.split(_WITH)[::-1]))
    )


def name_pairs(inspector: Any, pairs: list[Pair]) -> str:
    """Returns the names of pairs, grouped by shape, without the name of a model that all share."""
    names = [tuple(name_shape(inspector, shape) for shape in pair) for pair in pairs]
    models = {name.rpartition("::")[0] for pair in names for name in pair} - {""}
    if len(models) == 1:
        names = [tuple(name.rpartition("::")[2] for name in pair) for pair in names]
    links = dict.fromkeys(map(frozenset, names))
    shapes = sorted({name for pair in names for name in pair})
    others = dict.fromkeys(map(frozenset, itertools.combinations(shapes, 2)))
    apart = [pair for pair in others if pair not in links]
    each_two = f"any two of {', '.join(shapes)}" + f" but {_group(apart)}" * bool(apart)
    return min(_group(list(links)), each_two, key=len)


def _group(links: list[frozenset[str]]) -> str:
    """Returns the text of pairs, those of one name together, of the most frequent name first."""
    left, texts = list(links), []
    while left:
        counts = Counter(name for link in left for name in sorted(link))
        name = max(counts, key=counts.__getitem__)
        partners = [min(link - {name}, default=name) for link in left if name in link]
        texts.append(f"{name} with {', '.join(partners)}")
        left = [link for link in left if name not in link]
    return "; ".join(texts)


def _name_whole(plant: MultibodyPlant, inspector: Any, shape: GeometryId) -> str:
    """Returns the name of a shape with that of its link, which no other shape has."""
    model, _, name = name_shape(inspector, shape).rpartition("::")
    return f"{model}::{find_link(plant, inspector, shape).name()}::{name}".removeprefix("::")
