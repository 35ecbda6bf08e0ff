"""A baseline that wanders: its likelihood, that one is found, and that none is found where there is none."""

import dataclasses as dc

import numpy as np
import pytest
from helpers_statistics import PRESSURES, SD, SPEEDS, TIME, fit_toy, make_selection
from helpers_tumble import CHANNELS, NOISE, make_law, make_long, move
from scipy.linalg import null_space
from scipy.stats import multivariate_normal

import ddetumble as dd
from ddetumble.contact.torque import RigidBody
from ddetumble.exam.simulators.noise import draw_noise
from ddetumble.inference import variance_components
from ddetumble.inference.noise import Noise
from ddetumble.inference.problem import shift_clocks
from ddetumble.inference.variance_components import WanderSettings, find_slow_noise, weigh_quiet
from ddetumble.selection.problem import fit_reference, pose_selection


CONDITIONS = [(v, p) for v in SPEEDS for p in PRESSURES] * 2


def wander(seed, size, slow):
    """Adds such a baseline to every record."""
    def spoil(measured, stated):
        generator = np.random.default_rng([51, seed])
        for values in measured[:, 0]:
            values += draw_noise(generator, len(values), size, np.exp(-0.02 / slow))
    return spoil


def look(seed, spoil=None, **options):
    """The noise of the force after a look for a baseline under the reference model."""
    selection, fitted = fit_toy(make_selection(seed, conditions=CONDITIONS, spoil=spoil, **options))
    return find_slow_noise(selection.records, fitted.solution, selection.noise).noise["normal_force"]


def lose(square, slow, parts, power=1.0):
    rows = [variance_components._whiten_rows(*part) for part in parts]
    return variance_components._lose(square, [variance_components._turn(one, slow, power) for one in rows])


@pytest.mark.parametrize("count", [0, 2])
def test_restricted_likelihood_is_that_of_the_dense_normal_density(count):
    """log|V| + log|S'V⁻¹S| + r'Pr of all records at once, with and without free parameters."""
    generator, parts = np.random.default_rng(1), []
    for n in (4, 6, 5):
        time, root = np.sort(generator.random(n)), generator.standard_normal((n, n))
        parts.append((time, root @ root.T + np.eye(n), generator.standard_normal((n, count + 1)), np.eye(n)))
    for logarithm, slow, power in ((-np.inf, 1.0, 1.0), (-0.3, 0.2, 1.0), (1.6, 3.0, 1.0), (0.4, 0.3, 2.0)):
        covariance, place, size = np.zeros((15, 15)), 0, np.exp(logarithm)
        for time, own, *_ in parts:
            rows = slice(place, place + len(time))
            covariance[rows, rows] = own + size**2 * np.exp(-(abs(time[:, None] - time) / slow)**power / power)
            place += len(time)
        columns = np.concatenate([part[2] for part in parts])
        free, right, inverse = columns[:, :-1], columns[:, -1], np.linalg.inv(covariance)
        square = free.T @ inverse @ free
        projector = inverse - inverse @ free @ np.linalg.solve(square, free.T @ inverse)
        expected = np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(square)[1] + right @ projector @ right
        assert lose(size**2, slow, parts, power) == pytest.approx(expected, rel=1e-8)


def test_where_a_record_starts_from_is_projected_out():
    """As free columns of each record's own: the loss of two baselines differs by as much, whatever their scale."""
    generator, apart, together = np.random.default_rng(2), [], []
    for r, n in enumerate((5, 6, 7)):
        time, root = np.sort(generator.random(n)), generator.standard_normal((n, n))
        covariance, columns = root @ root.T + np.eye(n), generator.standard_normal((n, 2))
        start = generator.standard_normal((n, 2)) * [1e5, 1e-3]
        across = variance_components._list_rows_across(np.concatenate([start, start[:, :1], np.zeros((n, 1))], axis=1))
        assert across.shape == (n - 2, n) and np.allclose(across @ start, 0.0, atol=1e-9)
        apart.append((time, covariance, columns, across))
        own = np.zeros((n, 6))
        own[:, 2 * r: 2 * r + 2] = start / np.linalg.norm(start, axis=0)
        together.append((time, covariance, np.concatenate([own, columns], axis=1), np.eye(n)))
    losses = [[lose(*point, parts) for point in ((0.0, 1.0), (0.55, 0.2), (25.0, 3.0))]
              for parts in (apart, together)]
    assert np.diff(losses[0]) == pytest.approx(np.diff(losses[1]), rel=1e-6)


def spoil_rates(torque, size):
    """Tumbling records with a constant torque, and a walk so many times as large as the noise at the end."""
    campaign = make_long(4, 300.0, 3.0)
    samples, generator = campaign.samples.copy(), np.random.default_rng(4)
    for _, group in samples.groupby("record", sort=False):
        times, start = group["time"].to_numpy(), group.iloc[0][list(CHANNELS)].to_numpy(dtype=float)
        laws = [make_law(0.55, {"constant-torque": {"torque": x}}) for x in (np.zeros(3), torque)]
        free, pushed = (np.asarray(move(law, times, start).angular_velocity) for law in laws)
        walk = np.cumsum(generator.standard_normal((len(times), 3)), axis=0) / np.sqrt(len(times))
        samples.loc[group.index, list(CHANNELS)] += pushed - free + size * NOISE * walk
    return dc.replace(campaign, samples=samples)


def look_at_rates(torque, size):
    """The noise of such records after a look for a baseline."""
    selection, fitted = fit_reference(pose_selection(spoil_rates(torque, size), RigidBody()))
    return find_slow_noise(selection.records, fitted.solution, selection.noise)


@pytest.mark.slow
def test_what_a_torque_leaves_is_smooth():
    """A walk of the gyroscope is rough, about as a random walk of its size is; a torque's drift is smooth by far."""
    limit = WanderSettings().smooth
    walk, torque, quiet = (look_at_rates(*case) for case in (
        ([0.0] * 3, 4.0), ([3e-7, 2e-7, 4e-7], 0.0), ([0.0] * 3, 0.0)))
    assert walk.roughness > -limit > torque.roughness
    assert all(one.slow_sd > 1.5 * NOISE for one in walk.noise.values())
    assert quiet.roughness == 0.0 and not any(one.slow_sd for one in quiet.noise.values())


@pytest.mark.parametrize(("size", "slow"), [(0.05, 0.3), (0.1, 0.15), (0.2, 0.6)])
def test_a_baseline_is_found(size, slow):
    """Of one to four times the noise: its size within a third, and the nearest times that are tried to its own."""
    for seed in range(4):
        found = look(seed, wander(seed, size, slow))
        assert found.slow_sd == pytest.approx(size, rel=1 / 3) and slow / 3.0 < found.slow_time < 3.0 * slow
        assert found.sd == SD["normal_force"] and not found.is_white


@pytest.mark.parametrize(("size", "slow"), [(0.1, 0.15), (0.2, 0.3), (0.4, 0.6)])
def test_what_is_slow_during_contact_alone_is_no_baseline(size, slow):
    """The same walks, of two to eight times the noise, while something presses on the gauge, as physics would leave."""
    for seed in range(4):
        def spoil(measured, stated, seed=seed):
            before = measured.copy()
            wander(seed, size, slow)(measured, stated)
            resting = (TIME < 0) | (TIME > 1)
            measured[..., resting] = before[..., resting]
        assert look(seed, spoil).slow_sd == 0.0


def test_readings_without_contact_speak_for_a_baseline_or_against_it():
    """They are likelier beside the baseline that is there, and less likely beside one that is not, the larger the more;
    by as much as normal densities of the readings less their mean say."""
    for seed, real in ((0, True), (1, False)):
        selection, fitted = fit_toy(make_selection(seed, conditions=CONDITIONS, spoil=wander(seed, 0.2, 0.3) if real
                                                   else None))
        known, at = selection.noise["normal_force"], fitted.solution
        gains = [weigh_quiet(selection.records, at, dc.replace(known, slow_sd=size, slow_time=0.3), 0)
                 for size in (0.0, 0.05, 0.2)]
        assert gains[0] == 0.0 and (10.0 < gains[1] < gains[2] if real else -2.0 > gains[1] > gains[2])
        time, expected = np.asarray(selection.records.stack.time), 0.0
        residual = at.channels[:, 0] - np.asarray(selection.records.stack.values)[:, 0]
        for r in range(selection.records.count):
            end, touch = float(at.end[r]), float(shift_clocks(selection.records, at)[r])
            kept = (time[r] < min(touch, 0.0) - 1e-4) | (time[r] > end + 0.25 * (end - touch))
            lag, basis = time[r, kept][:, None] - time[r, kept], null_space(np.ones((1, int(kept.sum()))))
            for sign, size in ((1.0, 0.2), (-1.0, 0.0)):
                covariance = dc.replace(known, slow_sd=size, slow_time=0.3).covariance(lag)
                expected += sign * multivariate_normal(cov=basis.T @ covariance @ basis).logpdf(
                    basis.T @ residual[r, kept])
        assert gains[2] == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("rho", [0.0, 0.5])
def test_no_baseline_is_found_in_noise(rho):
    """White or correlated as it is known to be: none of 15 campaigns has one."""
    for seed in range(15):
        selection = make_selection(seed, conditions=CONDITIONS, rho=rho)
        known = {"normal_force": make_known(rho)}
        selection, fitted = fit_toy(selection.restack(known))
        assert find_slow_noise(selection.records, fitted.solution, known).noise == known


def make_known(rho):
    return Noise(SD["normal_force"], rho, 0.0, 0.02, SD["normal_force"], 0.0, "")


def test_settings_off_within_their_uncertainty_are_no_baseline():
    """A clock and settings that are as uncertain as stated, and parameters anywhere, take no baseline to explain."""
    assert look(3, truth={"stiffness": 14.0, "gas": 1.0, "loss": 2.0}).slow_sd == 0.0


@pytest.mark.slow
def test_a_fit_of_tumbling_allows_for_a_gyroscope_that_wanders():
    """Beside a walk the interval of the inertia ratio holds the truth, which one of the white noise misses; beside a
    torque, which is no noise, and beside neither the fit is that of the white noise."""
    walk = spoil_rates([0.0] * 3, 4.0)
    kept, narrow = dd.fit(walk), dd.fit(walk, noise="stated")
    (known, plain), truth = (fit.parameters["inertia_ratio"] for fit in (kept, narrow)), 0.55
    assert abs(plain.estimate - truth) > 3.0 * plain.sd and known.q025 < truth < known.q975
    assert kept.goodness.chi2_reduced < 1.2 < narrow.goodness.chi2_reduced
    assert all(one.slow_sd for one in kept.noise.values())
    for campaign in (spoil_rates([3e-7, 2e-7, 4e-7], 0.0), spoil_rates([0.0] * 3, 0.0)):
        assert not any(one.slow_sd for one in dd.fit(campaign).noise.values())
