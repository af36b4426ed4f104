"""Contact problems as MathematicalPrograms, and their constraints as polynomial penalties."""

from drake_aigto.transcription.literal import LiteralTranscription
from drake_aigto.transcription.penalties import cut_to_bounds, penalize
from drake_aigto.transcription.transcription import Transcription

__all__ = ["LiteralTranscription", "Transcription", "cut_to_bounds", "penalize"]
