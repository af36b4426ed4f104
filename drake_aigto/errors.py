"""The errors of this package: each says what was wrong, what was expected, and what to do."""

from __future__ import annotations

import math


class AigtoError(Exception):
    """Base of every error that this package raises on purpose.

    Its text reads ``hint what: got …, expected …. remedy``, without the parts that were not given.

    Attributes:
        what: the thing that is wrong: a field, a file, a joint, a term.
        got: what was found.
        expected: what would have been right.
        remedy: what to do about it, as a sentence.
        hint: what was probably meant, as a question.
    """

    def __init__(
        self,
        what: str,
        got: object = None,
        expected: object = None,
        remedy: str | None = None,
        hint: str | None = None,
    ) -> None:
        """Stores the five parts; all of them may be given by name."""
        # All go into `args`, so that the error survives pickling (worker processes).
        super().__init__(what, got, expected, remedy, hint)
        self.what = what
        self.got = got
        self.expected = expected
        self.remedy = remedy
        self.hint = hint

    def __str__(self) -> str:
        """Returns the one to four sentences that a user reads, the hint first."""
        parts = []
        if self.got is not None:
            parts.append(f"got {self.got}")
        if self.expected is not None:
            parts.append(f"expected {self.expected}")
        text = f"{self.what}: {', '.join(parts)}" if parts else self.what
        text = text if text.endswith((".", "!", "?")) else f"{text}."
        return " ".join(filter(None, (self.hint, text, self.remedy)))


class ScenarioError(AigtoError, ValueError):
    """A scenario that asks for something impossible, or a scenario file that can't be read."""


class ModelError(AigtoError, ValueError):
    """A model (SDF, URDF, MultibodyPlant) that can't be found, read, or planned for."""


class UnsupportedTermError(AigtoError, ValueError):
    """A cost or constraint whose mean over a box has no closed form here."""


class ProgramError(AigtoError, ValueError):
    """A cost or constraint of a user that contradicts others, can't be carried, or comes late."""


class PlanFileError(AigtoError, ValueError):
    """A plan file that is cut short, damaged, or from another version."""


class ResultsFileError(AigtoError, ValueError):
    """A file of results that is damaged, of another study, or there already."""


class StudyError(AigtoError, RuntimeError):
    """A study that can't go on; what was done is kept."""


class TrajectoryError(AigtoError, ValueError):
    """A trajectory, or a control to replay, whose numbers do not fit together."""


class FrictionError(TrajectoryError):
    """A motion of rigid bodies that friction leaves no way to go on, or several."""


class ControlError(AigtoError, ValueError):
    """A controller whose ports, period or plant do not fit."""


class DamagedDataError(AigtoError, ValueError):
    """Plain values that are not what they should be; says which."""


class OutputFileError(AigtoError, OSError):
    """A file that can't be written."""


class OptionsError(AigtoError, ValueError):
    """A numerical option outside its range."""


def check_positive(options: object, *names: str, below: float = math.inf) -> None:
    """Refuses options that are not in (0, below).

    Raises:
        OptionsError: one is not.
    """
    for name in names:
        if not 0 < (value := getattr(options, name)) < below:
            limit = "" if math.isinf(below) else f" and below {below:g}"
            raise OptionsError(name, got=f"{value:g}", expected=f"a number above 0{limit}")


def check_counts(options: object, **least: int) -> None:
    """Refuses options that are below the least that each may be.

    Raises:
        OptionsError: one is.
    """
    for name, smallest in least.items():
        if (value := getattr(options, name)) < smallest:
            raise OptionsError(name, got=value, expected=f"{smallest} or more")


class MissingExtraError(AigtoError, ImportError):
    """A library that only an extra of this package installs.

    Attributes:
        module: the library.
        extra: which installs it.
    """

    def __init__(self, what: str, module: str, extra: str) -> None:
        """Says what needs the library, and how to install it."""
        super().__init__(
            what,
            got=f"no module {module!r}",
            expected="it to be installed",
            remedy=f"Install the extra: pip install 'drake_aigto[{extra}]'.",
        )
        self.module, self.extra = module, extra

    def __reduce__(self) -> tuple[type[MissingExtraError], tuple[str, str, str]]:
        """Pickles through this constructor, so that the error survives worker processes."""
        return type(self), (self.what, self.module, self.extra)
