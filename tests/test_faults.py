"""Faults of the data, put in by `tests.independent.faults`: found, said, and not mistaken for physics."""

import dataclasses as dc

import numpy as np
import pandas as pd
import pytest

import ddetumble as dd
from ddetumble import InputError
from ddetumble._settings import find_data
from ddetumble.cli import main
from ddetumble.exam.cases import Exam, sample_case, write_case
from ddetumble.exam.simulators.campaigns import write_package
from ddetumble.exam.simulators.impact_campaigns import make_campaign
from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.exam.simulators.slip_campaigns import make_slip_campaign
from ddetumble.exam.simulators.tumbling_campaigns import make_tumble_campaign
from ddetumble.inference.estimation import fit
from ddetumble.inference.noise_estimation import estimate_from_pairs, estimate_noise, measure_deviation
from ddetumble.measurement.campaign import Campaign, Column, Uncertainty
from ddetumble.measurement.faults import find_runs, find_spikes, find_truncated, screen_samples
from ddetumble.measurement.package import read_campaign
from ddetumble.selection.data_errors import AMBIENT
from ddetumble.selection.discover import discover
from ddetumble.selection.missing.missing_force import draw_missing_force
from ddetumble.selection.outliers import begin_cleaning
from ddetumble.selection.restatements import add_atmosphere, list_restatements
from tests.independent import faults


BALL = {"effective_mass": 1.37, "restitution": 0.73}
RUBBER = {"adhesion_constant": 0.874, "loss_factor": 0.163, "tensile_strength": 10e6, "real_contact_pressure": 20e6,
          "slip_scale": 1.0}
EFFECT = {"impact": {"wall-stiffness": {"k_w": 1100.0, "q": 1.0}}, "slip": {"viscous-friction": {"c_t": 0.9}},
          "tumble": {"eddy-current": {"k_e": 2e-6}}}
CHANNEL = {"impact": "normal_force", "slip": "tangential_force", "tumble": "angular_velocity_x"}
NOISE = {"impact": 0.25, "slip": 0.04, "tumble": 2e-5}
FAMILIES = tuple(CHANNEL)
RATES = tuple(f"angular_velocity_{axis}" for axis in "xyz")
SHIPPED = sorted(p.name for p in find_data().glob("*-?") if p.name != "README")


def write(folder, family, effects, *, repeats=2):
    """A campaign of a family by the independent simulator."""
    if family == "impact":
        write_package(folder, make_campaign("f", 21, effects, BALL, [0.5e6, 1.1e6, 2.2e6], [0.16, 0.38, 0.66],
                                                    repeats, interval=4e-4))
    elif family == "slip":
        write_package(folder, make_slip_campaign("f", 22, effects, RUBBER, [6.0, 13.0, 25.0], [0.8e6, 1.9e6],
                                                     [0.02, 0.1, 0.4], 1))
    else:
        write_package(folder, make_tumble_campaign("f", 23, effects, {"inertia_ratio": 0.53}, 5))
    return folder


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    """Folders of campaigns in which nothing is missing, by family."""
    base = tmp_path_factory.mktemp("clean")
    return {family: write(base / family, family, {}) for family in FAMILIES}


@pytest.mark.parametrize(("share", "rising"), [(0.6, True), (0.9, False), (0.15, False)])
def test_records_cut_in_mid_contact_are_found(clean, share, rising):
    """Those that were cut, at a share of the peak on the way up or down, and no others; nothing is left out."""
    campaign = read_campaign(clean["impact"])
    assert campaign.samples is not None and not find_truncated(campaign)
    samples, cut = campaign.samples, campaign.record_keys[1:9:3]
    kept = np.ones(len(samples), dtype=bool)
    for key in cut:
        rows = np.flatnonzero(samples["record"] == key)
        force = samples["normal_force"].to_numpy()[rows]
        above = np.flatnonzero(force > share * force.max())
        kept[rows[above[0] if rising else above[-1]:]] = False
    short = dc.replace(campaign, samples=samples[kept])
    cleaned, found = screen_samples(short)
    (fault,) = found
    assert (fault.kind, fault.records, fault.channel, fault.left_out) == ("truncated", cut, "normal_force", False)
    assert cleaned.samples is not None and cleaned.samples.equals(short.samples)


@pytest.mark.parametrize("name", SHIPPED)
def test_no_shipped_record_counts_as_cut(name):
    assert not find_truncated(read_campaign(find_data() / name))


@pytest.fixture(scope="module")
def grown(tmp_path_factory):
    """Folders of campaigns with one effect, by family."""
    base = tmp_path_factory.mktemp("grown")
    return {family: write(base / family, family, EFFECT[family]) for family in FAMILIES}


def spoil(folder, target, *acts):
    """A spoilt copy of a campaign."""
    spoiler = faults.Spoiler(folder, target)
    for act, *arguments in acts:
        act(spoiler, *arguments)
    return spoiler.save()


def middle(folder):
    """Key of a record in the middle of a campaign's conditions."""
    head, rows = faults.read_rows(folder / "records.csv")
    columns = [k for k, name in enumerate(head) if name not in ("record", "sequence")]
    if not columns:
        return rows[2][0]
    values = np.array([[float(row[k]) for k in columns] for row in rows])
    rank = np.argsort(np.argsort(values, axis=0), axis=0) - 0.5 * (len(rows) - 1)
    return rows[int(np.argmin(np.sum(rank**2, axis=1)))][0]


def readings(campaign, channel):
    """All samples of a channel."""
    assert campaign.samples is not None
    return campaign.samples[channel].to_numpy()


def kinds(found):
    """Kinds of faults, in order."""
    return [fault.kind for fault in found]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_campaigns_lose_no_sample(name):
    campaign = read_campaign(find_data() / name)
    cleaned, found = screen_samples(campaign)
    assert found == ()
    assert cleaned.samples is not None and cleaned.samples.equals(campaign.samples)


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_clipped_samples_are_told_by_hand(family, clean, tmp_path):
    """Each model that is compared, and a fit, says what screening sees, and takes the samples as they are."""
    channel = CHANNEL[family]
    ceiling = float(f"{0.75 * np.nanmax(readings(read_campaign(clean[family]), channel)):.3g}")
    campaign = read_campaign(spoil(clean[family], tmp_path / "c", (faults.clip, channel, ceiling)))
    (seen,) = screen_samples(campaign)[1]
    found, whole = dd.compare(campaign), dd.compare(read_campaign(clean[family]))
    assert [(f.kind, f.seen, f.left_out) for f in found.faults] == [("clipped", seen.seen, False)]
    assert whole.faults == () and found.channels["samples"].sum() == whole.channels["samples"].sum()
    assert str(found.faults[0]) in found.notes and str(found.faults[0]) in dd.fit(campaign).notes


@pytest.mark.slow
def test_a_record_that_its_settings_were_moved_for_is_the_first_to_look_at(clean, tmp_path):
    """In pounds its pressure is moved until it fits: its residual is not the largest, its chi-square is by far."""
    key = middle(clean["impact"])
    found = dd.compare(spoil(clean["impact"], tmp_path / "f", (faults.scale, ["normal_force"], key, 1 / 4.4482216)))
    table = found.records.set_index("record")
    assert table["chi2_reduced"].idxmax() == key and key in found.sentence


@pytest.mark.parametrize("family", FAMILIES)
def test_clipped_samples_are_left_out(family, clean, tmp_path):
    channel = CHANNEL[family]
    before = readings(read_campaign(clean[family]), channel)
    ceiling = float(f"{0.75 * np.nanmax(before):.3g}")
    folder = spoil(clean[family], tmp_path / "c", (faults.clip, channel, ceiling))
    cleaned, found = screen_samples(read_campaign(folder))
    assert kinds(found) == ["clipped"] and found[0].channel == channel
    left = readings(cleaned, channel)
    cut = np.abs(before) >= ceiling
    # Single samples may cross the limit far from where the signal does.
    assert np.isnan(left[cut]).mean() > 0.97
    kept = np.isfinite(left)
    assert np.allclose(left[kept], np.clip(before, -ceiling, ceiling)[kept])
    assert (~kept & (np.abs(before) < ceiling - 6 * NOISE[family])).sum() < 0.02 * before.size


def clip_tumbling(folder, limits):
    """A tumbling campaign whose gyroscopes end at a limit by axis."""
    campaign = read_campaign(folder)
    assert campaign.samples is not None
    samples = campaign.samples.copy()
    for rate, limit in zip(RATES, limits, strict=True):
        samples[rate] = samples[rate].clip(-limit, limit)
    return dc.replace(campaign, samples=samples)


def test_clipped_rates_of_a_slow_nutation():
    """Fewer than two turns have no close readings: the least step of such records is not the gauge's."""
    random, time = np.random.default_rng(5), np.arange(300.0)
    rows = []
    for key, turn, size in (("a", 165.3, 0.09), ("b", 171.7, 0.08), ("c", 29.37, 0.04)):
        phase = 2.0 * np.pi * time / turn
        x, y, z = size * np.cos(phase), size * np.sin(phase), np.full(300, 0.05)
        rates = np.stack([x, y, z], axis=1) + 2e-5 * random.standard_normal((300, 3))
        rows.append(pd.DataFrame(np.round(rates, 7), columns=RATES).assign(record=key, time=time))
    samples = pd.concat(rows, ignore_index=True)
    for rate in RATES[:2]:
        samples[rate] = samples[rate].clip(-0.07, 0.07)
    stated = {rate: Column(rate, "rad/s", Uncertainty(absolute=2e-5)) for rate in RATES}
    campaign = Campaign("turns", "", "tumble", None, {}, pd.DataFrame(index=pd.Index(list("abc"), name="record")), {},
                        Column("time", "s"), stated, samples)
    _, found = screen_samples(campaign)
    clipped = [f for f in found if f.kind == "clipped"]
    assert [(f.channel, f.records) for f in clipped] == [(rate, ("a", "b")) for rate in RATES[:2]]


def test_a_rate_beyond_the_range_throughout_loses_its_record(clean):
    """Free spin about the axis is constant: beyond the gauge's range nothing of it is left."""
    axial = read_campaign(clean["tumble"]).samples.groupby("record", sort=False)[RATES[2]].mean().abs()
    limit = float(axial.sort_values().iloc[-2:].mean())
    clipped = clip_tumbling(clean["tumble"], (1.0, 1.0, limit))
    state = begin_cleaning(clipped)
    assert [(f.kind, f.channel, f.records, f.left_out) for f in state.faults] == [
        ("clipped", RATES[2], (axial.idxmax(),), False), ("missing", RATES[2], (axial.idxmax(),), True)]
    assert set(state.campaign.record_keys) == set(axial.index) - {axial.idxmax()}
    assert begin_cleaning(clipped, keep_all=True).campaign is clipped
    blind = clip_tumbling(clean["tumble"], (1.0, 1.0, 0.5 * float(axial.min())))
    assert screen_samples(blind)[1][0].kind == "clipped"  # `fit` says so, and takes them as they are
    with pytest.raises(InputError, match="wider range"):
        begin_cleaning(blind)


@pytest.mark.parametrize("family", FAMILIES)
def test_spikes_are_left_out(family, clean, tmp_path):
    channel = CHANNEL[family]
    folder = spoil(clean[family], tmp_path / "s", (faults.add_spikes, channel, 20 * NOISE[family]))
    cleaned, found = screen_samples(read_campaign(folder))
    before = readings(read_campaign(clean[family]), channel)
    spoilt = readings(read_campaign(folder), channel)
    hit = ~np.isclose(before, spoilt, rtol=0, atol=5 * NOISE[family])
    lost = np.isnan(readings(cleaned, channel))
    assert kinds(found) == ["spike"]
    assert (lost & hit).sum() > 0.9 * hit.sum()  # the ends of a record have no neighbours on one side
    assert not (lost & ~hit).any()


@pytest.mark.parametrize("family", FAMILIES)
def test_a_gauge_that_stands_still_is_seen(family, clean, tmp_path):
    key = middle(clean[family])
    folder = spoil(clean[family], tmp_path / "h", (faults.hold, CHANNEL[family], key, 0.3, 0.4))
    _, found = screen_samples(read_campaign(folder))
    assert [(f.kind, f.records) for f in found] in ([("held", (key,))], [("clipped", (key,))])


def test_a_channel_with_a_clock_of_its_own_lacks_nothing_but_what_it_lost(clean):
    """Every third instant of the force, in contact only: missing are those alone that were lost."""
    campaign = read_campaign(clean["impact"])
    assert campaign.samples is not None
    samples = campaign.samples.copy()
    place = samples.groupby("record", sort=False).cumcount().to_numpy()
    kept = (place % 3 == 0) & (samples["time"] > 0.0).to_numpy() & (samples["time"] < 0.02).to_numpy()
    samples["pressure"] = np.where(kept, 1e6 + 1e3 * np.sin(place), np.nan)
    channel = dc.replace(campaign.channels["normal_force"], name="pressure", unit="Pa", uncertainty=None)
    slow = dc.replace(campaign, samples=samples, channels={**campaign.channels, "pressure": channel})
    assert "missing" not in kinds(screen_samples(slow)[1])
    inner = np.flatnonzero(kept & (samples["record"] == campaign.record_keys[2]).to_numpy())[5:9]
    samples.loc[samples.index[inner], "pressure"] = np.nan
    (fault,) = (f for f in screen_samples(dc.replace(slow, samples=samples))[1] if f.kind == "missing")
    assert (fault.channel, fault.records) == ("pressure", (campaign.record_keys[2],))


@pytest.mark.parametrize("family", FAMILIES)
def test_missing_and_uneven_samples_are_reported(family, clean, tmp_path):
    channel = CHANNEL[family]
    lost = read_campaign(spoil(clean[family], tmp_path / "m", (faults.lose_samples, channel, 0.08)))
    cleaned, found = screen_samples(lost)
    share = 100.0 * np.isnan(readings(lost, channel)).mean()
    assert kinds(found) == ["missing"]
    assert float(found[0].seen.split("%")[0].split()[-1]) == pytest.approx(share, abs=0.6)
    assert np.array_equal(readings(cleaned, channel), readings(lost, channel), equal_nan=True)
    _, found = screen_samples(read_campaign(spoil(clean[family], tmp_path / "u", (faults.thin, 0.3))))
    assert kinds(found) == ["uneven"]


def test_a_record_exported_twice_is_left_out(clean, tmp_path):
    keys = faults.Spoiler(clean["slip"], tmp_path / "x").order
    folder = spoil(clean["slip"], tmp_path / "c", (faults.copy_record, keys[3], keys[8]))
    cleaned, found = screen_samples(read_campaign(folder))
    assert kinds(found) == ["copied"] and set(found[0].records) == {keys[3], keys[8]}
    assert not {keys[3], keys[8]} & set(cleaned.record_keys)


def test_what_jumps_bends_or_is_coarsely_read_is_no_fault():
    generator = np.random.default_rng(5)
    time = np.arange(200) * 4e-4
    noise = 0.25 * generator.standard_normal(200)
    jump = np.where((time > 0.01) & (time < 0.05), 30.0, 0.0)
    bend = np.maximum(time - 0.03, 0.0) * 3e3 * (time < 0.06)
    for signal in (jump, bend, 80 * np.sin(np.pi * np.clip(time / 0.02, 0, 1)) ** 2):
        assert not find_spikes(time, signal + noise, 0.25).any()
    # A converter of eight bits gives runs of equal readings everywhere: how many is for the campaign to say.
    coarse = np.round((jump + noise) / 0.5) * 0.5
    chance = float(np.mean(np.diff(coarse) == 0))
    clipped, held, _ = find_runs(coarse, 0.25, chance, 200, 1e-9)
    assert not held.any() and not clipped.any()


def make_pulses(zeros, step, spikes, noise=0.5, end=0.4, stated=None):
    """Fifteen pulses at three speeds, read in steps of two deviations of their noise, each less a zero of its own."""
    generator, rows = np.random.default_rng(8), []
    for k in range(15):
        time = np.arange(-0.1, end, 0.01)
        force = 4.0 * (1 + k % 3) * np.sin(np.pi * np.clip(time / 0.25, 0.0, 1.0)) - 0.4 * (time > 0.25)
        read = step * np.round((force + noise * step * generator.standard_normal(len(time))) / step)
        read[[place for key, place in spikes if key == k]] += 2.0
        rows.append(pd.DataFrame({"record": f"r{k}", "time": time, "normal_force": read - zeros * generator.normal()}))
    records = pd.DataFrame({"record": [f"r{k}" for k in range(15)],
                            "approach_speed": [0.3 * (1 + k % 3) for k in range(15)]}).set_index("record")
    return Campaign(
        name="pulses", title="pulses", family="impact", path=None, known={}, records=records,
        conditions={"approach_speed": Column("approach_speed", "m/s")}, independent=Column("time", "s"),
        channels={"normal_force": Column("normal_force", "N", stated or Uncertainty(absolute=step, relative=0.05))},
        samples=pd.concat(rows, ignore_index=True))


@pytest.mark.parametrize("zeros", [0.0, 0.7])
def test_a_coarse_gauge_with_a_zero_taken_off_every_record_is_not_clipped(zeros):
    """Equal readings follow one another at rest and at the peak; what is cut off in earnest is still seen."""
    whole = make_pulses(zeros, 0.03, [])
    assert not screen_samples(whole)[1]
    force = whole.samples["normal_force"]
    cut = dc.replace(whole, samples=whole.samples.assign(normal_force=np.minimum(force, 3.0)))
    assert {fault.kind for fault in screen_samples(cut)[1]} == {"clipped"}


@pytest.mark.parametrize("stated", [1.0, 2.0])
@pytest.mark.parametrize("noise", [0.1, 0.25])
def test_what_a_coarse_gauge_reads_is_a_fault_only_where_neighbours_say_so(noise, stated):
    """Steps of four and ten deviations of the noise, which may be less than stated: readings at rest are equal for
    long; a limit flattens the largest peaks, whose flanks lead beyond it, and a force that is gone for a while leaps
    to nothing and back."""
    whole = make_pulses(0.0, 0.1, [], noise, 3.0, Uncertainty(absolute=0.1 * noise * stated))
    assert not screen_samples(whole)[1]
    force = whole.samples["normal_force"].to_numpy()
    silent = make_pulses(0.0, 0.1, [], 0.0, 3.0).samples["normal_force"]
    quiet = np.where(whole.samples["record"] == "r2", silent, force)
    assert not screen_samples(dc.replace(whole, samples=whole.samples.assign(normal_force=quiet)))[1]
    cut = dc.replace(whole, samples=whole.samples.assign(normal_force=np.minimum(force, 10.0)))
    assert [(f.kind, len(f.records)) for f in screen_samples(cut)[1]] == [("clipped", 5)]
    gone = force.copy()
    gone[310 * 4 + 18: 310 * 4 + 26] = 0.0
    cleaned, found = screen_samples(dc.replace(whole, samples=whole.samples.assign(normal_force=gone)))
    assert [(f.kind, f.records) for f in found] == [("held", ("r4",))]
    assert cleaned.samples["normal_force"].isna().sum() == 8


@pytest.mark.parametrize(("case", "clipped"), [(42, ("r02", "r03", "r10", "r11")), (32, ("r04", "r05", "r06", "r08")),
                                               (0, ()), (4, ())])
def test_a_level_that_strokes_share_is_the_limit_of_a_coarse_gauge(tmp_path, case, clipped):
    """Steps of three deviations of the noise, from the second simulator: friction levels off by itself, and reads the
    same for long in one record or another, but not the largest of all in several of them."""
    exam = Exam("slip", 117, ("nothing",), bench="coarse", edition=1)
    kept = write_case(exam, sample_case(exam, case), tmp_path)
    found = screen_samples(read_campaign(tmp_path))[1]
    told = [f.records for f in found if f.kind in ("clipped", "held")]
    assert told == [clipped] * bool(clipped)
    assert not clipped or kept["fault_details"]["records"] == len(clipped)


def test_a_coarse_gyroscope_at_its_limit_throughout_is_seen(tmp_path):
    """From the second simulator: what spins about z faster than the gyroscope reads stands at its limit throughout, and
    what precesses meets it twice a turn; what keeps its spin within the range reads the same for long, too."""
    exam = Exam("tumble", 904, ("nothing",), bench="drawn", edition=1)
    write_case(exam, sample_case(exam, 19), tmp_path)
    found = screen_samples(read_campaign(tmp_path))[1]
    assert {f.channel[-1]: f.records for f in found if f.kind in ("clipped", "held")} == {
        "x": ("r01", "r02"), "y": ("r01", "r02"), "z": ("r02", "r04", "r06")}


def test_spikes_at_one_time_in_repeats_are_the_experiments():
    """Five repeats with a reading that sticks out at one time, and two accidents elsewhere: these two are faults."""
    own, accidents = [(k, 22 + (k == 4)) for k in range(1, 15, 3)], [(3, 30), (8, 14)]
    cleaned, found = screen_samples(make_pulses(0.0, 0.03, own + accidents))
    assert [(f.kind, f.records) for f in found] == [("spike", ("r3", "r8"))]
    assert int(cleaned.samples["normal_force"].isna().sum()) == 2


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, -1)])
@pytest.mark.parametrize("places", [(40, 41), (40, 42), (40, 43), (1, 198), (60, 150)])
def test_spikes_near_each_other_and_near_the_ends(places, signs):
    """On a flank, whose steps are ten times the spikes' size: only the smoothness of the rest shows them."""
    generator = np.random.default_rng(7)
    time = 0.1 * np.arange(200)
    x = 200.0 * np.sin(time) + 0.2 * generator.standard_normal(200)
    spoilt = x.copy()
    spoilt[list(places)] += 20.0 * 0.2 * np.array(signs)
    assert not find_spikes(time, x, 0.2).any()
    assert tuple(np.flatnonzero(find_spikes(time, spoilt, 0.2))) == places


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.85])
def test_noise_is_measured_where_samples_are_missing(correlation):
    generator = np.random.default_rng(6)
    traces = []
    for _ in range(12):
        x = generator.standard_normal(400)
        for i in range(1, 400):
            x[i] = correlation * x[i - 1] + np.sqrt(1 - correlation**2) * x[i]
        kept = generator.random(400) > 0.35
        traces.append((np.arange(400.0)[kept] * 1e-3, 0.3 * x[kept]))
    noise = estimate_from_pairs(traces, 1e-3, 0.3)
    assert noise.correlation * (1 - noise.white_share) == pytest.approx(correlation, abs=0.05)
    assert noise.sd == pytest.approx(0.3, rel=0.05)


QUIET = 12  # samples of a record before first touch


def listen(deviation, rho, white, stated, seed):
    """What is made of eighteen traces of noise whose first samples nothing touches."""
    random = np.random.default_rng(seed)
    traces = [draw_noise(random, 200, deviation, rho, white) for _ in range(18)]
    quiet = measure_deviation([trace[:QUIET] for trace in traces])
    return estimate_noise([trace[QUIET:] for trace in traces], 4e-4, 150.0, stated, quiet)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("rho", "white"), [(0.9, 0.0), (0.85, 0.0), (0.88, 0.3)])
def test_slow_noise_strays_little_before_the_touch(rho, white, seed):
    """Twelve neighbours stay near their own mean: that does not make the noise smaller than it is stated to be."""
    found = listen(0.25, rho, white, 0.25, seed)
    assert found.sd == pytest.approx(0.25, rel=0.05) and abs(found.correlation - rho) < 0.06


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("deviation", "rho"), [(0.1, 0.0), (0.6, 0.0), (0.6, 0.5), (0.12, 0.4)])
def test_a_wrongly_stated_noise_is_told(deviation, rho, seed):
    """The quiet samples and the spectrum together say that the stated size is wrong."""
    found = listen(deviation, rho, 0.0, 0.25, seed)
    assert found.sd == pytest.approx(deviation, rel=0.2) and "not the stated" in found.text


@pytest.mark.parametrize(("column", "row", "value", "word"), [
    (1, 5, "twelve", "samples.csv"), (1, 5, "-1", "goes back"), (0, 5, "r99", "r99"), (2, 5, "1e400", "samples.csv"),
])
def test_malformed_files_stay_one_sentence(clean, tmp_path, capsys, column, row, value, word):
    spoiler = faults.Spoiler(clean["impact"], tmp_path / "bad")
    header, rows = faults.read_rows(spoiler.folder / "samples.csv")
    rows[row][column] = value
    faults.write_rows(spoiler.folder / "samples.csv", header, rows)
    assert main(["discover", str(spoiler.folder), "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err.strip()
    assert word in error and len(error.splitlines()) <= 3 and "Traceback" not in error


def check(found, verdict, effects, values):
    """Verdict, effects, and parameters within four deviations of the truth."""
    assert (found.verdict, found.effects) == (verdict, effects), found.sentence
    for name, truth in values.items():
        e = found.steps[-1].parameters[name]
        assert abs(e.estimate - truth) < 4.0 * e.sd, name


@pytest.mark.study
def test_impact_with_one_effect_and_five_faults(grown, tmp_path, capsys):
    """Clipped peaks, spikes, missing samples, a record in another unit and one with a drifting zero, at once."""
    import json

    key = middle(grown["impact"])
    others = [k for k in faults.Spoiler(grown["impact"], tmp_path / "x").order if k != key]
    folder = spoil(grown["impact"], tmp_path / "f", (faults.add_spikes, "normal_force", 6.0),
                   (faults.lose_samples, "normal_force", 0.03, 1), (faults.scale, ["normal_force"], key, 1 / 4.4482216),
                   (faults.drift, "normal_force", others[5], 1.0, 2.0), (faults.clip, "normal_force", 95.0))
    assert main(["discover", str(folder), "-o", str(tmp_path / "d")]) == 0
    found = json.loads((tmp_path / "d" / "result.json").read_text())
    assert found["verdict"] == "explained" and found["effects"] == ["wall-stiffness"]
    e = found["parameters"]["wall-stiffness.k_w"]
    assert abs(e["estimate"] - 1100.0) < 4.0 * e["sd"]
    seen = {f["kind"]: f["records"] for f in found["faults"]}
    assert {"clipped", "spike", "missing", "unit", "zero"} <= set(seen)
    assert seen["unit"] == [key] and seen["zero"] == [others[5]]
    left = {k for f in found["faults"] if f["left_out"] for k in f["records"]}
    assert left == {key, others[5]}
    assert key in found["sentence"]
    page = (tmp_path / "d" / "report.html").read_text()
    assert "Faults of the data" in page and "4.448" in page
    assert "4.448" in " ".join(capsys.readouterr().out.split())


@pytest.mark.study
def test_zero_that_moves_in_every_impact(clean, tmp_path):
    found = discover(spoil(clean["impact"], tmp_path / "f", (faults.drift_all, "normal_force", 0.75)))
    check(found, "nothing-missing", (), BALL)
    assert kinds(found.faults) == ["zero"] and found.counts["records"] == 18
    kept = discover(spoil(clean["impact"], tmp_path / "g", (faults.drift_all, "normal_force", 0.75)), keep_all=True)
    assert kinds(kept.faults) == ["zero"] and "asked" in kept.faults[0].done
    # Nothing is done about it: a misfit is left, or baselines that wander are allowed for.
    assert kept.verdict != "nothing-missing" or kept.noise["normal_force"]["slow_sd"] > 0.2


@pytest.mark.slow
@pytest.mark.parametrize(("act", "kind"), [
    pytest.param((faults.scale, ["normal_force"], 1.1), "gain", marks=pytest.mark.study),
    ((faults.shift, ["normal_force"], 5), "clock"),
])
def test_a_wrong_impact_record_is_left_out(clean, tmp_path, act, kind):
    key = middle(clean["impact"])
    verb, names, size = act
    found = discover(spoil(clean["impact"], tmp_path / "f", (verb, names, key, size)))
    check(found, "nothing-missing", (), BALL)
    assert [(f.kind, f.records, f.left_out) for f in found.faults] == [(kind, (key,), True)]


@pytest.mark.study
def test_a_wrong_record_at_an_extreme_is_kept_and_named(tmp_path):
    write(tmp_path / "c", "impact", {}, repeats=1)
    head, rows = faults.read_rows(tmp_path / "c" / "records.csv")
    speed, pressure = head.index("approach_speed"), head.index("initial_pressure")
    key = max(rows, key=lambda row: float(row[speed]) - float(row[pressure]))[0]  # deepest of all
    found = discover(spoil(tmp_path / "c", tmp_path / "f", (faults.scale, ["normal_force"], key, 1.08)))
    assert [(f.kind, f.records, f.left_out) for f in found.faults] == [("doubtful", (key,), False)]
    assert found.counts["records"] == 9
    assert not found.effects


def list_column(folder, name):
    """Values of a condition by record."""
    head, rows = faults.read_rows(folder / "records.csv")
    return {row[0]: float(row[head.index(name)]) for row in rows}


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.6, 1.7])
def test_a_gain_at_a_corner_that_nothing_beside_it_shares_is_a_fault(clean, tmp_path, gain):
    load, speed = (list_column(clean["slip"], name) for name in ("normal_load", "slip_speed"))
    key = max(load, key=lambda k: load[k] * speed[k] ** 0.1)
    found = discover(spoil(clean["slip"], tmp_path / "f", (faults.scale, ["tangential_force"], key, gain)))
    assert (found.verdict, found.counts["records"]) == ("nothing-missing", 17), found.sentence
    assert [(f.kind, f.records, f.left_out) for f in found.faults] == [("gain", (key,), True)]
    assert found.faults[0].done.startswith("It is left out")


@pytest.mark.study
def test_a_wrong_record_and_a_missing_effect_hide_each_other(tmp_path):
    """Neither the model without the effect nor the effects found with the record see what is wrong."""
    folder = tmp_path / "both"
    write_package(folder, make_slip_campaign("f", 25, {"viscous-friction": {"c_t": 2.8}}, RUBBER, [7.5, 12.3, 19.6],
                                                 [0.73e6, 1.71e6], [0.048, 0.285], 1))
    load, speed, pressure = (list_column(folder, name) for name in ("normal_load", "slip_speed", "internal_pressure"))
    key = min(load, key=lambda k: load[k] / speed[k] / pressure[k])
    found = discover(spoil(folder, tmp_path / "f", (faults.scale, ["tangential_force"], key, 0.67)))
    check(found, "explained", ("viscous-friction",), {"viscous-friction.c_t": 2.8})
    assert [(f.kind, f.records, f.left_out) for f in found.faults] == [("gain", (key,), True)]


@pytest.mark.study
@pytest.mark.parametrize("power", [3.0, 6.0])
def test_a_steep_trend_towards_the_largest_load_loses_no_record(clean, tmp_path, power):
    load = list_column(clean["slip"], "normal_load")
    acts = [(faults.scale, ["tangential_force"], key, 1.0 + 0.3 * (x / max(load.values())) ** power)
            for key, x in load.items()]
    found = discover(spoil(clean["slip"], tmp_path / "f", *acts))
    assert found.verdict != "nothing-missing" and not any(f.left_out for f in found.faults), found.sentence


@pytest.mark.study
def test_two_records_stand_against_a_third(tmp_path):
    folder = tmp_path / "three"
    write_package(folder, make_tumble_campaign("f", 24, {}, {"inertia_ratio": 0.53}, 3))
    found = discover(spoil(folder, tmp_path / "f", (faults.scale, RATES, "r02", 1.35)))
    check(found, "nothing-missing", (), {"inertia_ratio": 0.53})
    assert [(f.records, f.left_out) for f in found.faults] == [(("r02",), True)]


@pytest.mark.study
def test_an_end_stop_that_only_the_deepest_tests_feel_loses_no_record(tmp_path):
    folder = tmp_path / "stop"
    write_package(folder, make_campaign(
        "stop", 41, {"x-end-stop": {"k": 2e5, "depth": 7.5e-3}}, BALL, [0.5e6, 1.1e6, 2.2e6], [0.16, 0.38, 0.66], 1,
        interval=4e-4))
    found = discover(folder)
    assert not any(f.left_out for f in found.faults)
    assert found.counts["records"] == 9 and found.verdict != "nothing-missing"


@pytest.mark.slow
@pytest.mark.parametrize(("acts", "kind"), [
    (lambda key: [(faults.scale, ["tangential_force"], key, 4.4482216)], "unit"),
    (lambda key: [(faults.drift, "tangential_force", key, 0.16, 0.32)], "zero"),
    (lambda key: [(faults.scale_condition, "normal_load", key, 0.22480894)], "unit"),
])
def test_slip_with_one_effect_and_a_fault(grown, tmp_path, acts, kind):
    key = middle(grown["slip"])
    found = discover(spoil(grown["slip"], tmp_path / "f", *acts(key)))
    check(found, "explained", ("viscous-friction",), {"viscous-friction.c_t": 0.9})
    assert [(f.kind, f.records) for f in found.faults] == [(kind, (key,))]


@pytest.mark.study
def test_tumbling_with_faults(clean, grown, tmp_path):
    found = discover(spoil(clean["tumble"], tmp_path / "f", (faults.scale, RATES, "r03", 57.29578)))
    check(found, "nothing-missing", (), {"inertia_ratio": 0.53})
    assert [(f.kind, f.records) for f in found.faults] == [("unit", ("r03",))]
    found = discover(spoil(grown["tumble"], tmp_path / "g", (faults.drift, RATES[0], "r03", 8e-5, 1.6e-4),
                           (faults.add_spikes, RATES[1], 4e-4)))
    check(found, "explained", ("eddy-current",), {"inertia_ratio": 0.53, "eddy-current.k_e": 2e-6})
    assert kinds(found.faults) == ["spike", "zero"]


@pytest.mark.slow
def test_fit_says_and_the_missing_force_leaves_out(clean, tmp_path):
    folder = spoil(clean["slip"], tmp_path / "f", (faults.add_spikes, "tangential_force", 2.0))
    found = fit(folder)
    assert any("single samples" in note and "as they are" in note for note in found.notes)
    drawn = draw_missing_force(folder, catalogue=False)
    assert drawn.shapes == () and any("single samples" in note for note in drawn.notes)
    kept = draw_missing_force(folder, catalogue=False, keep_all=True)
    # What is kept goes into the noise, too, so that chi-square grows by less than the spikes themselves.
    assert kept.reference > drawn.reference + 5.0 * np.sqrt(2.0 * drawn.reference)


@pytest.mark.slow
@pytest.mark.parametrize("family, hidden", [("impact", "grown"), ("slip", "clean")])
def test_two_records_with_the_settings_of_each_other_are_left_out(request, family, hidden):
    """Neither stands out by itself; without both, what is missing is found as ever."""
    campaign = read_campaign(request.getfixturevalue(hidden)[family])
    settings = [name for name in campaign.records.columns if name != "sequence"]
    records = campaign.records.copy()
    order = np.argsort(records[settings[0]].to_numpy(), kind="stable")
    pair = [campaign.record_keys[order[1]], campaign.record_keys[order[-2]]]
    records.loc[pair, settings] = campaign.records.loc[pair[::-1], settings].to_numpy()
    found = discover(dc.replace(campaign, records=records))
    (fault,) = [one for one in found.faults if one.left_out]
    assert (fault.kind, set(fault.records)) == ("setting", set(pair))
    assert found.effects == (() if hidden == "clean" else tuple(EFFECT[family]))
    assert found.verdict == ("nothing-missing" if hidden == "clean" else "explained")


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["clean", pytest.param("grown", marks=pytest.mark.study)])
def test_gauge_pressures_taken_for_absolute_ones_are_asked_about(request, hidden):
    """An atmosphere too little in every record looks like physics; nothing is named before that is settled."""
    campaign = read_campaign(request.getfixturevalue(hidden)["impact"])
    low = dc.replace(campaign, records=campaign.records.assign(
        initial_pressure=campaign.records["initial_pressure"] - AMBIENT))
    restored = add_atmosphere(low)
    assert np.allclose(restored.records["initial_pressure"], campaign.records["initial_pressure"])
    found = discover(low)
    assert found.verdict == "undecided" and found.effects == () and len(found.doubts) == 1
    # Those that the file gave as gauge pressures have had it added already.
    columns = low.conditions | {"initial_pressure": dc.replace(low.conditions["initial_pressure"], gauge=True)}
    assert add_atmosphere(dc.replace(campaign, conditions=columns)) is None


def test_restatements_of_a_campaign(request):
    """Pressures with the atmosphere, all known diameters doubled and halved; nothing of what is fitted."""
    campaign = read_campaign(request.getfixturevalue("clean")["impact"])
    known = campaign.known | {"outer_diameter": 0.03, "inner_diameter": 0.02}
    raised, doubled, halved = list_restatements(dc.replace(campaign, known=known))
    assert np.allclose(raised.campaign.records["initial_pressure"] - campaign.records["initial_pressure"], AMBIENT)
    for one, factor in ((doubled, 2.0), (halved, 0.5)):
        assert one.campaign.known == known | {"outer_diameter": 0.03 * factor, "inner_diameter": 0.02 * factor}
    free = dc.replace(campaign, known=dict.fromkeys(known))
    assert len(list_restatements(free)) == 1


def test_axes_that_are_exchanged_three_times_are_as_before(request):
    """Cyclically, with their names and uncertainties; each axis becomes z once."""
    campaign = read_campaign(request.getfixturevalue("clean")["tumble"])
    fine = campaign.channels["angular_velocity_x"]
    campaign = dc.replace(campaign, channels=campaign.channels | {
        "angular_velocity_x": dc.replace(fine, uncertainty=Uncertainty(absolute=1e-3))})
    x_first, y_first = list_restatements(campaign)
    assert [one.facts["axis"] for one in (x_first, y_first)] == ["x", "y"]
    old, new = campaign.samples, x_first.campaign.samples
    for before, after in zip("xyz", "zxy", strict=True):
        np.testing.assert_array_equal(new[f"angular_velocity_{after}"], old[f"angular_velocity_{before}"])
    assert x_first.campaign.channels["angular_velocity_z"].uncertainty.absolute == 1e-3
    lacking = dc.replace(campaign, samples=campaign.samples.drop(columns="angular_velocity_y"), channels={
        name: column for name, column in campaign.channels.items() if name != "angular_velocity_y"})
    assert list_restatements(lacking) == []
    twice = list_restatements(x_first.campaign)[0].campaign
    pd.testing.assert_frame_equal(y_first.campaign.samples, twice.samples)
    thrice = list_restatements(twice)[0].campaign
    pd.testing.assert_frame_equal(thrice.samples, old)
    assert thrice.channels == campaign.channels


@pytest.mark.slow
@pytest.mark.parametrize("hidden", ["clean", pytest.param("grown", marks=pytest.mark.study)])
def test_another_axis_of_symmetry_is_asked_about(request, hidden):
    """Unequal moments of inertia are no physics that is missing where the body is one of revolution about another axis
    than the one that was stated.
    """
    turned = list_restatements(read_campaign(request.getfixturevalue(hidden)["tumble"]))[0].campaign
    found = discover(turned)
    assert found.verdict == "undecided" and found.effects == () and len(found.doubts) == 1


@pytest.mark.study
@pytest.mark.parametrize("hidden", ["clean", "grown"])
def test_a_radius_given_for_a_diameter_is_asked_about(request, hidden):
    """Half a diameter looks like physics; no effect is named before that is settled."""
    campaign = read_campaign(request.getfixturevalue(hidden)["impact"])
    half = {**campaign.known, "outer_diameter": campaign.known["outer_diameter"] / 2.0}
    found = discover(dc.replace(campaign, known=half))
    assert found.verdict == "undecided" and found.effects == ()
    assert f"outer_diameter={1e3 * campaign.known['outer_diameter']:.6g} mm" in found.doubts[0]


@pytest.mark.study
@pytest.mark.parametrize(("asked", "verdict", "effects", "left_out"), [
    ((Exam("slip", 82, ("one", "two", "outside"), bench="drawn"), 23), "explained", ("load-exponent",), True),
    ((Exam("slip", 141, ("one",), bench="drawn"), 1), "undecided", (), False)])
def test_a_wrong_record_beside_wandering_baselines_hides_no_effect(tmp_path, asked, verdict, effects, left_out):
    """A load exponent, baselines that wander and one record in a wrong range, from the second simulator: that record is
    left out, or, where none lies beyond it, the question stays open; baselines never stand for all three."""
    case = sample_case(*asked)
    kept = write_case(asked[0], case, tmp_path)
    found = discover(tmp_path)
    assert (list(case.effects), case.bench, case.fault) == (["load-exponent"], ("wander",), "wrong-record")
    assert (found.verdict, found.effects) == (verdict, effects)
    wrong = [fault for fault in found.faults if fault.kind in ("gain", "doubtful")]
    key = read_campaign(tmp_path).record_keys[kept["fault_details"]["record"]]
    assert [fault.records for fault in wrong] == [(key,)] and wrong[0].left_out == left_out


@pytest.mark.parametrize("period", [12, 40, 150, 2000])
@pytest.mark.parametrize("step", [1.0, 4.0, 10.0])
def test_a_coarse_gauge_at_its_limit_is_seen_where_readings_are_smooth(period, step):
    """Equal readings follow one another at the top of what is slow, too; at a limit their neighbours
    lead to expect more, unless these are too few for so long a stay.
    """
    generator, noise = np.random.default_rng(5), 1e-3
    readings = np.sin(2.0 * np.pi * np.arange(400) / period + 0.3) + noise * generator.standard_normal(400)
    fine, beyond = (np.round(np.clip(readings, -top, top) / (step * noise)) * step * noise for top in (2.0, 0.8))
    error = noise * np.hypot(1.0, step / np.sqrt(12.0))
    for readings, limited in ((fine, False), (beyond, 12 < period < 2000)):
        clipped, held, limits = find_runs(readings, noise, 0.99, 400, 1e-9, error=error)
        assert (bool(limits), held.any()) == (limited, False)
        assert not limited or clipped[np.abs(readings) >= np.abs(readings).max() - 1e-9].all()
