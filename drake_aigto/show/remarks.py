"""What is to be said of a plan in words: its verdict, and what a reader has to know beside it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drake_aigto.planning import Plan, Veto
from drake_aigto.show.text import contact_names, miss_text, touch_names
from drake_aigto.simulation import Replay
from drake_aigto.world import Scenario, World

_MOST_VETOES = 3
_MOST_TOUCHES = 6
_AT_END = 1e-6  # of a duration: as near as rounding to an end of its range

INTERRUPTED = "the search was ended by Ctrl-C; this is the best of what it had found by then"


def describe_verdict(plan: Plan, world: World) -> str:
    """Returns whether simulations of a plan's control confirm it, and which do not."""
    return ", ".join(verdict_items(plan, contact_names(world)))


def verdict_items(plan: Plan, names: Sequence[str]) -> Iterator[str]:
    """Yields whether simulations confirm a plan, and what is wrong with it."""
    against = [replay for replay in plan.replay if not plan.best.is_confirmed_by(replay)]
    where = " and ".join(name_simulator(replay, names) for replay in against or plan.replay)
    if against:
        yield f"fails: the control alone misses the plan's promise {where}"
        broken = dict.fromkeys(name for replay in against for name in replay.broken)
        yield from (f"breaks '{name}'" for name in broken)
    elif plan.is_beaten:
        yield f"fails: {name_simulator(plan.replay.event_driven, names)} doing nothing costs less"
    else:
        yield f"holds: the control alone keeps the plan's promise {where}"


def describe_idle(plan: Plan, world: World) -> str | None:
    """Returns what doing nothing costs; None where the search did not look at it."""
    if plan.idle is None:
        return None
    if plan.best.is_idle:
        return "this is the plan: nothing that was found and holds costs less"
    replay = plan.idle.replay
    less = "doing nothing is better: " if plan.is_beaten else ""
    miss = miss_text(replay, plan.scenario, world)
    return f"{less}it costs {replay.cost:.3e} and ends {miss} off the goal"


def describe_bound(plan: Plan) -> str | None:
    """Returns how far a plan is above any other at most; None where that was not asked for."""
    if plan.bound is None:
        return None
    if plan.gap is None:
        return f"no lower bound: {plan.bound.reason}"
    of = " of the task's scale" if plan.bound.is_nothing else ""
    return (
        f"at most {100 * plan.gap:.2g} %{of} above any plan, as simulated: no control does it for "
        f"less than {plan.bound.lower_bound:.4e}"
    )


def describe_unplanned(plan: Plan, world: World) -> str | None:
    """Returns which contacts a plan's control has on rigid walls, and its trajectory has not."""
    found, names = plan.best.unplanned, touch_names(world)
    if not found or plan.best.is_idle:
        return None
    touches = ", ".join(_touch(each, names) for each in found[:_MOST_TOUCHES])
    more = f", and {len(found) - _MOST_TOUCHES} more" if len(found) > _MOST_TOUCHES else ""
    where = name_simulator(plan.best.replay, names)
    return f"{where} it also touches {touches}{more}"


def describe_steps(plan: Plan) -> str | None:
    """Returns how many time steps a plan has, if others than were asked for."""
    steps, asked = len(plan.trajectory.controls), plan.scenario.num_steps
    if steps == asked or plan.best.is_idle:
        return None
    why = "which are too few for its phases" if steps > asked else "with which it was not polished"
    return f"{steps} instead of {asked}, {why}"


def describe_duration(plan: Plan) -> str | None:
    """Returns how long a plan lasts, and if no longer or shorter one was allowed; None if given."""
    if plan.scenario.duration_range is None:
        return None
    T = plan.trajectory.times[-1]
    for end, word, other in zip(
        plan.scenario.duration_range, ("least", "most"), ("less", "more"), strict=True
    ):
        if abs(T - end) <= _AT_END * end:
            return f"{T:.4g} s, the {word} that it may be: with {other}, a plan may cost less"
    return f"{T:.4g} s, as it was free"


def describe_vetoes(plan: Plan, world: World) -> Iterator[str]:
    """Yields which candidates promise less than the plan costs, and what is wrong with them."""
    vetoes = sorted(plan.vetoes, key=lambda veto: veto.candidate.cost)
    for veto in vetoes[:_MOST_VETOES]:
        yield _describe_veto(veto, plan.scenario, world)
    if len(vetoes) > _MOST_VETOES:
        yield f"{len(vetoes) - _MOST_VETOES} more candidates that promise less"


def _describe_veto(veto: Veto, scenario: Scenario, world: World) -> str:
    candidate, replay, names = veto.candidate, veto.replay, touch_names(world)
    where = name_simulator(replay, names)
    times = [f"{contact.time:.3f}" for contact in candidate.contacts[:_MOST_TOUCHES]]
    more = ", …" if len(candidate.contacts) > _MOST_TOUCHES else ""
    contacts = f"contacts at {', '.join(times)}{more} s" if times else "no contact"
    text = (
        f"a candidate with {contacts} promises {candidate.cost:.2e}, but {where} costs "
        f"{replay.cost:.2e} and ends {miss_text(replay, scenario, world)} off the goal"
    )
    if replay.broken:
        return f"{text}, and breaks {', '.join(map(repr, replay.broken))}"
    planned, simulated = veto.first_difference
    if planned == simulated:
        return f"{text}, though with the same contacts"
    instead = f" instead of {_touch(planned, names)}" if planned else ""
    return f"{text}: it touches {_touch(simulated, names)}{instead}"


def _touch(contact: tuple[float, int] | None, names: Sequence[str]) -> str:
    if contact is None:
        return "nothing"
    time, which = contact
    return f"{names[which]} at {time:.3f} s"


def name_simulator(replay: Replay, names: Sequence[str]) -> str:
    """Returns where a control was simulated."""
    if replay.simulator == "drake":
        return "on Drake's plant"
    if replay.simulator == "integrated" or not names:
        return "by integration"
    return "on a rigid wall" if len(names) == 1 else "on rigid walls"
