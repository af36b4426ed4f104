"""How far motions are closed by shooting: those that boxes show, those kept, and finalists."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import CompliantLaw, ContactLaw
from drake_aigto.shooting import ShootingOptions, Smoothing
from drake_aigto.world import World

# What boxes show is closed in a few steps: from walls smoothed by more, it takes longer and ends
# within 1 % of the best half as often (of 800 boxes around the cart-pole, `cart_pole/soft_06`).
COARSE = ShootingOptions(
    rungs=(Smoothing(1e-2, 8, 5e-2), Smoothing(1e-3, 15, 1e-2)), order=2, multiplier_updates=0
)

# Hard goals take more: closed as above, no motion that was kept led to the goal in four of 16
# questions about the cart-pole between soft walls; in none so.
AIMED = dataclasses.replace(COARSE, multiplier_updates=2)

# Between walls that yield, from such as are nearly those that count, in Runge-Kutta steps that
# resolve them: of 9 starts deep in a wall of `cart_pole/soft_06`, drawn for this, plans are within
# 1 % of the best of ten such settings at 5, and of 19 others at all; closed as above at 2 and 18.
NEAR = ShootingOptions(rungs=(Smoothing(1e-3, 23, 1e-2),), order=2, multiplier_updates=0)

# What a motion costs in short time steps, and then what walls that are hardly smoothed make of it:
# more smoothed, they push otherwise by as much as hard goals allow.
TIGHT = ShootingOptions(rungs=(Smoothing(1e-3, 40, 1e-3),), substeps=4)
POLISH = ShootingOptions(rungs=(Smoothing(1e-4, 40, 1e-5), Smoothing(1e-6, 40, 1e-5)), substeps=4)
RUBBED = dataclasses.replace(POLISH, rungs=(Smoothing(1e-6, 150, 1e-5),))

# Friction stiffens from stiction speeds of a whole way in the duration to a thousandth.
COOLING = ShootingOptions(
    rungs=tuple(Smoothing(each, 60, 1e-5) for each in (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)),
    substeps=4,
)

# Joints that rub are closed so, too: bounds hardly count while friction is smoothed, for friction
# that is all viscous may not lead to the goal within them, and count ten times more after each rung
# that leaves them. Then friction as sharp as steps allow tells which of the motions is best. Of the
# ladder's boxes around nine of CRISP's payloads, the best closes at 1 to 1.2 times what the plan
# costs, and at twice that of one; as `COARSE` has it, at 3 to 1e5 times. `TIGHT` ends so early that
# the order of motions is not that of their polishes.
DRY = dataclasses.replace(COOLING, order=2, penalty=1e-5, multiplier_updates=5)
TIGHT_DRY = ShootingOptions(
    rungs=tuple(Smoothing(each, 60, 1e-6) for each in (0.01, 3e-3, 1e-3)),
    substeps=4,
    penalty=1e-5,
)

# Of a Runge-Kutta step of second order, in the time in which the fastest motion turns by 1 rad: if
# it is to be stable, and if it is to resolve what is pushed.
_LONGEST_STEP, _RESOLVING_STEP = 1.5, 0.75
# Walls that rub push from as far as the task is long, then from ever nearer.
_FROM_AFAR = tuple(Smoothing(each, 15, 1e-2) for each in (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3))


class Aim(NamedTuple):
    """What motions that boxes show are closed for.

    Attributes:
        most: what promises to cost more is left half-way, where it is closed in one pass, and
            between rigid walls what costs more (`RigidMechanismProblem.bounce`).
        is_patient: whether what ends worse than no control is closed again, with more care.
    """

    most: float = np.inf
    is_patient: bool = True

    def limit(self, options: ShootingOptions) -> ShootingOptions:
        """Returns how to close for it: costs by other walls and prices tell too little of those."""
        is_plain = len(options.rungs) == 1 and not options.multiplier_updates
        return dataclasses.replace(options, most_promised=self.most) if is_plain else options


def find_closing(
    world: World, law: ContactLaw, q: Floats, time_step: float, is_aimed: bool
) -> ShootingOptions:
    """Returns how what boxes show is closed.

    Args:
        world: the mechanism.
        law: what its contacts push with.
        q: where it starts, shape (n,).
        time_step: between knots [s].
        is_aimed: whether the goal is hard.
    """
    if world.dry_friction is not None:
        return DRY
    options = AIMED if is_aimed else COARSE
    if not isinstance(law, CompliantLaw):
        return options
    turn = time_step * _calc_pace(world, law, q)
    if law.rubs:
        return _from_afar(options, turn)
    substeps = max(1, int(np.ceil(turn / _RESOLVING_STEP)))
    return options if is_aimed else dataclasses.replace(NEAR, substeps=substeps)


def find_tight(world: World) -> ShootingOptions:
    """Returns how what was closed is followed in short time steps."""
    return TIGHT if world.dry_friction is None else TIGHT_DRY


def _from_afar(options: ShootingOptions, turn: float) -> ShootingOptions:
    """Returns the same, by walls that push from afar first, in Runge-Kutta steps that are stable.

    What is pushed and held by friction is felt only so, as is the way round it: of 96 renewals on
    `push_circle/round_it` none led anywhere otherwise.

    Args:
        options: whose rungs and substeps are replaced.
        turn: by how much the fastest motion turns in a stage [rad].
    """
    substeps = max(options.substeps, int(np.ceil(turn / _LONGEST_STEP)))
    return dataclasses.replace(options, rungs=_FROM_AFAR, substeps=substeps)


def _calc_pace(world: World, law: CompliantLaw, q: Floats) -> float:
    """Returns how fast what touches at q would swing on its springs, at most [rad/s]."""
    J, M = world.calc_contact_jacobian(q), world.calc_mass_matrix(q)
    distances = world.calc_signed_distance(q)
    _, _, levers = law.find_gaps(distances, np.zeros_like(distances))
    mobility = np.einsum("ij,ji->i", J, np.linalg.solve(M, J.T)) * levers**2
    return float(np.sqrt(np.max(law.stiffness * mobility, initial=0.0)))
