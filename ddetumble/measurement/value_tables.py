"""Campaigns of single values, such as rebound speeds, from a table with one row a test."""

import dataclasses as dc
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._errors import InputError
from .campaign import Campaign, Column
from .checks import Rows, check_values
from .columns import Plan, guess_value, list_columns, read_pairs, read_stated
from .conditions import (
    add_constants,
    list_tests,
    note_exact,
    open_conditions,
    read_conditions,
    refuse_unused,
    require_needs,
)
from .kinds import RecordKind
from .layout import split_heading
from .plausibility import check_plausibility
from .quantities import join_words


MEAN_OF = "repeats"  # how many tests a value is the mean of


def refuse_options(**given) -> None:
    """Refuse options of samples, beside a table that has none."""
    for name, value in given.items():
        if value is not None:
            raise InputError("a table of values holds all that is known of a test; leave out this option, or --values",
                             option=f"--{name.replace('_', '-')}")


def import_values(paths, plan: Plan, constants: Mapping[str, tuple[Any, str]], stated: Mapping[str, Any],
                  sheet: str | None = None) -> Campaign:
    """The campaign of a table with one row a test: its conditions, and single values with units in the headings.

    Args:
        paths: the table; of a spreadsheet with several sheets `FILE.xlsx:SHEET`, or its `sheet`.
        plan: the options about columns.
        constants: conditions of all tests, by option: the text and the condition.
        stated: uncertainties, by option.

    Raises:
        InputError: The table names no test, or holds no value that is known.
    """
    kind = plan.kind
    if not kind.value_words:
        raise InputError(f"tests of the family {kind.name} have no single values", option="--values")
    given = list(paths) if isinstance(paths, list | tuple) else [paths]
    if len(given) != 1:
        raise InputError(f"a table of values is one file, and {len(given)} are given", option="--values")
    path = f"{given[0]}:{sheet}" if sheet is not None else given[0]
    table = plan.table = open_conditions(path)
    keys = list_tests(plan, table)
    dropped = {plan.find_in_table("", text) for text in plan.drop}
    told = {name: plan.find_in_table(name, text) for name, text in plan.choices.items()}
    for column in table.columns:
        name = guess_value(split_heading(column)[0], kind)
        if name is None or column in dropped or name in told or column in told.values():
            continue
        if name in plan.choices:
            raise InputError(f"the headings {plan.choices[name]!r} and {column!r} both mean {name}; leave out one of "
                             "the columns with --drop", file=table.file, column=column)
        plan.choices[name] = column
    read_conditions(plan, table, dict.fromkeys(keys, table.file))
    names = [name for name in kind.value_words if name in plan.conditions]
    if not names:
        raise InputError(f"no column is known to be {join_words(list(kind.value_words), 'or')}: the table has "
                         f"{list_columns(table)}; name one with --keep, such as --keep {next(iter(kind.value_words))}="
                         "COLUMN", file=table.file)
    values = {name: plan.conditions.pop(name) for name in (*names, MEAN_OF) if name in plan.conditions}
    refuse_unused(plan)
    add_constants(plan, constants, keys)
    require_needs(plan, len(keys), path)
    order = [*(name for name in kind.conditions if name in plan.conditions),
             *(name for name in plan.conditions if name not in kind.conditions)]
    units = {name: plan.si[name] for name in (*values, *order)}
    own, shared = read_stated(
        kind, {option: _mean_peaks(kind, texts, units) for option, texts in stated.items()}, units)
    note_exact(plan, own)
    unknown = [name for name in names if name not in own]
    if unknown:
        plan.notes.append(f"No uncertainty is stated for {join_words(unknown)}: it is that of their scatter about a "
                          f"smooth course; --uncertainty {unknown[0]}='1 %' states one.")
    columns = {name: Column(name, unit, own.get(name), common=shared.get(name), stated=plan.stated.get(name, ""),
                            gauge=plan.ambient is not None and name == kind.pressure) for name, unit in units.items()}
    index = pd.Index(keys, name="record", dtype=object)

    def collect(found: Mapping[str, Mapping[str, float]], chosen) -> pd.DataFrame:
        return pd.DataFrame({name: [found[name][key] for key in keys] for name in chosen}, index=index)

    peaks = collect(values, values)
    for name in values:
        check_values(name, peaks[name].to_numpy(dtype=float), Rows(table.file, np.asarray(table.lines)), "peaks",
                     own.get(name), plan.headings.get(name, name))
    campaign = Campaign(
        name="", title="", family=kind.name, path=None, known={}, records=collect(plan.conditions, order),
        conditions={name: columns[name] for name in order}, peaks=peaks,
        peak_columns={name: columns[name] for name in values}, sources=({"title": Path(table.file).name},))
    return dc.replace(campaign, notes=(*plan.notes, *map(str, check_plausibility(campaign))))


def _mean_peaks(kind: RecordKind, texts: Any, units: Mapping[str, str]) -> dict[str, str]:
    """Uncertainties of an option, of which `force` and `depression` mean their peaks."""
    short = {"force": next(iter(kind.value_words)), "depression": "peak_depression"}
    return {short[name] if short.get(name) in units and name not in units else name: text
            for name, text in read_pairs("uncertainty", texts).items()}
