"""The plain sentences of a judgement on friction forces."""

from collections.abc import Sequence

import numpy as np

from ..contact.friction import DIVERGES_ABOVE
from .words import join, say_share, sign


def describe_friction(judged, assumed: Sequence[str]) -> tuple[str, tuple[str, ...]]:
    """The sentence and the notes of a `FrictionJudgement`.

    Args:
        judged: the judgement, without them.
        assumed: names of conditions that are assumptions.
    """
    notes = [judged.noise.text]
    given = [{"normal_load": "loads", "internal_pressure": "pressures", "slip_speed": "slip speeds"}.get(name, name)
             for name in assumed]
    if given:
        notes.append(f"The {join(given)} of these rows are assumed, not printed; every statement here stands on them.")
    if judged.separation:
        notes.append("No slip belongs to these forces, so the slip term of Eqs. 9 and 10 is left out of our model: "
                     "Eq. 8 alone is judged" + _describe_loads(judged.loads) + ".")
    else:
        notes.append(f"No slip belongs to these forces: the model {judged.model!r} is taken at zero slip.")
    notes += _describe_weights(judged)
    notes += [f"{effect.capitalize()} cannot be seen: {reason}." for effect, reason in judged.left_out.items()]
    notes.append(describe_best(judged))
    return _write_sentence(judged), tuple(notes)


def describe_best(judged) -> str:
    """Which model is best on left-out forces, and whether that is more than chance."""
    rows = [row for row in judged.rows if row.physical and np.isfinite(row.heldout)]
    best, plain = min(rows, key=lambda row: row.heldout), judged.constant
    gaps = {pair.first: pair for pair in judged.pairs}
    better = [name for name, gap in gaps.items() if gap.difference < -2 * gap.standard_error]
    worse = [name for name, gap in gaps.items() if gap.difference > 2 * gap.standard_error]
    start = f"A constant coefficient misses left-out forces by {say_share(plain.heldout)} (rms)"
    if best is plain:
        text = f"{start}, and nothing misses them by less."
    else:
        gap = gaps[best.label]
        text = (f"{start}; the least is {say_share(best.heldout)} ({best.label}), a difference of "
                f"{-100 * gap.difference:.2f} ± {100 * gap.standard_error:.2f} points of mean error.")
    told = (f" Beyond two standard errors only {join(better)} {'does' if len(better) == 1 else 'do'} better." if better
            else " No model does better than the constant beyond two standard errors.")
    return text + told + (f" Worse beyond that: {join(worse)}." if worse else "")


def _describe_loads(loads: np.ndarray) -> str:
    outside = int(np.sum(loads > DIVERGES_ABOVE))
    if not outside:
        return ""
    return (f"; {outside} of the {len(loads)} loads lie above {DIVERGES_ABOVE:.1f} N, where its curve diverges, so "
            f"that it could not be used anyway")


def _describe_weights(judged) -> list[str]:
    """Whether K and tan(delta) can be told apart, and what happens to them."""
    if not judged.separation:
        return []
    from .friction import RELEASED

    large, small, correlation = judged.separation
    if small < 1e-6 * large:
        return ["Without a spread of pressures K and tan δ cannot be told apart: only their product is seen."]
    found = [f"At the toolkit's values of K and tan δ the derivatives of the forces by their logarithms have singular "
             f"values {large:.2f} and {small:.3f}: estimates of the two are correlated by "
             f"{sign(correlation, 2)}, and only the spread of pressures tells them apart at all."]
    free = next((row for row in judged.rows if row.label == RELEASED), None)
    if "loss_factor" not in judged.reference.estimates and free is not None:
        value = free.estimates["loss_factor"]
        found.append(
            f"Left free in sign, tan δ comes out as {sign(value['estimate'], 3)} ± {value['sd']:.3f}: friction "
            f"over load does not grow with pressure as the hysteresis of Eq. 8 must. Within its limits tan δ goes to 0 "
            f"and K without limit; what remains of Eq. 8 is their product, which is a constant coefficient.")
    return found


def _write_sentence(judged) -> str:
    start = (f"With each record left out in turn, {'Eq. 8' if judged.separation else 'our model'} misses the friction "
             f"forces by {say_share(judged.reference.heldout)} (rms), a constant coefficient by "
             f"{say_share(judged.constant.heldout)}, a low polynomial in load by "
             f"{say_share(judged.polynomial.heldout)}")
    printed = [row for row in judged.rows if row.kind == "printed"]
    if printed:
        start += f", the printed column by {say_share(printed[0].heldout)}"
    mean, spread = judged.ratio
    tail = f" Friction over load is {mean:.3f} ± {spread:.3f}."
    if judged.verdict == "undecided":
        return f"{start}: {len(judged.peaks)} forces are too few to show or to rule out any effect.{tail}"
    if judged.verdict == "nothing-missing":
        return f"{start}: no lack of fit at the {100 * judged.level:g} % level.{tail}"
    if judged.verdict == "unexplained":
        return (f"{start}. What our model leaves is more than the scatter about that polynomial (p = "
                f"{judged.steps[0].p_value:.2g}), but no catalogued effect predicts left-out forces better beyond "
                f"chance.{tail}")
    effect = judged.effects[-1]
    rest = "no lack of fit is left" if judged.verdict == "explained" else "something is still missing"
    return f"{start}; {effect} brings our model to {say_share(judged.steps[-1].heldout)}, and {rest}.{tail}"
