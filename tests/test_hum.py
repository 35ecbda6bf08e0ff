"""Hum: that a sine of one frequency in all records is found with its size, and that nothing else passes for one."""

import dataclasses as dc

import numpy as np
import pytest
from helpers_statistics import PRESSURES, SPEEDS, TIME, fit_toy, make_selection

from ddetumble import discover
from ddetumble.exam import Exam
from ddetumble.exam.cases import sample_case, write_case
from ddetumble.inference.archive import resolve_model
from ddetumble.inference.assembly import assemble_space
from ddetumble.inference.hum import find_hum, tune_hum
from ddetumble.inference.noise import Noise
from ddetumble.inference.noise_estimation import has_more_hum
from ddetumble.inference.problem import Problem
from ddetumble.inference.stack import default_noise, stack_records
from ddetumble.measurement.package import read_campaign


CONDITIONS = [(v, p) for v in SPEEDS for p in PRESSURES] * 2
RECORDS = len(CONDITIONS)


def add_sine(seed, frequency, amplitude, phases=None):
    """Adds such a sine to every record; of random phases where none are given."""
    def spoil(measured, stated):
        drawn = np.random.default_rng([52, seed]).uniform(0.0, 2.0 * np.pi, len(measured)) if phases is None else phases
        for values, phase in zip(measured[:, 0], drawn, strict=True):
            values += amplitude * np.sin(2.0 * np.pi * frequency * TIME + phase)
    return spoil


def look(seed, spoil=None, **options):
    """The noise of the force after a look for hum under the reference model."""
    selection, fitted = fit_toy(make_selection(seed, conditions=CONDITIONS, spoil=spoil, **options))
    return find_hum(selection.campaign, selection.records, fitted.solution, selection.noise)["normal_force"]


@pytest.mark.parametrize(("frequency", "amplitude"), [(4.1, 0.1), (7.77, 0.05), (15.3, 0.2)])
def test_hum_is_found(frequency, amplitude):
    """Of one to four times the noise, of a few turns in a record or of many: frequency and rms."""
    for seed in (1, 2, 3):  # of the phases of seed 0 chance makes a pattern, one in a hundred
        ((found, rms),) = look(seed, add_sine(seed, frequency, amplitude)).hum
        assert found == pytest.approx(frequency, abs=0.05) and rms == pytest.approx(amplitude / np.sqrt(2.0), rel=0.15)


@pytest.mark.parametrize("seed", [169, 213, 332])
def test_hum_as_large_in_hard_blows_as_in_soft_ones_is_found_whatever_chance_makes_of_its_phases(seed):
    """Of the phases of these seeds chance makes a pattern, one in fifty does."""
    ((found, rms),) = look(seed, add_sine(seed, 7.77, 0.2)).hum
    assert found == pytest.approx(7.77, abs=0.05) and rms == pytest.approx(0.2 / np.sqrt(2.0), rel=0.15)


def test_two_sines_are_found():
    def spoil(measured, stated):
        add_sine(1, 5.0, 0.15)(measured, stated)
        add_sine(2, 15.0, 0.1)(measured, stated)

    assert sorted(f for f, _ in look(3, spoil).hum) == pytest.approx([5.0, 15.0], abs=0.02)


def test_none_is_found_in_noise():
    """White or correlated: none of 20 campaigns hums."""
    assert not any(look(seed, rho=rho).hum for seed in range(10) for rho in (0.0, 0.6))


# The same, the same but for its sign, and what each of the conditions gives, twice over.
@pytest.mark.parametrize("phases", [np.zeros(RECORDS), np.pi * (np.arange(RECORDS) % 2),
                                    np.tile(np.linspace(0.0, 5.0, RECORDS // 2), 2)])
def test_what_shares_its_phase_is_no_hum(phases):
    """A sine in the same phase in every record, the same but for its sign, or in one that the conditions give, may be
    physics."""
    assert not look(4, add_sine(4, 7.77, 0.2, phases)).hum


def test_what_grows_with_a_condition_is_no_hum():
    """Its amplitude is that of the mains, whatever is measured."""
    def spoil(measured, stated):
        generator = np.random.default_rng(5)
        for k, values in enumerate(measured[:, 0]):
            turns = 2.0 * np.pi * (7.77 * TIME + generator.random())
            values += 0.6 * (k % (RECORDS // 2)) / RECORDS * np.sin(turns) if k % 3 == 0 else 0.0

    assert not look(6, spoil).hum


def test_few_records_show_none():
    selection, fitted = fit_toy(make_selection(7, conditions=CONDITIONS[:9], spoil=add_sine(7, 7.77, 0.2)))
    assert find_hum(selection.campaign, selection.records, fitted.solution, selection.noise) == selection.noise


def test_a_fit_takes_the_hum_out():
    """With its sines as nuisances of every record, what is left is the noise."""
    selection, fitted = fit_toy(make_selection(8, conditions=CONDITIONS, spoil=add_sine(8, 7.77, 0.2)))
    noise = find_hum(selection.campaign, selection.records, fitted.solution, selection.noise)
    assert has_more_hum(selection.noise, noise) and not has_more_hum(noise, noise)
    again = selection.restack(noise).repeat(fitted)
    freedom = selection.samples - 2 * RECORDS - len(again.solution.names)
    assert fitted.solution.chi2 > 3.0 * freedom
    assert abs(again.solution.chi2 / freedom - 1.0) < 4.0 * np.sqrt(2.0 / freedom)
    assert selection.restack(noise).records.nuisances[-2:] == ("sine-0:normal_force", "cosine-0:normal_force")


@pytest.mark.parametrize("truth", [7.77, 50.0 / 6.0])
def test_a_frequency_that_was_off_is_mended(truth):
    """A third of a bin off, in 8 campaigns: two looks bring it to the truth within 0.02 Hz (0.7 Hz are a bin), and what
    is left is the noise; at the truth it stays."""
    for seed in range(8):
        selection, fitted = fit_toy(make_selection(seed, conditions=CONDITIONS, spoil=add_sine(seed, truth, 0.15)))
        noise = {c: n.with_hum(((truth + 0.22, 0.1),)) for c, n in selection.noise.items()}
        for _ in range(2):
            selection = selection.restack(noise)
            fitted = selection.repeat(fitted)
            noise = tune_hum(selection.campaign, selection.records, fitted.solution, noise)
        ((frequency, rms),) = noise["normal_force"].hum
        assert frequency == pytest.approx(truth, abs=0.02) and rms == 0.1
        selection = selection.restack(noise)
        fitted = selection.repeat(fitted)
        again = tune_hum(selection.campaign, selection.records, fitted.solution, noise)
        assert again["normal_force"].hum[0][0] == pytest.approx(frequency, abs=0.01)


def test_the_mains_are_taken_where_they_are_near():
    """Of 60 Hz, from 60.2 Hz, in two looks: exactly 60 (samples at 50 Hz show it as 10 Hz, and as well)."""
    selection, fitted = fit_toy(make_selection(4, conditions=CONDITIONS, spoil=add_sine(4, 60.0, 0.15)))
    noise = {c: n.with_hum(((60.2, 0.1),)) for c, n in selection.noise.items()}
    for _ in range(2):
        selection = selection.restack(noise)
        fitted = selection.repeat(fitted)
        noise = tune_hum(selection.campaign, selection.records, fitted.solution, noise)
    assert noise["normal_force"].hum[0][0] == 60.0


def test_bands_hold_the_hum():
    """Its power adds to that of the noise."""
    noise = Noise(0.3, 0.0, 0.0, 1e-3, 0.3, 0.0, "white").with_hum(((50.0, 0.4),))
    assert np.allclose(noise.deviations(np.zeros(5)), 0.5)
    assert dc.replace(noise, hum=()).deviations(np.zeros(5)) == pytest.approx(np.full(5, 0.3))


@pytest.mark.slow
def test_sines_of_a_slip_record_turn_with_time():
    """Over slip, 0.1 mm at 20 mm/s is 5 ms: amplitudes of every record's own, in units of the hum's rms."""
    campaign = read_campaign("slip-a")
    space = assemble_space(campaign, resolve_model("paper", "slip").reference).space
    noise = default_noise(campaign, "tangential_force", np.array([0.0, 1e-4])).with_hum(((5.0, 0.3),))
    problem = Problem(space, stack_records(campaign, {"tangential_force": noise}))
    z = np.zeros((problem.records.count, len(problem.records.nuisances)))
    start = space.coordinates()
    plain = problem.solve((), start, z, moving=False).channels
    z[:, -2], z[:, -1] = 0.5, -2.0
    moved = problem.solve((), start, z, moving=False).channels
    speed = campaign.records["slip_speed"].to_numpy()[:, None]
    turns = 2.0 * np.pi * 5.0 * np.asarray(problem.records.stack.time)[: len(speed)] / speed
    expected = 0.3 * (0.5 * np.sin(turns) - 2.0 * np.cos(turns))
    seen = np.arange(turns.shape[1]) < problem.records.lengths[:, None]
    assert np.allclose((moved - plain)[:, 0][seen], expected[seen], atol=1e-9)


@pytest.mark.slow
def test_hum_in_a_campaign_of_the_second_simulator(tmp_path):
    """Nothing hidden, then one effect: neither is hidden by it, nor made of it."""
    for truth in ("nothing", "one"):
        exam = Exam("slip", 42, truths=(truth,), fault="none", bench="hum")
        case = sample_case(exam, 0)
        drawn = write_case(exam, case, tmp_path / truth)["bench_details"]["hum"]
        found = discover(tmp_path / truth)
        assert found.verdict == ("explained" if case.effects else "nothing-missing") and {*found.effects} == {
            *case.effects}
        (line,) = found.noise["tangential_force"]["hum"]
        assert line["frequency"] == pytest.approx(drawn["frequency"], rel=0.01)
        sd = found.noise["tangential_force"]["stated_sd"]
        assert line["rms"] == pytest.approx(drawn["amplitude"] * sd / np.sqrt(2.0), rel=0.15)


@pytest.mark.slow
def test_hum_of_a_few_tumbling_records_is_no_physics(tmp_path):
    """Three records of a body that turns a fifth as often as the gyroscope is shaken: nothing is missing."""
    exam = Exam("tumble", 74, truths=("nothing",), bench="drawn")
    case = sample_case(exam, 5)
    drawn = write_case(exam, case, tmp_path)["bench_details"]["hum"]
    found = discover(tmp_path)
    assert (found.verdict, found.effects) == ("nothing-missing", ())
    assert all(line["frequency"] == pytest.approx(drawn["frequency"], rel=1e-2)
               for level in found.noise.values() for line in level["hum"])
    assert sum(len(level["hum"]) for level in found.noise.values()) == 3


def shake(campaign, kind, frequency):
    """A campaign of tumbling whose gyroscope is shaken by 4e-5 rad/s, in phases of every record's and axis' own;
    `alike` in all records, `weaker` in the last one, or at a frequency that goes `with the rates`."""
    draw, samples = np.random.default_rng(3), campaign.samples.copy()
    rates, alike = list(campaign.channels), draw.uniform(0.0, 2.0 * np.pi, 3)
    for key, rows in samples.groupby("record").groups.items():
        speed = np.sqrt(np.mean(np.sum(samples.loc[rows, rates].to_numpy() ** 2, axis=1)))
        own = frequency * (speed / 0.09 if kind == "with the rates" else 1.0)
        phases = alike if kind == "alike" else draw.uniform(0.0, 2.0 * np.pi, 3)
        turns = 2.0 * np.pi * own * samples.loc[rows, "time"].to_numpy()[:, None]
        size = 2.5e-5 if kind == "weaker" and key == campaign.records.index[-1] else 4e-5
        samples.loc[rows, rates] += size * np.sin(turns + phases)
    return dc.replace(campaign, samples=samples)


@pytest.mark.slow
@pytest.mark.parametrize(("kept", "frequency", "kinds"), [
    (["r01", "r02", "r03"], 0.07, ["alike", "with the rates"]),
    (["r01", "r02", "r03", "r04", "r05"], 0.07, ["alike", "with the rates"]),
    # At so low a frequency a line that goes with the rates would lie elsewhere in the last one alone.
    (["r01", "r02", "r03", "r05"], 0.02, ["alike", "with the rates", "weaker"]),
    (["r01", "r05"], 0.15, ["alike", "weaker"]),  # five times and more as fast as the body turns
    (["r01", "r05"], 0.09, []),
], ids=["three", "five", "one-elsewhere", "fast", "not-fast"])  # fmt: skip
def test_what_shakes_a_gyroscope(kept, frequency, kinds):
    """Of a body with a damper: a vibration in phases of their own is hum; what begins alike in every record, or goes
    with the body's rates, may be a torque, and is none. So may all be in two records that is not far faster than the
    body turns."""
    plain = read_campaign("tumble-b")
    plain = dc.replace(plain, records=plain.records.loc[kept],
                       samples=plain.samples[plain.samples["record"].isin(kept)])
    assembly = assemble_space(plain, resolve_model("paper", "tumble").reference)
    space, problem = assembly.space, Problem(assembly.space, stack_records(plain))
    start = space.family.guess_starts(plain, space, assembly.start, assembly.base)[0]
    start[space.index["internal-damper.c"]] = 1e-5
    names = *assembly.base, *space.of(["internal-damper", "gyro-bias"])
    solution = problem.solve(names, start)
    for kind in ("hum", *kinds):
        campaign = shake(plain, kind, frequency)
        records = stack_records(campaign)
        here = Problem(space, records).solve(names, solution.u, solution.z)
        noise = {c: default_noise(campaign, c, np.array([0.0, 2.5])) for c in campaign.channels}
        for level in find_hum(campaign, records, here, noise).values():
            assert len(level.hum) == (kind == "hum" and bool(kinds)), kind
            for found, rms in level.hum:
                assert found == pytest.approx(frequency, rel=2e-3) and rms == pytest.approx(4e-5 / 2**0.5, rel=0.1)
