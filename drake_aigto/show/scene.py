"""What every scene in Meshcat has: a place for what is drawn, its time, and who looks on."""

from __future__ import annotations

import numpy as np
from pydrake.geometry import Meshcat

from drake_aigto.arrays import Floats
from drake_aigto.show.board import Board
from drake_aigto.show.stage import Scenery

# All that is drawn lies below this path.
ROOT = "/drake_aigto"

# Frames are keyed where a motion has rows; between two of them the browser moves straight on.
FRAMES_PER_SECOND = 1000
# The end is held for a moment [s], then all motions start again, together: one length for all.
HOLD = 0.5

# Of boards: from afar, as walls hide less then; from aside by this; for a window of this width to
# height; and so much farther back.
_BOARD_FIELD_OF_VIEW = 12.0  # vertical [deg]
_BOARD_TILT = np.deg2rad(12.0)
ASPECT_RATIO = 1.4
_BOARD_SLACK = 1.08


def clear(meshcat: Meshcat) -> None:
    """Removes what was shown below `ROOT`, and hides Meshcat's own grid, axes and background."""
    meshcat.Delete(ROOT)
    for path in ("/Background", "/Grid", "/Axes"):
        meshcat.SetProperty(path, "visible", False)


def folder_of(index: int) -> str:
    """Returns the path of a motion's moving parts."""
    return f"{ROOT}/motions/{index + 1}"


def face_board(scenery: Scenery, board: Board, meshcat: Meshcat) -> None:
    """Looks at the middle of the board, from a little below a level one or above an upright one."""
    low, high = board.corners
    half_width, half_height = (high - low) / 2
    distance = _BOARD_SLACK * max(half_height, half_width / ASPECT_RATIO)
    distance /= np.tan(np.deg2rad(_BOARD_FIELD_OF_VIEW) / 2)
    is_level = abs(scenery.X_WT.rotation().matrix()[2, 2]) > 0.5
    tilt = -_BOARD_TILT if is_level else _BOARD_TILT
    back = distance * np.array([0.0, np.sin(tilt), np.cos(tilt)])
    look(scenery, meshcat, np.append((low + high) / 2, 0.0), back, _BOARD_FIELD_OF_VIEW)


def look(scenery: Scenery, meshcat: Meshcat, middle: Floats, back: Floats, angle: float) -> None:
    """Looks at a place in T from so far back, over an angle [deg]."""
    meshcat.SetCamera(Meshcat.PerspectiveCamera(fov=angle))
    meshcat.SetCameraPose(scenery.X_WT.multiply(middle + back), scenery.X_WT.multiply(middle))
