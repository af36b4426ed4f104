"""One axis on its own: a mass on a line between walls, in unit time."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Wall:
    """A wall on a line: where, on which side there is room (±1), and its restitution."""

    position: float
    side: int
    restitution: float


@dataclass(frozen=True)
class Line:
    """The cost ∫₀¹ (ẍ − drift)² dt + weight (x(1) − goal)², a unit of which is worth the price."""

    position: float
    velocity: float
    goal: float
    weight: float
    price: float
    walls: tuple[Wall, ...]
    drift: float

    @property
    def miss(self) -> float:
        """How far from the goal it coasts to without walls."""
        return self.goal - self.position - self.velocity - 0.5 * self.drift
