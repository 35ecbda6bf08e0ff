"""Commands about posteriors and rival models: `sample` and `average`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import (
    Bound,
    Effects,
    Fittable,
    Fix,
    Free,
    OptionalModel,
    Overwrite,
    OwnFile,
    Prior,
    Texts,
    command,
    name_own,
    option,
    place,
    read_source,
)
from .places import locate_campaign, open_folder, tell_page
from .progress import show_progress


Count = int | None


@command("sample", "Sample the posterior of the parameters; resumable.",
         "sample data/impact-b --effect adhesion -o posterior", "sample fits/impact-b/fit.toml",
         "sample data/slip-a --effect adhesive-offset --nuts -o nuts")
def sample_posterior(
    source: Fittable,
    model: OptionalModel = None,
    effect: Effects = None,
    effects_from: OwnFile = None,
    free: Free = None,
    fix: Fix = None,
    prior: Prior = None,
    bound: Bound = None,
    output: Annotated[Path | None, place("Folder for draws and report; for fit.toml, its own by default.")] = None,
    nuts: Annotated[bool, typer.Option("--nuts", help="Use NUTS instead of emcee; needs the extra `nuts`.")] = False,
    effective: Annotated[Count, option("N", "Effective sample size wanted of every parameter [1000].")] = None,
    steps: Annotated[Count, option("N", "Stop after this many steps, converged or not [5000].")] = None,
    walkers: Annotated[Count, option("N", "Number of walkers of an ensemble; even.")] = None,
    ensembles: Annotated[Count, option("N", "Number of independent ensembles, or of chains of NUTS [4].")] = None,
    burn: Annotated[Count, option("N", "Steps of the burn-in, which are discarded [100].")] = None,
    checkpoint: Annotated[Count, option("N", "Number of steps after which the chain is saved [50].")] = None,
    seed: Annotated[Count, option("N", "Seed of the random numbers [0].")] = None,
    overwrite: Overwrite = False,
):
    """Sample the posterior: the parameters with their uncertainty, which need not be Gaussian. If the command was
    stopped, the same command continues.
    """
    read = read_source(source, output, "posterior", effects_from, model=model, effects=effect, free=free, fixed=fix,
                       priors=prior, bounds=bound)
    from ..posterior.result import FILE, SUMMARY
    from ..posterior.sampling import CHAIN, sample

    with (read.open("sample", overwrite, (SUMMARY, FILE), resumes=(CHAIN,),
                    progress=f"{CHAIN}/block-000000.npz") as out,
          show_progress(f"sampling {read.name}") as report):
        found = sample(read.measured, **read.chosen, sampler="nuts" if nuts else None, folder=out.path,
                       progress=report, walkers=walkers, ensembles=ensembles, burn=burn, block=checkpoint,
                       effective=effective, most=steps, seed=seed)
        found = found.examine(lambda text, share: report(text, share))
        report("writing the report", 0.95)
        from ..reports import write_posterior

        found.save(out.draft)
        page = out.draw(lambda draft: write_posterior(found, draft), report,
                        "the same command goes on from its draws")
    typer.echo(str(found))
    return tell_page(page, out.path)


@command("average", "Compute the weights of rival models from left-out conditions.",
         "average data/slip-a --effect adhesive-offset --effect viscous-friction --effect none",
         "average data/impact-b --effect adhesion --effect wall-stiffness,sensor-lag -o w",
         "predict slip-a-weights conditions.csv")
def average_models(
    source: Annotated[str, typer.Argument(
        metavar="CAMPAIGN|DIR", help="A campaign, or a folder that discover wrote.")],
    model: OptionalModel = None,
    effect: Annotated[Texts, option(
        "ID[,ID...]", "A rival model: its effects separated by commas, or `none` for the reference model alone.",
        "-e", "--effect")] = None,
    effects_from: OwnFile = None,
    campaign: Annotated[str | None, option("CAMPAIGN", "The campaign that discover analysed.")] = None,
    output: Annotated[Path | None, place(
        "Folder for weights.json and the fit of every rival; if not given, NAME-weights.")] = None,
    overwrite: Overwrite = False,
):
    """Weight rival models by how well each predicts conditions that were left out (stacking). `predict` on the folder
    averages over them. A folder of discover has rivals where its verdict names effects that it cannot distinguish.
    """
    found = (Path(source) / "result.json").is_file()
    if found and (effect or model or effects_from):
        raise InputError("the folder says which models are rivals; leave out --effect, --effects-from and --model",
                         file=source)
    if not found and campaign is not None:
        raise InputError("--campaign applies only to a folder that discover wrote", file=source)
    if not found and len(effect or ()) < 2:
        raise InputError("averaging needs at least two models; give --effect for each, `none` for the "
                         "reference model alone", file=source)
    from ..measurement.package import read_campaign
    from ..posterior.stacking import average

    measured = Path(source) if found else read_campaign(locate_campaign(source))
    target = output or Path(f"{measured.resolve().name if isinstance(measured, Path) else measured.name}-weights")
    rivals = [",".join(name_own(one.split(","), effects_from)) for one in effect or ()]
    with (open_folder(target, "average", overwrite) as out,
          show_progress(f"averaging models of {source}") as report):
        result = average(measured, rivals, model or "paper", campaign=campaign and locate_campaign(campaign),
                         progress=report)
        result.save(out.draft)
    typer.echo(str(result))
    typer.echo(f"Written to {target}")
