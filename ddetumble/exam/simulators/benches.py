"""Benches whose noise and settings are not as stated: what each does to a campaign, and how much of it."""

import dataclasses as dc
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.signal import cont2discrete, lfilter

from .campaigns import Campaign, Record


FINE = 8  # places between two samples at which a gauge on a spring follows the force
MAINS = (50.0, 60.0)  # Hz
STEEPEST = 4.0  # stated deviations: rms of what jitter of the sampling instants may make at most


@dc.dataclass
class Draft:
    """What a bench does to one record: nothing, until a kind has written in it what it does."""

    written: dict[str, Any]  # conditions
    shift: float  # of its clock, s
    stray: np.ndarray  # of the places at which it is really read
    gain: np.ndarray  # of the gauge, by channel
    floor: np.ndarray  # of the noise by channel, in stated deviations
    share: np.ndarray  # of the reading that is added to it in square, by channel
    loudness: np.ndarray  # factor of the noise, by sample and channel
    added: np.ndarray  # to the readings, by sample and channel
    step: np.ndarray  # of the gauge's digits by channel, 0 for none
    mount: tuple[float, float] | None = None  # natural frequency [Hz] and damping ratio of the gauge on its spring


def begin_draft(campaign: Campaign, record: Record) -> Draft:
    """A draft that leaves the record as it is."""
    count, width = len(record.values), len(campaign.noise)
    return Draft(dict(record.written), record.shift, np.zeros(count), np.ones(width), np.ones(width), np.zeros(width),
                 np.ones((count, width)), np.zeros((count, width)), np.zeros(width))


def perturb(campaign: Campaign, generators: Mapping[str, np.random.Generator]
            ) -> tuple[Campaign, dict[str, dict[str, Any]]]:
    """The campaign as such a bench would have measured it, and what was drawn of every kind.

    generators: random numbers of each kind, by its name in `BENCHES`. True conditions, and the shocks from which noise
    is made, stay those of the campaign; channels of `Campaign.white` (the attitude) change with their instants only.
    """
    drafts = [begin_draft(campaign, record) for record in campaign.records]
    done = {kind: BENCHES[kind](campaign, drafts, generators[kind]) for kind in BENCHES if kind in generators}
    records = [measure(campaign, *pair) for pair in zip(campaign.records, drafts, strict=True)]
    return dc.replace(campaign, records=records), done


def measure(campaign: Campaign, record: Record, draft: Draft) -> Record:
    """The record that comes of a draft."""
    width, deviations = len(campaign.noise), list_deviations(campaign)
    places = record.places + draft.stray
    clean = record.clean.copy()
    if draft.stray.any() or draft.shift != record.shift:
        clean = campaign.read(record.true, places - draft.shift)
    if draft.mount is not None:
        fine = np.linspace(places[0], places[-1], FINE * (places.size - 1) + 1)
        force = campaign.read(record.true, fine - draft.shift)[:, :width]
        clean[:, :width] = CubicSpline(fine, ring(fine, force, *draft.mount))(places)
    clean[:, :width] *= draft.gain
    noise = record.values - record.clean
    noise[:, :width] *= np.hypot(draft.floor, draft.share * np.abs(clean[:, :width]) / deviations) * draft.loudness
    values = clean + noise
    readings = values[:, :width] + draft.added
    steps = np.where(draft.step > 0.0, draft.step, 1.0)
    values[:, :width] = np.where(draft.step > 0.0, steps * np.round(readings / steps), readings)
    return dc.replace(record, written=draft.written, shift=draft.shift, values=values, clean=clean)


def list_deviations(campaign: Campaign) -> np.ndarray:
    """Stated standard deviations of the channels that a bench disturbs, SI."""
    return np.array(list(campaign.noise.values()))


def list_settings(campaign: Campaign) -> list[str]:
    """Conditions with a stated uncertainty."""
    return [name for name in campaign.uncertainties if name in campaign.conditions]


def find_times(record: Record) -> np.ndarray:
    """Times (s) of a record's samples; of one over slip, slip over speed."""
    return record.along["time"] if "time" in record.along else record.places / record.true["slip_speed"]


def ring(times: np.ndarray, force: np.ndarray, frequency: float, damping: float) -> np.ndarray:
    """Readings of a mass on a spring: x'' + 2 zeta w x' + w^2 x = w^2 F, at rest under the first force.

    times: s, evenly spaced; force: shape (samples, channels), straight between samples; w = 2 pi frequency (Hz).
    """
    w = 2.0 * np.pi * frequency
    law = [w**2], [1.0, 2.0 * damping * w, w**2]
    found: Any = cont2discrete(law, times[1] - times[0], method="foh")
    top, bottom, _ = found
    return force[0] + lfilter(np.ravel(top), bottom, force - force[0], axis=0)


def make_proportional(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """Noise of 0.4 times what is stated, and a share of the reading: together 3 to 10 times as much at the largest."""
    floor, ratio = 0.4, float(generator.uniform(3.0, 10.0))
    width, deviations = len(campaign.noise), list_deviations(campaign)
    largest = np.max([np.nanmax(np.abs(record.clean[:, :width]), axis=0) for record in campaign.records], axis=0)
    share = floor * deviations * np.sqrt(ratio**2 - 1.0) / largest
    for draft in drafts:
        draft.floor, draft.share = draft.floor * floor, share
    return {"floor": floor, "ratio": ratio, "share": share.tolist()}


def make_bursts(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """Noise 2 to 4 times as large during 10 to 40 % of every trace, at a place of each record's own."""
    factor, part = float(generator.uniform(2.0, 4.0)), float(generator.uniform(0.1, 0.4))
    firsts = []
    for draft in drafts:
        count = len(draft.loudness)
        length = max(round(part * count), 1)
        first = int(generator.integers(count - length + 1))
        draft.loudness[first : first + length] *= factor
        firsts.append(first)
    return {"factor": factor, "part": part, "first": firsts}


def make_uneven(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """Noise of every record by a factor of its own: log-normal, one standard deviation being a factor of 2."""
    factors = 2.0 ** generator.standard_normal(len(drafts))
    for draft, factor in zip(drafts, factors, strict=True):
        draft.loudness *= factor
    return {"factors": factors.tolist()}


def make_tails(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """Student noise of three degrees of freedom with the stated standard deviation: normal noise over sqrt(chi2_3)."""
    freedom = 3
    for draft in drafts:
        draft.loudness *= np.sqrt((freedom - 2.0) / generator.chisquare(freedom, draft.loudness.shape))
    return {"freedom": freedom}


def make_coarse(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """A gauge whose digits are 2 to 4 stated standard deviations apart."""
    steps = float(generator.uniform(2.0, 4.0)) * list_deviations(campaign)
    for draft in drafts:
        draft.step = steps
    return {"steps": steps.tolist()}


def make_wander(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """A baseline that walks at random from zero; its expected square over a record is that of 1 to 3 deviations."""
    rms = float(generator.uniform(1.0, 3.0))
    for draft in drafts:
        count = len(draft.added)
        # The mean over i of the variance i s^2 is s^2 (count + 1)/2.
        steps = rms * np.sqrt(2.0 / (count + 1.0)) * list_deviations(campaign)
        draft.added += np.cumsum(steps * generator.standard_normal(draft.added.shape), axis=0)
    return {"rms": rms}


def make_hum(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """A sine of 1 to 3 stated deviations at 50 or 60 Hz, in a phase of each record's own.

    Where samples are too far apart to show that, a vibration at 0.1 to 0.35 of their rate.
    """
    amplitude, share = float(generator.uniform(1.0, 3.0)), float(generator.uniform(0.1, 0.35))
    frequency = float(generator.choice(MAINS))
    slowest = max(float(np.diff(find_times(record)).max()) for record in campaign.records)
    if frequency * slowest > 0.4:
        frequency = share / slowest
    for record, draft in zip(campaign.records, drafts, strict=True):
        phases = generator.uniform(0.0, 2.0 * np.pi, len(campaign.noise))
        turns = 2.0 * np.pi * frequency * find_times(record)[:, None] + phases
        draft.added += amplitude * list_deviations(campaign) * np.sin(turns)
    return {"frequency": frequency, "amplitude": amplitude}


def make_ringing(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """A gauge that is a mass on a spring: 80 to 300 Hz, damping ratio 0.03 to 0.2; see `ring`."""
    frequency, damping = (float(np.exp(generator.uniform(*np.log(pair)))) for pair in ((80.0, 300.0), (0.03, 0.2)))
    for draft in drafts:
        draft.mount = frequency, damping
    return {"frequency": frequency, "damping": damping}


def loosen_settings(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """Settings that lie 3 to 6 times as far as stated from what is written down."""
    factor = float(generator.uniform(3.0, 6.0))
    for record, draft in zip(campaign.records, drafts, strict=True):
        for name in list_settings(campaign):
            draft.written[name] = record.true[name] + factor * (record.written[name] - record.true[name])
    return {"factor": factor}


def loosen_trigger(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """A trigger that scatters 4 to 10 times as much as is stated."""
    factor = float(generator.uniform(4.0, 10.0))
    for draft in drafts:
        draft.shift *= factor
    return {"factor": factor}


def bias_setting(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """One setting that is written 1 to 4 % too high in all records, or too low."""
    name = str(generator.choice(list_settings(campaign)))
    return {"of": name, "factor": multiply(campaign, drafts, name, draw_bias(generator, 0.01, 0.04))}


def bias_gauge(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """One gauge, of a force or of the load, that reads 1 to 3 % high throughout, or low."""
    gauges = [*campaign.noise, *(name for name in list_settings(campaign) if name.endswith("load"))]
    name = str(generator.choice(gauges))
    return {"of": name, "factor": multiply(campaign, drafts, name, draw_bias(generator, 0.01, 0.03))}


def draw_bias(generator: np.random.Generator, low: float, high: float) -> float:
    """A factor that is off one by a share between two limits, up or down."""
    return 1.0 + float(generator.choice([-1.0, 1.0]) * generator.uniform(low, high))


def multiply(campaign: Campaign, drafts: Sequence[Draft], name: str, factor: float) -> float:
    """Let a channel, or a condition as it is written, be so many times as large in all records; returns the factor."""
    for draft in drafts:
        if name in campaign.noise:
            draft.gain[list(campaign.noise).index(name)] *= factor
        else:
            draft.written[name] *= factor
    return factor


def blur_instants(campaign: Campaign, drafts: Sequence[Draft], generator: np.random.Generator) -> dict[str, Any]:
    """Sampling instants that lie off those written by 5 to 15 % of their interval (rms, evenly spread).

    Less where that would leave more than four times the stated noise (bodies that turn far between two samples).
    """
    share, width = float(generator.uniform(0.05, 0.15)), len(campaign.noise)
    slopes = [np.gradient(record.clean[:, :width] / list_deviations(campaign), axis=0) for record in campaign.records]
    steepest = float(np.sqrt(np.max(np.nanmean(np.square(np.concatenate(slopes)), axis=0))))  # deviations a sample
    share = min(share, STEEPEST / steepest)
    for record, draft in zip(campaign.records, drafts, strict=True):
        places = record.places
        stray = np.sqrt(3.0) * share * generator.uniform(-1.0, 1.0, places.size) * np.gradient(places)
        draft.stray = np.clip(places + stray, places[0], places[-1]) - places  # a path has no place before its start
    return {"share": share}


# New kinds come last: a kind's place here is part of the seed of what is drawn of it.
BENCHES: dict[str, Callable[[Campaign, Sequence[Draft], np.random.Generator], dict[str, Any]]] = {
    "proportional": make_proportional, "bursts": make_bursts, "uneven-records": make_uneven, "tails": make_tails,
    "coarse": make_coarse, "wander": make_wander, "hum": make_hum, "ringing": make_ringing,
    "loose-settings": loosen_settings, "jitter": loosen_trigger, "biased-setting": bias_setting,
    "biased-gauge": bias_gauge, "time-stamps": blur_instants,
}  # fmt: skip
