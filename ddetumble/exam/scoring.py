"""What the answers of an exam are worth: marks of one case, and shares of many with their confidence limits."""

import dataclasses as dc
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats


Row = Mapping[str, Any]
KINDS = ("nothing", "one", "two", "three", "outside")  # of what is hidden
ALARMS = ("explained", "improved", "unexplained")
COLUMNS = [  # of what `score` counts
    "kind", "verdict", "fault", "noise", "bench", "strength", "alarm", "false", "undecided", "right", "first",
    "in_set", "pinned", "reported", "set_size", "heldout", "seconds", "answering", "processor"]  # fmt: skip
AIMS = {"false alarms": 0.05, "singles named or in a set of two": 0.98, "outside called explained": 0.05,
        "pairs named": 0.90}  # fmt: skip
SURE_STRENGTH = 2.0  # from which on singles count for the aim
# Effects from outside the catalogue that it has come to list since the cases were drawn: what names them is right.
LISTED_SINCE = {"x-quadratic-drag": "quadratic-drag"}
BINS = (0.5, 0.71, 1.0, 1.41, 2.0, 2.83, 4.0, 5.66, 8.0)  # of strength
FAINT_BINS = (0.1, 0.17, 0.29)  # below these, where any effect was so faint


@dc.dataclass(frozen=True)
class Share:
    """So many of so many, with the limits of Clopper and Pearson (1934), each exceeded with 2.5 % probability."""

    count: int
    total: int
    low: float = 0.0
    high: float = 1.0
    upper: float = 1.0  # one-sided 95 % limit
    share: float = float("nan")  # count over total


def count_share(flags: Iterable[bool]) -> Share:
    """Share of true ones."""
    marks = [bool(flag) for flag in flags]
    count, total = sum(marks), len(marks)
    if not total:
        return Share(0, 0)
    exact: Any = stats.binomtest(count, total)
    both = exact.proportion_ci(0.95, "exact")
    # One-sided: the upper limit of a two-sided interval of 90 %.
    upper = float(exact.proportion_ci(0.90, "exact").high)
    return Share(count, total, float(both.low), float(both.high), upper, count / total)


def is_alarm(row: Row) -> bool:
    """Whether something is said to be missing."""
    return row["verdict"] in ALARMS


def list_named(row: Row) -> set[str]:
    """Effects that are named: those found, and those that the result says it cannot tell from them."""
    return {effect for group in row.get("sets", ()) for effect in group} | set(row.get("found", ()))


def list_told(row: Row) -> set[str]:
    """Effects named that are not hidden but say the same as the bench: a gain where the gauge reads too high."""
    return (list_named(row) & set(row.get("told", ()))) - set(row["effects"])


def name_bench(row: Row) -> str:
    """Kind of the bench: `stated`, one of `BENCHES`, or `two together`."""
    kinds = row.get("bench") or ("stated",)
    return kinds[0] if len(kinds) == 1 else "two together"


def size_set(row: Row) -> int:
    """Size of the confusion set of the first effect named; 0 where none is."""
    return len(row["sets"][0]) if row.get("sets") else 0


def is_first(row: Row) -> bool:
    """Whether the first effect named is a hidden one."""
    return bool(row.get("found")) and row["found"][0] in row["effects"]


def is_in_set(row: Row) -> bool:
    """Whether all hidden effects are among those named, with no more found than are hidden.

    Further ones may be found that say the same as what the bench did.
    """
    return (row["verdict"] in ("explained", "improved") and set(row["effects"]) <= list_named(row)
            and len(row["found"]) <= len(row["effects"]) + len(list_told(row)))


def is_pinned(row: Row) -> bool:
    """Whether a single effect is named, or is in a set of at most two."""
    return is_in_set(row) and (row["found"] == list(row["effects"]) or size_set(row) <= 2)


def is_listed(row: Row) -> bool:
    """Whether what was hidden from outside the catalogue has come to be listed in it, and is named: no imitation."""
    listed = {LISTED_SINCE.get(effect, effect) for effect in row["effects"]}
    return (row["kind"] == "outside" and row["verdict"] == "explained" and listed <= list_named(row)
            and len(row["found"]) <= len(listed))


def is_right(row: Row) -> bool:
    """Whether the verdict is what an honest judge could say.

    Where nothing is hidden: that nothing is missing, or the effects that say the same as what the bench did.
    """
    if row["kind"] == "nothing":
        told = row["verdict"] == "explained" and bool(list_told(row)) and is_in_set(row)
        return row["verdict"] == "nothing-missing" or told
    if row["kind"] == "outside":
        return row["verdict"] in ("improved", "unexplained") or is_listed(row)
    return row["verdict"] == "explained" and is_in_set(row)


def is_false_alarm(row: Row) -> bool:
    """Whether something is said to be missing where nothing is; what says the same as the bench is no false alarm."""
    return row["kind"] == "nothing" and is_alarm(row) and not is_right(row)


def describe_failure(row: Row) -> str:
    """What is wrong with an answer, in a few words; nothing where it is right."""
    if row["verdict"] in ("failed", "refused"):
        return f"{row['verdict']}: {row['error']}"
    if is_right(row):
        return ""
    said = row["verdict"] + (f" by {', '.join(row['found'])}" if row["found"] else "")
    if row["kind"] == "nothing":
        return f"false alarm: {said}" if is_false_alarm(row) else said
    if not is_alarm(row):
        return f"not seen: {said}"
    if row["kind"] == "outside":
        return f"imitated: {said}"
    lost = ", ".join(sorted(set(row["effects"]) - list_named(row)))
    return f"{said}; {lost} not named" if lost else f"{said}, which is not the whole truth or more than it"


def pick(rows: Sequence[Row], kind: str, least: float = 0.0) -> list[Row]:
    """Rows of a kind in which every effect is at least so strong."""
    return [r for r in rows if r["kind"] == kind and min(r["strengths"].values(), default=np.inf) >= least]


def score(rows: Sequence[Row]) -> dict[str, Any]:
    """Everything that the scorecard says, as plain records.

    Coverage and widths are those of the 95 % intervals of cases that were answered rightly and hold nothing from
    outside the catalogue; widths are relative to the true value. Held-out errors are those of the grown model's
    predictions of noise-free tests, over the noise.
    """
    table: Any = pd.DataFrame([{
        "kind": r["kind"], "verdict": r["verdict"], "fault": r["fault"] or "none",
        "noise": "ar1" if r["noise"]["rho"] else "white", "strength": min(r["strengths"].values(), default=np.inf),
        "bench": name_bench(r), "alarm": is_alarm(r), "false": is_false_alarm(r),
        "undecided": r["verdict"] == "undecided", "right": is_right(r), "first": is_first(r), "in_set": is_in_set(r),
        "pinned": is_pinned(r), "reported": bool(r.get("reported")),
        "set_size": size_set(r) if r.get("found") else None, "heldout": r.get("heldout_over_noise"),
        "seconds": sum(r["seconds"].values()), "answering": r["seconds"].get("answering"),
        "processor": r.get("processor_seconds"),
    } for r in rows], columns=COLUMNS)  # fmt: skip
    nulls, singles, pairs, triples, outside = kinds = [table[table["kind"] == kind] for kind in KINDS]
    sure, sure_pairs = (own[own["strength"] >= SURE_STRENGTH] for own in (singles, pairs))
    inside = table["right"] & (table["kind"] != "outside")
    intervals: Any = pd.DataFrame([(name, name_bench(row), *values) for row, kept in zip(rows, inside, strict=True)
                                   if kept for name, values in row["intervals"].items()],
                             columns=["name", "bench", "truth", "estimate", "low", "high"])
    intervals["holds"] = (intervals["low"] <= intervals["truth"]) & (intervals["truth"] <= intervals["high"])
    intervals["width"] = (intervals["high"] - intervals["low"]) / intervals["truth"].abs().replace(0.0, np.nan)
    sizes = singles["set_size"].dropna()
    bins = BINS if (singles["strength"] > 0.97 * BINS[0]).all() else (*FAINT_BINS, *BINS)
    # What lies on an outer limit, or rounded beyond it, is in the bin beside it.
    place = np.clip(np.searchsorted(bins, singles["strength"], "right") - 1, 0, len(bins) - 2)
    power = []
    for k, (low, high) in enumerate(itertools.pairwise(bins)):
        own = singles[place == k]
        power.append({"low": low, "high": high, "seen": count_share(own["alarm"]),
                      "named": count_share(own["in_set"]), "first": count_share(own["first"])})
    return {
        "cases": len(rows), "failed": int(sum(table["verdict"] == "failed")),
        "refused": int(sum(table["verdict"] == "refused")), "undecided": count_share(table["undecided"]),
        "right": dict(zip(KINDS, (count_share(own["right"]) for own in kinds), strict=True)),
        "right_by_fault": split_share(table, "fault", "right"),
        "reports_by_fault": split_share(table, "fault", "reported"),
        "false_alarms": count_share(nulls["false"]), "nulls_undecided": count_share(nulls["undecided"]),
        "false_alarms_by_noise": split_share(nulls, "noise", "false"),
        "false_alarms_by_fault": split_share(nulls, "fault", "false"),
        "by_bench": split_benches(table, intervals),
        "singles_first": count_share(singles["first"]), "singles_in_set": count_share(singles["in_set"]),
        "set_size": float(sizes.mean()) if len(sizes) else None,
        "sure_first": count_share(sure["first"]), "sure_in_set": count_share(sure["in_set"]),
        "sure_pinned": count_share(sure["pinned"]),
        "pairs_named": count_share(pairs["right"]), "sure_pairs_named": count_share(sure_pairs["right"]),
        "triples_named": count_share(triples["right"]),
        "outside_explained": count_share((outside["verdict"] == "explained") & ~outside["right"]),
        "outside_unseen": count_share(~outside["alarm"]),
        "coverage": count_share(intervals["holds"]),
        "widths": {str(name): {"cases": len(own), "width": float(np.nan_to_num(own["width"].median())),
                               "coverage": float(own["holds"].mean())} for name, own in intervals.groupby("name")},
        "heldout_over_noise": summarise(table["heldout"][inside]), "seconds": summarise(table["seconds"]),
        "processor_seconds": summarise(table["processor"]), "seconds_answering": summarise(table["answering"]),
        "power": power, "by_effect": split_effects([r for r in rows if r["kind"] in ("one", "outside")]),
    }  # fmt: skip


def split_share(table: Any, by: str, flag: str) -> dict[str, Share]:
    """Shares of a flag by what stands in another column."""
    return {str(name): count_share(own) for name, own in table.groupby(by)[flag]}


def split_benches(table: Any, intervals: Any) -> dict[str, dict[str, Share]]:
    """By kind of bench: false alarms and undecided where nothing is hidden, right answers, intervals that hold."""
    found = {}
    for name, own in table.groupby("bench"):
        nulls, singles = own[own["kind"] == "nothing"], own[own["kind"] == "one"]
        found[str(name)] = {
            "false_alarms": count_share(nulls["false"]), "undecided": count_share(nulls["undecided"]),
            "singles_right": count_share(singles["right"]), "right": count_share(own["right"]),
            "coverage": count_share(intervals["holds"][intervals["bench"] == name])}  # fmt: skip
    return found


def split_effects(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """By hidden effect: cases, how often it was seen and rightly answered, and the median strength."""
    found = {}
    for effect in sorted({e for r in rows for e in r["effects"]}):
        own = [r for r in rows if effect in r["effects"]]
        found[effect] = {"cases": len(own), "strength": float(np.median([r["strengths"][effect] for r in own])),
                         "seen": count_share(map(is_alarm, own)), "right": count_share(map(is_right, own))}
    return found


def summarise(values: Any) -> dict[str, float] | None:
    """Median, 90 % quantile and largest of some numbers; nothing where there are none."""
    numbers = values.dropna().astype(float)
    if not len(numbers):
        return None
    return {name: float(numbers.quantile(q)) for name, q in (("median", 0.5), ("q90", 0.9), ("largest", 1.0))}
