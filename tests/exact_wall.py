"""A point mass and one rigid wall, or two, solved exactly: the judge of the judge.

Root by root of the parabolas between events, with 40 digits, and geometric series where bounces are
infinitely many. It shares no line and no idea with the simulation that it checks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from decimal import Decimal, localcontext


@dataclass
class ExactRun:
    """Where the mass ends, and every impact that a series did not sum up."""

    position: float = 0.0
    velocity: float = 0.0
    impact_times: list[float] = field(default_factory=list)
    impact_speeds: list[float] = field(default_factory=list)
    shortest_hop: float = float("inf")  # of those that a push brought back [s]


def run(
    position: float,
    velocity: float,
    times: Sequence[float],
    controls: Sequence[float],
    restitution: float,
    mass: float = 1.0,
    length: float | None = None,
) -> ExactRun:
    """Returns how a mass moves that starts with (q ≥ 0, v) and is pushed by held forces.

    The wall is at 0; with a length, there is another one that far from it.
    """
    with localcontext() as context:
        context.prec = 40
        q, v, e = Decimal(position), Decimal(velocity), Decimal(restitution)
        # Position of a wall, and which way it faces.
        walls = [(Decimal(0), 1)] + ([(Decimal(length), -1)] if length else [])
        result = ExactRun()
        time = Decimal(times[0])
        for end, control in zip(times[1:], controls, strict=True):
            a, stop = Decimal(control) / Decimal(mass), Decimal(end)
            rests = False
            while True:
                rests = v == 0 and any(q == wall and side * a <= 0 for wall, side in walls)
                waits = [
                    (wait, wall, side)
                    for wall, side in walls
                    if (wait := _time_to_wall(side * (q - wall), side * v, side * a)) is not None
                ]
                if rests or not waits or time + min(waits)[0] > stop:
                    break
                wait, wall, side = min(waits)
                q, v, time = wall, v + a * wait, time + wait
                result.impact_times.append(float(time))
                result.impact_speeds.append(float(abs(v)))
                v = -e * v
                pressed = side * a < 0 and not (length and v * v >= 2 * abs(a) * Decimal(length))
                if pressed and e < 1 and time + 2 * abs(v / a) / (1 - e) <= stop:
                    v = Decimal(0)  # the sum of all hops that follow
                elif pressed:
                    result.shortest_hop = min(result.shortest_hop, float(2 * abs(v / a)))
            left, time = stop - time, stop
            if not rests:
                q, v = q + v * left + a * left * left / 2, v + a * left
        result.position, result.velocity = float(q), float(v)
        return result


def _time_to_wall(q: Decimal, v: Decimal, a: Decimal) -> Decimal | None:
    """Returns when q + v t + a t²/2 next falls to zero, or None if it never does."""
    if q == 0 and (v < 0 or (v == 0 and a < 0)):
        return Decimal(0)
    if q == 0:
        return -2 * v / a if a < 0 else None
    discriminant = v * v - 2 * a * q
    if discriminant <= 0:
        return None  # a graze changes nothing
    if v < 0:
        return 2 * q / (discriminant.sqrt() - v)
    return (v + discriminant.sqrt()) / -a if a < 0 else None
