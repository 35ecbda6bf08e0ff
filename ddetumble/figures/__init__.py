"""Figures of a campaign and of what was found in it: records in, a matplotlib figure out.

`models` are the fitted series of one or two models by their names, the reference model first; `channel` is what is
drawn of them, the family's force where it is not given. `narrow` draws for a telephone.

Attributes:
    styled: decorator of a function that makes a figure, which it draws in the look of the house.
"""

from .fit import draw_fit, draw_prediction, draw_records, draw_signatures, draw_values
from .forest import draw_forest
from .missing import draw_missing_rivals, draw_missing_shape
from .planning import draw_map, draw_next_test, draw_power
from .posterior import draw_corner, draw_left_out, draw_predictive, draw_prior_predictive, draw_ranks, draw_traces
from .residuals import (
    draw_dependence,
    draw_missing_force,
    draw_noise_sizes,
    draw_record_errors,
    draw_residual_map,
    draw_shifts,
)
from .selection import draw_error_by_step, draw_parameters, draw_ranking
from .style import new_figure, render_png, styled


__all__ = [
    "draw_corner", "draw_dependence", "draw_error_by_step", "draw_fit", "draw_forest", "draw_left_out", "draw_map",
    "draw_missing_force", "draw_missing_rivals", "draw_missing_shape", "draw_next_test", "draw_noise_sizes",
    "draw_parameters", "draw_values", "draw_power", "draw_prediction", "draw_predictive",
    "draw_prior_predictive", "draw_ranking", "draw_ranks",
    "draw_record_errors", "draw_records", "draw_residual_map", "draw_shifts", "draw_signatures",
    "draw_traces",
    "new_figure", "render_png", "styled",
]  # fmt: skip
