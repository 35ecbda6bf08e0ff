"""Bad campaigns: each kind is refused in one sentence with its place, and damage of any kind never ends otherwise."""

import json
import re

import pytest
from helpers_measurement import RECORDS, SAMPLES, descriptor, raw_text, raw_trace, write_small
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ddetumble._errors import InputError
from ddetumble.measurement.laboratory import import_tests
from ddetumble.measurement.package import format_campaign, read_campaign


def refused(folder, *words):
    """Reading is refused in one line that holds all words."""
    with pytest.raises(InputError) as caught:
        read_campaign(folder)
    sentence = str(caught.value)
    assert "\n" not in sentence and "Traceback" not in sentence
    for word in words:
        assert word in sentence, sentence
    return caught.value


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("r01,0.0,0.25", "r01,0.0,heavy", ("line 4", "column normal_force", "'heavy' is not a number")),
        ("r01,0.0,0.25", "r01,0.0,OVR", ("line 4", "'OVR'")),
        ("r01,0.0,0.25", 'r01,0.0,"0,25"', ("line 4", "column normal_force", "decimal point")),
        ("r01,0.0,0.25", "r01,0.0,0,25", ("line 4", "4 cells", "decimal points")),
        ("r01,0.0,0.25", 'r01,0.0,"1,234.5"', ("line 4", "thousands")),
        ("r01,0.0,0.25", "r01,0.0,1'234.5", ("line 4", "thousands")),
        ("r01,0.0,0.25", "r01,0.0,1_000", ("line 4", "thousands")),
        ("r01,0.0,0.25", "r01,0.0,−0.25", ("line 4", "minus")),
        ("r01,0.0,0.25", "r01,0.0,0.25 N", ("line 4", "unit or text after")),
        ("r01,0.0,0.25", "r01,0.0,NaN", ("line 4", "column normal_force", "leave the cell empty")),
        ("r01,0.0,0.25", "r01,0.0,inf", ("line 4", "'inf' is not a number")),
        ("r01,0.0,0.25", "r01,0.0,1e999", ("line 4", "too large")),
        ("r01,0.0,0.25", "r01,,0.25", ("line 4", "column time", "empty")),
        ("r01,0.0,0.25", "r01,0.0", ("line 4", "2 cells", "header has 3")),
        ("r01,0.0,0.25", "", ("line 4", "empty; remove")),
        ("r01,0.0,0.25", "r07,0.0,0.25", ("line 4", "column record", "'r07' is not in the records table")),
        ("r01,0.0,0.25", ",0.0,0.25", ("line 4", "record key is empty")),
        ("r01,0.0,0.25", "r01,0.9,0.25", ("line 5", "column time", "goes back", "sort")),
        ("r01,0.0,0.25", "r01,-0.25,0.25", ("line 4", "column time", "twice")),
        ("r01,0.0,0.25", 'r01,0.0,"0.25', ("line 4", "quot")),
        ("record,time", "record,record", ("line 1", "'record' occurs 2 times")),
        ("record,time", "record,", ("line 1", "column 2 has no name")),
        ("record,time", "record,Zeit", ("there is no column 'time'", "Zeit")),
        ("normal_force\n", "normal_force;\n", ("there is no column 'normal_force'",)),
        (SAMPLES, "", ("samples.csv", "empty")),
        (SAMPLES, " \n\n", ("samples.csv", "empty")),
        (SAMPLES, "record,time,normal_force\n", ("no data rows",)),
        (SAMPLES, SAMPLES.replace(",", ";"), ("separated by ';'", "dialect")),
        (SAMPLES, "".join(SAMPLES.splitlines(True)[:8]), ("records.csv", "line 3", "'r02' has no samples")),
        (SAMPLES, "".join(SAMPLES.splitlines(True)[:12]), ("'r02' has only 4 samples", "at least 5")),
        (SAMPLES, re.sub(r",[\d.]+\n", ",\n", SAMPLES), ("column normal_force", "no value at all")),
    ],
)  # fmt: skip
def test_samples(tmp_path, old, new, words):
    assert old in SAMPLES
    refused(write_small(tmp_path / "c", samples=SAMPLES.replace(old, new, 1)), *words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("r01,1,1.0", "r01,1,-1.0", ("line 2", "column initial_pressure", "pressure cannot be negative", "gauge")),
        ("0.41", "0", ("line 3", "column approach_speed", "positive")),
        ("0.41", "-0.4", ("line 3", "column approach_speed", "positive")),
        ("0.41", "", ("line 3", "column approach_speed", "empty")),
        ("r02,2", "r01,2", ("line 3", "column record", "'r01' already has a row on line 2")),
        ("r02,2", "r02,1.5", ("line 3", "column sequence", "whole number")),
        ("r02,2", "r02,0", ("line 3", "column sequence", "whole number")),
        ("r02,2,1.5,0.41\n", "r02,2,1.5,0.41\nr03,3,1,1\n", ("line 4", "'r03' has no samples")),
        (RECORDS, "", ("records.csv", "empty")),
    ],
)  # fmt: skip
def test_records(tmp_path, old, new, words):
    assert old in RECORDS
    refused(write_small(tmp_path / "c", records=RECORDS.replace(old, new, 1)), *words)


def change(path, value):
    """A descriptor with one entry changed, or dropped where the value is None."""
    tree = descriptor()
    *way, last = path
    here = tree
    for part in way:
        here = here[part]
    if value is None:
        del here[last]
    else:
        here[last] = value
    return tree


SAMPLE_FIELDS = ("resources", 1, "schema", "fields")
RECORD_FIELDS = ("resources", 0, "schema", "fields")


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("family",), "crash", ("family must be impact, slip", "'crash'")),
        (("family",), "tumbling", ("did you mean tumble",)),
        (("family",), None, ("family is missing", "impact, slip, tumble or FILE.py:NAME")),
        (("resources",), [], ("resources",)),
        (("resources",), None, ("resources is missing",)),
        (("resources", 0), None, ("no resource named records",)),
        (("resources", 1), None, ("samples or peaks",)),
        (("resources", 0, "name"), "samples", ("two resources named 'samples'",)),
        (("resources", 1, "schema"), None, ("resources[2] (samples).schema is missing",)),
        (("resources", 1, "schema"), "schema.json", ("resources[2] (samples).schema",)),
        (("resources", 1, "path"), "../samples.csv", ("'../samples.csv'", "leaves the campaign's folder")),
        (("resources", 1, "path"), "/etc/hostname", ("leaves the campaign's folder",)),
        (("resources", 1, "path"), "https://example.org/s.csv", ("not a plain relative path",)),
        (("resources", 1, "path"), "a\\b.csv", ("not a plain relative path",)),
        (("resources", 1, "path"), "gone.csv", ("gone.csv", "does not exist")),
        (("resources", 1, "path"), ".", ("folder",)),
        (("resources", 1, "encoding"), "latin-1", ("latin-1", "UTF-8")),
        (("resources", 1, "dialect"), {"header": False}, ("dialect.header",)),
        (("resources", 1, "dialect"), {"delimiter": "ab"}, ("dialect.delimiter",)),
        ((*SAMPLE_FIELDS, 0), None, ("no field record",)),
        ((*SAMPLE_FIELDS, 2, "unit"), None, ("column normal_force", "no unit", '"unit": "N"')),
        ((*SAMPLE_FIELDS, 2, "unit"), "Nwt", ("column normal_force", "unit 'Nwt' is unknown")),
        ((*SAMPLE_FIELDS, 2, "unit"), "kg", ("column normal_force", "'kg' does not measure normal_force", "(N)")),
        ((*SAMPLE_FIELDS, 1, "unit"), "m", ("column time", "'m' does not measure time")),
        ((*SAMPLE_FIELDS, 2, "type"), "string", ("column normal_force", '"type": "number"')),
        ((*SAMPLE_FIELDS, 2, "uncertainty"), "-0.25 N", ("column normal_force", "must be positive")),
        ((*SAMPLE_FIELDS, 2, "uncertainty"), "0 %", ("column normal_force", "must be positive")),
        ((*SAMPLE_FIELDS, 2, "uncertainty"), 0.25, ("column normal_force", "needs a unit")),
        ((*SAMPLE_FIELDS, 2, "uncertainty"), "0.25 mm", ("column normal_force", "'mm' does not measure")),
        ((*SAMPLE_FIELDS, 2, "reference"), "gauge", ("column normal_force", "only a pressure")),
        ((*RECORD_FIELDS, 2, "reference"), "relative", ("initial_pressure", "gauge")),
        ((*RECORD_FIELDS, 2, "unit"), "barg", ("column initial_pressure", '"reference": "gauge"')),
        ((*RECORD_FIELDS, 2, "assumed"), "yes", ("assumed",)),
        ((*RECORD_FIELDS, 3), None, ("column approach_speed", "need this condition")),
        (("resources", 0, "schema", "primaryKey"), "sequence", ("primaryKey",)),
        (("resources", 1, "schema", "foreignKeys", 0, "fields"), "time", ("foreign key",)),
        (("known", "outer_diameter"), "60", ("key known.outer_diameter", "needs a unit")),
        (("known", "outer_diameter"), "-60 mm", ("key known.outer_diameter", "positive")),
        (("known", "outer_diameter"), "60 kg", ("key known.outer_diameter", "does not measure")),
        (("known", "outer_diameter"), True, ("known.outer_diameter",)),
        (("known", "restitution"), 1.2, ("key known.restitution", "at most 1")),
    ],
)  # fmt: skip
def test_descriptor(tmp_path, path, value, words):
    refused(write_small(tmp_path / "c", change(path, value)), "datapackage.json" if path[-1] != "path" else "", *words)


def test_a_column_of_the_table_needs_a_field(tmp_path):
    tree = descriptor()
    tree["resources"][0]["schema"]["fields"].pop(1)
    refused(write_small(tmp_path / "c", tree), "records.csv", "column sequence", "not described")


@pytest.mark.parametrize(("i", "word"), [(1, "needs the column time"), (2, "needs at least one of normal_force")])
def test_samples_need_time_and_a_channel(tmp_path, i, word):
    tree = descriptor()
    tree["resources"][1]["schema"]["fields"].pop(i)
    samples = "\n".join(",".join(row.split(",")[:i] + row.split(",")[i + 1 :]) for row in SAMPLES.splitlines())
    refused(write_small(tmp_path / "c", tree, samples=samples), "datapackage.json", word)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", ("empty",)),
        ("[]", ("JSON object",)),
        ('{"family": "impact",\n "known": {', ("line 2", "character", "cut off")),
        ('{"family": impact}', ("line 1", "character 12", "not valid JSON")),
        ('{"family": "impact", "family": "slip"}', ("'family' occurs twice",)),
        ('{"known": {"x": NaN}}', ("NaN",)),
        ("[" * 100_000, ("deep",)),
        ('{"known": {"x": ' + "9" * 5000 + "}}", ("descriptor",)),
        ("\0", ("NUL",)),
    ],
)
def test_json(tmp_path, text, words):
    folder = write_small(tmp_path / "c")
    (folder / "datapackage.json").write_text(text)
    refused(folder, "datapackage.json", *words)


def test_paths(tmp_path):
    folder = write_small(tmp_path / "c")
    refused(tmp_path / "none", "no such campaign folder")
    refused(tmp_path, "no datapackage.json")
    refused(folder / "records.csv", "is a file", "folder")
    refused("a\0b", "path")
    (folder / "samples.csv").unlink()
    refused(folder, "samples.csv", "does not exist")
    outside = tmp_path / "outside.csv"
    outside.write_text(SAMPLES)
    (folder / "samples.csv").symlink_to(outside)
    refused(folder, "link out of the folder")


def test_bytes_that_are_no_text(tmp_path):
    folder = write_small(tmp_path / "c")
    (folder / "samples.csv").write_bytes(SAMPLES.encode().replace(b"r01,0.0", b"r\xfc1,0.0"))
    refused(folder, "samples.csv", "line 4", "0xfc", "UTF-8")
    (folder / "samples.csv").write_bytes(SAMPLES.encode().replace(b"r01,0.0", b"r\x001,0.0"))
    refused(folder, "samples.csv", "line 4", "NUL")


FUZZ = settings(deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
FILES = ("datapackage.json", "records.csv", "samples.csv")
TEXTS = {"datapackage.json": json.dumps(descriptor()), "records.csv": RECORDS, "samples.csv": SAMPLES}
PIECES = [b'"', b",", b";", b"\n", b"\r", b"-", b"nan", b"1e999", b"\xff", b"\0", b"{", b"}", b"null", b"[", b"9", b" ",
          b"\\u", b"0x1", "µ".encode(), b"\\ud800", b"..", b"/", b"r02", b"MPa", b"%"]  # fmt: skip


EDITS = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 12), st.one_of(st.sampled_from(PIECES), st.binary(max_size=3))),
    min_size=1,
    max_size=4,
)


def damage(data, edits):
    """Bytes with pieces replaced by others."""
    for place, length, piece in edits:
        start = int(place * len(data))
        data = data[:start] + piece + data[start + length :]
    return data


@settings(FUZZ, max_examples=250)
@given(name=st.sampled_from(FILES), edits=EDITS)
def test_damage_is_read_or_refused(tmp_path, name, edits):
    folder = write_small(tmp_path / "c")
    (folder / name).write_bytes(damage(TEXTS[name].encode(), edits))
    try:
        campaign = read_campaign(folder)
    except InputError as error:
        assert str(error).isprintable()
    else:
        assert len(campaign.records) and repr(campaign)


TRACE = raw_trace(length=0.03, rate=4e3)
RAW = [raw_text(TRACE, ["t [s]", "Fz [N]"], preamble="Bench;3\n", delimiter=sign) for sign in ";,\t"]


@settings(FUZZ, max_examples=100)
@given(text=st.sampled_from(RAW), edits=EDITS, head=st.booleans())
def test_damaged_raw_files_are_imported_or_refused(tmp_path, text, edits, head):
    edits = [(place * 0.05 if head else place, length, piece) for place, length, piece in edits]
    (tmp_path / "a.csv").write_bytes(damage(text.encode(), edits))
    try:
        campaign = import_tests(tmp_path / "a.csv", pressure="1 MPa", speed="0.4 m/s")
        assert format_campaign(campaign)["samples.csv"].count("\n") > 5
    except InputError as error:
        assert str(error).isprintable()


def test_contacts_that_pull_are_refused(tmp_path):
    """A column whose sign is that of the plate's; of some records alone it is a fault that is looked for later."""
    lines = SAMPLES.strip().splitlines()
    place = lines[0].split(",").index("normal_force")

    def turn(line):
        cells = line.split(",")
        return ",".join(f"-{cell}" if k == place and float(cell) > 0 else cell for k, cell in enumerate(cells))

    turned = "\n".join([lines[0], *map(turn, lines[1:])]) + "\n"
    refused(write_small(tmp_path / "c", samples=turned), "column normal_force", "reverse the sign")
    one = "\n".join([lines[0], *(turn(line) if line.startswith("r01") else line for line in lines[1:])]) + "\n"
    assert read_campaign(write_small(tmp_path / "one", samples=one)).samples["normal_force"].min() < 0
