"""The plain sentences of a judgement on peaks."""

from collections.abc import Sequence

import numpy as np

from .rows import PeakRow, compare_rows
from .words import say_share


def describe_verdict(judged, assumed: Sequence[str], repeats: np.ndarray | None) -> tuple[str, tuple[str, ...]]:
    """The sentence and the notes of a `PeakJudgement`.

    Args:
        judged: the judgement, without them.
        assumed: names of conditions that are assumptions.
        repeats: how many impacts each value is the mean of, or None.
    """
    notes = [judged.noise.text]
    zero = judged.pressures == 0
    if zero.any():
        value = judged.peaks[zero].max()
        notes.append(
            f"At P0 = 0 the gas model gives no force at all, and {value:.1f} N was measured: that row alone says that "
            "something but gas carries load, or that the pressures are not what they are taken to be"
            + (" (they are an assumption)." if "initial_pressure" in assumed else "."))
        read = [row for row in judged.rows if row.kind == "reading" and not row.effects]
        if read:
            first = read[0].fitted[np.argmin(judged.pressures)]
            notes.append(f"Read as gauge pressures (the atmosphere added), that row gets {first:.1f} N in vacuum "
                         f"and the "
                         f"left-out error of our model is {say_share(read[0].heldout)}: not enough either.")
    if "initial_pressure" in assumed:
        notes.append("The pressures of these rows are assumed, not printed; every statement here stands on them.")
    if repeats is not None and np.all(repeats > 1):
        notes.append(f"Each value is the mean of {int(np.min(repeats))} impacts whose scatter is not given.")
    for name, value in judged.fixed.items():
        notes.append(f"{name.capitalize()} cannot be told from what is fitted by peaks alone; it was kept at "
                     f"{value:g}.")
    notes += [f"{effect.capitalize()} cannot be seen: {reason}." for effect, reason in judged.left_out.items()]
    notes += _describe_final(judged) + _describe_pairs(judged)
    return _write_sentence(judged), tuple(notes)


def _write_sentence(judged) -> str:
    base, last, low = judged.reference, judged.steps[-1], judged.polynomial
    start = (f"With each record left out in turn, the {judged.model} model misses the peaks by "
             f"{say_share(base.heldout)} "
             f"(rms), a low polynomial in pressure by {say_share(low.heldout)}")
    printed = next((row for row in judged.rows if row.kind == "printed"), None)
    if printed is not None:
        start += f", the printed theory times one factor by {say_share(printed.heldout)}"
    if judged.verdict == "undecided":
        return (f"{len(judged.peaks)} peaks are too few to show or to rule out any effect of the catalogue. {start}. "
                "Whole force records would do.")
    if judged.verdict == "nothing-missing":
        return f"These peaks show no lack of fit at the {100 * judged.level:g} % level. {start}."
    if judged.verdict == "unexplained":
        return (f"No effect of the catalogue explains what is missing in these peaks. {start}; no catalogued effect in "
                "its physical range helps on peaks that were left out.")
    effects = " and ".join(last.effects)
    twins = next((c["indistinguishable_from"] for c in judged.candidates if c["effect"] == last.effects[0]), [])
    twins = [twin for twin in twins if twin in {e for row in judged.rows if row.physical for e in row.effects}]
    told = f" (these peaks cannot tell it from {', '.join(twins)})" if twins else ""
    many = len(last.effects) > 1
    if judged.verdict == "explained":
        return (f"{effects.capitalize()} {'explain' if many else 'explains'} what is missing. {start}; {effects}{told} "
                f"brings our model to {say_share(last.heldout)}, and no lack of fit is left.")
    gap = compare_rows(last, low, judged.peaks)
    head = "help but are not all" if many else "helps but is not all"
    return (f"{effects.capitalize()} {head}. {start}. {effects.capitalize()}{told} brings our model "
            f"to {say_share(last.heldout)}, still {100 * gap.difference:.1f} ± {100 * gap.standard_error:.1f} points "
            "behind the polynomial: no single effect of the catalogue, in its physical range, does what a curve "
            "without physics does. Force over time, at two speeds or more, is what to measure next.")


def _describe_final(judged) -> list[str]:
    """What the final model would mean for a force record, which is how to test it."""
    times, ratios = judged.contact
    some = (judged.pressures > 0) & (ratios > 0)
    if len(judged.steps) < 2 or not some.any():
        return []
    return [f"The model with {' and '.join(judged.effects)} says that the ball comes back at "
            f"{ratios[some].min():.2f} to "
            f"{ratios[some].max():.2f} of its speed after {1e3 * times[some].min():.0f} to "
            f"{1e3 * times[some].max():.0f} ms of "
            "contact (rows with gas): one force record over time would confirm or refute that."]


def _describe_pairs(judged) -> list[str]:
    """What pairs of effects reach, and at what price."""
    pairs = [row for row in judged.rows if row.kind == "pair"]
    if not pairs:
        return []
    level = [row for row in pairs if _level_with(row, judged)]
    told = [f"{' with '.join(row.effects)} ({say_share(row.heldout)}{'; ' + row.remark if row.remark else ''})"
            for row in level[:4]]
    if not told:
        return [f"Of the {len(pairs)} pairs of effects that fit best, none holds out as well as the polynomial."]
    count = max(row.free for row in level)
    return [f"Of the {len(pairs)} pairs of effects that fit best, these hold out as well as the polynomial: "
            f"{'; '.join(told)}. They take {count} fitted numbers of {len(judged.peaks)}, the polynomial "
            f"{judged.polynomial.free}: a model with as many numbers as a plain curve is not shown to be more than "
            f"one."]


def _level_with(row: PeakRow, judged) -> bool:
    gap = compare_rows(row, judged.polynomial, judged.peaks)
    return np.isfinite(row.heldout) and row.heldout < 2 * judged.polynomial.heldout and (
        gap.difference < gap.standard_error)
