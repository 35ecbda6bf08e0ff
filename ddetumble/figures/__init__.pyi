"""Public names of figures and where they live."""

from .fit import draw_coefficients as draw_coefficients
from .fit import draw_fit as draw_fit
from .fit import draw_prediction as draw_prediction
from .fit import draw_records as draw_records
from .fit import draw_signatures as draw_signatures
from .fit import draw_values as draw_values
from .forest import draw_forest as draw_forest
from .missing import draw_missing_rivals as draw_missing_rivals
from .missing import draw_missing_shape as draw_missing_shape
from .planning import draw_map as draw_map
from .planning import draw_next_test as draw_next_test
from .planning import draw_power as draw_power
from .posterior import draw_corner as draw_corner
from .posterior import draw_left_out as draw_left_out
from .posterior import draw_predictive as draw_predictive
from .posterior import draw_prior_predictive as draw_prior_predictive
from .posterior import draw_ranks as draw_ranks
from .posterior import draw_traces as draw_traces
from .residuals import draw_dependence as draw_dependence
from .residuals import draw_missing_force as draw_missing_force
from .residuals import draw_noise_sizes as draw_noise_sizes
from .residuals import draw_record_errors as draw_record_errors
from .residuals import draw_residual_map as draw_residual_map
from .residuals import draw_shifts as draw_shifts
from .selection import draw_error_by_step as draw_error_by_step
from .selection import draw_parameters as draw_parameters
from .selection import draw_ranking as draw_ranking
from .style import new_figure as new_figure
from .style import render_png as render_png
from .style import styled as styled

__all__: list[str]
