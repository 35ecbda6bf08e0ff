"""Commands that make campaigns from a laboratory's files, and tables from campaigns and results: `import`, `export`."""

import dataclasses as dc
import glob
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from .._errors import InputError, plain_text
from .options import Overwrite, Texts, command, option, place
from .places import check_file, locate_campaign, open_optional, write_bytes, write_table
from .progress import show_progress


Text = str | None


@command(
    "import", "Turn a laboratory's files into a checked campaign.",
    "import run*.csv --conditions settings.csv -o campaign",
    'import "P1.0MPa_v0.4.csv" --name-pattern "P{initial_pressure}MPa_v{approach_speed:m/s}" -o campaign',
    'import all.csv --record-column Test --force "Fz [N]" --uncertainty "force=0.25 N" -o campaign',
    'import stroke*.csv --family slip --conditions settings.csv --uncertainty "force=0.04 N" -o friction',
    'import a.csv --family slip --load "20 N" --pressure "8 bar" --speed "50 mm/s" --slip "Weg [mm]" -o out',
    "import bench.xlsx --sheet 'shot*' --conditions bench.xlsx:settings -o campaign",
    'import rebounds.csv --values --uncertainty "rebound_speed=1 %" -o campaign',
    "import run1.tdms --list", "import import.toml -o campaign", "import import.toml --dry-run --figure check.png")
def import_files(
    raw: Annotated[list[Path], typer.Argument(metavar="RAW", help=(
        "Files, or folders with files: delimited text, .xlsx, .ods, .mat, HDF5, TDMS, Parquet, MDF, MCAP, rosbag2, "
        "universal files."))],
    output: Annotated[Path | None, place("Folder of the new campaign.", "CAMPAIGN")] = None,
    conditions: Annotated[
        Path | None, option("FILE", "Table of conditions: one row per file or record, with units in the headings; of a "
                                    "spreadsheet with several sheets, FILE.xlsx:SHEET.")
    ] = None,
    name_pattern: Annotated[
        Text, option("TEXT", "Pattern of the conditions in file names: "
                             "'{initial_pressure}MPa_{approach_speed:m/s}'.")] = None,
    pressure: Annotated[
        Text, option("QUANTITY", "Initial (slip: internal) pressure of all tests: '1.0 MPa'.")] = None,
    speed: Annotated[Text, option("QUANTITY", "Approach (slip: sliding) speed of all tests: '0.4 m/s'.")] = None,
    load: Annotated[Text, option("QUANTITY", "Normal load of all tests of the family slip: '20 N'.")] = None,
    gauge: Annotated[
        bool | None, typer.Option("--gauge/--absolute", help="Whether pressures are gauge pressures, "
                                   "which need --ambient, or absolute; without either they are taken as absolute.")
    ] = None,
    ambient: Annotated[Text, option("QUANTITY", "Ambient pressure of the day: '101.3 kPa'.")] = None,
    force: Annotated[Text, option("COLUMN", "Column with the force (slip: friction).")] = None,
    time: Annotated[Text, option("COLUMN", "Column with the time.")] = None,
    rate: Annotated[Text, option("QUANTITY", "Sampling rate of files that hold no time: '10 kHz'.")] = None,
    slip: Annotated[Text, option("COLUMN", "Column with the slip (family slip), with or without time.")] = None,
    record_column: Annotated[Text, option(
        "COLUMN", "Column, of the files or of the table of conditions, that says which test a row belongs to.")] = None,
    keep: Annotated[
        Texts, option("[NAME=]COLUMN", "A further column, or the column of a quantity: of the files, or, where they "
                                       "lack it, of the table of conditions; may be repeated.")] = None,
    drop: Annotated[Texts, option(
        "COLUMN", "Column, sought as by --keep, that is left out although its heading would be understood; may be "
                  "repeated.")] = None,
    unit: Annotated[Texts, option("NAME=UNIT", "Unit of a quantity, or of a column, whose heading has none: "
                                               "'angular_velocity=deg/s'; may be repeated.")] = None,
    uncertainty: Annotated[
        Texts, option("NAME=QUANTITY", "Standard deviation of a quantity: 'force=0.25 N'; may be repeated.")] = None,
    common_uncertainty: Annotated[
        Texts, option("NAME=QUANTITY", "Deviation of an error common to all records: 'approach_speed=2 %'.")] = None,
    known: Annotated[Texts, option(
        "NAME=QUANTITY", "Parameter of the model: 'outer_diameter=60 mm' (slip: 'elastic_modulus=7.8 MPa'), or null to "
        "have it fitted.")] = None,
    onset: Annotated[
        Text, option("TIME|COLUMN", "Impacts: time of the contact onset, or its column in the conditions; if not "
                                    "given, it is detected.")
    ] = None,
    symmetry_axis: Annotated[
        Text, option("x|y|z", "Tumbling: the body's axis of symmetry in the columns, which becomes z.")] = None,
    decimal: Annotated[Text, option("SIGN", "Decimal sign: . or ,")] = None,
    delimiter: Annotated[Text, option("SIGN", "Delimiter: , ; | tab or space")] = None,
    crop: Annotated[Text, option("START to END", "Window of the raw time that is kept: '0 ms to 80 ms'.")] = None,
    cut: Annotated[Texts, option(
        "NAME=QUANTITY", "Cut long recordings into one record a contact: 'level=5 N' (of the force above its median), "
                         "'before=20 ms' and 'after=80 ms', one --cut each.")] = None,
    reverse: Annotated[Texts, option("NAME", "Channel whose sign is reversed; may be repeated.")] = None,
    zero: Annotated[Texts, option(
        "NAME=START to END", "Window over which a channel's mean is its zero: 'force=0 ms to 20 ms'; may be "
                             "repeated.")] = None,
    describe: Annotated[Texts, option(
        "NAME=TEXT", "What to write down about a channel: its filter, where its gauge is; may be repeated.")] = None,
    values: Annotated[bool, typer.Option("--values", help=(
        "The file is a table with one row a test: its conditions and single values, such as peak force, rebound speed, "
        "contact time, impulse or peak depression."))] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be made; nothing is written but "
                                                            "--figure.")] = False,
    figure: Annotated[Path | None, option("FILE.png", "Draw the records as imported.")] = None,
    sheet: Annotated[Text, option(
        "NAME", "Sheet of a spreadsheet or group of another file; with a pattern such as '*' each is a test.")] = None,
    contents: Annotated[bool, typer.Option("--list", help="Only show which channels the files hold.")] = False,
    family: Annotated[Text, option(
        "NAME", "Kind of tests: impact (the default), slip (friction over slip or over time) or tumble, or "
                "FILE.py:NAME "
        "for one of your own.")] = None,
    title: Annotated[Text, option("TEXT", "Title of the campaign.")] = None,
    overwrite: Overwrite = False,
):
    """Turn a laboratory's files into a checked campaign: one file, sheet or group per test, or one long file.

    What the files show (delimiter, decimal sign, units, columns, contact onset, sign of the friction) is read from
    them, and every decision is reported. What they do not show is not guessed: the message names the option to give.
    """
    # All but where to write are arguments of `import_tests`, most of them by the same name.
    given = dict(locals())
    # The shells of Windows leave patterns to programs.
    raw = [one for path in raw for one in (not path.exists() and sorted(map(Path, glob.glob(str(path)))) or [path])]
    for name in ("raw", "output", "overwrite", "unit", "contents", "dry_run", "figure"):
        del given[name]
    if contents:
        show_contents(raw)
        return
    if output is None and not dry_run:
        raise InputError("name the folder of the new campaign, or see with --dry-run what would be made", option="-o")
    from ..measurement.kinds import DEFAULT_KIND
    from ..measurement.laboratory import import_tests
    from ..measurement.package import write_campaign

    check_file(figure, overwrite)
    if values and figure is not None:
        raise InputError("single values have no records to draw; leave out this option, or --values", option="--figure")
    place = None if dry_run else output
    with open_optional(place, "import", overwrite) as out, TemporaryDirectory() as spare, show_progress("reading"):
        campaign = import_tests(raw, **given | {"units": unit, "family": family or DEFAULT_KIND})
        named = dc.replace(campaign, name=campaign.name or (place or Path("campaign")).resolve().name)
        campaign = write_campaign(out.draft if out else Path(spare) / "campaign", named)
        if figure is not None:
            from ..figures import draw_records, render_png

            write_bytes(render_png(draw_records(campaign)), figure)
    for note in campaign.notes:
        typer.echo(f"- {note}")
    count = len(campaign.records)
    if figure is not None:
        typer.echo(f"Figure: {figure}")
    typer.echo(f"{place or 'No campaign was written: it would have'}{':' * bool(place)} {count} "
               f"record{'' if count == 1 else 's'}")


@command("export", "Export a campaign or results for a spreadsheet program.", "export impact-b -o impact-b.xlsx",
         "export discovery -o discovery.xlsx", "export discovery -o parameters.csv")
def export_tables(
    source: Annotated[str, typer.Argument(
        metavar="CAMPAIGN|DIR", help="Campaign (folder or name of a shipped one), or a folder that fit, discover, "
                                     "compare or sample wrote.")],
    output: Annotated[Path, place("Workbook with a sheet for each table, or of results the parameters as CSV.",
                                  "OUT.xlsx|OUT.csv")],
    overwrite: Overwrite = False,
):
    """Export a campaign, in SI with units in the headings, or the tables of a folder with results."""
    from ..measurement.package import read_campaign
    from ..reports.export import RESULTS, tabulate_campaign, tabulate_results, write_workbook

    check_file(output, overwrite)
    ending, parameters = output.suffix.lower(), "parameters"
    if ending not in (".xlsx", ".csv"):
        raise InputError("the name must end with .xlsx or .csv", file=output, option="-o")
    results = any((Path(source) / name).is_file() for name in RESULTS)
    tables = tabulate_results(source) if results else tabulate_campaign(read_campaign(locate_campaign(source)))
    if ending == ".csv" and parameters not in tables:
        raise InputError("there are no parameters to write as CSV; name an .xlsx file for everything", option="-o")
    if ending == ".csv":
        write_table(tables[parameters], output)
    else:
        write_bytes(write_workbook(tables), output)
    typer.echo(f"{output}: {', '.join([parameters] if ending == '.csv' else tables)}")


def show_contents(paths: list[Path]) -> None:
    """Print the channels of files by sheet or group: unit, number of samples, and their interval or first value."""
    from ..measurement.recordings import is_bag, is_notes, list_channels, list_folder

    folders = [path for path in paths if path.is_dir() and not is_bag(path)]
    for path in [one for given in paths for one in (list_folder(given) if given in folders else [given])]:
        typer.echo(path)
        shown = ""
        try:
            channels = list_channels(path)
        except InputError as error:
            if path in paths:
                raise
            # Of a folder's other files the rest is told, too.
            typer.echo(f"    {'no rows of numbers' if is_notes(path) else plain_text(error.problem)}")
            continue
        for channel in channels:
            if channel.group != shown:
                shown = channel.group
                typer.echo(f"  {plain_text(shown)}:")
            unit, count = f" [{channel.unit}]" if channel.unit else "", len(channel.values)
            about = f"{count} value{'s' * (count != 1)}"
            if channel.clock is not None and count > 1:
                about += f", clock of its own, every {float(channel.clock[-1] - channel.clock[0]) / (count - 1):.6g} s"
            elif count:
                first = channel.values[0]
                about += f", {'from ' * (count > 1)}{first if isinstance(first, str) else f'{first:.6g}'}"
            typer.echo(f"    {plain_text(f'{channel.name}{unit}: {channel.problem or about}')}")
