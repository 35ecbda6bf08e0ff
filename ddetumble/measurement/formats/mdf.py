"""ASAM MDF: channel groups, each with a clock of its own."""

import gc
import sys
from pathlib import Path

import numpy as np

from ..._errors import InputError
from ..._settings import refuse_memory
from .channel import Channel, make_channels


TIME = 1  # synchronisation type of the standard


def read_mdf(path: Path) -> list[Channel]:
    """Channels of all channel groups, converted as the file says; samples that it marks as invalid are left out."""
    with _open(path) as file:
        refuse_memory(16.0 * sum(group.channel_group.cycles_nr * len(group.channels) for group in file.groups),
                      f"reading {path}")
        found = []
        for i, group in enumerate(file.groups):
            about = group.channel_group
            label = getattr(about, "acq_name", "") or about.comment or f"channel group {i + 1}"
            master = file.masters_db.get(i)
            over_time = master is not None and getattr(group.channels[master], "sync_type", TIME) == TIME
            for j in range(len(group.channels)):
                if j == master:
                    continue
                signal = file.get(group=i, index=j)
                if over_time:
                    found += make_channels(signal.name, signal.samples, signal.unit, label, signal.timestamps)
                else:
                    found.append(Channel(signal.name, np.empty(0), signal.unit, label, signal.timestamps,
                                         "it was not measured over time; export it with a clock"))
    return found


def _open(path: Path):
    """A file open for reading; of one that is damaged asammdf leaves an object that also fails when it is removed."""
    import asammdf

    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        return asammdf.MDF(path)
    except Exception as error:
        problem = f"the file is damaged or is no MDF file ({type(error).__name__}: {error}); export or copy it again"
    finally:
        gc.collect()
        sys.unraisablehook = hook
    raise InputError(problem, file=path)
