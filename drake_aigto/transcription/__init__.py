"""Contact problems as MathematicalPrograms, and their constraints as polynomial penalties."""

from drake_aigto.transcription.contact_law import PolynomialLaw
from drake_aigto.transcription.facings import Facing, find_facings
from drake_aigto.transcription.literal import LiteralTranscription
from drake_aigto.transcription.penalties import cut_to_bounds, penalize
from drake_aigto.transcription.phases import PhaseTranscription
from drake_aigto.transcription.rigid import RigidTranscription
from drake_aigto.transcription.single_shooting import SingleShooting, count_terms
from drake_aigto.transcription.touch import Touch, TouchSequence, joint_times
from drake_aigto.transcription.transcription import NONPENETRATION, Transcription
from drake_aigto.transcription.with_forces import LiteralWithForces, RigidWithForces

__all__ = [
    "NONPENETRATION",
    "Facing",
    "LiteralTranscription",
    "LiteralWithForces",
    "PhaseTranscription",
    "PolynomialLaw",
    "RigidTranscription",
    "RigidWithForces",
    "SingleShooting",
    "Touch",
    "TouchSequence",
    "Transcription",
    "count_terms",
    "cut_to_bounds",
    "find_facings",
    "joint_times",
    "penalize",
]
