"""How a quantity of random scenarios varies: listed values in turn, or evenly over a range."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from drake_aigto.errors import OptionsError

_SYNTAX = "a number, several (1 0.8 0.5), or one range low:high (0.5:1)"


@dataclass(frozen=True)
class Spread:
    """Values that are taken in turn, or a range that is drawn from evenly.

    Attributes:
        values: all of them, or the two ends of the range.
        is_range: which of both.

    Raises:
        OptionsError: none, one that is not finite, or ends in the wrong order.
    """

    values: tuple[float, ...]
    is_range: bool = False

    def __post_init__(self) -> None:
        """Checks."""
        if not self.values or not all(map(math.isfinite, self.values)):
            raise OptionsError("values", got=self.values or "none", expected="finite numbers")
        if self.is_range and not (len(self.values) == 2 and self.values[0] < self.values[1]):
            raise OptionsError("range", got=self, expected="low:high, the lower end first")

    @classmethod
    def parse(cls, texts: str | Iterable[str]) -> Spread:
        """Returns what ``str`` gave, or its words.

        Raises:
            OptionsError: no numbers, or more than one range.
        """
        words = texts.split() if isinstance(texts, str) else list(texts)
        is_range = len(words) == 1 and words[0].count(":") == 1
        try:
            values = tuple(map(float, words[0].split(":") if is_range else words))
        except ValueError:
            raise OptionsError("values", got=" ".join(words), expected=_SYNTAX) from None
        return cls(values, is_range)

    @classmethod
    def from_plain(cls, text: str) -> Spread:
        """Returns what `to_plain` gave."""
        return cls.parse(text)

    def to_plain(self) -> str:
        """Returns the text that files have."""
        return str(self)

    @property
    def num_turns(self) -> int:
        """After so many scenarios the values come again."""
        return 1 if self.is_range else len(self.values)

    def pick(self, turn: int, share: float) -> float:
        """Returns the value of a turn, or so much of the way from low to high, share ∈ [0, 1)."""
        if not self.is_range:
            return self.values[turn]
        low, high = self.values
        return low + share * (high - low)

    def __str__(self) -> str:
        """Returns what `parse` reads: the same bits."""
        return (":" if self.is_range else " ").join(f"{value!r}" for value in self.values)
