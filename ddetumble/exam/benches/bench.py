"""A test bench: how one family's campaigns are drawn, simulated, measured and written."""

import dataclasses as dc
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..hidden import Hidden


class HeldOut(NamedTuple):
    """A noise-free test at conditions that the campaign does not hold.

    Attributes:
        conditions: as `predict` wants them, SI.
        along: time or slip, shape (samples,), SI.
        readings: shape (samples, channels), SI.
    """

    conditions: Mapping[str, float]
    along: np.ndarray
    readings: np.ndarray


@dc.dataclass(frozen=True)
class Bench:
    """One family's bench; a setting is a plain dictionary, `base` in it the parameters of the reference model.

    Attributes:
        name: of the family.
        channels: that are measured and predicted, with the noise of each, SI.
        along: `time` or `slip`.
        catalogue: effects that the package lists, as the exam hides them.
        outside: effects that it lacks.
        draw_setting: base parameters and conditions, from a generator.
        make: a campaign with noise, from name, seed, effects, setting and noise (`rho`, `white_share`).
        write: the campaign's folder.
        traces: the campaign's readings as views, one a record, shape (samples, channels): faults act on them.
        prepare: for a setting and a seed, the function effects -> rms over noise that a refitted reference leaves.
        hold_out: noise-free tests elsewhere, from effects and setting.
        edition: of the way in which cases are drawn: another one asks other questions under the same seed.
    """

    name: str
    channels: Mapping[str, float]
    along: str
    catalogue: Mapping[str, Hidden]
    outside: Mapping[str, Hidden]
    draw_setting: Callable[[np.random.Generator], dict[str, Any]]
    make: Callable[[str, int, Mapping[str, Any], Mapping[str, Any], Mapping[str, float]], dict[str, Any]]
    write: Callable[[Path, dict[str, Any]], None]
    traces: Callable[[dict[str, Any]], list[np.ndarray]]
    prepare: Callable[[Mapping[str, Any], int], Callable[[Mapping[str, Any]], float]]
    hold_out: Callable[[Mapping[str, Any], Mapping[str, Any]], list[HeldOut]]
    edition: int = 1
