"""Pairs of shapes that a scenario keeps apart."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.dynamics import EquationsOfMotion
from drake_aigto.errors import ScenarioError
from drake_aigto.world.files import suggest


def find_least_distances(
    world: EquationsOfMotion, reaches: Floats, clearance: Mapping[str, float]
) -> Floats:
    """Returns the least φ of each contact, shape (m,) [m]; −∞ where shapes may touch.

    Of two spheres that move about each other φ = (l² − R²)/(2R), l the distance of their centers,
    so that a distance d between them is φ = d + d²/(2R).

    Args:
        world: of the contacts.
        reaches: R of each, 0 of all but such spheres, shape (m,) [m].
        clearance: name of a pair, or a glob → the distance to keep [m].

    Raises:
        ScenarioError: no pair has this name, or a box is passed on several sides, where the
            distance is no single φ.
    """
    names = [contact.name for contact in world.contacts]
    least, num_faces = np.full(len(names), -np.inf), world.are_of_one_solid.sum(axis=1)
    for glob, distance in clearance.items():
        chosen = [i for i, name in enumerate(names) if fnmatchcase(name, glob)]
        if not chosen:
            raise ScenarioError(
                f"clearance: {glob!r}",
                got="no pair of this name that can touch",
                expected=f"one of {', '.join(names)}" if names else "a model with contacts",
                remedy=suggest(glob, names),
            )
        for i in chosen:
            if num_faces[i] > 1:
                raise ScenarioError(
                    f"clearance: {names[i]!r}",
                    got=f"a box with {num_faces[i]} faces that can be touched",
                    expected="a half space, a sphere, or a box with one such face",
                    remedy="Bound positions, or make the box larger in the model.",
                )
            phi = distance + (distance**2 / (2 * reaches[i]) if reaches[i] else 0.0)
            least[i] = max(least[i], phi)
    return least


def check_clearance(world: EquationsOfMotion, least: Floats, q: Floats) -> None:
    """Refuses a start whose φ are below the least ones, shape (m,) [m].

    Raises:
        ScenarioError: one is; says which.
    """
    lacks = least - world.calc_signed_distance(q)
    if np.any(lacks > 0):
        i = int(np.argmax(lacks))
        raise ScenarioError(
            "initial_position",
            got=f"{lacks[i]:.3g} m too near ({world.contacts[i].name})",
            expected="one that keeps the scenario's clearance",
            remedy="Start farther away, or ask for less clearance.",
        )
