"""Public names of inference and where they live."""

from .archive import make_fitted as make_fitted
from .archive import resolve_model as resolve_model
from .curve_fit import SlipRecord as SlipRecord
from .curve_fit import fit_curve as fit_curve
from .curve_fit import fit_rubber as fit_rubber
from .curve_fit import fit_slip_curve as fit_slip_curve
from .curve_fit import fit_slip_polynomials as fit_slip_polynomials
from .noise import Noise as Noise

__all__: list[str]
