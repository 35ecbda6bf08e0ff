"""LabVIEW's TDMS: groups of channels with `unit_string` and the sampling of a waveform."""

import numbers
import struct
from pathlib import Path

import numpy as np

from ..._errors import InputError
from ..._settings import refuse_memory
from .channel import Channel, make_channels


TAG = b"TDSm"  # first bytes of every segment
LEAD_IN = struct.Struct("<4sIIQQ")  # tag, contents, version, length of the segment after this, and of its metadata


def read_tdms(path: Path) -> list[Channel]:
    """Channels of all groups; those with `wf_increment` have a clock, counted from the first start in their group.

    Numbers among the properties of a group, and of the file, are single values beside its channels.
    """
    import nptdms

    _check_start(path)
    with path.open("rb") as stream, nptdms.TdmsFile.open(stream) as file:
        if file.file_status.incomplete_final_segment:
            raise InputError("the file is cut off in its last segment; copy it again from the measuring computer")
        refuse_memory(16.0 * sum(len(one) for group in file.groups() for one in group.channels()), f"reading {path}")
        found = []
        for group in file.groups():
            starts = {one.name: one.properties["wf_start_time"] for one in group.channels()
                      if "wf_increment" in one.properties and "wf_start_time" in one.properties}
            for one in group.channels():
                clock = one.time_track() if one.properties.get("wf_increment", 0.0) > 0 else None
                if clock is not None and one.name in starts:
                    clock = clock + (starts[one.name] - min(starts.values())) / np.timedelta64(1, "ns") / 1e9
                unit = one.properties.get("unit_string")
                found += make_channels(one.name, one[:], unit if isinstance(unit, str) else None, group.name, clock)
            # Settings of a test, as LabVIEW programs write them; those of the file hold for all of its groups.
            for name, value in (dict(file.properties) | dict(group.properties)).items():
                if isinstance(value, numbers.Real) and not isinstance(value, bool):
                    found += make_channels(name, [float(value)], None, group.name)
    return found


def _check_start(path: Path):
    """Refuse a file that is no TDMS file, or ends within its first segment, of which the library says little."""
    with path.open("rb") as stream:
        head = stream.read(LEAD_IN.size)
    if not TAG.startswith(head[:len(TAG)]):
        raise InputError("this is no TDMS file, whatever its name says; choose another file, or export the measurement "
                         "again")
    if len(head) < LEAD_IN.size or path.stat().st_size < LEAD_IN.size + LEAD_IN.unpack(head)[3]:
        raise InputError("the file is cut off in its first segment; copy it again from the measuring computer")
