"""``python -m drake_aigto``: the command line, where `drake-aigto` itself is not on the path."""

import sys

from drake_aigto.cli import main

if __name__ == "__main__":
    sys.exit(main())
