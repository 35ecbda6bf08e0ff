"""What a strong user would write by hand for friction: vectorised NumPy, and SciPy's least squares for every effect.

    python benchmarks/slip_peer.py CAMPAIGN [--refit | --one-step]      (needs numpy, scipy, pandas)

It does the work of `ddetumble discover` on a slip campaign: fits the reference model (Eqs. 8 to 11) and each of the six
effects on top of it, from the same starts, with load and pressure of every record as nuisances; holds out every
condition in turn; adds the effect that predicts best, and goes on with pairs while a misfit is left. Derivatives are
differences, and use that a nuisance touches its own record only: all loads are moved at once. What is left out is
predicted by a fit without it, from where the full fit ended; `--one-step` takes one Gauss-Newton step instead, as the
toolkit does. Noise counts as white, of the stated size: it is not measured, and there are no places of a misfit and no
intervals.
"""

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.optimize import least_squares
from scipy.stats import chi2


MODULUS = 7.8e6 / (1 - 0.47**2)  # Pa, E* of Eq. 8
REFERENCE = {"K": 0.8, "tan": 0.15, "scale": 1.0}
NULLS = {"A": 0.0, "u_s": 0.1, "c_t": 0.0, "m": 0.0, "s_0": 0.0, "kappa": 0.0, "f_a": 0.0}
LOGARITHMIC = ("K", "tan", "u_s")
EFFECTS = {
    "stribeck": [{"A": 0.2, "u_s": 0.03}, {"A": 0.2, "u_s": 0.1}, {"A": 0.2, "u_s": 0.3}],
    "viscous-friction": [{"c_t": 0.5}], "load-exponent": [{"m": 0.05}], "presliding": [{"s_0": 2e-4}],
    "frictional-heating": [{"kappa": 2.0}], "adhesive-offset": [{"f_a": 0.2}],
}  # fmt: skip
SCALES = {"scale": 0.3, "A": 0.2, "c_t": 1.0, "m": 0.05, "s_0": 1e-4, "kappa": 2.0, "f_a": 0.3}
LEVEL, MOST = 1e-3, 3  # of the stated noise alone chi-square is no finer test


class Campaign:
    """Samples of all records side by side, shape (records, samples); what is missing has weight 0."""

    def __init__(self, folder):
        folder = Path(folder)
        records, samples = pd.read_csv(folder / "records.csv"), pd.read_csv(folder / "samples.csv")
        units, sds = read_fields(folder)
        groups = [group for _, group in samples.groupby("record", sort=False)]
        order = {key: i for i, key in enumerate(records["record"])}
        groups.sort(key=lambda group: order[group["record"].iloc[0]])
        size = max(map(len, groups))
        shape = (len(groups), size)
        self.slip, self.way, self.force = np.zeros(shape), np.ones(shape), np.zeros(shape)
        self.weight = np.zeros(shape)
        for i, group in enumerate(groups):
            n, path = len(group), group["slip"].to_numpy() * units["slip"]
            turned = np.sign(np.diff(path, prepend=path[0] - 1.0))
            starts = np.flatnonzero(np.diff(turned)) if "time" in group else np.array([], int)
            origin = np.zeros(n)
            for k in starts:
                origin[k + 1:] = path[k]
            self.slip[i, :n], self.way[i, :n] = np.abs(path - origin), turned
            self.slip[i, n:] = self.slip[i, n - 1]
            measured = group["tangential_force"].to_numpy() * units["tangential_force"]
            valid = np.isfinite(measured)
            for k in starts:
                valid[max(k - 1, 0):k + 2] = False
            self.force[i, :n] = np.nan_to_num(measured)
            self.weight[i, :n] = valid / sds["tangential_force"]
        self.load = records["normal_load"].to_numpy() * units["normal_load"]
        self.pressure = records["internal_pressure"].to_numpy() * units["internal_pressure"]
        self.speed = records["slip_speed"].to_numpy() * units["slip_speed"]
        self.sd = np.array([sds["normal_load"], sds["internal_pressure"]])  # relative
        self.step = np.diff(self.slip, axis=1, prepend=0.0)
        self.step = np.where(self.step < 0, self.slip, self.step)
        self.groups = group_conditions(np.stack([self.load, self.pressure, self.speed]))


def read_fields(folder):
    """Size of every column's unit in SI, and its stated deviation: absolute in SI, relative where in per cent."""
    sizes = {"m": 1.0, "mm": 1e-3, "s": 1.0, "ms": 1e-3, "N": 1.0, "MPa": 1e6, "Pa": 1.0, "bar": 1e5, "m/s": 1.0,
             "mm/s": 1e-3}  # fmt: skip
    units, sds = {}, {}
    for resource in json.loads((folder / "datapackage.json").read_text(encoding="utf-8"))["resources"]:
        for field in resource["schema"]["fields"]:
            if "unit" in field:
                units[field["name"]] = sizes[field["unit"]]
            if "uncertainty" in field:
                number, unit = field["uncertainty"].split()
                sds[field["name"]] = float(number) * (0.01 if unit == "%" else sizes[unit])
    return units, sds


def group_conditions(settings):
    """Number of the condition of each record: settings closer than 3 % are one."""
    labels = []
    for values in settings:
        order = np.argsort(values)
        label = np.zeros(len(values), int)
        label[order[1:]] = np.cumsum(np.diff(values[order]) / values[order[1:]] > 0.03)
        labels.append(label)
    return np.unique(np.stack(labels, axis=1), axis=0, return_inverse=True)[1].ravel()


def predict(p, c, load, pressure):
    """Friction of all records, shape (records, samples) [N]; `load` and `pressure` of shape (records,)."""
    x, n = 1e3 * c.slip, load[:, None]
    a = 0.74769 - 0.01684 * n
    b = -0.13056 - 0.01728 * n + 5.35714e-4 * n**2
    cc = -1.04239 + 0.00583 * n - 4.07238e-4 * n**2
    d = 0.010619 + 0.01829 * n - 7.75e-4 * n**2
    up, down = np.exp((b + d) * x), np.exp((b - d) * x)
    slipping = p["scale"] * (a + 0.5 * a * (cc * (up - down) - up - down))
    rubber = p["tan"] * (0.125 * np.pi * p["K"] + 0.1 * np.pi * (3 * pressure / MODULUS) ** (2 / 3))
    rubber = rubber * (1 + p["A"] * np.exp(-((c.speed / p["u_s"]) ** 2)))
    rubber = rubber[:, None] * (1 - np.exp(-c.slip / p["s_0"]) if p["s_0"] > 0 else 1.0)
    normal = n * (n / 10) ** -p["m"]
    more = p["c_t"] * c.speed[:, None] + p["f_a"]
    cold, rest = rubber * normal + 0 * x, slipping * normal + more
    if p["kappa"] == 0:
        return c.way * (cold + rest)
    work, before, heated = np.zeros(len(load)), np.zeros(len(load)), np.empty_like(cold)
    fresh = np.zeros(len(load)) if p["s_0"] > 0 else (rubber * normal)[:, 0]
    begins = c.slip <= c.step
    for k in range(x.shape[1]):  # Heun's method from sample to sample, all records at once
        step = c.step[:, k]
        before = np.where(begins[:, k], fresh * np.exp(-p["kappa"] * work) + more[:, 0], before)
        guess = work + step * np.abs(before)
        now = cold[:, k] * np.exp(-p["kappa"] * guess) + rest[:, k]
        work = work + 0.5 * step * (np.abs(before) + np.abs(now))
        heated[:, k] = before = cold[:, k] * np.exp(-p["kappa"] * work) + rest[:, k]
    return c.way * heated


class Fit:
    """A least-squares problem of named parameters and the nuisances of every record."""

    def __init__(self, c, names, used=None):
        self.c, self.names = c, tuple(names)
        self.weight = c.weight if used is None else c.weight * used[:, None]
        self.records = np.arange(len(c.load))

    def read(self, z):
        """Parameters by name, and the nuisances, shape (records, 2)."""
        p, k = NULLS | REFERENCE, len(self.names)
        for name, value in zip(self.names, z[:k], strict=True):
            p[name] = float(np.exp(np.clip(value, -30, 30))) if name in LOGARITHMIC else float(value * SCALES[name])
        return p, z[k:].reshape(-1, 2)

    def write(self, p):
        """Values by name as coordinates."""
        return np.array([np.log(p[n]) if n in LOGARITHMIC else p[n] / SCALES[n] for n in self.names])

    def force(self, z):
        """Model at coordinates, shape (records, samples)."""
        p, own = self.read(z)
        return predict(p, self.c, self.c.load * (1 + self.c.sd[0] * own[:, 0]),
                       self.c.pressure * (1 + self.c.sd[1] * own[:, 1]))

    def residual(self, z):
        """Weighted residuals and nuisances in their deviations."""
        return np.concatenate([(self.weight * (self.force(z) - self.c.force)).ravel(), z[len(self.names):]])

    def columns(self, z):
        """Derivatives by differences: of shared parameters, and of each nuisance in all records at once."""
        k, base, step = len(self.names), self.force(z), 1e-6
        found = []
        for i in range(k + 2):
            moved = z.copy()
            moved[i if i < k else slice(i, None, 2)] += step
            found.append(self.weight * (self.force(moved) - base) / step)
        return found[:k], found[k:]

    def jacobian(self, z):
        """The whole Jacobian, shape (samples + nuisances, parameters + nuisances)."""
        k, (shared, own) = len(self.names), self.columns(z)
        count, size = self.c.force.shape
        whole = np.zeros((count * size + 2 * count, k + 2 * count))
        whole[: count * size, :k] = np.stack([column.ravel() for column in shared], axis=1)
        blocks = whole[: count * size, k:].reshape(count, size, count, 2)
        for j in (0, 1):
            blocks[self.records, :, self.records, j] = own[j]
        whole[count * size + np.arange(2 * count), k + np.arange(2 * count)] = 1.0
        return whole

    def solve(self, start):
        """Least squares from a start; coordinates and chi-square."""
        found = least_squares(self.residual, start, jac=self.jacobian,  # pyright: ignore[reportArgumentType]
                              method="lm", ftol=1e-8, xtol=1e-8, max_nfev=60)  # fmt: skip
        return found.x, 2 * found.cost


def fit_effect(c, names, more, start):
    """Best fit over the starts of an effect, or None where an amplitude comes out on the wrong side."""
    best: Any = None
    for values in more:
        fit = Fit(c, (*names, *values))
        z, loss = fit.solve(np.concatenate([start[: len(names)], Fit(c, values).write(values), start[len(names):]]))
        if best is None or loss < best[2]:
            best = fit, z, loss
    p, _ = best[0].read(best[1])
    wrong = any(p[n] < 0 for n in ("c_t", "s_0", "kappa", "f_a"))
    return None if wrong else best


def hold_out(c, fit, z, one_step):
    """Loss of every record by a fit without its condition, its own nuisances profiled by one step."""
    k, loss = len(fit.names), np.zeros(len(c.load))
    if one_step:
        return step_out(c, fit, z)
    for group in np.unique(c.groups):
        out = c.groups == group
        other = Fit(c, fit.names, ~out)
        found, _ = other.solve(z)
        found[k:].reshape(-1, 2)[out] = z[k:].reshape(-1, 2)[out]
        _, own = fit.columns(found)
        residual = c.weight * (fit.force(found) - c.force)
        for r in np.flatnonzero(out):
            side = np.vstack([np.stack([own[0][r], own[1][r]], axis=1), np.eye(2)])
            left = np.concatenate([residual[r], found[k + 2 * r: k + 2 * r + 2]])
            loss[r] = np.sum((left - side @ np.linalg.lstsq(side, left, rcond=None)[0]) ** 2)
    return loss


def step_out(c, fit, z):
    """The same by one Gauss-Newton step from the full fit, nuisances projected out of each record."""
    shared, own = fit.columns(z)
    residual = c.weight * (fit.force(z) - c.force)
    count, k = len(c.load), len(fit.names)
    a = np.concatenate([np.stack(shared, axis=2), np.zeros((count, 2, k))], axis=1)
    b = np.concatenate([np.stack(own, axis=2), np.broadcast_to(np.eye(2), (count, 2, 2))], axis=1)
    y = np.concatenate([residual, z[k:].reshape(-1, 2)], axis=1)
    q, _ = np.linalg.qr(b)
    a = a - q @ (q.transpose(0, 2, 1) @ a)
    y = y - (q @ (q.transpose(0, 2, 1) @ y[:, :, None]))[:, :, 0]
    blocks, sides = np.einsum("rsk,rsl->rkl", a, a), np.einsum("rsk,rs->rk", a, y)
    loss = np.zeros(count)
    for group in np.unique(c.groups):
        out = c.groups == group
        left, right = blocks[~out].sum(axis=0), sides[~out].sum(axis=0)
        step = np.linalg.lstsq(left, -right, rcond=1e-12)[0]
        loss[out] = np.sum((y[out] + a[out] @ step) ** 2, axis=1)
    return loss


def discover(c, one_step):
    """Forward selection: rows of the first round, best first, and the effects that were added."""
    count = int((c.weight > 0).sum())
    names, start = tuple(REFERENCE), np.zeros(3 + 2 * len(c.load))
    fit = Fit(c, names)
    start[:3] = fit.write(REFERENCE)
    z, loss = fit.solve(start)
    held = hold_out(c, fit, z, one_step)
    first, added, rest = [], [], dict(EFFECTS)
    while len(added) < MOST and (not first or chi2.sf(loss, count - len(names)) < LEVEL):
        rows = []
        for effect, starts in rest.items():
            found = fit_effect(c, names, starts, z)
            if found is not None:
                out = hold_out(c, found[0], found[1], one_step)
                rows.append((float(out.sum()), effect, found[2] / count, found, out))
        rows.sort(key=lambda row: row[0])
        first = first or rows
        if not rows or chi2.sf(loss, count - len(names)) >= LEVEL:
            break
        gain = held - rows[0][4]
        sums = np.array([gain[c.groups == g].sum() for g in np.unique(c.groups)])
        if sums.sum() < max(9.0, 2 * np.sqrt(len(sums)) * sums.std(ddof=1)):
            break
        _, effect, _, (fit, z, loss), held = rows[0]
        names = fit.names
        added.append(effect)
        rest.pop(effect)
    return first, added, loss / count


def main():
    """Run on the campaign that the command line names; rows of the first round, best first."""
    c = Campaign(sys.argv[1])
    began = time.perf_counter()
    rows, added, left = discover(c, "--one-step" in sys.argv)
    wall = time.perf_counter() - began
    for row in rows:
        print(f"{row[1]:20s} held out {row[0]:9.1f}  chi2/N {row[2]:.3f}")
    print(f"added {', '.join(added) or 'nothing'}; chi2/N {left:.3f}")
    print(f"wall {wall:.3f} s for {len(EFFECTS)} effects, {len(c.load)} records, {int((c.weight > 0).sum())} samples")
    return rows


if __name__ == "__main__":
    main()
