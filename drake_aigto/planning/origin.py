"""Where a candidate came from: who proposed its contact sequence, and what was changed since."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

from drake_aigto.planning.mechanism_boxes import MechanismRung
from drake_aigto.planning.options import Rung
from drake_aigto.transcription import TouchSequence

ChangeName = Literal["seen", "dropped", "added", "swapped", "moved", "mode", "left out"]

_WORDS: dict[ChangeName, str] = {
    "seen": "with a bounce seen in its replay",
    "dropped": "a touch dropped",
    "added": "a touch added",
    "swapped": "touches swapped",
    "moved": "contacts moved",
    "mode": "a touch in another mode",
    "left out": "left out at first",
}

# The proposers of doing nothing, and of the contacts that this has.
NO_CONTROL, COASTING = "no control", "contacts of the motion without control"


@dataclass(frozen=True)
class Change:
    """One step from a candidate to one near it.

    Attributes:
        kind: "seen", a bounce added that the replay has and the plan lacks; "dropped" or "added", a
            touch less or more; "swapped", bounces at one moment in the other order; "moved",
            contacts at other knots; "mode", a touch with friction that sticks or slips instead;
            "left out", a flight that was not expected to win, and is
            tried as nothing that was holds.
        of: the contact sequence that was changed.
    """

    kind: ChangeName
    of: TouchSequence


@dataclass(frozen=True)
class Origin:
    """Where a candidate came from.

    Attributes:
        proposer: AIGO's algorithm, as the options name it, or another's guess: "zero", "random",
            or "no control", which is what the world does by itself, or that motion's contacts.
        rung: where AIGO started; None for another's guess, and in plan files of version 3, whose
            whole sentence is the proposer.
        changes: of the contact sequence that was proposed, in order.
        renewals: how many times a stretch of the motion was opened to boxes again.
    """

    proposer: str
    rung: Rung | MechanismRung | None = None
    changes: tuple[Change, ...] = ()
    renewals: int = 0

    def changed(self, kind: ChangeName, of: TouchSequence) -> Origin:
        """Returns the origin of a candidate whose sequence was made by changing this one's."""
        return dataclasses.replace(self, changes=(*self.changes, Change(kind, of)))

    def renewed(self) -> Origin:
        """Returns the origin of a motion of which a stretch of this one's was opened again."""
        return dataclasses.replace(self, renewals=self.renewals + 1)

    def __str__(self) -> str:
        """Returns it in words; a change that was made several times is told once."""
        first = self.rung.describe(self.proposer) if self.rung else self.proposer
        changes = dict.fromkeys(_WORDS[each.kind] for each in self.changes)
        renewed = [f"renewed {self.renewals} times"] if self.renewals else []
        return "; ".join([first, *changes, *renewed])
