"""A simulated campaign of any family: what was really done, what was written down and measured, and its folder."""

import csv
import dataclasses as dc
import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from .noise import draw_noise


SOURCE = "Simulated by ddetumble.exam.simulators"
TITLE = "Synthetic {} campaign with an undisclosed physical effect, or none"
UNITS = {"time": ("s", 1.0), "normal_force": ("N", 1.0), "tangential_force": ("N", 1.0), "depression": ("mm", 1e-3),
         "slip": ("mm", 1e-3), "pressure": ("MPa", 1e6), "initial_pressure": ("MPa", 1e6),
         "approach_speed": ("m/s", 1.0), "tangential_speed": ("m/s", 1.0), "normal_load": ("N", 1.0),
         "internal_pressure": ("MPa", 1e6), "slip_speed": ("m/s", 1.0)}  # fmt: skip
UNITS |= {f"angular_velocity_{axis}": ("rad/s", 1.0) for axis in "xyz"}
UNITS |= {f"attitude_{axis}": ("1", 1.0) for axis in "wxyz"}
DIGITS = {"normal_load": 4, "slip_speed": 4}  # after the point, of conditions in files; 5 of the others


@dc.dataclass(frozen=True)
class Record:
    """One test: true conditions and written ones, and its samples, SI."""

    label: str
    true: dict[str, Any]
    written: dict[str, Any]
    shift: float  # of its clock, s
    along: dict[str, np.ndarray]  # columns without noise: time, slip
    values: np.ndarray  # of the channels, shape (samples, channels)
    places: np.ndarray  # where it was read, by its own clock: time or path
    clean: np.ndarray  # `values` without noise


@dc.dataclass(frozen=True)
class Campaign:
    """What a campaign is made of; `records` are empty until `draw_records` has made them."""

    name: str
    family: str
    seed: int  # of everything that is drawn
    effects: Mapping[str, Mapping[str, Any]]  # hidden ones
    base: Mapping[str, float]  # parameters of the reference model
    known: Mapping[str, Any]  # what the package states of these, None where a fit has to find them
    conditions: tuple[str, ...]  # columns of the table of records
    uncertainties: Mapping[str, float]  # one standard deviation: relative, of `time` in s; conditions without are exact
    noise: Mapping[str, float]  # standard deviation by channel, SI
    digits: Sequence[int]  # after the point, by channel, in the files' units
    # From nominal conditions, where the simulator reads (time or path), and the columns `Record.along`.
    place: Callable[[Mapping[str, Any]], tuple[np.ndarray, dict[str, np.ndarray]]]
    # From true conditions and such places, noise-free channels, shape (samples, channels).
    read: Callable[[Mapping[str, Any], np.ndarray], np.ndarray]
    rho: float = 0.0  # of `draw_noise`, like the next
    white_share: float = 0.0
    setting_scatter: float = 0.0  # relative, of true conditions about nominal ones
    white: Mapping[str, float] = dc.field(default_factory=dict)  # `noise` that is always white: channels that come last
    title: str = ""
    records: Sequence[Record] = ()


def draw_records(campaign: Campaign, generator: np.random.Generator, tests: Sequence[Mapping[str, Any]]) -> Campaign:
    """The campaign with its records, from the nominal conditions of the tests in their order.

    A true condition is nominal x (1 + setting_scatter x N(0, 1)); what is written down is the true one
    x (1 + uncertainty x N(0, 1)). Written times lag the true ones by a shift drawn with the uncertainty of `time`.
    """
    stated, records = campaign.uncertainties, []
    for number, nominal in enumerate(tests, start=1):
        names = [condition for condition in nominal if condition in stated]
        draw = generator.standard_normal(2 * len(names) + ("time" in stated))
        true, written = dict(nominal), dict(nominal)
        for i, condition in enumerate(names):
            true[condition] = nominal[condition] * (1.0 + campaign.setting_scatter * draw[i])
            written[condition] = true[condition] * (1.0 + stated[condition] * draw[len(names) + i])
        shift = stated["time"] * draw[-1] if "time" in stated else 0.0
        places, along = campaign.place(nominal)
        clean = campaign.read(true, places - shift)
        values = clean.copy()
        for j, deviation in enumerate(campaign.noise.values()):
            values[:, j] += draw_noise(generator, places.size, deviation, campaign.rho, campaign.white_share)
        if campaign.white:
            rest = generator.standard_normal((places.size, len(campaign.white)))
            values[:, len(campaign.noise) :] += np.array(list(campaign.white.values())) * rest
        records.append(Record(f"r{number:02d}", true, written, shift, along, values, places, clean))
    return dc.replace(campaign, records=records)


def order_tests(generator: np.random.Generator, names: Sequence[str], settings: Sequence[Sequence[float]],
                repeats: int = 1) -> list[dict[str, Any]]:
    """Nominal conditions: every setting with every other in random order, numbered by `sequence`."""
    plan = list(itertools.product(*settings)) * repeats
    return [dict(zip(names, plan[k], strict=True)) | {"sequence": j}
            for j, k in enumerate(generator.permutation(len(plan)), start=1)]  # fmt: skip


def place_between(values: Sequence[float]) -> tuple[float, float, float]:
    """Geometric means of the two lowest and of the two highest of some settings, and 0.9 times the highest."""
    v = sorted(values)
    return (v[0] * v[min(1, len(v) - 1)]) ** 0.5, (v[-min(2, len(v))] * v[-1]) ** 0.5, 0.9 * v[-1]


def name_conditions(names: Sequence[str], rows: Sequence[Sequence[float]], **more: Any) -> list[dict[str, Any]]:
    """Conditions by name, to six digits."""
    return [dict(zip(names, (float(f"{x:.6g}") for x in row), strict=True)) | more for row in rows]


def describe_campaign(campaign: Campaign, source: str = SOURCE) -> dict[str, Any]:
    """Data Package descriptor; source: who made the campaign."""
    stated = campaign.uncertainties

    def describe(name: str, uncertainty: str = "") -> dict[str, str]:
        if name not in UNITS:
            return {"name": name, "type": "integer"}
        number = {"name": name, "type": "number", "unit": UNITS[name][0]}
        return number | {"uncertainty": uncertainty} if uncertainty else number

    label = {"name": "record", "type": "string"}
    records = [label, *(describe(name, f"{100 * stated[name]:g} %" if name in stated else "")
                        for name in campaign.conditions)]  # fmt: skip
    samples = [label, *(describe(name, f"{stated['time'] * 1e3:g} ms" if name == "time" and name in stated else "")
                        for name in campaign.records[0].along)]  # fmt: skip
    for channel, deviation in {**campaign.noise, **campaign.white}.items():
        unit, size = UNITS[channel]
        samples.append(describe(channel, f"{deviation / size:g}" + (f" {unit}" if unit != "1" else "")))
    key = {"fields": "record", "reference": {"resource": "records", "fields": "record"}}
    schemas = {"records": {"fields": records, "primaryKey": "record"},
               "samples": {"fields": samples, "foreignKeys": [key]}}  # fmt: skip
    return {
        "name": campaign.name, "title": campaign.title or TITLE.format(campaign.family),
        "licenses": [{"name": "CC0-1.0"}], "sources": [{"title": source}], "family": campaign.family,
        "known": campaign.known,
        "resources": [{"name": table, "path": f"{table}.csv", "format": "csv", "schema": schema}
                      for table, schema in schemas.items()],
    }  # fmt: skip


def write_package(folder: Path, campaign: Campaign, source: str = SOURCE) -> None:
    """Write the Data Package: datapackage.json, records.csv and samples.csv."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    descriptor = describe_campaign(campaign, source)
    write_json(folder / "datapackage.json", descriptor)
    records, samples = [], []
    for row in campaign.records:
        records.append([row.label, *(
            f"{row.written[name] / UNITS[name][1]:.{DIGITS.get(name, 5)}f}" if name in UNITS else row.written[name]
            for name in campaign.conditions)])  # fmt: skip
        along = [np.round(column, 12) / UNITS[name][1] + 0.0 for name, column in row.along.items()]
        sizes = [UNITS[channel][1] for channel in (*campaign.noise, *campaign.white)]
        for *places, values in zip(*along, row.values / sizes, strict=True):
            samples.append([row.label, *(f"{x:g}" for x in places), *(
                "" if np.isnan(x) else f"{np.round(x, digits) + 0.0:.{digits}f}"  # no minus zero
                for x, digits in zip(values, campaign.digits, strict=True))])  # fmt: skip
    for table, rows in zip(descriptor["resources"], (records, samples), strict=True):
        write_table(folder / table["path"], [field["name"] for field in table["schema"]["fields"]], rows)


def write_table(path: Path, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write one CSV file with Unix line ends."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_json(path: Path, content: Any, indent: int | None = 2) -> None:
    """Write one JSON file with a final line end."""
    text = json.dumps(content, indent=indent, ensure_ascii=False)
    path.write_text(text + "\n", encoding="utf-8")
