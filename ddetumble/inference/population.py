"""Several specimens of one kind: mean and spread of their parameters, told from noise, and each specimen."""

import collections
import dataclasses as dc
import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, final

from .._display import Progress, align_table
from .._errors import InputError
from ..measurement.quantities import format_number, format_p, format_value, join_words, say_p
from .files import AbstractWritten, list_versions, make_plain
from .findings import Fit, Fitted
from .goodness import LEVEL
from .joint import JointFit, Measured, Models, fit_each, identify, label_parameter, tell_misfits
from .random_effects import FEWEST, Homogeneity, RandomEffects, estimate_random_effects


SCHEMA = "ddetumble.population/1"


class Specimen(NamedTuple):
    """A parameter of one specimen, in its public unit."""

    alone: Fitted  # by its own records
    # estimate, q025, q975: with what the other specimens tell about it, and the 95 % interval of that.
    estimate: float
    q025: float
    q975: float


class PopulationParameter(NamedTuple):
    """A parameter over all specimens, in its public unit; intervals are of 95 %."""

    # mean, q025, q975: of the population (of what is positive, the median).
    mean: float
    q025: float
    q975: float
    # spread, spread_q025, spread_q975: standard deviation from specimen to specimen, to first order.
    spread: float
    spread_q025: float
    spread_q975: float
    unit: str
    p_value: float  # of there being no spread
    homogeneity: Homogeneity  # Cochran's test of the same
    varies: bool  # whether there is a spread beyond doubt, all parameters that were tested allowed for
    specimens: Mapping[str, Specimen]


@final
@dc.dataclass(frozen=True, eq=False, repr=False)
class PopulationFit(AbstractWritten):
    """Specimens of one kind, such as balls: what they have in common and how far they differ.

    Attributes:
        specimens: their names.
        parameters: by name; those that two specimens or more determine.
        effects: the same in the coordinates in which fits move.
        fits: of each specimen by itself.
        notes: sentences.
    """

    file: ClassVar[str] = "population.json"
    specimens: tuple[str, ...]
    parameters: Mapping[str, PopulationParameter]
    effects: Mapping[str, RandomEffects]
    fits: Mapping[str, Fit | JointFit]
    notes: tuple[str, ...]

    def __repr__(self) -> str:
        return f"<PopulationFit of {len(self.specimens)} specimens: {', '.join(self.parameters)}>"

    @property
    def intervals(self) -> dict[str, dict[str, tuple[float, float, float]]]:
        """Estimate and 95 % interval of each parameter by specimen, and the `mean` last; for `dd.figures.draw_forest`.
        """
        return {label_parameter(name, p.unit): {
            key: (one.alone.estimate, one.alone.q025, one.alone.q975) for key, one in p.specimens.items()} | {
            "mean": (p.mean, p.q025, p.q975)} for name, p in self.parameters.items()}

    @property
    def sentence(self) -> str:
        """Which parameters differ from specimen to specimen."""
        varying = [f"{name} (standard deviation {format_number(p.spread)} {p.unit}".rstrip() + f"; {say_p(p.p_value)})"
                   for name, p in self.parameters.items() if p.varies]
        told = (f"differ in {join_words(varying)}" if varying else
                "do not differ by more than the noise of their records explains")
        return f"The {len(self.specimens)} specimens {told}. {tell_misfits(self.fits) if varying else ''}".rstrip()

    @property
    def tables(self) -> list[list[tuple[str, ...]]]:
        """Rows of cells: the population, and every specimen."""
        population = [("parameter", "mean", "95 % interval", "spread", "95 % interval", "p (no spread)")]
        each = [("specimen", "alone", "95 % interval", "with the others", "95 % interval")]
        for name, p in self.parameters.items():
            label, sd = label_parameter(name, p.unit), 0.25 * (p.q975 - p.q025)
            mean, *ends = (format_value(x, sd) for x in (p.mean, p.q025, p.q975))
            spread, *more = (format_number(x) for x in (p.spread, p.spread_q025, p.spread_q975))
            population.append((label, mean, " to ".join(ends), spread, " to ".join(more) if math.isfinite(p.spread_q975)
                               else "too few specimens", format_p(p.p_value)))
            each.append((label, "", "", "", ""))
            for key, one in p.specimens.items():
                alone, a, b, shrunken, c, d = (format_value(x, one.alone.sd) for x in (
                    one.alone.estimate, one.alone.q025, one.alone.q975, one.estimate, one.q025, one.q975))
                each.append((f"  {key}", alone, f"{a} to {b}", shrunken, f"{c} to {d}"))
        return [population, each]

    def __str__(self) -> str:
        """Which parameters differ from specimen to specimen, the population, and every specimen."""
        return "\n\n".join([self.sentence, *("\n".join(align_table(rows)) for rows in self.tables),
                            "\n".join(self.notes)]).strip()

    def to_dict(self) -> dict[str, Any]:
        """What the file holds, as plain data."""
        plain = {name: p._asdict() | {"homogeneity": p.homogeneity._asdict(), "specimens": {
            key: one._asdict() for key, one in p.specimens.items()}} for name, p in self.parameters.items()}
        return make_plain({"schema": SCHEMA, "specimens": self.specimens, "parameters": plain,
                           "coordinates": {name: one._asdict() | {"homogeneity": one.homogeneity._asdict()}
                                           for name, one in self.effects.items()},
                           "notes": self.notes, "versions": list_versions()})


def fit_population(specimens: Sequence[Measured | JointFit], models: Models = "paper", *,
                   progress: Progress | None = None) -> PopulationFit:
    r"""Fit several specimens, such as balls, and estimate how far they differ beyond the noise of their records.

    Each specimen is fitted by itself; of every parameter the estimates $\theta_i$ with standard errors $s_i$, in the
    coordinate in which fits move, are $N(\mu, \tau^2 + s_i^2)$ (`random_effects`). Errors that only one campaign's
    records share are not compared; one that all campaigns share, as of a gauge, shifts the mean and is no spread.

    Args:
        specimens: two or more fits, joint fits, campaigns, folders or specifications, one a specimen.
        models: of those that are no fits: one for all, or one each.
        progress: called with a sentence and the share done.

    Raises:
        InputError: There are fewer than two specimens, or no parameter that two of them determine.
        ComputationError: A model could not be integrated.
    """
    fits = fit_each(specimens, models, progress)
    if len(fits) < 2:
        raise InputError("a population takes two specimens or more")
    known: dict[tuple, dict[str, str]] = collections.defaultdict(dict)
    for label, one in fits.items():
        commons = {c.slot.name for single in (one.singles.values() if isinstance(one, JointFit) else [one])
                   for c in single.space.commons}
        for name in one.parameters:
            if math.isfinite(one.gaussians[name][1]) and name not in commons and not _is_assumed(one, name):
                known[identify(one, name)][label] = name
    groups = {next(iter(names.values())): tuple(names) for names in known.values() if len(names) > 1}
    if not groups:
        raise InputError(f"no parameter is determined by the records of two specimens or more of {join_words(fits)}")
    parameters, effects, notes = {}, {}, []
    for name, labels in groups.items():
        gaussians = [fits[label].gaussians[name] for label in labels]
        found = effects[name] = estimate_random_effects([g[0] for g in gaussians], [g[1] for g in gaussians])
        first = fits[labels[0]]
        transform = first.space.parameter(name).transform
        mean = transform.from_unconstrained(found.mean)
        slope = transform.slope(mean)
        each = {}
        for label, best, sd in zip(labels, found.shrunken, found.shrunken_sd, strict=True):
            ends = transform.interval(float(best - 1.959964 * sd), float(best + 1.959964 * sd))
            each[label] = Specimen(fits[label].parameters[name], transform.from_unconstrained(float(best)), *ends)
        parameters[name] = PopulationParameter(
            mean, *transform.interval(*found.mean_interval), slope * found.spread, slope * found.spread_interval[0],
            slope * found.spread_interval[1], first.parameters[name].unit, found.p_value, found.homogeneity,
            found.p_value * len(groups) < LEVEL, each)
        if len(labels) < len(fits):
            notes.append(f"{name} is that of {len(labels)} specimens only: the others hold or do not determine it.")
        if len(labels) < FEWEST:
            notes.append(f"{len(labels)} specimens are too few for an interval of the spread of {name}; it takes "
                         f"{FEWEST}.")
        if isinstance(first, Fit) and name in first.problem.priors:
            notes.append(f"The fits have a prior of {name}, which makes the specimens look more alike than they are.")
    notes += [f"{label}: {one.goodness}" for label, one in fits.items() if isinstance(one, Fit) and str(one.goodness)]
    return PopulationFit(tuple(fits), parameters, effects, fits, tuple(notes))


def _is_assumed(one: Fit | JointFit, name: str) -> bool:
    """Whether a prior stands in place of a measurement that determines the parameter."""
    singles = one.singles.values() if isinstance(one, JointFit) else [one]
    having = [single for single in singles if name in single.parameters]
    return bool(having) and all(name in single.settings.get("assumed", ()) for single in having)
