"""Contact laws drawn from what fits leave uncertain, some for every model that a discovery could not rule out.

All laws have one structure: the effects of all models, each at its null in a model that lacks it. So they are one
batched tree, and one compiled program computes any of them.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from .._errors import InputError, offer_names
from ..contact.effect import parameters_of, read_field
from ..contact.gripping import StrikeLaw
from ..inference.archive import AbstractFitted, FittedModel, load, take_fitted
from ..inference.parameters import ParameterSpace
from ..posterior.result import FILE as POSTERIOR
from ..posterior.result import Posterior
from ..posterior.stacking import FILE as WEIGHTS
from ..posterior.stacking import ModelWeights, list_rivals, name_rival, read_weights
from ..posterior.target import CampaignTarget


Tree = TypeVar("Tree")


@final
class Laws(eqx.Module):
    """Draws of contact laws.

    Attributes:
        draws: every array with the axis (models * draws,) in front, one model's draws after the other's.
        best: the best estimates, every array with the axis (models,) in front.
        names: of the models.
        weights: of the models, with sum 1.
        note: where draws and weights come from, in words.
        folder: of the fit, as `ddetumble design` takes it; '' where there is none.
        drawn, held: what of the contact the draws vary, and what is the same in all of them, in words; both empty where
            that is not said.
    """

    draws: StrikeLaw
    best: StrikeLaw
    names: tuple[str, ...] = eqx.field(static=True)
    weights: tuple[float, ...] = eqx.field(static=True)
    note: str = eqx.field(static=True, default="")
    folder: str = eqx.field(static=True, default="")
    drawn: tuple[str, ...] = eqx.field(static=True, default=())
    held: tuple[str, ...] = eqx.field(static=True, default=())

    @property
    def main(self) -> StrikeLaw:
        """The best estimate of the first of the models with the largest weight."""
        return jax.tree.map(lambda leaf: leaf[int(np.argmax(self.weights))], self.best)

    def shares(self) -> np.ndarray:
        """Weights of the draws, with sum 1, shape (models * draws,)."""
        count = jax.tree.leaves(self.draws)[0].shape[0] // len(self.names)
        return np.repeat(np.asarray(self.weights), count) / count

    def owners(self) -> np.ndarray:
        """Number of the model to which each draw belongs, shape (models * draws,)."""
        return np.arange(len(self.shares())) * len(self.names) // len(self.shares())


def split_batch(batch: Tree) -> list[Tree]:
    """What a tree of arrays with one first axis holds, one by one."""
    leaves, tree = jax.tree.flatten(jax.tree.map(np.asarray, batch))
    return [jax.tree.unflatten(tree, [jnp.asarray(leaf[k]) for leaf in leaves]) for k in range(len(leaves[0]))]


def draw_normals(count: int, size: int, seed: int) -> np.ndarray:
    """Standard normal numbers that fill their space evenly (a scrambled Halton sequence), shape (count, size)."""
    if not size:
        return np.zeros((count, 0))
    return ndtri(np.clip(qmc.Halton(size, rng=np.random.default_rng(seed)).random(count), 1e-12, 1.0 - 1e-12))


def draw_coordinates(space: ParameterSpace, u: np.ndarray, spread: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Draws of all coordinates (a logarithm, a logit: what is positive stays so) from a Gaussian about `u`, within the
    hard limits of the parameters, shape (count, parameters); the squares of the rows of `spread` add up to the
    covariance.
    """
    return np.clip(u + draw_normals(count, len(spread), seed) @ spread, *space.bounds())


def draw_posterior(saved: FittedModel, count: int, seed: int) -> np.ndarray:
    """Draws of all coordinates from the posterior that `sample` wrote beside a fit, shape (count, parameters).

    Raises:
        InputError: the posterior cannot be read, or is one of other parameters.
    """
    import xarray as xr

    if saved.folder is None:
        raise InputError("the model has not been saved; save the fit and its posterior in one folder")
    path = saved.folder / POSTERIOR
    try:
        with xr.open_dataset(path, group="posterior", engine="h5netcdf") as data:
            values = {str(name): np.ravel(data[name].to_numpy()) for name in data.data_vars}
    except (OSError, ValueError, KeyError):
        raise InputError("the posterior cannot be read; sample it again", file=path) from None
    if set(values) != set(saved.free):
        raise InputError("the posterior is not of the parameters of model.json in the same folder; sample it again",
                         file=path)
    size = len(next(iter(values.values()), ()))
    chosen = np.random.default_rng(seed).choice(size, count, replace=count > size)
    found = np.tile(saved.u, (count, 1))
    for name, own in values.items():
        k = saved.space.index[name]
        transform = saved.space.parameter(name).transform
        found[:, k] = [transform.to_unconstrained(float(value)) for value in own[chosen]]
    return np.clip(found, *saved.space.bounds())


Source = str | Path | FittedModel | AbstractFitted | ModelWeights | Posterior
Named = Sequence[tuple[str, FittedModel, float]]


def find_models(source: Source) -> tuple[list[tuple[str, FittedModel, float]], str]:
    """Name, model and weight of every model in a result, and a note on the weights.

    A discovery has its rivals, an average its own weights; a folder is one that `fit`, `sample`, `discover` or
    `average` wrote, or a file in it.

    Raises:
        InputError: the folder holds no fit, or a damaged one; the posterior is none of a campaign's parameters.
    """
    averaged = "The models count by the weights that average gave them."
    if isinstance(source, ModelWeights):
        return [(one.name, one.fit.fitted_model(), one.weight) for one in source.rivals if one.weight > 0], averaged
    if isinstance(source, Posterior):
        if not isinstance(source.target, CampaignTarget):
            raise InputError("the posterior is not of a campaign's parameters; a strike needs those of a contact")
        source = source.target.fit
    if isinstance(source, AbstractFitted):
        models = [take_fitted(one) for one in (source, *getattr(source, "rivals", ()))]
    elif isinstance(source, (str, Path)):
        folder = Path(source)
        folder = folder.parent if folder.suffix == ".json" else folder
        if (folder / WEIGHTS).is_file():
            rivals = read_weights(folder)
            total = sum(weight for *_, weight in rivals)
            return [(name, load(place), weight / total) for name, place, weight in rivals], averaged
        models = [*map(load, list_rivals(folder))]
    else:
        models = [take_fitted(source)]
    note = "" if len(models) == 1 else "The models have no weights (average computes them), so each counts the same."
    return [(name_rival(one.effects), one, 1.0 / len(models)) for one in models], note


def draw_laws(source: Source | Named, make: Callable[[Any], StrikeLaw], *, draws: int = 32, seed: int = 0,
              note: str = "", name: str = "the fit") -> Laws:
    """Draw contact laws from the samples of a posterior if there are any, else from the covariance of a fit.

    All models are drawn with the same random numbers.

    Args:
        source: what `fit`, `sample`, `discover` (with its rivals, each counted the same) or `average` returned or
            wrote, or name, model and weight of each.
        make: turns a fitted law into the law of oblique impacts; traced by JAX.
        draws: of each model.
        seed: of the random numbers.
        note: where the weights come from; a result says it itself.
        name: of the fit, for the note on where the draws come from.

    Raises:
        InputError: the folder holds no fit, or models that extend different references.
    """
    folder = str(source) if isinstance(source, (str, Path)) else ""
    if isinstance(source, Sequence) and not isinstance(source, str):
        named = source
    else:
        named, note = find_models(source)
    names, models, weights = zip(*named, strict=True)
    first = models[0].space
    if any(one.space.key[:2] != first.key[:2] for one in models):
        raise InputError("the models extend different reference models; plan with one at a time", file=folder or None)
    space = ParameterSpace(first.reference, tuple(dict.fromkeys(e for one in models for e in one.space.effects)),
                           first.commons)
    sampled = [one.folder is not None and (one.folder / POSTERIOR).is_file() for one in models]
    build = jax.vmap(lambda u: make(space.build(u)))

    def place(own: Iterable[np.ndarray]) -> StrikeLaw:
        """The laws of coordinates of every model, shape (laws, parameters) each."""
        rows = []
        for saved, u in zip(models, own, strict=True):
            rows.append(np.tile(space.coordinates(), (len(u), 1)))
            rows[-1][:, [space.index[name] for name in saved.space.index]] = u
        return build(jnp.asarray(np.concatenate(rows)))

    if isinstance(source, Posterior):
        sampled, drawn = [True], [np.tile(models[0].u, (draws, 1))]
        drawn[0][:, [models[0].space.index[name] for name in source.target.names]] = source.draw(draws, seed)
    else:
        drawn = [draw_posterior(one, draws, seed) if known
                 else draw_coordinates(one.space, one.u, one.spread(), draws, seed)
                 for one, known in zip(models, sampled, strict=True)]
    origin = (f"There are {draws} draws{' of each model' if len(models) > 1 else ''} from the "
              f"{'posterior' if all(sampled) else 'covariance'} of {name}.")
    return Laws(place(drawn), place(one.u[None] for one in models), names, tuple(map(float, weights)),
                f"{origin} {note}".rstrip(), folder)


def pair_laws(ball: Laws, friction: Laws, make: Callable[[Any, Any], StrikeLaw], *, seed: int = 0) -> Laws:
    """Draws of a ball and of its friction as those of one contact, every model of the one with every model of the
    other; as many of each. Their draws are paired in random order: two fits know nothing of each other.

    Args:
        ball, friction: draws of fitted laws, each as `draw_laws` gives them where `make` changes nothing.
        make: turns a law of the ball and one of friction into the law of oblique impacts; traced by JAX.
        seed: of the order.
    """
    count = len(ball.shares()) // len(ball.names)
    order = np.random.default_rng(seed).permutation(count)
    first, second = (one.ravel() for one in np.indices((len(ball.names), len(friction.names))))

    def join(one: Any, other: Any, places: np.ndarray, others: np.ndarray) -> StrikeLaw:
        return jax.vmap(make)(jax.tree.map(lambda leaf: leaf[places], one),
                              jax.tree.map(lambda leaf: leaf[others], other))

    draws = join(ball.draws, friction.draws, (first[:, None] * count + np.arange(count)).ravel(),
                 (second[:, None] * count + order).ravel())
    # A model that all have in common tells none from the other.
    several = [one for one in (ball, friction) if len(one.names) > 1] or [ball, friction]
    own = [[one.names[i if one is ball else j] for one in several] for i, j in zip(first, second, strict=True)]
    nothing = name_rival(())
    return Laws(draws, join(ball.best, friction.best, first, second),
                tuple("+".join(one for one in names if one != nothing) or nothing for names in own),
                tuple(np.outer(ball.weights, friction.weights).ravel().tolist()),
                f"{ball.note} {friction.note} They are drawn together, each independently of the other.",
                ball.folder if len(ball.names) > 1 or len(friction.names) == 1 else friction.folder)


def vary_law(law: StrikeLaw, stated: Mapping[str, tuple[float | None, float]],
             correlations: Sequence[tuple[str, str, float]] = (), *, draws: int = 32, seed: int = 0) -> Laws:
    """Draw contact laws about a law from stated means (None: that of the law) and standard deviations by name of the
    parameter, in its public unit, and rows of two names and their correlation.

    Raises:
        InputError: there is no such parameter, a mean that it cannot have, or correlations that contradict each other.
    """
    space = ParameterSpace(law.reference, tuple(type(effect) for effect in law.effects))
    own = {f"{effect.id}.{p.name}": float(read_field(effect, p.field))
           for effect in law.effects for p in parameters_of(effect)}
    u = space.coordinates(own)
    low, high = space.bounds()
    names = list(stated)
    roots, sds = np.zeros((len(names), len(space))), np.zeros(len(names))
    for row, (name, (mean, sd)) in enumerate(stated.items()):
        if name not in space.index:
            words = {one: space.parameter(one).text for one in space.index}
            meant = [f"did you mean {one}, the {text}? Its parameters are {', '.join(words)}"
                     for one, text in words.items() if text.split(" ")[0] == name]
            raise InputError(f"there is no parameter {name!r} in this model; "
                             f"{(*meant, offer_names(name, space.index, 'its parameters are'))[0]}",
                             key="uncertainty.parameters")
        k = space.index[name]
        transform = space.parameter(name).transform
        try:
            u[k] = u[k] if mean is None else transform.to_unconstrained(mean)
        except (ValueError, ZeroDivisionError):
            u[k] = np.nan
        if not low[k] <= u[k] <= high[k] or not np.isfinite(u[k]):
            raise InputError(f"{name} cannot be {mean:g}", key=f"uncertainty.parameters.{name}")
        sds[row] = sd / transform.slope(transform.from_unconstrained(float(u[k])))
        roots[row, k] = 1.0
    matrix = np.eye(len(names))
    for first, second, correlation in correlations:
        i, j = names.index(first), names.index(second)
        matrix[i, j] = matrix[j, i] = correlation
    values, vectors = np.linalg.eigh(matrix)
    if values.min() < -1e-9:
        raise InputError("these correlations contradict one another: no parameters can have all of them",
                         key="uncertainty.correlation")
    spread = (vectors * np.sqrt(np.maximum(values, 0.0))).T * sds @ roots
    build = jax.vmap(space.build)
    found = draw_coordinates(space, u, spread, draws, seed)
    return Laws(build(jnp.asarray(found)), build(jnp.asarray(u[None])), ("the stated model",), (1.0,),
                f"There are {draws} draws from the stated means and standard deviations.", drawn=tuple(names),
                held=("all else",))
