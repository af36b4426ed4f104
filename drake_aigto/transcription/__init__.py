"""Contact problems as MathematicalPrograms, and their constraints as polynomial penalties."""

from drake_aigto.transcription.additions import (
    NO_ADDITIONS,
    Addition,
    Additions,
    Place,
    Samples,
)
from drake_aigto.transcription.mechanism_program import (
    COST,
    DISTANCES,
    GOAL,
    ROWS,
    Ends,
    MechanismProgram,
    soften,
)
from drake_aigto.transcription.open_program import MotionProgram, OpenProgram
from drake_aigto.transcription.phases import PhaseTranscription
from drake_aigto.transcription.rigid import RigidTranscription
from drake_aigto.transcription.rows import NONPENETRATION, cut_to_bounds, penalize
from drake_aigto.transcription.touches import (
    Facing,
    Touch,
    TouchSequence,
    find_facings,
    joint_times,
    touches_at_once,
)
from drake_aigto.transcription.transcription import Transcription

__all__ = [
    "COST",
    "DISTANCES",
    "GOAL",
    "NONPENETRATION",
    "NO_ADDITIONS",
    "ROWS",
    "Addition",
    "Additions",
    "Ends",
    "Facing",
    "MechanismProgram",
    "MotionProgram",
    "OpenProgram",
    "PhaseTranscription",
    "Place",
    "RigidTranscription",
    "Samples",
    "Touch",
    "TouchSequence",
    "Transcription",
    "cut_to_bounds",
    "find_facings",
    "joint_times",
    "penalize",
    "soften",
    "touches_at_once",
]
