"""Fitted coefficients of friction curves with intervals, and in words what the readings cannot tell apart."""

import dataclasses as dc
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from .files import make_plain
from .identifiability import Blend
from .profiles import RISE, Curve, Measured, Profile, Settled, measure_knowledge, measure_spread


UNKNOWN = 100.0  # relative deviation of a combination beyond which nothing is known of it
UNLIKELY = 1e-4  # probability of a misfit as large below which the curve is said not to fit
ENOUGH = 0.2  # relative deviation at which a coefficient counts as known
MOST_BLENDS = 2  # told one by one
MOST_MEMBERS = 4  # of a combination, told by name
MOST_STROKES = 1e4  # beyond it, averaging is no advice


@dc.dataclass(frozen=True)
class Coefficient:
    """One fitted number.

    Attributes:
        name, unit: which; b and d are per millimetre, as Eq. 10 has them.
        estimate: at the smallest chi-square.
        sd: standard deviation from the Jacobian; infinite where nothing is known.
        low, high: 95 % interval by profile likelihood; infinite where there is no end.
        bounded: whether the readings bound it on both sides.
    """

    name: str
    unit: str
    estimate: float
    sd: float
    low: float
    high: float
    bounded: bool


@dc.dataclass(frozen=True)
class CurveFit:
    """A fit of one friction curve, or of several by polynomials.

    Attributes:
        subject: what was fitted.
        coefficients: by name, in order.
        derived: estimate and standard deviation of combinations, by name.
        fixed: what was held, by name.
        covariance: in coordinates (of what is positive: the logarithm), shape (coefficients, coefficients).
        correlations: shape (coefficients, coefficients).
        singular_values: of the whitened Jacobian with columns of unit norm, descending; 0 is an exact symmetry.
        chi2, readings: misfit, and how many numbers it sums over.
        steps: that the optimiser took.
        profiles: one a coefficient.
        notes: what cannot be told apart and which test would, sentences.
        curve, data: for those who go on computing.
    """

    subject: str
    coefficients: Mapping[str, Coefficient]
    derived: Mapping[str, tuple[float, float]]
    fixed: Mapping[str, float]
    covariance: np.ndarray
    correlations: np.ndarray
    singular_values: np.ndarray
    chi2: float
    readings: int
    steps: int
    profiles: tuple[Profile, ...]
    notes: tuple[str, ...]
    curve: Curve
    data: Any

    @property
    def values(self) -> np.ndarray:
        """Estimates in order, shape (coefficients,)."""
        return np.array([c.estimate for c in self.coefficients.values()])

    def text(self) -> str:
        """A table for people, and the sentences below it."""
        lines = [f"{self.subject}: chi-square {self.chi2:.1f} of {self.readings} readings less "
                 f"{len(self.coefficients)} coefficients"]
        for c in self.coefficients.values():
            reach = f"95 % from {say_end(c.low)} to {say_end(c.high)}"
            known = "" if c.bounded else ", not bounded by these readings"
            lines.append(f"  {c.name:12} {c.estimate:12.5g} +- {say_sd(c.sd):9} {c.unit:10} {reach}{known}")
        lines += [f"  {name:26} {value:12.5g} +- {say_sd(sd)}" for name, (value, sd) in self.derived.items()]
        lines += [f"  {name} = {value:g}, held" for name, value in self.fixed.items()]
        return "\n".join([*lines, *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """As plain data for JSON; what has no end is null."""
        return {f.name: make_plain(getattr(self, f.name)) for f in dc.fields(self) if f.name not in ("curve", "data")}


def say_end(value: float) -> str:
    """An end of an interval in words."""
    return f"{value:.5g}" if math.isfinite(value) else ("no upper end" if value > 0 else "no lower end")


def say_sd(value: float) -> str:
    """A standard deviation in words."""
    return f"{value:.2g}" if math.isfinite(value) else "unknown"


def fits_noise(chi2: float, degrees: int) -> bool:
    """Whether noise alone would often make a chi-square as large, with so many degrees of freedom."""
    return degrees <= 0 or bool(stats.chi2.sf(chi2, degrees) >= UNLIKELY)


def gather_fit(curve: Curve, subject: str, fit: Settled, measured: Measured, profiles: Sequence[Profile],
               fixed: Mapping[str, float], readings: int, notes: Sequence[str], data: Any) -> CurveFit:
    """Put the parts of a fit together."""
    lost = measured.known.undetermined
    doubtful = [p.name for p in profiles if p.name in lost and all(p.bounded)]
    coefficients = {}
    for k, name in enumerate(curve.names):
        low, high, bounded = 0.0 if curve.logs[k] else -math.inf, math.inf, False
        if profiles and not doubtful:
            low, high, bounded = profiles[k].low, profiles[k].high, all(profiles[k].bounded)
        sd = math.inf if name in lost or doubtful else float(measured.sd[k])
        coefficients[name] = Coefficient(name, curve.units[k], float(fit.coefficients[k]), sd, low, high, bounded)
    if doubtful:
        notes = [f"The readings do not determine {_list(doubtful)}: there may be other places, far from this estimate, "
                 "that fit as well. No interval is given for any coefficient.", *notes]
    derived = {n: (v, s if s < UNKNOWN * abs(v) else math.inf) for n, (v, s) in measured.derived.items()}
    degrees = readings - len(curve.names)
    if not fits_noise(fit.chi2, degrees):
        chance = float(stats.chi2.sf(fit.chi2, degrees))
        notes = [f"The curve does not fit: chi-square is {fit.chi2:.5g} where about {degrees} is expected "
                 f"(p = {chance:.1g}), so that no interval here can be relied on.", *notes]
    return CurveFit(subject, coefficients, derived, dict(fixed), measured.known.covariance,
                    measured.known.correlations, measured.singular, fit.chi2, readings, fit.steps, tuple(profiles),
                    tuple(notes), curve, data)


def describe_confusion(curve: Curve, fit: Settled, measured: Measured, profiles: Sequence[Profile],
                       tests: Sequence[tuple[str, Any]], elsewhere: Mapping[str, str], unit: str) -> list[str]:
    """What cannot be told apart, worst first, in sentences with the test that would resolve it.

    Args:
        curve, fit, measured, profiles: the fit.
        tests: designs to try, as text and data; each is added to the readings there are.
        elsewhere: for a coefficient, where else it can be had.
        unit: what could be repeated and averaged: `strokes`.
    """
    found = [f"These readings say nothing about {name}: it changes them less than their noise."
             for name in measured.known.silent]
    blends = measured.known.blends
    found += [_describe_blend(curve, fit, measured, blend, tests, elsewhere, unit) for blend in blends[:MOST_BLENDS]]
    rest = len(blends) - MOST_BLENDS
    if rest > 0:
        found.append(f"{rest} further combination{'s are' if rest > 1 else ' is'} loose too: rely on the curve rather "
                     "than on single coefficients.")
    for profile in profiles:
        if all(profile.bounded):
            continue
        name, values, largest = profile.name, profile.values, float(np.max(profile.rise))
        if any(profile.bounded):
            bound, end = ("below", "upper") if profile.bounded[0] else ("above", "lower")
            found.append(f"These readings bound {name} from {bound} only: its interval has no {end} end.")
        elif largest < RISE:
            found.append(f"These readings do not bound {name} at all: with it held anywhere from {values[0]:.3g} to "
                         f"{values[-1]:.3g} and the rest refitted, chi-square rises by {largest:.2g} at most.")
        else:
            found.append(f"These readings do not bound {name} at all: far from its estimate, with the other "
                         "coefficients elsewhere too, the fit is as good.")
    return found


def _describe_blend(curve: Curve, fit: Settled, measured: Measured, blend: Blend, tests: Sequence[tuple[str, Any]],
                    elsewhere: Mapping[str, str], unit: str) -> str:
    shown = blend.names[:MOST_MEMBERS]
    others = len(blend.names) - len(shown)
    members = _list([*shown, f"{others} other{'s' if others > 1 else ''}"] if others else shown)
    change, share = _say_change(curve, fit, blend)
    if blend.singular:
        text = f"{members} cannot be told apart: {change} changes no reading beyond its noise"
    else:
        part = "one standard deviation" if share == 1 else f"{share:.2g} of a standard deviation"
        text = f"{members} are hard to tell apart: {change} changes the readings by {part} only"
    return f"{text}; {_say_remedy(curve, fit, measured, blend, tests, elsewhere, unit)}."


def _say_change(curve: Curve, fit: Settled, blend: Blend) -> tuple[str, float]:
    """Such as: raising b by 0.1 1/mm and lowering d by 20 %; and how large a part of one deviation that is."""
    steps = {n: blend.step[curve.index[n]] for n in blend.names}
    share = 1.0
    if blend.singular:
        k = curve.index[blend.names[0]]
        share = (0.01 if curve.logs[k] else curve.typical[k]) / abs(steps[blend.names[0]])
    logs = [abs(steps[n]) for n in blend.names if curve.logs[curve.index[n]]]
    share = min([share, *(0.5 / step for step in logs if step > 0)])
    if steps[blend.names[0]] < 0:
        share = -share
    parts = []
    for name in blend.names[:MOST_MEMBERS]:
        k = curve.index[name]
        step = share * steps[name]
        if curve.logs[k]:
            size = f"{abs(math.expm1(step)) * 100:.2g} %"
        else:
            size = f"{abs(step):.2g}" + (f" {curve.units[k]}" if curve.units[k] else "")
        parts.append(f"{'raising' if step > 0 else 'lowering'} {name} by {size}")
    return _list(parts) + (", and the others with them," if len(blend.names) > MOST_MEMBERS else ""), abs(share)


def _say_remedy(curve: Curve, fit: Settled, measured: Measured, blend: Blend, tests: Sequence[tuple[str, Any]],
                elsewhere: Mapping[str, str], unit: str) -> str:
    """The design that shortens the uncertainty most, how often to repeat this one, or what to take from elsewhere."""
    gains = []
    for text, data in tests:
        more = measure_knowledge(curve, fit.coefficients, data).columns
        both = np.concatenate([measured.columns, more])
        gains.append((measure_spread(measured.columns, both, blend.direction), text))
    best, text = min(gains, default=(1.0, ""))
    size = _size(curve, fit, blend)
    if blend.singular:
        if best * size < 0.5:
            return f"{text} would tell them apart"
    elif size <= ENOUGH:
        return f"these steps are at most {100 * ENOUGH:g} % of each"
    else:
        strokes = (size / ENOUGH) ** 2
        average = f"the average of about {strokes:.2g} such {unit} would fix them to {100 * ENOUGH:g} %"
        gain = "tell them apart" if best < 0.1 else f"make their difference {1 / best:.1f} times as certain"
        if best < 0.5:
            return f"{text} would {gain}" + (f", and {average}" if strokes < MOST_STROKES else "")
        if strokes < MOST_STROKES:
            return average
    known = next((elsewhere[n] for n in blend.names if n in elsewhere), "the value of one of them from elsewhere")
    return f"{known} would tell them apart"


def _size(curve: Curve, fit: Settled, blend: Blend) -> float:
    """Largest relative deviation of a member along the combination."""
    found = []
    for name in blend.names:
        k = curve.index[name]
        step = abs(blend.step[k])
        found.append(step if curve.logs[k] else step / max(abs(fit.coefficients[k]), curve.typical[k]))
    return max(found)


def _list(words: Sequence[str]) -> str:
    words = list(words)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
