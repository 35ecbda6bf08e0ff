"""Predictions averaged over rival models, by weights from `weigh`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from ..inference.archive import SavedModel, load_model
from ..sampling.weighing import read_weights
from .prediction import ask_model, lay_times, predict_model


def average_predictions(tables: Sequence[pd.DataFrame], weights: Sequence[float]) -> pd.DataFrame:
    """Mix predictions of the same rows: mean, and deviations by the law of total variance.

    Args:
        tables: one a model, as `predict` returns them.
        weights: of the models, with sum 1.

    Returns:
        A table of the same columns: `<channel>` is the mean of the means, the square of `<channel>_sd` (and of
        `<channel>_sd_new`) the mean of the squares plus the spread of the means.
    """
    result, w = tables[0].copy(), np.asarray(weights, dtype=float)[:, None]
    for channel in [name.removesuffix("_sd_new") for name in result.columns if name.endswith("_sd_new")]:
        means = np.stack([table[channel].to_numpy(dtype=float) for table in tables])
        mean = (w * means).sum(axis=0)
        spread = (w * (means - mean) ** 2).sum(axis=0)
        result[channel] = mean
        for ending in ("_sd", "_sd_new"):
            own = np.stack([table[channel + ending].to_numpy(dtype=float) for table in tables])
            result[channel + ending] = np.sqrt((w * own**2).sum(axis=0) + spread)
    return result


def predict_average(folder: Path, conditions: str | Path | pd.DataFrame) -> pd.DataFrame:
    """Predict by all models of a folder that `weigh` wrote; arguments and result as those of `predict`.

    Raises:
        InputError: The folder or the conditions are faulty.
        ComputationError: A model could not be integrated there.
    """
    names, models, weights = read_rivals(folder)
    # Where times are chosen, they are those of the model with the most weight.
    saved, request = ask_model(models[int(np.argmax(weights))], conditions)
    request = lay_times(saved, request)
    tables = [predict_model(model, request) for model in models]
    result = average_predictions(tables, weights)
    shares = ", ".join(f"{name} {weight:.2f}" for name, weight in zip(names, weights, strict=True))
    if len(models) == 1:
        first = f"Predicted by {names[0]}, which has all the weight among its rivals."
    else:
        first = (f"Averaged over {len(models)} models by their weights ({shares}); the spread between the models is "
                 "part of the standard deviations.")
    notes = dict.fromkeys([first, *(note for table in tables for note in table.attrs["notes"])])
    result.attrs["notes"] = tuple(notes)
    return result


def read_rivals(folder: Path) -> tuple[list[str], list[SavedModel], list[float]]:
    """Names, models and weights, with sum 1, of the rivals in a folder that `weigh` wrote."""
    rivals = read_weights(folder)
    total = sum(weight for *_, weight in rivals)
    return ([name for name, *_ in rivals], [load_model(place) for _, place, _ in rivals],
            [weight / total for *_, weight in rivals])
