"""Contact problems as MathematicalPrograms, and their constraints as polynomial penalties."""

from drake_aigto.transcription.additions import (
    NO_ADDITIONS,
    Addition,
    Additions,
    Place,
    Samples,
)
from drake_aigto.transcription.consistency import check_together
from drake_aigto.transcription.knots import Layout
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
from drake_aigto.transcription.rigid import ImpulseDirections, RigidTranscription
from drake_aigto.transcription.rows import (
    CONTACT,
    DYNAMICS,
    FLIGHT,
    INTEGRATION,
    KINEMATICS,
    NONPENETRATION,
    RESTITUTION,
    UNITS,
    Bounds,
    as_expression,
    cut_to,
    cut_to_bounds,
    largest_defect,
    penalize,
    scaled_defects,
    shared_constraint,
    shared_cost,
)
from drake_aigto.transcription.timeline import bend, straight_path
from drake_aigto.transcription.touches import (
    AT_ONCE,
    Facing,
    Touch,
    TouchSequence,
    find_facings,
    joint_times,
    touches_at_once,
)
from drake_aigto.transcription.transcription import Transcription, rigid_defects

__all__ = [
    "AT_ONCE",
    "CONTACT",
    "COST",
    "DISTANCES",
    "DYNAMICS",
    "FLIGHT",
    "GOAL",
    "INTEGRATION",
    "KINEMATICS",
    "NONPENETRATION",
    "NO_ADDITIONS",
    "RESTITUTION",
    "ROWS",
    "UNITS",
    "Addition",
    "Additions",
    "Bounds",
    "Ends",
    "Facing",
    "ImpulseDirections",
    "Layout",
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
    "as_expression",
    "bend",
    "check_together",
    "cut_to",
    "cut_to_bounds",
    "find_facings",
    "joint_times",
    "largest_defect",
    "penalize",
    "rigid_defects",
    "scaled_defects",
    "shared_constraint",
    "shared_cost",
    "soften",
    "straight_path",
    "touches_at_once",
]
