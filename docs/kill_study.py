"""Kill a sampling process at random moments and see what is left: `python -m docs.kill_study -o fits/kill-study`.

Every round starts the sampling of one chain in a process of its own, kills that with SIGKILL at a random moment, and
reads the folder; the next round goes on from what is there. A chain that has come to its end is compared with one
that nobody disturbed, number by number, and a new one begins. Writes `result.json` and `README.md`.
"""

import argparse
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ddetumble.inference.files import list_versions, write_json
from ddetumble.posterior.chain import Settings, read_arrays, run_chains
from ddetumble.posterior.ensemble import Ensembles
from ddetumble.posterior.target import CurveTarget, pose_curve


ROOT = Path(__file__).resolve().parent.parent
SETTINGS = Settings(walkers=64, ensembles=4, burn=60, block=20, effective=10**9, most=800, seed=7)
TIMES = np.linspace(0.0, 4.0, 60)
CHECKED = ("x", "log_density", "random_keys", "random_rest")


def decay(x, data):
    """Whitened residual of a decaying oscillation."""
    time, value = data
    return (x[0] * jnp.exp(-x[1] * time) * jnp.cos(x[2] * time) - value) / 0.05


def make_target() -> CurveTarget:
    """Its posterior, from made readings."""
    truth = np.array([1.0, 0.4, 3.0])
    value = truth[0] * np.exp(-truth[1] * TIMES) * np.cos(truth[2] * TIMES)
    value = value + 0.05 * np.random.default_rng(3).standard_normal(len(TIMES))
    return pose_curve(decay, (jnp.asarray(TIMES), jnp.asarray(value)), ["amplitude", "damping", "frequency"], truth,
                      np.diag([0.02, 0.015, 0.015]) ** 2, identity={"title": "a decaying oscillation"})


def work(folder: Path) -> None:
    """Sample; says on standard output how many blocks are on disk."""
    count = [len(list(folder.glob("block-*.npz")))]
    print("ready", flush=True)

    def report(text, share):
        count[0] += 1
        print(count[0], flush=True)

    run_chains(Ensembles, make_target(), SETTINGS, folder, report)
    print("done", flush=True)


def start(folder: Path) -> subprocess.Popen:
    """The same in a process of its own."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen([sys.executable, "-m", "docs.kill_study", "--work", str(folder)], cwd=ROOT, text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=environment)


def kill_once(folder: Path, wait: float) -> dict:
    """Start, wait so many seconds from the moment that sampling begins, kill, read what is there."""
    process = start(folder)
    assert process.stdout is not None
    first = process.stdout.readline()
    if first.strip() != "ready":
        raise RuntimeError(f"the process did not begin: {process.communicate()[1][-2000:]}")
    time.sleep(wait)
    process.send_signal(signal.SIGKILL)
    said = process.communicate()[0].split()
    done = "done" in said
    told = max((int(s) for s in said if s.isdigit()), default=0)
    return {"wait": wait, "told": told, "done": done, **inspect(folder)}


def inspect(folder: Path) -> dict:
    """Blocks in a folder: how many, and how many cannot be read."""
    files = sorted(folder.glob("block-*.npz"))
    bad = 0
    for file in files:
        try:
            block = read_arrays(file)
            bad += not all(np.all(np.isfinite(block[name])) for name in CHECKED)
        except Exception:  # whatever is wrong with it
            bad += 1
    return {"blocks": len(files), "unreadable": bad, "parts": len(list(folder.glob(".*.part")))}


def compare(one: Path, other: Path) -> bool:
    """Whether two chains are the same to the last bit."""
    files = [sorted(f.name for f in folder.glob("block-*.npz")) for folder in (one, other)]
    return files[0] == files[1] and all(
        np.array_equal(read_arrays(one / name)[key], read_arrays(other / name)[key])
        for name in files[0] for key in CHECKED)


def main() -> None:
    """Run the study, or the work of one process."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--work", type=Path, help="internal: sample into this folder")
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--scratch", type=Path, default=Path("kill-study-scratch"))
    given = parser.parse_args()
    if given.work:
        work(given.work)
        return
    rng, rows, same, chains = np.random.default_rng(1), [], 0, 0
    whole = given.scratch / "whole"
    began = time.perf_counter()
    run_chains(Ensembles, make_target(), SETTINGS, whole)
    long = time.perf_counter() - began
    print(f"undisturbed: {long:.1f} s, {len(list(whole.glob('block-*.npz')))} blocks")
    folder, before = given.scratch / "chain-0", 0
    while len(rows) < given.kills:
        row = kill_once(folder, float(rng.uniform(0.0, 0.5 * long)))
        row["kept"] = bool(row["blocks"] >= max(before, row["told"]))
        before = row["blocks"]
        rows.append(row)
        print(f"\rkill {len(rows)} of {given.kills}: {row['blocks']} blocks", end="", flush=True)
        if row["done"]:
            same, chains, before = same + compare(whole, folder), chains + 1, 0
            folder = given.scratch / f"chain-{chains}"
    work(folder)  # the last chain, to its end
    same, chains = same + compare(whole, folder), chains + 1
    midst = sum(not r["done"] for r in rows)
    result = {"schema": "ddetumble.kill-study/1", "kills": len(rows), "while_sampling": midst,
              "unreadable": sum(r["unreadable"] for r in rows), "lost_blocks": sum(not r["kept"] for r in rows),
              "cut_writes": sum(r["parts"] for r in rows), "chains": chains, "identical": same,
              "steps_between_checkpoints": SETTINGS.block, "rounds": rows, "versions": list_versions()}
    text = (f"# Killed {len(rows)} times\n\nMade by `python -m docs.kill_study -o fits/kill-study`.\n\n"
            f"SIGKILL at random moments, {midst} of {len(rows)} while the chain was growing: "
            f"{result['unreadable']} blocks that cannot be read, {result['lost_blocks']} times a block lost that was "
            f"there (so that no more than the {SETTINGS.block} steps since the last block are ever lost), "
            f"{result['cut_writes']} writes cut in the middle and swept away. Of {chains} chains that were brought to "
            f"their end this way, {same} equal the undisturbed one to the last bit.\n")
    given.output.mkdir(parents=True, exist_ok=True)
    write_json(given.output / "result.json", result)
    (given.output / "README.md").write_text(text, encoding="utf-8")
    print("\n" + text)


if __name__ == "__main__":
    main()
