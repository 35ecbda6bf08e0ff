"""What the answers of an exam are worth: marks of one case, and shares of many with their confidence limits."""

import dataclasses as dc
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats


Row = Mapping[str, Any]
ALARMS = ("explained", "improved", "unexplained")
AIMS = {"false alarms": 0.05, "singles named or in a set of two": 0.98, "outside called explained": 0.05,
        "pairs named": 0.90}  # fmt: skip
SURE_STRENGTH = 2.0  # from which on singles count for the aim
BINS = (0.5, 0.71, 1.0, 1.41, 2.0, 2.83, 4.0, 5.66, 8.0)  # of strength


@dc.dataclass(frozen=True)
class Share:
    """So many of so many, with the limits of Clopper and Pearson (1934), each exceeded with 2.5 % probability.

    Attributes:
        count, total: cases.
        low, high: limits of the share; 0 and 1 where there are no cases.
        upper: one-sided 95 % upper limit.
    """

    count: int
    total: int
    low: float
    high: float
    upper: float

    @property
    def value(self) -> float:
        """The share itself; nan without cases."""
        return self.count / self.total if self.total else float("nan")


def count_share(flags: Iterable[bool]) -> Share:
    """Share of true ones."""
    marks = [bool(flag) for flag in flags]
    count, total = sum(marks), len(marks)
    if not total:
        return Share(0, 0, 0.0, 1.0, 1.0)
    exact: Any = stats.binomtest(count, total)
    both = exact.proportion_ci(0.95, "exact")
    # One-sided: the upper limit of a two-sided interval of 90 %.
    return Share(count, total, float(both.low), float(both.high), float(exact.proportion_ci(0.90, "exact").high))


def is_alarm(row: Row) -> bool:
    """Whether something is said to be missing."""
    return row["verdict"] in ALARMS


def list_named(row: Row) -> set[str]:
    """Effects that are named: those found, and those that the result says it cannot tell from them."""
    return {effect for group in row.get("sets", ()) for effect in group} | set(row.get("found", ()))


def size_set(row: Row) -> int:
    """Size of the confusion set of the first effect named; 0 where none is."""
    return len(row["sets"][0]) if row.get("sets") else 0


def is_first(row: Row) -> bool:
    """Whether the first effect named is a hidden one."""
    return bool(row.get("found")) and row["found"][0] in row["effects"]


def is_in_set(row: Row) -> bool:
    """Whether all hidden effects are among those named, with no more found than are hidden."""
    return (row["verdict"] in ("explained", "improved") and set(row["effects"]) <= list_named(row)
            and len(row["found"]) <= len(row["effects"]))


def is_pinned(row: Row) -> bool:
    """Whether a single effect is named, or is in a set of at most two."""
    return is_in_set(row) and (row["found"] == list(row["effects"]) or size_set(row) <= 2)


def is_right(row: Row) -> bool:
    """Whether the verdict is what an honest judge could say."""
    kind = row["kind"]
    if kind == "nothing":
        return row["verdict"] == "nothing-missing"
    if kind == "outside":
        return row["verdict"] in ("improved", "unexplained")
    return row["verdict"] == "explained" and is_in_set(row)


def describe_failure(row: Row) -> str:
    """What is wrong with an answer, in a few words; nothing where it is right."""
    if row["verdict"] in ("failed", "refused"):
        return f"{row['verdict']}: {row['error']}"
    if is_right(row):
        return ""
    said = row["verdict"] + (f" by {', '.join(row['found'])}" if row["found"] else "")
    if row["kind"] == "nothing":
        return f"false alarm: {said}" if is_alarm(row) else said
    if not is_alarm(row):
        return f"not seen: {said}"
    if row["kind"] == "outside":
        return f"imitated: {said}"
    lost = sorted(set(row["effects"]) - list_named(row))
    return f"{said}; {', '.join(lost)} not named" if lost else f"{said}, which is not the whole truth or more than it"


def pick(rows: Sequence[Row], kind: str, least: float = 0.0) -> list[Row]:
    """Rows of a kind in which every effect is at least so strong."""
    return [r for r in rows if r["kind"] == kind and min(r["strengths"].values(), default=np.inf) >= least]


def score(rows: Sequence[Row]) -> dict[str, Any]:
    """Everything that the scorecard says, as plain records.

    Coverage and widths are those of the 95 % intervals of cases that were answered rightly and hold nothing from
    outside the catalogue; widths are relative to the true value. Held-out errors are those of the grown model's
    predictions of noise-free tests, over the noise.
    """
    singles, sure = pick(rows, "one"), pick(rows, "one", SURE_STRENGTH)
    pairs, outside, nulls = pick(rows, "two"), pick(rows, "outside"), pick(rows, "nothing")
    named = [r for r in singles if r.get("found")]
    inside = [r for r in rows if r["kind"] != "outside" and is_right(r)]
    intervals = [values for r in inside for values in r["intervals"].values()]
    errors = [r["heldout_over_noise"] for r in inside if r.get("heldout_over_noise") is not None]
    return {
        "cases": len(rows), "failed": sum(r["verdict"] == "failed" for r in rows),
        "refused": sum(r["verdict"] == "refused" for r in rows),
        "right": {kind: count_share(map(is_right, pick(rows, kind))) for kind in ("nothing", "one", "two", "outside")},
        "right_by_fault": split_share(rows, name_fault, is_right),
        "reports_by_fault": split_share(rows, name_fault, has_report),
        "false_alarms": count_share(map(is_alarm, nulls)),
        "false_alarms_by_noise": split_share(nulls, name_noise, is_alarm),
        "false_alarms_by_fault": split_share(nulls, name_fault, is_alarm),
        "singles_first": count_share(map(is_first, singles)), "singles_in_set": count_share(map(is_in_set, singles)),
        "set_size": float(np.mean([size_set(r) for r in named])) if named else None,
        "sure_first": count_share(map(is_first, sure)), "sure_in_set": count_share(map(is_in_set, sure)),
        "sure_pinned": count_share(map(is_pinned, sure)),
        "pairs_named": count_share(map(is_right, pairs)),
        "sure_pairs_named": count_share(map(is_right, pick(rows, "two", SURE_STRENGTH))),
        "outside_explained": count_share(r["verdict"] == "explained" for r in outside),
        "outside_unseen": count_share(not is_alarm(r) for r in outside),
        "coverage": count_share(low <= truth <= high for truth, _, low, high in intervals),
        "widths": measure_widths(inside),
        "heldout_over_noise": summarise(errors),
        "seconds": summarise([sum(r["seconds"].values()) for r in rows]),
        "processor_seconds": summarise([r.get("processor_seconds") for r in rows]),
        "seconds_answering": summarise([r["seconds"].get("answering") for r in rows]),
        "power": measure_power(singles), "by_effect": split_effects([*singles, *outside]),
    }  # fmt: skip


def name_noise(row: Row) -> str:
    """`white` or `ar1`."""
    return "ar1" if row["noise"]["rho"] else "white"


def name_fault(row: Row) -> str:
    """The case's fault, or `none`."""
    return row["fault"] or "none"


def has_report(row: Row) -> bool:
    """Whether the result says that the data have a fault."""
    return bool(row.get("reported"))


def split_share(rows: Sequence[Row], name: Callable[[Row], str], flag: Callable[[Row], bool]) -> dict[str, Share]:
    """Shares by what `name` says of a row."""
    return {key: count_share(flag(r) for r in rows if name(r) == key) for key in sorted({name(r) for r in rows})}


def split_effects(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """By hidden effect: cases, how often it was seen and rightly answered, and the median strength."""
    found = {}
    for effect in sorted({e for r in rows for e in r["effects"]}):
        own = [r for r in rows if effect in r["effects"]]
        found[effect] = {"cases": len(own), "strength": float(np.median([r["strengths"][effect] for r in own])),
                         "seen": count_share(map(is_alarm, own)), "right": count_share(map(is_right, own))}
    return found


def measure_power(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """By strength of single effects: how often they are seen at all, named, and named alone or with one other."""
    found = []
    for low, high in zip(BINS[:-1], BINS[1:], strict=True):
        last = high == BINS[-1]
        own = [r for r in rows if low <= next(iter(r["strengths"].values())) and
               (last or next(iter(r["strengths"].values())) < high)]  # fmt: skip
        found.append({"low": low, "high": high, "seen": count_share(map(is_alarm, own)),
                      "named": count_share(map(is_in_set, own)), "first": count_share(map(is_first, own))})
    return found


def measure_widths(rows: Sequence[Row]) -> dict[str, dict[str, float]]:
    """By parameter: median width of its interval over the true value, cases, share of intervals that hold the truth."""
    found: dict[str, list] = {}
    for row in rows:
        for name, values in row["intervals"].items():
            found.setdefault(name, []).append(values)
    return {name: {"cases": len(own), "width": float(np.median([(h - lo) / abs(t) for t, _, lo, h in own if t] or [0])),
                   "coverage": float(np.mean([lo <= t <= h for t, _, lo, h in own]))}
            for name, own in sorted(found.items())}  # fmt: skip


def summarise(values: Iterable[float | None]) -> dict[str, float] | None:
    """Median, 90 % quantile and largest of some numbers; nothing where there are none."""
    numbers = [float(x) for x in values if x is not None]
    if not numbers:
        return None
    middle, high, most = np.quantile(numbers, [0.5, 0.9, 1.0])
    return {"median": float(middle), "q90": float(high), "largest": float(most)}
