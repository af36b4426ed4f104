"""Settings for closing guesses by shooting, its springs, and corrections after it."""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from drake_aigto.arrays import Floats
from drake_aigto.contact import (
    CompliantLaw,
    ContactLaw,
    RigidLaw,
    TreeMechanism,
    calc_dissipation,
    calc_frequencies,
    calc_mobilities,
)
from drake_aigto.errors import ModelError
from drake_aigto.planning.feedback import count_damper_steps
from drake_aigto.planning.search import scaled
from drake_aigto.shooting import (
    IMPLICIT,
    ShootingOptions,
    ShootingProblem,
    ShootingResult,
    Smoothing,
    is_implicit,
)
from drake_aigto.world import SpaceWorld, World, find_anywhere

# Guesses are closed in a few steps, some from contact that is wide at first (`Guess.width`).
COARSE = ShootingOptions(
    rungs=(
        *(Smoothing(each, 8, 5e-2) for each in (0.3, 0.1, 0.03, 0.01)),
        Smoothing(1e-3, 15, 1e-2),
    ),
    order=2,
    multiplier_updates=0,
)

# Hard goals take more: with the settings above, no kept motion reached the goal in four of 16 tasks
# of the cart-pole between soft walls; with these, all did.
AIMED = dataclasses.replace(COARSE, multiplier_updates=2)

# Between compliant walls, hardly smoothed, in Runge-Kutta steps that resolve them: of 9 random
# starts deep in a wall of `cart_pole/soft_06`, plans of 5 are within 1 % of the best of ten such
# settings, and of all of 19 others; with the settings above, of 2 and 18.
NEAR = dataclasses.replace(COARSE, rungs=(*COARSE.rungs[:-1], Smoothing(1e-3, 23, 1e-2)))

# First in short time steps, then with hardly smoothed walls: with more smoothing, their forces
# would differ by as much as hard goals allow.
TIGHT = ShootingOptions(rungs=(Smoothing(1e-3, 40, 1e-3),), substeps=4)
POLISH = ShootingOptions(rungs=(Smoothing(1e-4, 40, 1e-5), Smoothing(1e-6, 40, 1e-5)), substeps=4)
# Steps of order 4 that resolve friction cost twice as much, and are of order 2 where it slips.
WITH_FRICTION = dataclasses.replace(POLISH, rungs=(Smoothing(1e-6, 150, 1e-4),), order=2)

# In the plane with friction, kinks of the sharp law stop descents early, so most of the way is gone
# while contact is smooth: in a fourth of the steps of closings, then, of finalists, in an eighth.
SLIDING = dataclasses.replace(TIGHT, rungs=(Smoothing(1e-3, 120, 3e-4),), order=2)
FINER, FINEST = 4, 8

# In space, the exact law says when steps are short enough. Ranking takes a few iterations, and as
# many as a polish in long steps where these leave it open: after 20 of them two strokes of a hand
# cost 0.0118 and 0.0123, after 120 0.0100 and 0.0092, and in short steps 0.0095 and 0.0087.
TIGHT_IN_SPACE = dataclasses.replace(
    TIGHT, rungs=(Smoothing(1e-3, 20, 1e-3), Smoothing(1e-3, 80, 1e-3))
)

# Friction stiffens from stiction speeds of one length per duration to a thousandth of that.
COOLING = ShootingOptions(
    rungs=tuple(Smoothing(each, 60, 1e-5) for each in (1.0, 0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)),
    substeps=4,
)

# Joints with friction are closed so, too: bounds hardly count while friction is smoothed, as
# viscous friction may not allow the goal within them, and count ten times more after each rung that
# violates them. Then friction as sharp as steps allow ranks the motions. Of the ladder's boxes
# around nine of CRISP's payloads, the best closes at 1 to 1.2 times the cost of the plan (one at
# twice that); with `COARSE`, at 3 to 1e5 times. `TIGHT` ends too early to rank motions as their
# polishes do.
#
# Rungs before the last one only lead there: with as many iterations as that, plans of payloads and
# dry cart-poles take up to 2.4 times as long, and none of eight costs less.
_WARM = tuple(Smoothing(each.smoothing, 20, 1e-3) for each in COOLING.rungs[:-1])
DRY = dataclasses.replace(
    COOLING, rungs=(*_WARM, COOLING.rungs[-1]), order=2, penalty=1e-5, multiplier_updates=5
)
TIGHT_DRY = ShootingOptions(
    rungs=(*_WARM[-2:], Smoothing(1e-3, 60, 1e-6)), substeps=4, penalty=1e-5
)


# The longest second-order Runge-Kutta step that resolves contact, as a part of the time in which
# the fastest oscillation turns by 1 rad. Steps of twice that are stable, but fill the kept motions
# with some that only coarse steps can do: the hopper's plan costs 8.79 with them and 8.04 with
# these, the spinner's 2.765 and 2.728, the puck's 0.049 and 0.030, in up to 2.5 times the time.
_RESOLVING_STEP = 0.75
# Walls with friction push from as far as the task is long, then from ever nearer. Only so costs
# have slopes towards pushing with friction, or going round an object: of 96 renewals on
# `push_circle/round_it` none succeeded otherwise.
_FROM_AFAR = tuple(Smoothing(each, 15, 1e-2) for each in (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3))


# Runge-Kutta steps of a finalist are halved until cost and end change by this part of their scales.
EXACT, MOST_SUBSTEPS = 1e-3, 64
# So are those that resolve contact in searches: with more, a finalist's last steps would turn by
# 2 rad or more, and be unstable. A puck that an arm strikes in 0.8 s takes 127 CPU seconds through
# contact of 1e6 N/m, in 84 steps; through 1e7 N/m there was no plan in 260.
_MOST_RESOLVING = int(2 * MOST_SUBSTEPS / _RESOLVING_STEP)
# Where bodies slide, friction under a heavy load is sharp in very short steps only.
MOST_OF_SLIDING = 4 * MOST_SUBSTEPS
# A motion that halved steps change by less is steady: its controls reproduce it closely.
_STEADY = 0.1
# Times the cost of a motion that another one costs at most, which is as good.
_HARDLY = 1.05
# A motion that violates its bounds by more (relative to the scales) won't become a plan.
HOPELESS = 0.05
_LEAST_RESTITUTION = 0.2  # of springs that stand in for rigid walls
_LEAST_MOBILITY = 0.01  # of the one elsewhere: an arm that is not quite stretched out


class Aim(NamedTuple):
    """Limits of the effort to close guesses.

    Attributes:
        most: motions that promise to cost more are left unfinished, where one pass closes them, or
            wide ones tell; between rigid walls, those that cost more (`RigidMechanismTask.bounce`).
        is_patient: whether motions worse than no control are closed again, with more care.
        substeps: steps of the last pass, at least.
        order: of these; None: that of the passes before.
    """

    most: float = np.inf
    is_patient: bool = True
    substeps: int = 1
    order: int | None = None

    def limit(self, options: ShootingOptions, tells: tuple[float, float] | None) -> ShootingOptions:
        """Returns options with this limit, unless their costs are of other walls or prices.

        Costs of wider passes tell from a smoothing ε on, and their limits grow with ε by the
        second; None: they do not.
        """
        *wide, last = options.rungs
        if options.multiplier_updates or (wide and tells is None):
            return options
        first, rise = tells or (0.0, 0.0)
        rungs = (
            each._replace(most=scaled(1 + rise * each.smoothing, self.most))
            if each.smoothing <= first
            else each
            for each in wide
        )
        return dataclasses.replace(options, rungs=(*rungs, last), most_promised=self.most)


def begin_at(options: ShootingOptions, width: float) -> ShootingOptions:
    """Returns options without rungs that are wider than this; the last one stays."""
    kept = tuple(each for each in options.rungs[:-1] if each.smoothing <= width)
    return dataclasses.replace(options, rungs=(*kept, options.rungs[-1]))


def find_closing(
    world: World, law: ContactLaw, q: Floats, time_step: float, is_aimed: bool
) -> ShootingOptions:
    """Returns the options for closing guesses from q in time steps [s], at a hard goal if aimed.

    Raises:
        ModelError: a contact is too stiff to be searched in steps that resolve it.
    """
    if world.dry_friction is not None and not _meets_in_space(world):
        return DRY
    options = AIMED if is_aimed else COARSE
    if not isinstance(law, CompliantLaw):
        return options
    # By how much oscillations of contacts at q on their springs turn [rad].
    turns = time_step * calc_frequencies(world, law, q)
    substeps = max(1, int(np.ceil(np.max(turns, initial=0.0) / _RESOLVING_STEP)))
    if substeps > _MOST_RESOLVING:
        worst = int(np.argmax(turns))
        k, turn = law.stiffness[worst], turns[worst]
        bounce = np.pi * time_step / turn
        most = 0.95 * k * (_MOST_RESOLVING * _RESOLVING_STEP / turn) ** 2  # Is rounded.
        raise ModelError(
            f"compliant contact of {world.contacts[worst].name}",
            f"a stiffness of {k:.2g} N/m, which throws bodies back in {bounce:.1g} s",
            f"at most {most:.2g} N/m, of both shapes in series, in steps of {time_step:.2g} s",
            "Make it softer by the scenario's material; or take contact: rigid, for walls and "
            "bodies in a plane.",
        )
    if law.has_friction:
        substeps = max(options.substeps, substeps)
        options = dataclasses.replace(options, rungs=_FROM_AFAR, substeps=substeps)
    elif not is_aimed:
        options = dataclasses.replace(NEAR, substeps=substeps)
    return _resolve_dampers(options, world, q, time_step)


def _meets_in_space(world: World) -> bool:
    """Returns whether shapes may touch in space, whose settings count for dry joints as well."""
    return isinstance(world, SpaceWorld) and bool(world.num_contacts)


def find_tight(world: World, q: Floats, time_step: float) -> ShootingOptions:
    """Returns the options for refining closed motions; arguments are those of `find_closing`."""
    if world.dry_friction is not None and not _meets_in_space(world):
        return TIGHT_DRY
    tight = TIGHT_IN_SPACE if isinstance(world, SpaceWorld) else TIGHT
    return _resolve_dampers(tight, world, q, time_step)


def _resolve_dampers(
    options: ShootingOptions, world: World, q: Floats, time_step: float
) -> ShootingOptions:
    """Returns options with steps in which the dampers of joints are stable.

    Where these ask for more steps than contacts in space, steps are implicit: there robots leave
    the start, with whose inertia steps are counted.
    """
    least = count_damper_steps(world, q, time_step)
    if least > options.substeps and _meets_in_space(world):
        return dataclasses.replace(options, order=IMPLICIT)
    return dataclasses.replace(options, substeps=max(options.substeps, least))


def close_gaps(
    problem: ShootingProblem,
    motion: ShootingResult,
    controls: Floats,
    states: Floats | None,
    options: ShootingOptions,
    prices: Floats | None = None,
) -> ShootingResult:
    """Returns the local optimum near states and controls of a motion.

    The first one that costs hardly more than the motion counts, or the best: near its states, where
    gaps between them are closed by whole steps or by wary ones, or near its controls alone. In the
    plane they are also closed in the last rung at once, without prices: the controls of one rung
    let an unstable motion fall in the next, and penalties that have grown bar its way back. In
    space, contact may get lost as gaps are closed, so controls and wary steps come first, unless
    steps are of another order, where controls fail, and what costs more does not count at once; and
    each of these is left where it costs more after its first pass.
    Others are as in `ShootingProblem.solve`.
    """
    ways, most = [(states, options, prices)], scaled(_HARDLY, motion.cost)
    if states is not None:
        wary = states, dataclasses.replace(options, is_wary=True), prices
        alone = None, options, prices
        in_space = isinstance(problem.mechanism, TreeMechanism)
        if in_space and is_implicit(options.order) == is_implicit(motion.order):
            first = options.rungs[0]._replace(most=min(options.rungs[0].most, most))
            brief = dataclasses.replace(options, rungs=(first, *options.rungs[1:]))
            wary = states, dataclasses.replace(brief, is_wary=True), prices
            ways = [(None, brief, prices), wary, *ways]
        else:
            at_once = states, dataclasses.replace(options, rungs=options.rungs[-1:]), None
            is_other = not in_space and (len(options.rungs) > 1 or prices is not None)
            ways = [*ways, *([at_once] if is_other else []), wary, alone]
            most = motion.cost if in_space else most
    tried = []
    for way in ways:
        found = problem.solve(controls, *way)
        if found.violation <= HOPELESS and found.cost <= most:
            return found
        tried.append(found)
    return min(tried, key=lambda each: (each.is_left or each.violation > HOPELESS, each.cost))


def halve_steps(
    problem: ShootingProblem, motion: ShootingResult, most: float, most_substeps: int
) -> ShootingResult:
    """Returns the local optimum near a motion, its Runge-Kutta steps halved until they agree.

    There are 64 between knots at most, or as many as are given where motions converge in these. Its
    states are kept, and gaps between them closed, where steps or sharper walls change it. What
    promises to cost more than the most is left, if steps change it little, by that at least. A
    motion whose bounds are violated by much is returned as it is found.
    """
    has_friction, options = problem.mechanism.has_friction, POLISH
    error = problem.estimate_error(motion) if has_friction else 0.0
    if has_friction and motion.substeps > POLISH.substeps:  # Else it diverges.
        options = dataclasses.replace(WITH_FRICTION, substeps=motion.substeps)
    while True:
        problem = problem.starting_from(motion)
        # Under other steps or walls its controls would lead elsewhere.
        unit = max(abs(motion.cost), problem.cost_scale)
        off = max(error, abs(motion.exact_cost - motion.cost) / unit)
        states = motion.states if off > _STEADY or problem.is_unstable(motion) else None
        # Its cost says little there until they are closed.
        limit = np.inf if states is not None else scaled(1 + error, most)
        options = dataclasses.replace(options, most_promised=limit)
        motion = close_gaps(problem, motion, motion.controls, states, options, motion.prices)
        is_over = motion.is_left or motion.violation > HOPELESS
        finest = most_substeps if motion.is_converged else MOST_SUBSTEPS
        if is_over or motion.substeps >= finest:
            return motion
        error = problem.estimate_error(motion)
        is_known = motion.is_converged and error <= _STEADY
        if error <= EXACT or (is_known and motion.cost > scaled(1 + error, most)):
            return motion
        # Where contact begins and ends, steps are of second order. Contacts that stick in long
        # steps slip in short ones.
        halvings = np.ceil(np.log2(min(error / EXACT, MOST_SUBSTEPS)) / 2)
        substeps = motion.substeps * 2 ** (1 if has_friction else int(halvings))
        rungs = (WITH_FRICTION if has_friction else POLISH).rungs[-1:]
        options = dataclasses.replace(POLISH, rungs=rungs, substeps=min(substeps, most_substeps))


def soften(world: World, law: RigidLaw, time_step: float, speed: float) -> CompliantLaw:
    """Returns springs that stand in for rigid walls, as soft as time steps require.

    They reverse a speed in π dt, k = 1/(dt² J M⁻¹ Jᵀ) at the plant's default position, where
    explicit steps would become unstable at twice the frequency; their restitution is e at a speed.

    Args:
        world: has M and J.
        law: has μ, and e; it is at least 0.2, as springs with less would pull.
        time_step: dt [s].
        speed: φ̇ of an impact with restitution e [m/s].
    """
    mobility = _calc_mobility(world)
    e = np.maximum(law.restitution, _LEAST_RESTITUTION)
    dissipation = np.array([calc_dissipation(each, speed) for each in e])
    return CompliantLaw(1 / (time_step**2 * mobility), dissipation, law.friction)


def _calc_mobility(world: World) -> Floats:
    """Returns J M⁻¹ Jᵀ of each contact at the plant's default position, shape (m,) [1/kg].

    If an arm is stretched out there along the wall's normal, with zero mobility, it is that at
    another position.
    """
    mobilities = []
    for q in (world.plant.GetDefaultPositions(), find_anywhere(world.plant)):
        mass, J = world.calc_mass_matrix(q), world.calc_contact_jacobian(q)
        mobilities.append(calc_mobilities(mass, J))
    here, elsewhere = mobilities
    return np.where(here > _LEAST_MOBILITY * elsewhere, here, elsewhere)
