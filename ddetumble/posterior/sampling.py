"""Draw from the posterior of a fit: by emcee, or by NUTS."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from .._display import Progress, stay_silent
from .._errors import InputError
from ..contact.effect import AbstractEffect
from ..inference.archive import Model
from ..inference.estimation import fit
from ..inference.findings import Fit
from ..inference.specification import read_specification
from ..measurement.campaign import Campaign
from .chain import Settings, run_chains
from .ensemble import Ensembles
from .nuts import Nuts
from .result import Posterior
from .target import AbstractTarget, pose_fit


SAMPLERS = {one.name: one for one in (Ensembles, Nuts)}
CHAIN = "chain"  # folder of the blocks


def sample(source: Campaign | Fit | AbstractTarget | str | Path, model: Model = "paper",
           effects: Sequence[str | type[AbstractEffect]] = (), *, sampler: str | None = None,
           folder: str | Path | None = None, progress: Progress | None = None, walkers: int | None = None,
           ensembles: int | None = None, burn: int | None = None, block: int | None = None,
           effective: int | None = None, most: int | None = None, seed: int | None = None, **fitting: Any) -> Posterior:
    """Sample the posterior of the parameters of a model, with the nuisances of every record integrated out.

    Args:
        source: a campaign or its folder, a specification `fit.toml`, a fit, or a target made by
            `pose_curve`.
        model, effects: as for `fit`.
        sampler: `emcee` (default), or `nuts`, which needs the extra `nuts`.
        folder: where a chain is kept, so that the same call goes on after whatever stopped it.
        progress: called with a sentence and the share done.
        walkers, ensembles, burn, block, effective, most, seed: as in `Settings`; chains instead of ensembles with NUTS.
        **fitting: further arguments of `fit`: `priors`, `bounds`, `fixed`, `noise`, ...

    Priors are those given, Gaussian; elsewhere flat in the coordinate in which the parameter is fitted (its logarithm
    for what is positive, its logit between 0 and 1, itself otherwise) between its bounds.

    Raises:
        InputError: The campaign cannot be fitted, or there is no posterior as nothing bounds a parameter.
        ComputationError: The model cannot be computed.
    """
    report = progress or stay_silent
    given = {"walkers": walkers, "ensembles": ensembles, "burn": burn, "block": block, "effective": effective,
             "most": most, "seed": seed}
    stated, named = {}, "emcee"
    if isinstance(source, AbstractTarget):
        target = source
    else:
        if isinstance(source, (str, Path)) and Path(source).suffix == ".toml":
            found, _ = read_specification(Path(source))
            own = found.sampler
            stated, named = {"walkers": own.walkers, "burn": own.burn, "most": own.steps, "effective": own.effective,
                             "ensembles": own.ensembles, "seed": found.seed}, own.name
        if not isinstance(source, Fit):
            source = fit(source, model, effects, progress=lambda text, share: report(text, 0.1 * share), **fitting)
        elif fitting or effects:
            raise InputError("a fit already has its model and effects; make a new fit for others")
        report("checking whether nuisances can be integrated analytically", 0.1)
        target = pose_fit(source)
    sampler = sampler or named
    if sampler not in SAMPLERS:
        raise InputError(f"there is no sampler {sampler!r}; give {' or '.join(SAMPLERS)}", option="sampler")
    settings = Settings(**{**stated, **{name: value for name, value in given.items() if value is not None}})
    return run_chains(SAMPLERS[sampler], target, settings, None if folder is None else Path(folder) / CHAIN,
                      lambda text, share: report(text, 0.15 + 0.85 * share))
