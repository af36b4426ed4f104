"""The command line: parse, load, call, print. A file for each command or few."""

from drake_aigto.cli.entry import main
from drake_aigto.cli.status import BAD_INPUT, FAULT, FINE, INTERRUPTED, NOTHING_HOLDS, UNREAD

__all__ = ["BAD_INPUT", "FAULT", "FINE", "INTERRUPTED", "NOTHING_HOLDS", "UNREAD", "main"]
