"""What a GPU is good for: the same computations on JAX's default device and on the processor, in one process.

    python -m benchmarks.accelerator [--repeats 3] [-o result.json]

Batches of impacts and of tumbling bodies with `jax.vmap`, each with its gradient, in sizes from 1 to many; a fit of a
shipped campaign, which is many small steps one after the other. Told are the time of a run once compiled (median), the
ratio, and the largest difference between the two devices relative to the largest value. It needs a JAX that sees an
accelerator.
"""

import argparse
import os
import statistics
import time
from pathlib import Path

import numpy as np

from benchmarks.records import describe_machine, print_table, write_result


SIZES = (1, 256, 4096)
CAMPAIGN = "impact-i"


def main(arguments=None):
    """Run everything on both devices and print a table."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.accelerator", description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("-o", "--output", type=Path, metavar="FILE")
    options = parser.parse_args(arguments)
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")
    import jax

    default, processor = jax.devices()[0], jax.devices("cpu")[0]
    tasks = {f"{name} of {size}": (run, draw(size)) for name, (run, draw) in list_batches().items() for size in SIZES}
    tasks |= {f"{name} of {CAMPAIGN}": (run, ()) for name, run in list_verbs().items()}
    rows, found = [], {}
    for name, (run, inputs) in tasks.items():
        values, times = {}, {}
        for device in (default, processor):
            with jax.default_device(device):
                placed = jax.device_put(inputs, device)
                began = time.perf_counter()
                values[device] = np.asarray(run(*placed))
                first = time.perf_counter() - began
                runs = [measure(run, placed) for _ in range(options.repeats)]
                times[device] = {"first_s": round(first, 3), "median_s": round(statistics.median(runs), 6)}
        largest = np.abs(values[processor]).max()
        difference = float(np.abs(values[default] - values[processor]).max() / largest)
        found[name] = {"default": times[default], "processor": times[processor], "difference": difference}
        ratio = times[processor]["median_s"] / times[default]["median_s"]
        rows.append((name, times[default]["median_s"], times[processor]["median_s"], f"{ratio:.2f}",
                     f"{difference:.1e}"))
        print(*rows[-1], flush=True)
    print_table(("task", f"{default.device_kind} [s]", "processor [s]", "ratio", "difference"), rows)
    write_result({"benchmark": "accelerator", "device": default.device_kind, "machine": describe_machine(),
                  "tasks": found}, options.output)
    return found


def measure(run, inputs):
    """Seconds that one run takes, with its result on the host."""
    began = time.perf_counter()
    np.asarray(run(*inputs))
    return time.perf_counter() - began


def list_batches():
    """By name: a compiled function of a batch, and what draws its inputs."""
    import jax
    import jax.numpy as jnp

    import ddetumble as dd
    from ddetumble.contact.torque import RigidBody
    from ddetumble.dynamics.spinning import START, spin
    from ddetumble.effects.tumble import ConstantTorque, EddyCurrent

    times = jnp.linspace(0.0, 0.02, 200)

    def strike(speed, pressure):
        conditions = {"approach_speed": speed, "initial_pressure": pressure}
        return dd.dynamics.simulate_impact(dd.Ball(), conditions, times).normal_force

    wanted, mesh = jnp.linspace(0.0, 600.0, 61), jnp.linspace(0.0, 600.0, 241)

    def turn(rate, eddy):
        law = RigidBody(0.55).extend((EddyCurrent(eddy), ConstantTorque(2e-6, -1e-6, 5e-7)))
        return spin(law, dict(zip(START, rate, strict=True)), wanted, mesh).body

    def draw_strikes(size):
        rng = np.random.default_rng(1)
        return rng.uniform(0.3, 1.5, size), rng.uniform(1.5e5, 4e5, size)

    def draw_bodies(size):
        rng = np.random.default_rng(2)
        return rng.uniform(-0.2, 0.2, (size, 3)), rng.uniform(1e-5, 4e-4, size)

    return {
        "impacts": (jax.jit(jax.vmap(strike)), draw_strikes),
        "gradients of impacts": (jax.jit(jax.vmap(jax.grad(lambda *a: jnp.max(strike(*a))))), draw_strikes),
        "tumbling bodies": (jax.jit(jax.vmap(turn)), draw_bodies),
        "gradients of tumbling bodies": (jax.jit(jax.vmap(jax.grad(lambda *a: jnp.sum(turn(*a)[-1] ** 2)))),
                                         draw_bodies),
    }


def list_verbs():
    """By name: a verb on a shipped campaign, and the numbers that it gives."""
    import ddetumble as dd

    def fit():
        return [one.estimate for one in dd.fit(CAMPAIGN).parameters.values()]

    return {"fit": fit}


if __name__ == "__main__":
    main()
