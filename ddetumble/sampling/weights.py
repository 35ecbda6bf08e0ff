r"""Weights of rival models by stacking: the mixture that predicts left-out conditions best.

With the predictive density $p_k(y_g | y_{-g})$ of model k for the condition g that it has not seen, the weights
maximise $\sum_g \ln \sum_k w_k\, p_k(y_g | y_{-g})$ over $w_k \ge 0$, $\sum_k w_k = 1$ (Yao et al. 2018). They say how
much each model adds to a prediction, not how probable it is: of two that predict alike, any split is as good.
"""

import dataclasses as dc
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize

from .._errors import ComputationError, InputError
from ..inference.files import list_versions, make_plain, write_json
from ..inference.findings import Fit
from .scores import Scores, add_up


FILE = "weights.json"
SCHEMA = "ddetumble.weights/1"
LEAST = 4.0  # difference of summed logarithms of densities below which models are not told apart
ERRORS = 2.0  # standard errors that it has to exceed, too
FEW = 8  # conditions below which a standard error from their scatter is itself a guess
NOTHING = 1e-4  # weights below are none


@dc.dataclass(frozen=True, eq=False)
class Rival:
    """One model of a set.

    Attributes:
        name: its effects joined by `+`, or `reference`; `folder` that its fit goes into.
        fit: its fit, all rivals under the same noise.
        scores: left-out conditions.
        weight: by stacking.
        difference: of its summed score from that of the best; negative or 0.
        standard_error: of the difference, over conditions.
        apart: whether the conditions tell it from the best.
    """

    name: str
    folder: str
    fit: Fit
    scores: Scores
    weight: float
    difference: float
    standard_error: float
    apart: bool


@dc.dataclass(frozen=True, eq=False, repr=False)
class Weighing:
    """Rival models with their weights.

    Attributes:
        campaign, sha256: that they were fitted to.
        model: reference model.
        rivals: best left-out score first.
        sentence: what the weights mean, and whether the data tell the models apart.
        notes: further sentences.
    """

    campaign: str
    sha256: str
    model: str
    rivals: tuple[Rival, ...]
    sentence: str
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<Weighing of {', '.join(f'{r.name} {r.weight:.2f}' for r in self.rivals)}>"

    @property
    def weights(self) -> dict[str, float]:
        """By name of the rival."""
        return {one.name: one.weight for one in self.rivals}

    def text(self) -> str:
        """The report."""
        rows = [("", "weight", "elpd", "behind the best", "std. error", "largest k", "refits", "chi2/dof")]
        for one in self.rivals:
            scores = one.scores.scores
            rows.append((one.name, f"{one.weight:.3f}", f"{one.scores.elpd:.1f}", f"{abs(one.difference):.1f}",
                         f"{one.standard_error:.1f}", f"{max(s.pareto_k for s in scores):.2f}",
                         f"{sum(s.way == 'refit' for s in scores)} of {len(scores)}", f"{one.fit.chi2_reduced:.4g}"))
        widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
        lines = [self.sentence, ""]
        lines += ["  ".join(cell.ljust(w) if k == 0 else cell.rjust(w)
                            for k, (cell, w) in enumerate(zip(row, widths, strict=True))) for row in rows]
        return "\n".join([*lines, "", *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """`weights.json`: plain data."""
        conditions = [{"conditions": one.conditions, "records": one.records} for one in self.rivals[0].scores.scores]
        return make_plain({
            "schema": SCHEMA, "campaign": self.campaign, "sha256": self.sha256, "model": self.model,
            "sentence": self.sentence, "notes": self.notes, "left_out": conditions,
            "rivals": [{
                "name": one.name, "folder": one.folder, "effects": one.fit.effects, "weight": one.weight,
                "elpd": one.scores.elpd, "elpd_standard_error": one.scores.standard_error,
                "difference": one.difference, "standard_error": one.standard_error, "told_apart": one.apart,
                "chi2_reduced": one.fit.chi2_reduced, "text": one.scores.text,
                "left_out": [{"elpd": s.elpd, "pareto_k": s.pareto_k, "way": s.way, "trusted": s.trusted}
                             for s in one.scores.scores],
            } for one in self.rivals],
            "versions": list_versions(),
        })  # fmt: skip

    def save(self, folder) -> Path:
        """Write every rival's fit into a folder below this one, then `weights.json`; returns the folder."""
        folder = Path(folder)
        if folder.exists() and not folder.is_dir():
            raise InputError("is a file; name a folder for the weights", file=folder)
        # Weights of an earlier set must not stand beside the fits of this one.
        (folder / FILE).unlink(missing_ok=True)
        for one in self.rivals:
            target = folder / one.folder
            if target.is_symlink() or (target.exists() and not target.is_dir()):
                raise InputError("is in the way; remove it, or name another folder", file=target)
            if target.is_dir() and not any(target.iterdir()):
                shutil.rmtree(target)
            one.fit.save(target)
        write_json(folder / FILE, self.to_dict())
        return folder


def stack_weights(elpd: np.ndarray) -> np.ndarray:
    """Weights of models.

    Args:
        elpd: logarithm of each model's predictive density of every left-out condition, shape (conditions, models).

    Returns:
        Shape (models,), not negative, with sum 1; of models that predict alike, even ones.
    """
    conditions, count = elpd.shape
    if count == 1:
        return np.ones(1)
    if not np.all(np.isfinite(elpd.max(axis=1))):
        raise ComputationError("a left-out condition has no density under any of the models: there are no weights")
    relative = np.exp(elpd - elpd.max(axis=1, keepdims=True))

    def loss(w):
        mixed = np.maximum(relative @ w, 1e-300)
        return -np.sum(np.log(mixed)) / conditions, -(relative / mixed[:, None]).sum(axis=0) / conditions

    w = np.full(count, 1.0 / count)
    # EM never leaves the simplex nor lowers the sum; the end of its way, which may be long, is left to SLSQP.
    for _ in range(200):
        w = w * np.mean(relative / np.maximum(relative @ w, 1e-300)[:, None], axis=0)
    with np.errstate(all="ignore"):
        found = optimize.minimize(loss, w, jac=True, method="SLSQP", bounds=[(0.0, 1.0)] * count,
                                  constraints={"type": "eq", "fun": lambda v: v.sum() - 1.0,
                                               "jac": lambda v: np.ones(count)}, options={"ftol": 1e-14})
    better = np.clip(found.x, 0.0, 1.0)
    if np.all(np.isfinite(better)) and better.sum() > 0 and loss(better / better.sum())[0] <= loss(w)[0]:
        w = better / better.sum()
    w = np.where(w < NOTHING, 0.0, w)
    return w / w.sum()


def compare_rivals(elpd: np.ndarray, best: int) -> list[tuple[float, float, bool]]:
    """Difference of every model's summed score from the best's, its standard error, and whether it is told apart.

    Args:
        elpd: shape (conditions, models).
        best: number of the best model.
    """
    found = []
    for k in range(elpd.shape[1]):
        difference, error = add_up(elpd[:, k] - elpd[:, best])
        found.append((difference, error, bool(k != best and -difference > LEAST and -difference > ERRORS * error)))
    return found


def conclude(campaign: str, model: str, fits: Sequence[Fit], scores: Sequence[Scores], notes: Sequence[str] = ()
             ) -> Weighing:
    """Weights and what they mean, from the left-out scores of every rival."""
    elpd = np.stack([one.values for one in scores], axis=1)
    weights, best = stack_weights(elpd), int(np.argmax(elpd.sum(axis=0)))
    order = sorted(range(len(fits)), key=lambda k: (k != best, -float(elpd[:, k].sum())))
    compared = compare_rivals(elpd, best)
    names = [name_rival(one.effects) for one in fits]
    rivals = tuple(Rival(names[k], _name_folder(names[k]), fits[k], scores[k], float(weights[k]), *compared[k])
                   for k in order)
    conditions = len(elpd)
    notes = list(notes)
    if conditions < FEW:
        notes.append(f"With {conditions} conditions the standard errors, and so the weights, are themselves rough.")
    doubtful = [one.name for one in rivals if not all(s.trusted for s in one.scores.scores)]
    if doubtful:
        notes.append(f"Not every score of {', '.join(doubtful)} can be trusted: single conditions decide what the "
                     "others leave open (see pareto_k in weights.json).")
    notes.append("Weights are those of a mixture for prediction, not probabilities of the models; none of the rivals "
                 "need be right.")
    return Weighing(campaign, fits[0].sha256, model, rivals, _say(rivals, conditions), tuple(notes))


def _say(rivals: Sequence[Rival], conditions: int) -> str:
    shares = ", ".join(f"{one.name} {one.weight:.2f}" for one in sorted(rivals, key=lambda r: -r.weight))
    head = f"To predict conditions of {rivals[0].fit.campaign} that were left out, the models mix best as {shares}"
    if len(rivals) == 1:
        return f"{rivals[0].name} has no rival, so that its weight is 1 and says nothing."
    near = [one for one in rivals[1:] if not one.apart]
    far = [one for one in rivals[1:] if one.apart]
    parts = []
    if far:
        told = ", ".join(f"{one.name} ({-one.difference:.1f} ± {one.standard_error:.1f} behind)" for one in far)
        parts.append(f"{rivals[0].name} predicts better than {told}, in logarithms of the density over {conditions} "
                     "conditions")
    if near:
        told = ", ".join(f"{one.name} ({-one.difference:.1f} ± {one.standard_error:.1f} behind)" for one in near)
        parts.append(f"these data do not tell {rivals[0].name} from {told}")
    return f"{head}; {', and '.join(parts)}."


def name_rival(effects: Sequence[str]) -> str:
    """Name of a model among its rivals."""
    return "+".join(effects) or "reference"


def _name_folder(name: str) -> str:
    return "".join(c if c.isalnum() or c in "+-_" else "-" for c in name)[:100]
