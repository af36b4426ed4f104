"""How far motions are closed by shooting, and what comes before and after."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Bools, Floats
from drake_aigto.contact import CompliantLaw, ContactLaw, calc_pushes
from drake_aigto.shooting import ShootingOptions, ShootingProblem, ShootingResult, Smoothing
from drake_aigto.simulation import EVENT_DRIVEN, Held, HeldControl, has_knots, replay_with
from drake_aigto.world import Scenario, World

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
WITH_FRICTION = dataclasses.replace(POLISH, rungs=(Smoothing(1e-6, 150, 1e-5),))

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
            between rigid walls what costs more (`RigidMechanismTask.bounce`).
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
    if law.has_friction:
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


# A throw takes this part of the duration at most: in more, control has a say in where it leads.
_THROW = 0.1
# By how much a hinge that was thrown turns in a time step of drawn boxes, at most [rad].
_LARGEST_TURN = 1.0


class Launch(NamedTuple):
    """From where on boxes have a say.

    A wall that throws a start off does so within one time step of boxes, in which they take its
    first push for one that lasts, so that all that follows is wrong. Of 20 starts deep in the walls
    of `cart_pole/soft_06`, drawn for this, plans are within 1 % of the best known of 13 with boxes
    from where these leave the walls on, in time steps that resolve how fast they turn and with more
    patience; of 9 with boxes from the start on, a mean of three seeds (2.9 and 2.2 CPU seconds).

    Attributes:
        knot: of motions as they are searched for; 0: the start.
        time: of it [s].
        position: q there, shape (n,).
        velocity: v there, shape (n,).
    """

    knot: int
    time: float
    position: Floats
    velocity: Floats

    def find_haste(self, time_step: float, is_hinge: Bools) -> int:
        """Returns into how many parts time steps of boxes are divided to resolve what turns.

        Args:
            time_step: what they are elsewhere [s].
            is_hinge: which coordinates turn, shape (n,).
        """
        fastest = np.max(np.abs(self.velocity[is_hinge]), initial=0.0)
        return max(1, int(np.ceil(time_step * fastest / _LARGEST_TURN)))


def find_launch(world: World, law: CompliantLaw, coast: ShootingResult) -> Launch:
    """Returns where the motion without control first touches nothing, if that is soon.

    Args:
        world: the mechanism.
        law: what its contacts push with.
        coast: the motion without control.
    """
    q, v = np.split(coast.states, 2, axis=1)
    is_finite = np.isfinite(coast.states).all(axis=1)
    is_soon = is_finite & (coast.times <= _THROW * coast.times[-1])
    pushes = calc_pushes(world, law, q[is_soon], v[is_soon])
    knot = int(np.argmin(np.any(pushes > 0, axis=1)))
    return Launch(knot, float(coast.times[knot]), q[knot], v[knot])


class _Correcting(HeldControl):
    """Holds a motion's controls between knots, less what its gains answer at each."""

    is_open_loop = False

    def __init__(self, motion: ShootingResult, gains: Floats, bounds: Floats) -> None:
        super().__init__(motion.times, motion.controls)
        self._motion, self._gains, self._bounds = motion, gains, bounds
        self.controls = np.array(motion.controls)

    def sample(self, time: float, x: Floats, bounces: Sequence[int]) -> Held:
        held = super().sample(time, x, bounces)
        k = int(np.searchsorted(self._motion.times, held.until)) - 1
        answer = self._gains[k] @ (x - self._motion.states[k])
        self.controls[k] = np.clip(self._motion.controls[k] + answer, *self._bounds)
        return Held(self.controls[k], held.until)


def steady(
    world: World, scenario: Scenario, problem: ShootingProblem, motion: ShootingResult
) -> ShootingResult:
    """Returns a motion with its controls corrected along the exact law.

    Where friction sticks and slips, Runge-Kutta steps are of low order, and what is unstable makes
    much of their errors: of a pole that balances for 3 s 1e-8 becomes 1e-3. So the motion is
    simulated again by the world's own equations, each control corrected at its knot by
    the gains of the motion (`ShootingProblem.calc_gains`), and what was held is the answer.

    Args:
        world: the mechanism.
        scenario: the task.
        problem: that the motion is a result of.
        motion: near an optimum.
    """
    gains = problem.calc_gains(motion.controls, motion.substeps)
    controller = _Correcting(motion, gains, problem.control_bounds)
    found = None
    if scenario.contact == "compliant":
        found = replay_with(EVENT_DRIVEN, world, scenario, controller)
    else:
        EVENT_DRIVEN.simulate(world, scenario, controller)
    # Where its cost has kinks between knots, the replay of a plan has knots there, too.
    is_whole = has_knots(scenario, motion.times)
    return dataclasses.replace(
        motion, controls=controller.controls, replay=found if is_whole else None
    )
