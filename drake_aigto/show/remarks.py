"""What a plan would rather not say: that its search was cut short, and what simulations vetoed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from drake_aigto.planning import Plan, Veto
from drake_aigto.show.text import length_text, touch_names
from drake_aigto.world import World

_MOST_VETOES = 3
_MOST_TOUCHES = 6

INTERRUPTED = "the search was ended by Ctrl-C; this is the best of what it had found by then"


def describe_idle(plan: Plan) -> str | None:
    """Returns what doing nothing costs; None where the search did not look at it."""
    if plan.idle is None:
        return None
    if plan.best.is_idle:
        return "this is the plan: nothing that was found and holds costs less"
    replay = plan.idle.replay
    less = "doing nothing is better: " if plan.is_beaten else ""
    return (
        f"{less}it costs {replay.cost:.3e} and ends {length_text(replay.goal_error)} off the goal"
    )


def describe_vetoes(plan: Plan, world: World) -> Iterator[str]:
    """Yields which candidates promise less than the plan costs, and what is wrong with them."""
    names = touch_names(world)
    vetoes = sorted(plan.vetoes, key=lambda veto: veto.candidate.cost)
    for veto in vetoes[:_MOST_VETOES]:
        yield _describe(veto, names)
    if len(vetoes) > _MOST_VETOES:
        yield f"{len(vetoes) - _MOST_VETOES} more candidates that promise less"


def _describe(veto: Veto, names: Sequence[str]) -> str:
    candidate, replay = veto.candidate, veto.replay
    where = "Drake's plant" if replay.simulator == "drake" else "rigid walls"
    times = [f"{contact.time:.3f}" for contact in candidate.contacts[:_MOST_TOUCHES]]
    more = ", …" if len(candidate.contacts) > _MOST_TOUCHES else ""
    contacts = f"contacts at {', '.join(times)}{more} s" if times else "no contact"
    text = (
        f"a candidate with {contacts} promises {candidate.cost:.2e}, but on {where} costs "
        f"{replay.cost:.2e} and ends {length_text(replay.goal_error)} off the goal"
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
