"""One writer a file format: each writes the same channels with the format's own library."""

import gc
import json
import warnings

import numpy as np
from helpers_measurement import pulse


STEP = 2.0**-9  # s: a whole number of nanoseconds and of binary digits, so that every format keeps it exactly
TIME = np.arange(512) * STEP


def trace(peak=50.0, seed=0):
    """Force of a slow impact [N] in steps that every format keeps exactly, shape of `TIME`."""
    noise = 0.2 * np.random.default_rng(seed).standard_normal(TIME.size)
    return np.round((pulse(TIME, 0.25, peak, 0.4) + 1.5 + noise) * 1024) / 1024


def channels(**more):
    """Time and force, each with its unit and values."""
    return {"t": ("s", TIME), "Fz": ("N", trace())} | more


def as_rows(held):
    """Headings with units, and rows of numbers; short columns end with None."""
    length = max(len(values) for _, values in held.values())
    columns = [[*np.asarray(values).tolist(), *[None] * (length - len(values))] for _, values in held.values()]
    headings = [f"{name} [{unit}]" if unit else name for name, (unit, _) in held.items()]
    return [headings, *map(list, zip(*columns, strict=True))]


def write_csv(path, held):
    rows = ([repr(cell) if isinstance(cell, float) else str(cell) for cell in row] for row in as_rows(held))
    path.write_text("\n".join(map(",".join, rows)) + "\n")
    return path


def write_sheets(path, sheets):
    """A workbook: rows of cells by name of the sheet, .xlsx or .ods."""
    if path.suffix == ".ods":
        return _write_open_document(path, sheets)
    import openpyxl

    book = openpyxl.Workbook()
    book.remove(book.active)
    for name, rows in sheets.items():
        sheet = book.create_sheet(name)
        for row in rows:
            sheet.append(row)
    book.save(path)
    return path


def _write_open_document(path, sheets):
    from odf.element import Element
    from odf.opendocument import OpenDocumentSpreadsheet
    from odf.table import Table, TableCell, TableRow
    from odf.text import P

    Element.namespaces.clear()  # odfpy writes those of every file that it has read, those of damaged ones too
    book = OpenDocumentSpreadsheet()
    for name, rows in sheets.items():
        table = Table(name=name)
        for row in rows:
            line = TableRow()
            for cell in row:
                number = isinstance(cell, int | float)
                kind = {"valuetype": "float", "value": repr(cell)} if number else {"valuetype": "string"}
                box = TableCell(**kind) if cell is not None else TableCell()
                if cell is not None:
                    box.addElement(P(text=f"{cell:.2f}" if number else cell))
                line.addElement(box)
            table.addElement(line)
        book.spreadsheet.addElement(table)
    book.save(str(path))
    return path


def write_sheet(path, held):
    return write_sheets(path, {"Data": as_rows(held)})


def write_matlab(path, held):
    from scipy.io import savemat

    units = {name: unit for name, (unit, _) in held.items() if unit}
    savemat(path, {name: np.asarray(values) for name, (_, values) in held.items()} | {"units": units})
    return path


def write_matlab_73(path, held):
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, (unit, values) in held.items():
            item = file.create_dataset(name, data=np.asarray(values)[None, :])
            item.attrs["MATLAB_class"] = np.bytes_("double")
            if unit:
                text = file.create_dataset(f"units/{name}", data=np.array([[ord(letter)] for letter in unit], "u2"))
                text.attrs["MATLAB_class"] = np.bytes_("char")
    return path


def write_hdf5(path, groups):
    """An HDF5 file of groups of channels; channels alone make the group `shot`."""
    import h5py

    groups = groups if isinstance(next(iter(groups.values())), dict) else {"shot": groups}
    with h5py.File(path, "w") as file:
        for group, held in groups.items():
            for name, (unit, values) in held.items():
                item = file.create_dataset(f"{group}/{name}", data=values)
                if unit:
                    item.attrs["units"] = unit
    return path


def write_nexus(path, held):
    """A NeXus file with a log, which has its own clock, for every channel; `held` as of `write_clocked`."""
    import h5py

    with h5py.File(path, "w") as file:
        for name, (unit, step, values) in held.items():
            log = file.create_group(f"entry/{name}")
            log.attrs["NX_class"] = "NXlog"
            log["value"], log["time"] = values, np.arange(len(values)) * step * 1e3
            log["time"].attrs["units"] = "ms"
            if unit:
                log["value"].attrs["units"] = unit
    return path


def write_parquet(path, held):
    import pyarrow as pa
    from pyarrow import parquet

    fields = [pa.field(name, pa.array(values).type, metadata={"units": unit} if unit else None)
              for name, (unit, values) in held.items()]
    parquet.write_table(pa.table([pa.array(values) for _, values in held.values()], schema=pa.schema(fields)), path)
    return path


def write_tdms(path, groups, properties=None):
    """A TDMS file of groups of channels (unit, values), or (unit, step, values) with a clock, and the `properties` of
    groups, those of the file under ''.
    """
    from nptdms import ChannelObject, GroupObject, RootObject, TdmsWriter

    groups = groups if isinstance(next(iter(groups.values())), dict) else {"Bench": groups}
    with TdmsWriter(str(path)) as writer:
        for group, held in groups.items():
            about = properties or {}
            objects = [RootObject(about[""])] if "" in about else []
            objects += [GroupObject(group, properties=about[group])] if group in about else []
            for name, (unit, *step, values) in held.items():
                about = {"unit_string": unit} if unit else {}
                about |= {"wf_increment": step[0], "wf_start_offset": 0.0, "wf_samples": len(values)} if step else {}
                objects.append(ChannelObject(group, name, np.asarray(values), properties=about))
            writer.write_segment(objects)
    return path


def write_mdf(path, held):
    """An MDF file: channels (unit, step, values), one channel group each."""
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        for name, (unit, step, values) in held.items():
            times, values = np.arange(len(values)) * step, np.asarray(values)
            more = {"encoding": "utf-8"} if values.dtype.kind == "S" else {}
            file.append([Signal(values, times, name=name, unit=unit or "", **more)], comment=f"group of {name}")
        file.save(path, overwrite=True)
    return path


def write_universal(path, held):
    """A universal file: channels (unit, step, values) as binary functions of time."""
    import pyuff

    path.unlink(missing_ok=True)
    sets = [pyuff.prepare_58(
        binary=1, func_type=1, rsp_node=1, rsp_dir=3, ref_node=0, ref_dir=0, data=np.asarray(values), id1=name,
        x=np.arange(len(values)) * step, rsp_ent_name="cell", ord_data_type=4, num_pts=len(values), abscissa_spacing=0,
        abscissa_min=0.0, abscissa_inc=0.0, abscissa_spec_data_type=17, ordinate_spec_data_type=13,
        orddenom_spec_data_type=0, z_axis_spec_data_type=0,
        abscissa_axis_units_lab="s", ordinate_axis_units_lab=unit or "NONE")
        for name, (unit, step, values) in held.items()]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the writer leaves files open
        pyuff.UFF(str(path)).write_sets(sets, mode="add")  # to overwrite binary functions it loses their heads
        gc.collect()
    return path


def write_mcap(path, held):
    """An MCAP file: channels (unit, step, values) as JSON messages {name: value}, one topic each."""
    from mcap.writer import Writer

    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for name, (_, step, values) in held.items():
            schema = writer.register_schema(name, "jsonschema", b"{}")
            channel = writer.register_channel(f"/{name}", "json", schema)
            for i, value in enumerate(np.asarray(values).tolist()):
                time = 10**18 + round(i * step * 1e9)
                writer.add_message(channel, time, json.dumps({name: value}).encode(), time)
        writer.finish()
    return path


def write_bag(path, held, storage="SQLITE3"):
    """A rosbag2: channels (unit, step, values) as stamped wrenches, with the values as force along z."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.LATEST)
    make = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    with Writer(path, version=9, storage_plugin=StoragePlugin[storage]) as writer:
        for name, (_, step, values) in held.items():
            stamped = make["WrenchStamped"]
            link = writer.add_connection(f"/{name}", stamped.__msgtype__, typestore=store)
            for i, value in enumerate(np.asarray(values).tolist()):
                stamp = round(i * step * 1e9)
                header = make["Header"](make["Time"](1000 + stamp // 10**9, stamp % 10**9), "gauge")
                wrench = make["Wrench"](make["Vector3"](0.0, 0.0, value), make["Vector3"](0.0, 0.0, 0.0))
                late = 10**15 + stamp + 1000 * (i % 7)  # recorded with a delay that varies
                writer.write(link, late, store.serialize_cdr(stamped(header, wrench), stamped.__msgtype__))
    return path


def clocked(**more):
    """The force with its clock: unit, step and values."""
    return {"Fz": ("N", STEP, trace())} | more


# Writer of every format by the name of a file, and the channels that it takes.
FORMATS = {
    "run.xlsx": (write_sheet, channels), "run.ods": (write_sheet, channels), "run.mat": (write_matlab, channels),
    "run73.mat": (write_matlab_73, channels), "run.h5": (write_hdf5, channels), "run.nxs": (write_nexus, clocked),
    "run.parquet": (write_parquet, channels), "run.tdms": (write_tdms, clocked), "run.mf4": (write_mdf, clocked),
    "run.uff": (write_universal, clocked), "run.mcap": (write_mcap, clocked), "bag": (write_bag, clocked),
}
# What the importer has to be told: the settings of all tests and, of formats without units, the force and its unit.
CONDITIONS = {"pressure": "1.0 MPa", "speed": "0.4 m/s"}
UNITLESS = {"run.mcap": {"units": "force=N"}, "bag": {"units": "force=N", "force": "wrench.force.z"}}
