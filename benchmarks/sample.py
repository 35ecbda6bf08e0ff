"""Independent draws a second: our emcee beside emcee with a Numba simulator, on one target, in one process.

    python -m benchmarks.sample CAMPAIGN --peer FILE.py [--effect stress-softening] [-o result.json]

The target is the posterior of the reference model's mass and restitution and one effect's parameters, each record's
pressure, speed and time origin integrated out about the same points. The peer is the simulator of a file like that of
`benchmarks.discover` (with `load`, `campaign`, `NAMES`, `NULL`, `SCALE`), its derivatives by those three differences,
and emcee as one meets it: 32 walkers, stretch moves. `--joint` samples the nuisances along with the parameters
instead, which is what one writes first. Everything runs on one core.
"""

import argparse
import os
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.discover import load_peer, locate
from benchmarks.records import describe_machine, write_result


SLOTS = {"effective_mass": "m", "restitution": "e", "stress-softening.sigma_m": "sig", "stress-softening.j_0": "j0",
         "adhesion.tau_a": "ta", "wall-stiffness.k_w": "kw", "polytropic-gas.n": "n", "arm-servo.k_s": "ks"}
STEPS = 2  # of the peer's integrator from sample to sample, as in its own fits


def main(arguments=None):
    """Run the comparison and print it."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.sample", description=__doc__.splitlines()[0])
    parser.add_argument("campaign", metavar="CAMPAIGN", help="folder, or name of a shipped campaign")
    parser.add_argument("--peer", metavar="FILE", type=Path, required=True)
    parser.add_argument("--effect", metavar="ID", default="stress-softening")
    parser.add_argument("--repeats", type=int, default=3, help="chains of ours, each of its own seed (default 3)")
    parser.add_argument("--peer-steps", type=int, default=1500, help="of each of the peer's walkers (default 1500)")
    parser.add_argument("--joint", action="store_true", help="also time the peer on parameters and nuisances together")
    parser.add_argument("-o", "--output", metavar="FILE", type=Path, help="also write the result as JSON")
    options = parser.parse_args(arguments)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    # The peer's compiled code goes to a folder of our own, not beside its file.
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("NUMBA_CACHE_DIR", folder)
        result = compare(options)
    write_result(result, options.output)
    return result


def compare(options):
    """Time both."""
    from ddetumble import fit, read_campaign
    from ddetumble.posterior import pose_fit
    from ddetumble.posterior.chain import Settings, run_chains
    from ddetumble.posterior.ensemble import Ensembles

    module = load_peer(options.peer)  # before anything that takes long
    campaign = read_campaign(locate(options.campaign))
    fitted = fit(campaign, effects=[options.effect], noise="stated")
    target = pose_fit(fitted)
    run_chains(Ensembles, target, Settings(burn=4, block=4, most=4, effective=10**9))  # compiles
    ours = []
    for seed in range(options.repeats):
        began = time.perf_counter()
        chains = run_chains(Ensembles, target, Settings(seed=seed))
        seconds = time.perf_counter() - began
        ours.append({"seconds": seconds, "effective": chains.convergence.effective, "rhat": chains.convergence.rhat,
                     "evaluations": chains.statistics['evaluations'], "time": float(chains.convergence.times.max())})
        print(f"ours, seed {seed}: {seconds:.0f} s, {chains.statistics['evaluations']} densities, "
              f"{chains.convergence.effective:.0f} independent draws", flush=True)
    peer = Peer(module, locate(options.campaign), target, fitted)
    rng = np.random.default_rng(0)
    x = target.draw_inside(rng, 20)
    theirs, mine = np.array([peer.log_density(one) for one in x]), target.log_density(x)
    off = float(np.ptp(theirs - mine))
    print(f"same target: over 20 draws the two densities differ by a constant within {off:.2g}")
    found = {"benchmark": "sample", "campaign": options.campaign, "effect": options.effect,
             "records": campaign.records.shape[0], "samples": len(campaign.samples), "free": len(target.names),
             "ours": ours, "disagreement": off, "machine": describe_machine(), "peer_file": options.peer.name}
    found["peer"] = peer.sample(peer.log_density, x, options.peer_steps)
    if options.joint:
        found["joint"] = peer.sample_joint(x, options.peer_steps)
    rate = np.median([one["effective"] / one["seconds"] for one in ours])
    found["ours_per_second"] = float(rate)
    print(f"ours: {rate:.0f} independent draws a second (median of {options.repeats})")
    for name in ("peer", "joint"):
        if name in found:
            own = found[name]["effective"] / found[name]["seconds"]
            found[name]["per_second"], found[name]["ratio"] = own, rate / own
            print(f"{name}: {own:.2f} a second, autocorrelation time {found[name]['time']:.0f} steps: ours is "
                  f"{rate / own:.1f} times as fast")
    return found


class Peer:
    """What one writes by hand around the peer's simulator.

    Args:
        module: of the peer.
        folder: of the campaign.
        target: for the points about which nuisances are integrated out, and the order of the parameters.
        fitted: the fit.
    """

    def __init__(self, module, folder, target, fitted):
        self.module, self.target = module, target
        self.data = module.load(folder)
        self.places = [module.NAMES.index(SLOTS[name]) for name in target.names]
        self.kinds = target.coordinates
        plan = target.plan
        self.own, self.slope = np.asarray(plan.own), np.asarray(plan.slope)
        self.centre = np.asarray(plan.centre)
        noise = next(iter(fitted.noise.values()))
        lengths = self.data["lens"]
        time_axis = np.concatenate([s + d * np.arange(n) for s, d, n in
                                    zip(self.data["starts"], self.data["dts"], lengths, strict=True)])
        self.weight = np.where(np.abs(time_axis) > 1.5e-4, 1.0 / noise.sd, 0.0)
        self.cuts = np.cumsum(lengths)[:-1]
        self.out = np.empty(len(self.data["F"]))

    def simulate(self, x, z):
        """Whitened residual at coordinates x and nuisances z, shape (records, 3)."""
        module, data = self.module, self.data
        p = module.NULL.copy()
        p[self.places] = [np.exp(u) if k == "log" else 1 / (1 + np.exp(-u)) if k == "logit" else u
                          for u, k in zip(x, self.kinds, strict=True)]
        module.campaign(data["starts"], data["dts"], data["lens"], data["P0"], data["v1"], data["seq"],
                        z[:, 0] * 0.005, z[:, 1] * 0.003, z[:, 2] * 5e-5, p, STEPS, self.out)
        return (self.out - data["F"]) * self.weight

    def log_density(self, x):
        """Nuisances integrated out, by differences."""
        z = self.own + self.slope @ (x - self.centre)
        r, step, columns = self.simulate(x, z), 1e-4, []
        for k in range(3):
            moved = z.copy()
            moved[:, k] += step
            columns.append((self.simulate(x, moved) - r) / step)
        total = 0.0
        for k, (rest, own) in enumerate(zip(np.split(r, self.cuts), np.split(np.stack(columns, 1), self.cuts),
                                            strict=True)):
            corner = np.eye(3) + own.T @ own
            g = own.T @ rest + z[k]
            total -= 0.5 * (rest @ rest + z[k] @ z[k] - g @ np.linalg.solve(corner, g)
                            + np.linalg.slogdet(corner)[1])
        return total if np.isfinite(total) else -np.inf

    def joint_density(self, v):
        """Parameters and nuisances together."""
        free = len(self.places)
        z = v[free:].reshape(-1, 3)
        r = self.simulate(v[:free], z)
        total = -0.5 * (r @ r + v[free:] @ v[free:])
        return total if np.isfinite(total) else -np.inf

    def sample(self, density, x, steps):
        """emcee with its defaults."""
        walkers = max(32, 2 * x.shape[1] + 2)
        start = self.centre + (x.std(axis=0) * np.random.default_rng(1).standard_normal((walkers, x.shape[1])))
        return self._run(density, start, steps)

    def sample_joint(self, x, steps):
        """The same over parameters and nuisances."""
        rng, count = np.random.default_rng(1), len(self.places) + self.own.size
        start = np.concatenate([self.centre + x.std(axis=0) * rng.standard_normal((2 * count + 2, x.shape[1])),
                                self.own.ravel() + 0.3 * rng.standard_normal((2 * count + 2, self.own.size))], axis=1)
        return self._run(self.joint_density, start, steps)

    def _run(self, density, start, steps):
        import emcee

        from ddetumble.posterior.diagnostics import measure_times

        sampler = emcee.EnsembleSampler(*start.shape, density)
        began = time.perf_counter()
        sampler.run_mcmc(start, steps)
        seconds = time.perf_counter() - began
        chain = sampler.get_chain()[steps // 5:]
        times = measure_times(chain)[: len(self.places)]
        return {"seconds": seconds, "effective": float(chain.shape[0] * chain.shape[1] / times.max()),
                "time": float(times.max()), "evaluations": steps * start.shape[0], "walkers": start.shape[0]}


if __name__ == "__main__":
    main()
