"""Commands about posteriors and rival models: `sample` and `average`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import (
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
from .places import locate_campaign, open_folder
from .progress import show_progress


Count = int | None


@command("sample", "Draw from the posterior of the parameters; resumable.",
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
    output: Annotated[Path | None, place("Folder for draws and report; a specification's own.")] = None,
    nuts: Annotated[bool, typer.Option("--nuts", help="NUTS in place of emcee; needs the extra `nuts`.")] = False,
    effective: Annotated[Count, option("N", "Independent draws wanted of every parameter [2000].")] = None,
    steps: Annotated[Count, option("N", "Stop after so many steps whatever was reached [5000].")] = None,
    walkers: Annotated[Count, option("N", "Walkers of an ensemble, even.")] = None,
    ensembles: Annotated[Count, option("N", "Independent ensembles, or chains of NUTS [4].")] = None,
    burn: Annotated[Count, option("N", "First steps, to be left out [100].")] = None,
    checkpoint: Annotated[Count, option("N", "Steps between two writings of the chain [50].")] = None,
    seed: Annotated[Count, option("N", "Of the random numbers [0].")] = None,
    overwrite: Overwrite = False,
):
    """Draw from the posterior: parameters with their uncertainty where it is no Gaussian. What stopped it, the same
    command goes on.
    """
    read = read_source(source, output, "posterior", effects_from, model=model, effects=effect, free=free, fixed=fix,
                       priors=prior)
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
        page = out.place(write_posterior(found, out.draft))
    typer.echo(str(found))
    typer.echo(f"Report: {page}")


@command("average", "Weights of rival models, by conditions left out.",
         "average data/slip-a --effect adhesive-offset --effect viscous-friction --effect none",
         "average data/impact-b --effect adhesion --effect wall-stiffness,sensor-lag -o w",
         "predict slip-a-weights conditions.csv")
def average_models(
    source: Annotated[str, typer.Argument(
        metavar="CAMPAIGN|DIR", help="A campaign, or a folder that discover wrote.")],
    model: OptionalModel = None,
    effect: Annotated[Texts, option(
        "ID[,ID...]", "One rival: its effects with commas between them, or `none` for the reference model alone.",
        "-e", "--effect")] = None,
    effects_from: OwnFile = None,
    campaign: Annotated[str | None, option("CAMPAIGN", "The campaign that discover looked at.")] = None,
    output: Annotated[Path | None, place(
        "Folder for weights.json and every rival's fit; NAME-weights, if not given.")] = None,
    overwrite: Overwrite = False,
):
    """Weigh rival models by how well each predicts conditions that it has not seen. `predict` on the folder averages
    over them. A folder of discover has rivals where its sentence names effects that it could not tell apart.
    """
    found = (Path(source) / "result.json").is_file()
    if found and (effect or model or effects_from):
        raise InputError("the folder says which models are rivals; leave out --effect, --effects-from and --model",
                         file=source)
    if not found and campaign is not None:
        raise InputError("--campaign goes with a folder that discover wrote", file=source)
    if not found and len(effect or ()) < 2:
        raise InputError("there have to be at least two models to average; give --effect for each, `none` for the "
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
