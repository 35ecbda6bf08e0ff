"""The command that puts the toolkit itself to the test: `exam`."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import OVERWRITE
from .places import open_folder
from .progress import show_progress


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command(
        "exam",
        short_help="Sealed exam of discover on simulated cases, with a scorecard.",
        epilog="\b\nExamples:\n  ddetumble exam --family slip --cases 40 --seed 1 -o exam\n"
        "  ddetumble exam --family impact --cases 200 --truth nothing --noise ar1 -o nulls",
    )(sit_exam)


def sit_exam(
    family: Annotated[str, typer.Option(metavar="NAME", help="Family of records: impact, slip, oblique or tumble.")],
    cases: Annotated[int, typer.Option(metavar="N", min=1, help="How many cases.")],
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for cases.jsonl, scorecard.json, report.html.")
    ],
    seed: Annotated[int, typer.Option(metavar="S", help="Of everything that is drawn.")] = 0,
    first: Annotated[int, typer.Option(metavar="N", help="Number of the first case.")] = 0,
    truth: Annotated[
        list[str] | None,
        typer.Option(metavar="KIND", help="Hide only this: nothing, one, two or outside; may be repeated."),
    ] = None,
    noise: Annotated[str, typer.Option(metavar="KIND", help="white, ar1, or drawn: either.")] = "drawn",
    fault: Annotated[
        str, typer.Option(metavar="KIND", help="none, clipping, drop-out, wrong-record, or drawn: one in a quarter.")
    ] = "drawn",
    workers: Annotated[
        int | None, typer.Option(metavar="N", min=1, help="Processes; as many as there are cores if not given.")
    ] = None,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="ADDRESS", help="Dask scheduler whose workers do the cases (ddetumble[cluster])."),
    ] = None,
    keep: Annotated[bool, typer.Option(help="Leave campaign, discovery and truth of every case in DIR/kept.")] = False,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Put discover to a sealed exam: hidden truths of known strength, simulated by a second implementation and judged
    blind. Writes a scorecard; what stopped it, the same command goes on.
    """
    from ..exam.cases import TRUTHS, Exam

    if scheduler is not None and workers is not None:
        raise InputError("a scheduler has workers of its own; leave out --workers", option="--scheduler")
    chosen = tuple(kind for kind in TRUTHS if kind in truth) + tuple(k for k in truth if k not in TRUTHS) \
        if truth else TRUTHS
    exam = Exam(family, seed, chosen, noise, fault)
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
