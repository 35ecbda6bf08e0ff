"""Conditions of a laboratory's tests from a table or from file names."""

import re
import unicodedata
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError, error_place
from .checks import COUNTS, Rows, check_keys
from .columns import (
    Plan,
    ask_unit,
    guess_condition,
    guess_role,
    is_counter,
    list_columns,
    name_condition,
    names_number,
    read_unit,
)
from .layout import RawFile, split_heading
from .quantities import join_words
from .recordings import read_files, split_sheet
from .tables import Table, convert_column, read_texts
from .units import (
    ROLES,
    check_unit,
    find_unit_text,
    list_usual,
    parse_quantity,
    parse_unit,
    si_unit,
    strip_gauge,
)


LINKS = {"file": ("file", "filename", "datei", "fichier"), "record": ("record",)}  # headings of the test of a row
NEEDED = "every test needs a number here: write it, or leave out the test, its row and its file"
SHOWN = 5  # names of a table in a message


def open_conditions(path) -> RawFile:
    """The table of conditions as it stands; it may be `FILE.xlsx:SHEET`."""
    file, sheet = split_sheet(path)
    tables = read_files(file, sheet=sheet, option="--conditions")
    if len(tables) > 1:
        raise InputError(f"{sheet!r} names several sheets; name the one with the conditions", file=file,
                         option="--conditions")
    return tables[0].join(tables[0].columns)


def read_conditions(plan: Plan, table: RawFile, records: dict[str, str]) -> None:
    """Add the columns of a table of conditions with one row a file or record; `records`: key to name of the raw file.

    It has a column that says which test a row belongs to, then one column a condition, with units in the headings;
    `onset` is a time.
    """
    with error_place(sheet=table.sheet):
        _add_columns(plan, table, Path(table.file), records)


def list_tests(plan: Plan, table: RawFile) -> list[str]:
    """What a table with one row a test calls the tests, in its order."""
    links = _find_links(plan, table)
    column = links.get("record") or links["file"]
    keys = [cell.strip() for cell in read_texts(table, column)]
    for row, key in enumerate(keys):
        if key and key in keys[:row]:
            raise _repeat_row(table, key, keys.index(key), row)
    check_keys(keys, Rows(table.file, np.asarray(table.lines)), column)
    return keys


def _find_links(plan: Plan, table: RawFile) -> dict[str, str]:
    """The columns that say which test a row belongs to, by what stands in them: `file`, `record` or both."""
    named = plan.find_in_table("record", plan.choices["record"]) if "record" in plan.choices else None
    if named is not None:
        return {"file" if named.casefold() in LINKS["file"] else "record": named}
    links = {role: name for name in table.columns for role, words in LINKS.items() if name.casefold() in words}
    runs = [name for name in table.columns if guess_role(name, plan.kind) == "record"]
    runs += [name for name in table.columns if names_number(name)]
    if not links and not runs:
        raise InputError(f"no column is known to say which test a row belongs to: the table has {list_columns(table)}; "
                         "name one with --record-column COLUMN, or head it file, record, Run, Test no. or No.",
                         file=table.file)
    return links or {"record": runs[0]}


def _add_columns(plan: Plan, table: RawFile, path: Path, records: dict[str, str]) -> None:
    links = _find_links(plan, table)
    chosen: dict[str, str] = {}
    for role, wanted in plan.choices.items():
        column = plan.find_in_table(role, wanted)
        if column is not None and role != "record":
            chosen[column] = plan.kind.pressure or role if role == "pressure" else role
    kept = {plan.find_in_table("", text) for text in plan.keep}
    dropped = {plan.find_in_table("", text) for text in plan.drop}
    plan.notes += [f"The conditions were read from {path.name}.", *table.notes]
    plan.notes += [f"The column {column} of {path.name} was left out, as --drop says." for column in table.columns
                   if column in dropped]
    rows = _match(table, links, records) or _match_numbers(plan, table, links, records)
    if rows is None:
        raise _miss_row(table, links, records)
    unused = [table.lines[row] for row in sorted(set(range(len(table))) - set(rows.values()))]
    if unused:
        belong = f"row {unused[0]} belongs" if len(unused) == 1 else (
            f"{len(unused)} rows ({', '.join(map(str, unused[:SHOWN]))}{', …' * (len(unused) > SHOWN)}) belong")
        plan.notes.append(f"In {path.name}, {belong} to no imported test.")
    given: dict[str, str] = {}
    text: list[str] = []
    for column in table.columns:
        if column in links.values() or column in dropped:
            continue
        if is_counter(column) and column not in kept and column not in chosen:
            plan.notes.append(f"The column {column} only counts repeats, so it is not a condition and was left out.")
            continue
        # Headings that differ in their units alone are kept with these.
        role = chosen.get(column) or guess_condition(split_heading(column)[0], plan.kind)
        usual = role is not None and (column in chosen or role in plan.kind.conditions)
        name = role if role is not None and usual else name_condition(column)
        unit = plan.find_text(name, column, table.units[column])
        if not unit and name not in plan.kind.conditions and _is_text(table, column):
            text.append(column)
            continue
        if name in given:
            raise InputError(f"the headings {given[name]!r} and {column!r} both mean {name}; leave out one of the "
                             "columns", file=table.file, column=column)
        given[name] = column
        unit = unit or ("1" if name in COUNTS else None)
        asked = "time" if name == "onset" else name
        if unit is None:
            order = "; if it numbers the tests in the order in which they were made, name it sequence"
            raise InputError(f"the column has no unit: {ask_unit(column, asked, name)}"
                             + order * _is_order(table, column), file=table.file, column=column)
        checked = read_unit(unit, asked, table.file, column, plan)
        values = checked.convert(convert_column(table, column, decimal=table.decimal, needed=NEEDED))
        places = {key: {"file": table.file, "column": column, "row": table.lines[row]} for key, row in rows.items()}
        found = {key: float(values[row]) for key, row in rows.items()}
        plan.add(name, found, checked.si, path.name, places)
        plan.headings[name] = column
        plan.note_unit(name, checked.text)
    if text:
        one = len(text) == 1
        why = "it is no condition and was" if one else "they are no conditions and were"
        plan.notes.append(f"The column{'' if one else 's'} {join_words(text)} of {path.name} hold{'s' * one} no "
                          f"numbers, so {why} left out.")


def read_names(plan: Plan, pattern: str, records: dict[str, str]) -> None:
    """Add conditions that stand in the file names; `records`: key to name of the raw file.

    The pattern is the name without its ending, like `{initial_pressure}MPa_{approach_speed}ms`; a unit may stand in the
    braces (`{initial_pressure:MPa}`), and `{}` or `{_}` matches anything.
    """
    parts = re.split(r"\{([^{}]*)\}", pattern)
    if len(parts) < 3 or any("{" in part or "}" in part for part in parts[::2]):
        raise InputError(f"--name-pattern {pattern!r} needs braces around names, like '{{initial_pressure}}MPa'")
    expression, units = re.escape(parts[0]), {}
    for part, after in zip(parts[1::2], parts[2::2], strict=True):
        name, _, unit = part.partition(":")
        if name in ("", "_"):
            expression += ".*?" + re.escape(after)
            continue
        unit = plan.find_text(name, name, unit or _unit_after(after, name))
        if name in units:
            raise InputError(f"--name-pattern {pattern!r} contains {name} twice")
        if unit is None:
            usual = list_usual(name)
            asked, near = (f"is it {join_words(usual, 'or')}? Write", usual[0]) if usual else ("write", "mm")
            raise InputError(f"--name-pattern does not state the unit of {name}: {asked} {{{name}:{near}}}")
        units[name] = read_unit(unit, name, "--name-pattern", name, plan)
        expression += r"([-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?)" + re.escape(after)
    found = {}
    for key, file in records.items():
        match = re.fullmatch(expression, Path(file).stem)
        if match is None:
            raise InputError(f"the file name does not match --name-pattern {pattern!r}", file=file)
        found[key] = [float(text.replace(",", ".")) for text in match.groups()]
    for i, (name, unit) in enumerate(units.items()):
        values = {key: float(unit.convert(numbers[i])) for key, numbers in found.items()}
        plan.add(name, values, unit.si, "--name-pattern", {key: {"file": file} for key, file in records.items()})
        plan.note_unit(name, unit.text)
    plan.notes.append(f"The file names gave {', '.join(f'{name} in {unit.text}' for name, unit in units.items())}.")


def add_constants(plan: Plan, options: Mapping[str, tuple[Any, str]], keys: Iterable[str]) -> None:
    """Add conditions that are the same in all tests, given with an option: by its name, the text and the condition."""
    for option, (given, name) in options.items():
        if given is None:
            continue
        with error_place(option=f"--{option}"):
            plain = strip_gauge(find_unit_text(given)) if name == plan.kind.pressure else None
            if plain is not None:
                raise InputError(f"{given!r} is a gauge pressure; write it in {plain}, and give --gauge and "
                                 "--ambient '101.3 kPa'")
            value = parse_quantity(given, name)
        plan.add(name, dict.fromkeys(keys, value), si_unit(name), f"--{option}")
        plan.note_unit(name, find_unit_text(given))
        plan.notes.append(f"{name} is {value:g} {si_unit(name)} for all records, as given with --{option}.")


def refuse_unused(plan: Plan) -> None:
    """Refuse --unit of what no column that is imported is."""
    unknown = [name for name in plan.units if name not in plan.used]
    if unknown:
        raise InputError(f"no column that is imported is {' or '.join(unknown)}; there are "
                         f"{', '.join(name for name in plan.headings if name != 'record')}", option="--unit")


def require_needs(plan: Plan, tests: int, path) -> None:
    """Refuse so many tests where a condition that their kind needs was found nowhere; `path` is that of the table."""
    for name in plan.kind.needs:
        if name in plan.conditions:
            continue
        usual = f"--conditions FILE.csv with a column {name}", name
        option, heading = plan.kind.options.get(name, usual)
        alone = f", or give {option}" + " if it is the same in all tests" * (tests > 1)
        where = f"; give {option}, --conditions FILE.csv or --name-pattern" if plan.table is None else (
            f": the table has {list_columns(plan.table)}; name the column with --keep '{name}=COLUMN', add one "
            f"like {heading!r}{alone}")
        near = [one for one, unit in plan.singles.items() if unit and _has_unit_of(name, unit)]
        for one in near[:1]:
            where = f"; if it is the {one!r} of the files, say so with --keep '{name}={one}'; else{where[1:]}"
        raise InputError(f"{name} is not known{where}", file=path)


def _has_unit_of(name: str, text: str) -> bool:
    """Whether a unit is one of that quantity."""
    try:
        return parse_unit(text).dimension == parse_unit(si_unit(name)).dimension
    except InputError:
        return False


def note_exact(plan: Plan, stated: Collection[str]) -> None:
    """Note which conditions state no uncertainty."""
    exact = [name for name in plan.conditions if name not in stated and name != "sequence"]
    if exact:
        count, their = ("it counts", "its error") if len(exact) == 1 else ("they count", "their errors")
        plan.notes.append(f"No uncertainty is stated for {', '.join(exact)}: {count} as exact, so {their} can look "
                          f"like missing physics; give one, such as --uncertainty {exact[0]}='0.5 %'.")


def _is_order(table: RawFile, column: str) -> bool:
    """Whether a column holds every number from 1 to that of its rows."""
    try:
        values = convert_column(table, column, decimal=table.decimal)
    except InputError:
        return False
    return sorted(values) == list(range(1, len(values) + 1))


def _is_text(table: Table, column: str) -> bool:
    """Whether a column holds text (dates, remarks) and not a single number, with or without a unit; or nothing."""
    for cell in read_texts(table, column):
        begin = re.match(r"\s*[-+]?\d+(?:[.,]\d+)?(?:[eE][-+]?\d+)?", cell)
        if begin:
            try:
                parse_unit(cell[begin.end():] or "1")
            except InputError:
                continue
            return False
    return True


def _match(table: Table, links: dict[str, str], records: dict[str, str]) -> dict[str, int] | None:
    """Row of the table for each record; None where one has none."""
    rows = {key: found[0] for key, found in _look_up(table, links, records).items() if found}
    return rows if len(rows) == len(records) else None


def _match_numbers(plan: Plan, table: Table, links: dict[str, str], records: dict[str, str]) -> dict[str, int] | None:
    """Row of the table for each record by the number that ends its name; None where that tells no row of one."""
    rows = _look_up_numbers(table, links, records)
    if len(rows) < len(records):
        return None
    [column] = links.values()
    first, ordered = next(iter(rows)), any(name_condition(split_heading(one)[0]) == "sequence" for one in table.columns)
    plan.notes.append(f"The rows of {column} were found by the number that ends a record's name: {first} is "
                      f"{read_texts(table, column)[rows[first]].strip()}." + (not ordered) * (
                          " If it is the order of the tests as well, a column `sequence` of the same numbers lets what "
                          "changes from test to test be looked for."))
    return rows


def _look_up_numbers(table: Table, links: dict[str, str], records: dict[str, str]) -> dict[str, int]:
    """Row of the table for each record whose name ends with the number of one, where the table has nothing but numbers
    for the tests and no record is in it by its name; none where two records have the same number.
    """
    if len(links) > 1 or any(_look_up(table, links, records).values()):
        return {}
    [column] = links.values()
    numbers, ends = _read_numbers(table, column), {key: re.fullmatch(r"(.*?)0*(\d+)", key) for key in records}
    if numbers is None or not all(ends.values()) or len({one[1] for one in ends.values() if one}) > 1:
        return {}
    wanted = {key: int(one[2]) for key, one in ends.items() if one}
    if len(set(wanted.values())) < len(wanted):
        return {}
    rows: dict[str, int] = {}
    for key, number in wanted.items():
        found = [row for row, one in enumerate(numbers) if one == number]
        if len(found) > 1:
            raise _repeat_row(table, key, *found[:2])
        if found:
            rows[key] = found[0]
    return rows


def _read_numbers(table: Table, column: str) -> list[int] | None:
    """Cells of a column that holds nothing but whole numbers; None of any other."""
    cells = [re.fullmatch(r"(\d+)(?:\.0+)?", cell.strip()) for cell in read_texts(table, column)]
    return [int(one[1]) for one in cells if one] if all(cells) else None


def _repeat_row(table: Table, key: str, first: int, second: int) -> InputError:
    """What to say of a record with two rows."""
    return InputError(f"record {key!r} already has a row on line {table.lines[first]}; keep one", file=table.file,
                      row=table.lines[second])


def _look_up(table: Table, links: dict[str, str], records: dict[str, str]) -> dict[str, list[int]]:
    """Rows of the table for each record, one at most."""
    cells = {link: [_unify(cell) for cell in read_texts(table, column)] for link, column in links.items()}
    rows: dict[str, list[int]] = {}
    single = len(set(records.values())) == 1
    for key, file in records.items():
        short = key.removeprefix(f"{Path(file).stem}-") if single else key  # a sheet or group by its own name
        names = {"file": (file, Path(file).name, Path(file).stem), "record": (key, short, Path(file).name)}
        rows[key] = [i for i in range(len(table)) if all(cells[link][i] in map(_unify, names[link]) for link in links)]
        if len(rows[key]) > 1:
            raise _repeat_row(table, key, *rows[key][:2])
    return rows


def _miss_row(table: Table, links: dict[str, str], records: dict[str, str]) -> InputError:
    """What to say of the first record without a row."""
    there = {key for key, rows in _look_up(table, links, records).items() if rows}
    there |= set(_look_up_numbers(table, links, records))
    key = next(key for key in records if key not in there)
    what = f"record {key!r}" + ("" if Path(records[key]).stem == key else f" of {Path(records[key]).name}")
    columns, numbers = [*links.values()], _read_numbers(table, next(iter(links.values())))
    if len(columns) == 1 and numbers:
        shown = _list_ranges(numbers)
    else:
        cells = [read_texts(table, column) for column in columns]
        shown = [*dict.fromkeys(" ".join(filter(None, map(str, row))) for row in zip(*cells, strict=True))]
    more = ", …" * (len(shown) > SHOWN)
    # Where no record is found, their names are written differently.
    remedy = "add one" if there else "write the records' names there"
    holds = f"columns {' and '.join(columns)} hold" if len(columns) > 1 else f"column {columns[0]} holds"
    return InputError(f"{what} has no row; {remedy}: the {holds} {', '.join(shown[:SHOWN]) or 'nothing'}{more}",
                      file=table.file)


def _list_ranges(numbers: list[int]) -> list[str]:
    """Whole numbers in words, in order: `1 to 6` for those that follow one another."""
    ordered, runs = sorted(set(numbers)), []
    for number in ordered:
        if runs and number == runs[-1][-1] + 1:
            runs[-1].append(number)
        else:
            runs.append([number])
    return [f"{run[0]} to {run[-1]}" if len(run) > 2 else ", ".join(map(str, run)) for run in runs]


def _unify(name: str) -> str:
    """A name as all systems write it: macOS may take letters and their accents apart, Windows turns slashes round."""
    return unicodedata.normalize("NFC", name).replace("\\", "/")


def _unit_after(text: str, name: str) -> str | None:
    """The unit that the pattern's text begins with: `MPa_` is MPa, and `ms` after a speed is m/s."""
    begin = re.match(r"[^\W\d_]*(?:-[^\W\d_]+)?", text)
    letters = begin[0] if begin else ""
    if ROLES.get(name) == "speed":
        letters = {"ms": "m/s", "mps": "m/s", "mms": "mm/s", "cms": "cm/s"}.get(letters.split("-")[0], letters)
    for end in range(len(letters), 0, -1):
        try:
            return check_unit(letters[:end], name).text
        except InputError:
            continue
    return None
