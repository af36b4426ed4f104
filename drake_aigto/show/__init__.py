"""What people see: text tables, figures, Meshcat, reports."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from drake_aigto.show.box_playback import play_boxes as play_boxes
    from drake_aigto.show.box_run import BoxRun as BoxRun
    from drake_aigto.show.box_run import run_boxes as run_boxes
    from drake_aigto.show.embedding import embed_scenes as embed_scenes
    from drake_aigto.show.figures import plot_boxes as plot_boxes
    from drake_aigto.show.figures import plot_controls as plot_controls
    from drake_aigto.show.figures import plot_motions as plot_motions
    from drake_aigto.show.figures import plot_path as plot_path
    from drake_aigto.show.figures import plot_plan as plot_plan
    from drake_aigto.show.figures import plot_positions as plot_positions
    from drake_aigto.show.figures import plot_velocities as plot_velocities
    from drake_aigto.show.landscapes import plot_cost_history as plot_cost_history
    from drake_aigto.show.landscapes import plot_cost_landscape as plot_cost_landscape
    from drake_aigto.show.landscapes import plot_integrated_product as plot_integrated_product
    from drake_aigto.show.methods import paper_methods as paper_methods
    from drake_aigto.show.methods import plot_methods as plot_methods
    from drake_aigto.show.methods import write_numbers as write_numbers
    from drake_aigto.show.motion import Motion as Motion
    from drake_aigto.show.motion import motions_of_plan as motions_of_plan
    from drake_aigto.show.page import Page as Page
    from drake_aigto.show.playback import open_meshcat as open_meshcat
    from drake_aigto.show.playback import play as play
    from drake_aigto.show.playback import publish as publish
    from drake_aigto.show.playback import save_html as save_html
    from drake_aigto.show.portraits import plot_phase_portrait as plot_phase_portrait
    from drake_aigto.show.report import figures_of_plan as figures_of_plan
    from drake_aigto.show.report import report_plan as report_plan
    from drake_aigto.show.rivals import gradient_motions as gradient_motions
    from drake_aigto.show.table_report import report_table1 as report_table1

# Public name → module. Loaded on first use: tables need neither matplotlib nor Meshcat.
_EXPORTS = {
    "BoxRun": "box_run",
    "Motion": "motion",
    "Page": "page",
    "embed_scenes": "embedding",
    "figures_of_plan": "report",
    "gradient_motions": "rivals",
    "motions_of_plan": "motion",
    "open_meshcat": "playback",
    "paper_methods": "methods",
    "play": "playback",
    "play_boxes": "box_playback",
    "plot_boxes": "figures",
    "plot_controls": "figures",
    "plot_cost_history": "landscapes",
    "plot_cost_landscape": "landscapes",
    "plot_integrated_product": "landscapes",
    "plot_methods": "methods",
    "plot_motions": "figures",
    "plot_path": "figures",
    "plot_phase_portrait": "portraits",
    "plot_plan": "figures",
    "plot_positions": "figures",
    "plot_velocities": "figures",
    "publish": "playback",
    "report_plan": "report",
    "report_table1": "table_report",
    "run_boxes": "box_run",
    "save_html": "playback",
    "write_numbers": "methods",
}

__all__ = sorted(_EXPORTS)


def __getattr__(name: str) -> Any:
    """Imports a public name when it is first asked for."""
    if name not in _EXPORTS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_EXPORTS[name]}"), name)
