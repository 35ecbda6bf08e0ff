"""How sure a plan is, as plain data and as a section of its page."""

import dataclasses as dc
from typing import Any

import numpy as np

from ..figures.plan import draw_outlook, draw_prospect
from ..planning.uncertainty import Assessment, Outlook, Prospect, Spread
from .page import Section, Table, draw_picture


WORDS = {
    "best": "The impacts are planned for the best estimate.",
    "mean": "The impacts are planned for the mean over the draws, every limit kept in the mean of its own worst share "
    "of them.",
    "tail": "The impacts are planned for the mean over the worst share of the draws, every limit kept in the mean of "
    "its own worst share.",
}


def list_outlook(found: Assessment, plan_for: str, prospect: Prospect | None = None) -> dict[str, Any]:
    """As `plan.json` has it, SI; shares of the angular momentum at the start."""
    return {
        "sequence": None if prospect is None else {
            "sentence": prospect.sentence, "share_left": [dc.asdict(one) for one in prospect.after],
            "best_estimate": prospect.best.tolist(), "reached": prospect.reached, "violated": prospect.violated,
            "lost": prospect.lost},
        "plan_for": plan_for, "tail": found.tail, "note": found.note, "sentences": list(found.sentences),
        "matters": found.matters, "difference": found.difference, "within": found.within,
        "whole": _list_one(found.whole), "models": {name: _list_one(one) for name, one in found.models.items()},
    }  # fmt: skip


def _list_one(one: Outlook) -> dict[str, Any]:
    return {
        "weight": one.weight, "best_estimate": one.nominal, "share_left": dc.asdict(one.momentum),
        "peak_normal_force": dc.asdict(one.peak_force), "peak_depression": dc.asdict(one.peak_depression),
        "violated": one.violated, "regret": dc.asdict(one.regret), "draws": one.shares.tolist(),
    }  # fmt: skip


def show_outlook(found: Assessment, plan_for: str, prospect: Prospect | None = None, share: float = 0.0) -> Section:
    """Sentences, the momentum left under every draw, and numbers of every model."""
    rows = [[name, *_show(one)] for name, one in found.models.items()]
    if len(rows) > 1:
        rows.append(["all, by their weights", *_show(found.whole)])
    table = Table(
        ["model", "weight", "momentum left, mean ± sd [%]", "5 to 95 % of the draws [%]",
         f"worst {100 * found.tail:.0f} % [%]", "peak force [N]", "depression [mm]", "limits not kept in",
         "wrong plan costs [%]"], rows,
        "Of the first impact. The last column: what is lost, of what was wanted small, by a plan for another model.")
    shares = {name: one.shares for name, one in found.models.items()}
    caption = ("How much of the angular momentum the first impact leaves, under draws of the contact law. Dashed: the "
               "mean of the worst share.")
    pictures = [draw_picture("outlook", caption, draw_outlook, shares, found.whole.nominal, found.whole.momentum.tail)]
    sentences = list(found.sentences)
    if prospect is not None:
        low, high, tail = (np.array([getattr(one, name) for one in prospect.after]) for name in ("q05", "q95", "tail"))
        caption = ("How much of the angular momentum is left after each impact, under the same draws and with nothing "
                   "planned again.")
        pictures.append(draw_picture("prospect", caption, draw_prospect, prospect.best, low, high, tail, share))
        sentences.insert(1, prospect.sentence)
    return Section("How sure this is", [*sentences, WORDS[plan_for], found.note], figures=pictures, tables=[table])


def _show(one: Outlook) -> list[str]:
    def spread(value: Spread, factor: float, digits: int) -> str:
        return f"{factor * value.mean:.{digits}f} ± {factor * value.sd:.{digits}f}"

    momentum = one.momentum
    passed = ", ".join(f"{name} {100 * share:.0f} %" for name, share in one.violated.items() if share > 0)
    return [f"{one.weight:.2f}", spread(momentum, 100, 2), f"{100 * momentum.q05:.2f} to {100 * momentum.q95:.2f}",
            f"{100 * momentum.tail:.2f}", spread(one.peak_force, 1, 1), spread(one.peak_depression, 1e3, 2),
            passed or "none", f"{100 * one.regret.loss:.2f}"]
