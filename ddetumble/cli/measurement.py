"""The command that makes campaigns from a laboratory's files: `import`."""

import dataclasses as dc
from pathlib import Path
from typing import Annotated

import typer

from .options import OVERWRITE
from .places import open_folder
from .progress import show_progress


EXAMPLES = """\b
Examples:
  ddetumble import run*.csv --conditions settings.csv -o campaign
  ddetumble import "P1.0MPa_v0.4.csv" --name-pattern "P{initial_pressure}MPa_v{approach_speed:m/s}" -o campaign
  ddetumble import all.csv --record-column Test --force "Fz [N]" --uncertainty "force=0.25 N" -o campaign
  ddetumble import stroke*.csv --family slip --conditions settings.csv --uncertainty "force=0.04 N" -o friction
  ddetumble import a.csv --family slip --load "20 N" --pressure "8 bar" --speed "50 mm/s" --slip "Weg [mm]" -o out"""


def register(app: typer.Typer) -> None:
    """Add this module's commands."""
    app.command("import", short_help="A laboratory's CSV files to a checked campaign.", epilog=EXAMPLES)(import_files)


def import_files(
    raw: Annotated[list[Path], typer.Argument(metavar="RAW", help="CSV files, or folders with CSV files.")],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="CAMPAIGN", help="Folder of the new campaign.")],
    conditions: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv", help="Table of conditions: one row a file or record, units in the headings."),
    ] = None,
    name_pattern: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="Conditions in file names: '{initial_pressure}MPa_{approach_speed:m/s}'."),
    ] = None,
    pressure: Annotated[
        str | None, typer.Option(metavar="QUANTITY", help="Initial (slip: internal) pressure of all tests: '1.0 MPa'.")
    ] = None,
    speed: Annotated[
        str | None, typer.Option(metavar="QUANTITY", help="Approach (slip: sliding) speed of all tests: '0.4 m/s'.")
    ] = None,
    load: Annotated[
        str | None, typer.Option(metavar="QUANTITY", help="Normal load of all tests of the family slip: '20 N'.")
    ] = None,
    gauge: Annotated[
        bool | None, typer.Option("--gauge/--absolute", help="Whether pressures count from the ambient pressure.")
    ] = None,
    ambient: Annotated[
        str | None, typer.Option(metavar="QUANTITY", help="Ambient pressure of the day: '101.3 kPa'.")
    ] = None,
    force: Annotated[str | None, typer.Option(metavar="COLUMN", help="Column with the force (slip: friction).")] = None,
    time: Annotated[str | None, typer.Option(metavar="COLUMN", help="Column with the time.")] = None,
    slip: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Column with the slip (family slip), over it or over time.")
    ] = None,
    record_column: Annotated[
        str | None, typer.Option(metavar="COLUMN", help="Column that says which test a row belongs to.")
    ] = None,
    keep: Annotated[
        list[str] | None,
        typer.Option(metavar="[NAME=]COLUMN", help="A further column, or the column of a quantity; may be repeated."),
    ] = None,
    unit: Annotated[
        list[str] | None, typer.Option(metavar="NAME=UNIT", help="Unit where a heading has none; may be repeated.")
    ] = None,
    uncertainty: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=QUANTITY", help="One standard deviation: 'force=0.25 N'; may be repeated."),
    ] = None,
    common_uncertainty: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=QUANTITY", help="The same of an error that all records share: 'pressure=2 %'."),
    ] = None,
    known: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=QUANTITY",
            help="Parameter of the model: 'outer_diameter=60 mm' (slip: 'elastic_modulus=7.8 MPa'), or null to have "
            "it fitted.",
        ),
    ] = None,
    onset: Annotated[
        str | None,
        typer.Option(
            metavar="TIME|COLUMN", help="Impacts: contact onset, or the conditions' column with it; else it is found."
        ),
    ] = None,
    symmetry_axis: Annotated[
        str | None, typer.Option(metavar="x|y|z", help="Tumbling: the body's axis of symmetry in the columns; made z.")
    ] = None,
    decimal: Annotated[str | None, typer.Option(metavar="SIGN", help="Decimal sign: . or ,")] = None,
    delimiter: Annotated[str | None, typer.Option(metavar="SIGN", help="Delimiter: , ; | tab or space")] = None,
    family: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="impact (where not given), slip (friction over slip or over time) or tumble, "
                     "or FILE.py:NAME for a kind of tests of your own."),
    ] = None,
    title: Annotated[str | None, typer.Option(metavar="TEXT", help="Title of the campaign.")] = None,
    overwrite: Annotated[bool, OVERWRITE] = False,
):
    """Turn a laboratory's CSV files into a checked campaign: one file a test, or one long file.

    What can be read off the files (delimiter, decimal sign, units, columns, contact onset, sign of the friction) is,
    and every decision is told. What cannot is not guessed: the message names the option that settles it.
    """
    from ..measurement.kinds import DEFAULT_KIND
    from ..measurement.laboratory import import_tests
    from ..measurement.package import write_campaign

    with open_folder(output, "import", overwrite) as out, show_progress("reading"):
        campaign = import_tests(
            raw,
            conditions=conditions,
            name_pattern=name_pattern,
            pressure=pressure,
            speed=speed,
            load=load,
            gauge=gauge,
            ambient=ambient,
            force=force,
            time=time,
            slip=slip,
            record_column=record_column,
            keep=keep,
            units=unit,
            uncertainty=uncertainty,
            common_uncertainty=common_uncertainty,
            known=known,
            onset=onset,
            symmetry_axis=symmetry_axis,
            decimal=decimal,
            delimiter=delimiter,
            family=family or DEFAULT_KIND,
            title=title,
        )
        written = write_campaign(out.draft, dc.replace(campaign, name=campaign.name or output.resolve().name))
    for note in written.notes:
        typer.echo(f"- {note}")
    count = len(written.records)
    typer.echo(f"{output}: {count} record{'' if count == 1 else 's'}")
