"""Figures of a campaign and of what was found in it: records in, a matplotlib figure out; matplotlib is loaded late."""

from .dependence import draw_dependence, draw_missing_force
from .error_by_step import draw_error_by_step
from .estimates import draw_parameters
from .fit import draw_fit, draw_peaks
from .missing import draw_missing_rivals, draw_missing_shape
from .planning import draw_map, draw_next_test
from .posterior import draw_corner, draw_ranks, draw_traces
from .power import draw_power
from .prediction import draw_prediction
from .predictive import draw_left_out, draw_predictive
from .ranking import draw_ranking
from .residuals import draw_record_errors, draw_residual_map
from .shifts import draw_shifts
from .signatures import draw_signatures
from .style import new_figure, render_png, styled


__all__ = [
    "draw_signatures",
    "draw_error_by_step",
    "draw_corner",
    "draw_dependence",
    "draw_fit",
    "draw_left_out",
    "draw_map",
    "draw_missing_force",
    "draw_missing_rivals",
    "draw_missing_shape",
    "draw_next_test",
    "draw_parameters",
    "draw_peaks",
    "draw_power",
    "draw_prediction",
    "draw_predictive",
    "draw_ranking",
    "draw_ranks",
    "draw_record_errors",
    "draw_residual_map",
    "draw_shifts",
    "draw_traces",
    "new_figure",
    "render_png",
    "styled",
]
