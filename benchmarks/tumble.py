"""Torque-perturbed tumbling: ours beside SciPy's DOP853 and heyoka's Taylor method, at equal accuracy, in one process.

    python -m benchmarks.tumble [--count 4096] [--repeats 3] [-o result.json]

A body with moments (1, 1, 0.55) under an eddy-current torque and a constant one turns at 0.05 to 0.3 rad/s for 600 s;
rates and attitude are wanted every 10 s. Tolerances (and our step) are the loosest of a ladder at which the worst
of 64 trajectories is within 1e-9 of a reference of heyoka at 1e-16. Timed: many trajectories, one trajectory, and the
gradient of the last rates by the three starting rates and the eddy constant. SciPy runs on a sample of the many, and
its time is scaled up. heyoka integrates them in batches of its vector width, its gradient by variational equations;
SciPy's gradient is by central differences. Compiling is told apart.
"""

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.records import describe_machine, summarise, write_result


RATIO, END, POINTS = 0.55, 600.0, 61
TORQUE = np.array([2e-6, -1e-6, 5e-7])
WANTED = 1e-9
SAMPLE = 24  # trajectories that SciPy integrates


def main(arguments=None):
    """Run the comparison and print it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tumble", description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=4096, help="trajectories (default 4096)")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    rates, eddy = draw(options.count)
    reference = Heyoka(1e-16).many(rates[:64], eddy[:64])
    found = {"benchmark": "tumble", "count": options.count, "wanted": WANTED, "machine": describe_machine()}
    for name, kind, ladder in (("ours", Ours, (1.6, 1.3, 1.0, 0.8, 0.6, 0.45)),
                               ("heyoka", Heyoka, (1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11)),
                               ("scipy", Scipy, (1e-8, 1e-9, 1e-10, 1e-11, 1e-12))):
        for setting in ladder:
            solver = kind(setting)
            few = 64 if name != "scipy" else SAMPLE
            error = float(np.abs(solver.many(rates[:few], eddy[:few]) - reference[:few]).max())
            if error < WANTED:
                break
        found[name] = {"setting": setting, "error": error, **clock(solver, rates, eddy, options.repeats)}
        print(name, found[name])
    check = [found[name].pop("gradient_value") for name in ("ours", "heyoka", "scipy")]
    found["gradient_difference"] = [float(np.abs(np.array(check[0]) - np.array(c)).max() / np.abs(check[0]).max())
                                    for c in check[1:]]
    for task in ("many", "one", "gradient"):
        ours = found["ours"][task]["median_s"]
        print(f"{task}: ours {ours:.4g} s, " + ", ".join(
            f"{name} {found[name][task]['median_s']:.4g} s ({found[name][task]['median_s'] / ours:.2f} x ours)"
            for name in ("heyoka", "scipy")))
    write_result(found, options.output)
    return found


def draw(count):
    """Starting rates, shape (count, 3), and eddy constants, shape (count,)."""
    rng = np.random.default_rng(11)
    way = rng.standard_normal((count, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    return way * rng.uniform(0.05, 0.3, count)[:, None], rng.uniform(1e-5, 4e-4, count)


def clock(solver, rates, eddy, repeats):
    """Times of the three tasks."""
    few = SAMPLE if isinstance(solver, Scipy) else len(rates)
    began = time.perf_counter()
    solver.many(rates[:few], eddy[:few])
    first = time.perf_counter() - began
    many = [measure(lambda: solver.many(rates[:few], eddy[:few])) * len(rates) / few for _ in range(repeats)]
    solver.one(rates[0], eddy[0])
    one = [measure(lambda k=k: solver.one(rates[k], eddy[k])) for k in range(1, 8)]
    value = solver.gradient(rates[0], eddy[0])
    gradient = [measure(lambda k=k: solver.gradient(rates[k], eddy[k])) for k in range(1, 8)]
    return {"many": summarise(many), "many_first_s": round(first, 3),
            "one": {"median_s": float(np.median(one))}, "gradient": {"median_s": float(np.median(gradient))},
            "gradient_value": np.asarray(value).tolist()}


def measure(work):
    """Seconds that it takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


class Ours:
    """`spin` on an even mesh, batched by vmap."""

    def __init__(self, step):
        import jax
        import jax.numpy as jnp

        from ddetumble.contact.torque import RigidBody
        from ddetumble.dynamics.spinning import START, spin
        from ddetumble.effects.tumble import ConstantTorque, EddyCurrent

        times = jnp.linspace(0.0, END, POINTS)
        mesh = jnp.linspace(0.0, END, 60 * max(1, int(np.ceil(END * 0.3 / step / 60))) + 1)

        def run(rate, eddy):
            law = RigidBody(RATIO).extend((EddyCurrent(eddy), ConstantTorque(*TORQUE)))
            found = spin(law, dict(zip(START, rate, strict=True)), times, mesh)
            return jnp.concatenate([found.body, found.attitude], axis=1)

        self._one = jax.jit(run)
        # LLVM takes vectors of 256 bits unless it is told; a processor that has no wider ones does not mind.
        self._many = jax.jit(jax.vmap(run), compiler_options={"xla_cpu_prefer_vector_width": 512})
        self._gradient = jax.jit(jax.jacfwd(lambda p: run(p[:3], p[3])[-1, :3]))
        self._ready = jax.block_until_ready

    def many(self, rates, eddy):
        """Rates and attitudes, shape (count, times, 7)."""
        return np.asarray(self._many(rates, eddy))

    def one(self, rate, eddy):
        """The same of one."""
        return np.asarray(self._one(rate, eddy))

    def gradient(self, rate, eddy):
        """Last rates by starting rates and eddy constant, shape (3, 4)."""
        return np.asarray(self._gradient(np.append(rate, eddy)))


def field(y, eddy):
    """Derivatives of rates and attitude, for sequences of numbers or expressions."""
    x, v, z, a, b, c, d = y
    moments = (1.0, 1.0, RATIO)
    rates = [((moments[1] - moments[2]) * v * z - eddy * x + TORQUE[0]) / moments[0],
             ((moments[2] - moments[0]) * z * x - eddy * v + TORQUE[1]) / moments[1],
             ((moments[0] - moments[1]) * x * v - eddy * z + TORQUE[2]) / moments[2]]
    return [*rates, 0.5 * (-b * x - c * v - d * z), 0.5 * (a * x + c * z - d * v), 0.5 * (a * v + d * x - b * z),
            0.5 * (a * z + b * v - c * x)]


class Scipy:
    """DOP853 of SciPy."""

    def __init__(self, rtol):
        self.rtol = rtol

    def one(self, rate, eddy):
        """As `Ours`."""
        from scipy.integrate import solve_ivp

        start = [*rate, 1.0, 0.0, 0.0, 0.0]
        return solve_ivp(lambda t, y: field(y, eddy), (0.0, END), start, method="DOP853", rtol=self.rtol,
                         atol=1e-2 * self.rtol, t_eval=np.linspace(0.0, END, POINTS)).y.T

    def many(self, rates, eddy):
        """As `Ours`."""
        return np.stack([self.one(r, e) for r, e in zip(rates, eddy, strict=True)])

    def gradient(self, rate, eddy):
        """As `Ours`, by central differences."""
        columns = []
        for k, h in enumerate((1e-5, 1e-5, 1e-5, 1e-7)):
            ends = []
            for side in (h, -h):
                p = np.append(rate, eddy)
                p[k] += side
                ends.append(self.one(p[:3], p[3])[-1, :3])
            columns.append((ends[0] - ends[1]) / (2 * h))
        return np.stack(columns, axis=1)


class Heyoka:
    """heyoka's Taylor method: one at a time, in batches, and with variational equations."""

    def __init__(self, tolerance):
        import heyoka as hy

        names = hy.make_vars("x", "v", "z", "a", "b", "c", "d")
        system = list(zip(names, field(names, hy.par[0]), strict=True))
        self.width = hy.recommended_simd_size()
        self._batch = hy.taylor_adaptive_batch(system, np.zeros((7, self.width)) + 0.1, tol=tolerance)
        self._one = hy.taylor_adaptive(system, [0.1] * 7, tol=tolerance)
        varied = hy.var_ode_sys(system, [*names[:3], hy.par[0]], order=1)
        self._varied = hy.taylor_adaptive(varied, [0.1] * 7, tol=tolerance, compact_mode=True)
        self._start = self._varied.state[7:].copy()
        self._grid = np.linspace(0.0, END, POINTS)

    def many(self, rates, eddy):
        """As `Ours`."""
        out, width = np.empty((len(rates), POINTS, 7)), self.width
        grid = np.repeat(self._grid[:, None], width, axis=1)
        for k in range(0, len(rates), width):
            part = np.minimum(np.arange(k, k + width), len(rates) - 1)
            self._batch.set_time(0.0)
            self._batch.state[:3] = rates[part].T
            self._batch.state[3:] = np.array([1.0, 0.0, 0.0, 0.0])[:, None]
            self._batch.pars[0] = eddy[part]
            found = self._batch.propagate_grid(grid)
            values = found[-1] if isinstance(found, tuple) else found
            count = min(width, len(rates) - k)
            out[k:k + count] = np.moveaxis(values, 2, 0)[:count]
        return out

    def one(self, rate, eddy):
        """As `Ours`."""
        self._one.time = 0.0
        self._one.state[:] = [*rate, 1.0, 0.0, 0.0, 0.0]
        self._one.pars[0] = eddy
        return self._one.propagate_grid(self._grid)[-1]

    def gradient(self, rate, eddy):
        """As `Ours`."""
        self._varied.time = 0.0
        self._varied.state[:7] = [*rate, 1.0, 0.0, 0.0, 0.0]
        self._varied.state[7:] = self._start
        self._varied.pars[0] = eddy
        self._varied.propagate_until(END)
        return np.array([self._varied.state[self._varied.get_vslice(order=1, component=i)] for i in range(3)])


if __name__ == "__main__":
    main()
