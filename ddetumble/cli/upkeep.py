"""Commands about the toolkit itself: `exam` puts it to the test, `cache` and `trust` keep what it stores."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import Overwrite, Texts, app, command, option, place, show_examples
from .places import open_folder
from .progress import show_progress


@command("exam", "Run a blind exam of discover on simulated cases, with a scorecard.",
         "exam --family slip --cases 40 --seed 1 -o exam",
         "exam --family impact --cases 200 --truth nothing --noise ar1 -o nulls",
         "exam --family slip --cases 10 --truth nothing --bench proportional -o bench")
def sit_exam(
    family: Annotated[str, option("NAME", "Family of records: impact, slip, oblique or tumble.")],
    cases: Annotated[int, option("N", "Number of cases.", min=1)],
    output: Annotated[Path, place("Folder for cases.jsonl, scorecard.json, report.html.")],
    seed: Annotated[int, option("S", "Seed of everything that is drawn.")] = 0,
    first: Annotated[int, option("N", "Number of the first case.")] = 0,
    truth: Annotated[Texts, option("KIND", "Hide only this: nothing, one, two or outside; may be repeated.")] = None,
    noise: Annotated[str, option("KIND", "Kind of noise: white, ar1, or drawn (one of the two at random).")] = "drawn",
    fault: Annotated[
        str, option("KIND", "Fault in the data: none, clipping, drop-out, wrong-record, or drawn (in a quarter "
                            "of the cases).")] = "drawn",
    bench: Annotated[str, option(
        "KIND", "stated: noise and settings are as the campaign says; drawn: they are not, in one or two ways; or one "
        "way: proportional, bursts, uneven-records, tails, coarse, wander, hum, time-stamps, where the family has it "
        "ringing, loose-settings, jitter, biased-setting, biased-gauge.")] = "stated",
    plan: Annotated[str, option(
        "KIND", "full, or few (with --truth nothing): 3 to 8 tests, often at one pressure, speed or load.")] = "full",
    workers: Annotated[int | None, option("N", "Number of processes; if not given, that of the cores.", min=1)] = None,
    scheduler: Annotated[
        str | None, option("ADDRESS", "Dask scheduler whose workers run the cases (ddetumble[cluster]).")] = None,
    keep: Annotated[bool, typer.Option(help="Keep campaign, discovery and truth of every case in DIR/kept.")] = False,
    overwrite: Overwrite = False,
):
    """Examine discover blind: hidden truths of known strength, simulated by a second implementation. Writes a
    scorecard; if the command was stopped, the same command continues.
    """
    from ..exam.cases import TRUTHS, Exam

    if scheduler is not None and workers is not None:
        raise InputError("a scheduler has workers of its own; leave out --workers", option="--scheduler")
    chosen = TRUTHS
    if truth:
        chosen = (*(kind for kind in TRUTHS if kind in truth), *(kind for kind in truth if kind not in TRUTHS))
    exam = Exam(family, seed, chosen, noise, fault, bench=bench, plan=plan)
    from ..exam.examination import ANSWERS, QUESTIONS, examine
    from ..exam.scorecard import PAGE, write_scorecard

    with (open_folder(output, "exam", overwrite, resumes=(QUESTIONS, ANSWERS, "kept"), progress=ANSWERS) as out,
          show_progress(f"exam of {family}") as report):
        rows = examine(exam, range(first, first + cases), out.path, workers=workers, scheduler=scheduler, keep=keep,
                       progress=report)
        card = write_scorecard(exam, rows, out.draft)
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
    """Show or clear the compiled programs kept on disk."""
    if context.invoked_subcommand is None:
        show_cache()


@cache.command("show", epilog=show_examples("ddetumble cache show"))
def show_cache():
    """Show where compiled programs are kept, how many there are, and their size. DDETUMBLE_CACHE=off keeps none."""
    from .._settings import describe_cache

    typer.echo(describe_cache())


@cache.command("clear", epilog=show_examples("ddetumble cache clear"))
def remove_cache():
    """Remove all compiled programs; the next commands take longer and refill the cache."""
    from .._settings import clear_cache, find_cache

    count, size = clear_cache()
    typer.echo(f"{find_cache()}: {count} compiled programs removed, {size / 1e6:.1f} MB")
