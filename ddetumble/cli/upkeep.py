"""Commands about the toolkit itself: `exam` puts it to the test, `cache` and `trust` keep what it stores."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import Overwrite, Texts, app, command, option, place, show_examples
from .places import locate_campaign, locate_plan, open_folder
from .progress import show_progress


@command("exam", "Run a blind exam of discover on simulated cases, with a scorecard.",
         "exam --family slip --cases 40 --seed 1 -o exam",
         "exam --family impact --cases 200 --truth nothing --noise ar1 -o nulls",
         "exam --family slip --cases 10 --truth nothing --bench proportional -o bench",
         "exam --plan my-campaign --cases 40 -o rehearsal",
         'exam --plan plan.csv --channel "normal_force: 0.1 N" --cases 40 -o rehearsal')
def sit_exam(
    cases: Annotated[int, option("N", "Number of cases.", min=1)],
    output: Annotated[Path, place("Folder for cases.jsonl, scorecard.json, report.html.")],
    family: Annotated[str | None, option("NAME", "Family of records: impact, slip, oblique or tumble.")] = None,
    plan: Annotated[str | None, option(
        "CAMPAIGN|PLAN.csv", "Rehearse this campaign, measured or planned (a table as for map), instead: its "
        "conditions, times, noise and uncertainties.")] = None,
    seed: Annotated[int, option("S", "Seed of everything that is drawn.")] = 0,
    first: Annotated[int, option("N", "Number of the first case.")] = 0,
    truth: Annotated[Texts, option("KIND", "Hide only this: nothing, one, two, three, outside; repeatable.")] = None,
    noise: Annotated[str, option("KIND", "Kind of noise: white, ar1, or drawn (one of the two at random).")] = "drawn",
    fault: Annotated[
        str, option("KIND", "Fault in the data: none, clipping, drop-out, wrong-record, or drawn (in a quarter "
                            "of the cases).")] = "drawn",
    bench: Annotated[str, option(
        "KIND", "stated: noise and settings are as the campaign says; drawn: they are not, in one or two ways; or one "
        "way: proportional, bursts, uneven-records, tails, coarse, wander, hum, time-stamps, where the family has it "
        "ringing, loose-settings, jitter, biased-setting, biased-gauge.")] = "stated",
    tests: Annotated[str, option(
        "KIND", "full, or few (with --truth nothing): 3 to 8 tests, often at one pressure, speed or load.")] = "full",
    model: Annotated[str, option("MODEL", "With --plan: reference model, or the folder of a fit.")] = "paper",
    effects_from: Annotated[Path | None, option(
        "FILE.py", "With --plan: effects of your own, hidden and looked for beside the catalogue.")] = None,
    channel: Annotated[Texts, option("NAME: NOISE UNIT", "With --plan PLAN.csv: as of map.")] = None,
    uncertainty: Annotated[Texts, option("NAME=VALUE", "With --plan PLAN.csv: as of map.")] = None,
    value: Annotated[Texts, option("NAME=VALUE UNIT", "With --plan PLAN.csv: as of map.")] = None,
    length: Annotated[str | None, option("'30 ms'", "With --plan PLAN.csv: length of a record.")] = None,
    interval: Annotated[str | None, option("'0.1 ms'", "With --plan PLAN.csv: interval between samples.")] = None,
    workers: Annotated[int | None, option("N", "Number of processes; if not given, that of the cores.", min=1)] = None,
    scheduler: Annotated[
        str | None, option("ADDRESS", "Dask scheduler whose workers run the cases (ddetumble[cluster]).")] = None,
    keep: Annotated[bool, typer.Option(help="Keep campaign, discovery and truth of every case in DIR/kept.")] = False,
    overwrite: Overwrite = False,
):
    """Examine discover blind: hidden truths of known strength, simulated by a second implementation. Writes a
    scorecard; if the command was stopped, the same command continues. With --plan, rehearse a campaign of your own:
    what discover would see in it.
    """
    from ..exam.cases import TRUTHS, Exam

    if scheduler is not None and workers is not None:
        raise InputError("a scheduler has workers of its own; leave out --workers", option="--scheduler")
    if (family is None) == (plan is None):
        raise InputError("name either the family of an exam (--family) or a campaign to rehearse (--plan)")
    kinds = tuple(truth or ())
    if plan is None:
        given = (effects_from, channel, uncertainty, value, length, interval, None if model == "paper" else model)
        if any(given):
            raise InputError("--model, --effects-from, --channel, --uncertainty, --value, --length and --interval "
                             "belong to --plan")
        chosen = (*(kind for kind in TRUTHS if kind in kinds), *(kind for kind in kinds if kind not in TRUTHS))
        asked = Exam(str(family), seed, chosen or TRUTHS, noise, fault, bench=bench, tests=tests)
    else:
        if (noise, fault, bench, tests) != ("drawn", "drawn", "stated", "full"):
            raise InputError("--noise, --fault, --bench and --tests belong to --family: a rehearsal has the noise and "
                             "the tests of its campaign")
        from ..exam.rehearsal import HIDDEN, Rehearsal

        locate_plan(plan, channel=channel, uncertainty=uncertainty, value=value, length=length, interval=interval)
        # As it was given: the results name it, and shipped campaigns lie elsewhere on another machine.
        asked = Rehearsal(plan, model, seed, kinds or HIDDEN, effects_from and str(effects_from), tuple(channel or ()),
                          tuple(uncertainty or ()), tuple(value or ()), length, interval)
    from ..exam.examination import ANSWERS, QUESTIONS, examine
    from ..exam.scorecard import PAGE, write_scorecard

    with (open_folder(output, "exam", overwrite, resumes=(QUESTIONS, ANSWERS, "kept"), progress=ANSWERS) as out,
          show_progress(asked.title) as report):
        rows = examine(asked, range(first, first + cases), out.path, workers=workers, scheduler=scheduler, keep=keep,
                       progress=report)
        card = write_scorecard(asked, rows, out.draft)
    typer.echo(card["sentence"])
    for one in card["failures"][:10]:
        typer.echo(f"- case {one['case']} ({', '.join(one['hidden']) or 'nothing'}): {one['what']}")
    if len(card["failures"]) > 10:
        typer.echo(f"- and {len(card['failures']) - 10} more")
    typer.echo(f"Report: {output / PAGE}")


@command("trust", "Allow a Python file that a campaign or a model names to be run.", "trust tests/own_kind.py")
def trust(files: Annotated[list[Path], typer.Argument(metavar="FILE.py...", help="Python files that you have read.")]):
    """Allow Python files to be run that campaigns or saved models name: effects, models or kinds of tests of one's own.

    What you name on the command line or in Python yourself, or have saved, is allowed anyway, there and wherever it
    is copied unchanged. What comes from elsewhere is not run until you allow it here. DDETUMBLE_TRUST names the file
    that keeps the list.
    """
    from .._user_files import find_trusted, trust_file

    for file in files:
        trust_file(file)
    typer.echo(f"These files may now be run: {', '.join(map(str, files))} (listed in {find_trusted()}).")


cache = typer.Typer(rich_markup_mode=None)
app.add_typer(cache, name="cache", epilog=show_examples("ddetumble cache clear"))


@cache.callback(invoke_without_command=True)
def choose_action(context: typer.Context):
    """Show, fill or clear the compiled programs kept on disk."""
    if context.invoked_subcommand is None:
        show_cache()


@cache.command("show", epilog=show_examples("ddetumble cache show"))
def show_cache():
    """Show where compiled programs are kept, how many there are, and their size. DDETUMBLE_CACHE=off keeps none."""
    from .._settings import describe_cache

    typer.echo(describe_cache())


@cache.command("fill", epilog=show_examples("ddetumble cache fill", "ddetumble cache fill my-campaign"))
def fill_cache(campaigns: Annotated[list[str] | None, typer.Argument(
        metavar="[CAMPAIGN]...", help="Campaigns like yours; if none is named, one of every family that comes with the "
        "toolkit.")] = None):
    """Compile what `compare`, `fit` and `discover` need, so that these commands start faster from now on.

    It serves every campaign of about as many records and samples. Nothing else is kept or written.
    """
    import tempfile

    from .._settings import describe_cache, list_shipped
    from ..families import list_families, name_family
    from ..inference.estimation import fit
    from ..measurement.package import read_campaign
    from ..reports import report
    from ..selection.compare import compare
    from ..selection.discover import discover

    named = campaigns
    if not named:
        first = {name_family(read_campaign(name)): name for name in reversed(list_shipped()) if "/" not in name}
        named = [first[one.name] for one in list_families() if one.name in first]
    found = [read_campaign(locate_campaign(one)) for one in named]
    with tempfile.TemporaryDirectory() as draft:
        for k, one in enumerate(found):
            with show_progress(f"compiling for campaigns like {one.name}, {k + 1} of {len(found)}") as tell:
                report(compare(one), Path(draft) / f"{k}-compare")
                fit(one)
                report(discover(one, progress=tell), Path(draft) / f"{k}-discover")
    typer.echo(describe_cache())


@cache.command("clear", epilog=show_examples("ddetumble cache clear"))
def remove_cache():
    """Remove all compiled programs; the next commands take longer and refill the cache."""
    from .._settings import clear_cache, find_cache

    count, size = clear_cache()
    typer.echo(f"{find_cache()}: {count} compiled programs removed, {size / 1e6:.1f} MB")
