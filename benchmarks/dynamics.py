"""How long accelerations of trees of joints take, with and without their derivatives.

    python -m benchmarks.dynamics

Arms of 2, 4 and 7 hinges, and a floating body with four legs of 3 hinges each, 18 coordinates; the
least of some repeats, beside Drake's own time for M and h by numbers. Exits with 1 if one with
derivatives takes longer than 4 µs for 7 hinges or 12 µs for 18 coordinates.
"""

from __future__ import annotations

import sys
import time

import numpy as np
from pydrake.multibody.plant import MultibodyPlant
from pydrake.multibody.tree import RevoluteJoint, RigidBody, SpatialInertia

from drake_aigto.dynamics import Tree, make_tree_memory, repeat_accelerations

MOST = {7: 4.0, 18: 12.0}  # [µs]
_COUNT, _REPEATS = 4000, 7


def _add_chain(plant: MultibodyPlant, parent: RigidBody, name: str, count: int) -> None:
    """Adds links on hinges about z and y in turns, each driven."""
    for k in range(count):
        inertia = SpatialInertia.SolidBoxWithMass(1.0, 0.1, 0.08, 0.3).Shift(np.array([0, 0, -0.1]))
        link = plant.AddRigidBody(f"{name}_{k}", inertia)
        axis = [0.0, 0.0, 1.0] if k % 2 == 0 else [0.0, 1.0, 0.0]
        joint = RevoluteJoint(f"{name}_{k}", parent.body_frame(), link.body_frame(), axis)
        plant.AddJointActuator(f"{name}_{k}", plant.AddJoint(joint))
        parent = link


def make_plant(num_hinges: int, num_legs: int = 0) -> MultibodyPlant:
    """Returns an arm, or a floating body with legs of this many hinges."""
    plant = MultibodyPlant(0.0)
    if num_legs:
        base = plant.AddRigidBody("base", SpatialInertia.SolidBoxWithMass(9.0, 0.4, 0.2, 0.1))
        for leg in range(num_legs):
            _add_chain(plant, base, f"leg_{leg}", num_hinges)
    else:
        _add_chain(plant, plant.world_body(), "arm", num_hinges)
    plant.Finalize()
    return plant


def measure(plant: MultibodyPlant) -> tuple[float, float, float]:
    """Returns µs of v̇, of v̇ with derivatives, and of Drake's M and h."""
    tree, rng = Tree.of(plant), np.random.default_rng(0)
    memory, found = make_tree_memory(tree), []
    q = tree.add(plant.GetDefaultPositions(), rng.normal(size=tree.num_velocities))
    v, u = rng.normal(size=tree.num_velocities), rng.normal(size=plant.num_actuators())
    for has_slopes in (False, True):
        seconds = []
        for _ in range(_REPEATS):
            begin = time.process_time()
            repeat_accelerations(_COUNT, tree, q, v, u, has_slopes, memory)
            seconds.append(time.process_time() - begin)
        found.append(min(seconds) / _COUNT * 1e6)
    context, begin = plant.CreateDefaultContext(), time.process_time()
    for _ in range(_COUNT):
        plant.SetPositions(context, q)
        plant.CalcMassMatrix(context)
        plant.CalcBiasTerm(context)
    return found[0], found[1], (time.process_time() - begin) / _COUNT * 1e6


def main() -> int:
    """Prints the figures, and returns 1 if one is missed."""
    is_missed = False
    for plant in (make_plant(2), make_plant(4), make_plant(7), make_plant(3, num_legs=4)):
        n = plant.num_velocities()
        value, slopes, drake = measure(plant)
        is_missed |= slopes > MOST.get(n, np.inf)
        print(f"{n:3} coordinates: v̇ {value:6.2f} µs, with derivatives {slopes:6.2f} µs", end="")
        print(f"; Drake's M and h {drake:6.2f} µs")
    return int(is_missed)


if __name__ == "__main__":
    sys.exit(main())
