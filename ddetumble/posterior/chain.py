"""Chains: run in blocks until they are long enough, and kept on disk so that the same call goes on with them.

A block is a file that is there whole or not at all; one process at a time writes. (emcee's HDF backend holds one
ensemble's chain and random state, but neither the adapted proposal nor NUTS, and appends in place.)
"""

import contextlib
import dataclasses as dc
import io
import os
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from .._display import Progress, stay_silent
from .._errors import InputError
from ..inference.files import claim_folder, hold_folder, write_whole
from ..inference.specification import EFFECTIVE
from .diagnostics import judge_chains
from .result import Posterior, summarise_posterior
from .target import AbstractTarget


SCHEMA = "ddetumble.chain/3"
PLAN = "chain.json"
Block = dict[str, np.ndarray]


@dc.dataclass(frozen=True)
class Settings:
    """How to sample."""

    walkers: int = 0  # of each ensemble, even; 0 for twice as many as parameters and four, at least 16. NUTS has one
    ensembles: int = 4  # independent ones, or chains of NUTS
    burn: int = 100  # first steps, from which the proposals are adapted and which are left out then
    block: int = 50  # steps between checkpoints
    effective: int = EFFECTIVE  # independent draws wanted of every parameter
    most: int = 5000  # steps after the burn-in at which to stop whatever was reached
    seed: int = 0  # of the random numbers

    def __post_init__(self):
        for name, least in (("ensembles", 1), ("burn", 0), ("block", 1), ("effective", 1), ("most", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name} must be at least {least}; it is {getattr(self, name)}", option=name)


class AbstractSampler(ABC):
    """A way to make steps of several independent chains."""

    name: ClassVar[str]

    def __init__(self, target: AbstractTarget, settings: Settings):
        self.target, self.settings = target, settings

    @staticmethod
    @abstractmethod
    def count_walkers(settings: Settings, free: int) -> int:
        """Walkers of every chain, for so many parameters."""

    @abstractmethod
    def advance(self, steps: int) -> Block:
        """So many steps of all chains: `x`, shape (chains, steps, walkers, free), `log_density`, shape (chains, steps,
        walkers), and whatever `resume` and `count` need.
        """

    @abstractmethod
    def resume(self, block: Block) -> None:
        """Go on from the end of a block."""

    @abstractmethod
    def refine(self, draws: np.ndarray) -> None:
        """Take a better density from here on, if the one sampled is off at these draws, shape (draws, free)."""

    @abstractmethod
    def adapt(self, draws: np.ndarray) -> None:
        """Adapt the proposals to the second half of the burn-in, shape (draws, free)."""

    @abstractmethod
    def count(self, blocks: list[Block], late: list[Block]) -> dict[str, Any]:
        """Statistics of all blocks and of those after the burn-in: share of accepted moves, evaluations and so on."""


def run_chains(sampler: type[AbstractSampler], target: AbstractTarget, settings: Settings, folder: Path | None = None,
               progress: Progress = stay_silent) -> Posterior:
    """Sample until every parameter has as many independent draws as wanted and the chains agree; blocks are kept in the
    folder, if there is one, and a chain that is there goes on.

    Raises:
        InputError: The folder is in use, or holds a chain of something else.
        ComputationError: The model cannot be computed where the chains start.
    """
    free, burn = len(target.names), settings.burn
    settings = dc.replace(settings, walkers=sampler.count_walkers(settings, free))
    # How long a chain is to become may change while it goes on.
    fixed = {name: value for name, value in dc.asdict(settings).items() if name not in ("effective", "most")}
    with open_chain(folder, {**target.identity, "sampler": sampler.name, **fixed}) as blocks:
        runner = sampler(target, settings)

        def join(name: str) -> np.ndarray:
            return np.concatenate([block[name] for block in blocks], axis=1)

        def join_early() -> np.ndarray:  # the second half of the burn-in
            return join("x")[:, burn // 2: burn].reshape(-1, free)

        resumed = done = sum(block["x"].shape[1] for block in blocks)
        if blocks:
            if done >= burn > 0:
                runner.refine(join_early())
            runner.resume(blocks[-1])
        convergence = judge_chains(join("x")[:, burn:] if blocks else np.zeros((1, 0, 1, free)), settings.effective)
        while True:
            if done == burn and burn:
                runner.refine(join_early())
                runner.adapt(join_early())
            if blocks and is_due(done, settings):
                convergence = judge_chains(join("x")[:, burn:], settings.effective)
                if convergence.enough or done >= burn + settings.most:
                    break
            # A block ends with the burn-in.
            block = runner.advance(min(settings.block, burn - done) if done < burn else settings.block)
            if folder is not None:
                write_arrays(_name_block(folder, len(blocks)), block)
            blocks.append(block)
            done += block["x"].shape[1]
            share = max(convergence.effective / settings.effective, (done - burn) / settings.most)
            far = (f"effective sample size {convergence.effective:.0f}, R-hat {convergence.rhat:.3f}"
                   if np.isfinite(convergence.rhat) else "settling")
            progress(f"step {done}: {far}", float(np.clip(share, 0.0, 1.0)))
        ends = np.cumsum([block["x"].shape[1] for block in blocks])
        late = [block for block, end in zip(blocks, ends, strict=True) if end > burn]
        statistics = {**runner.count(blocks, late), "resumed": resumed}
        return summarise_posterior(runner.target, sampler.name, dc.asdict(settings), join("x")[:, burn:],
                                   join("log_density")[:, burn:], convergence, statistics)


def is_due(done: int, settings: Settings) -> bool:
    """Whether chains are judged after so many steps: ever more seldom, and the same for a chain that was stopped."""
    number = (done - settings.burn) // settings.block
    return done >= settings.burn + settings.most or number < 8 or number % (1 << (number.bit_length() - 3)) == 0


@contextlib.contextmanager
def open_chain(folder: Path | None, identity: Mapping[str, Any]) -> Iterator[list[Block]]:
    """Blocks of the chain in a folder, locked as long as it is open; none without a folder.

    Raises:
        InputError: Another process holds it, it is damaged or of something else, or it cannot be written.
    """
    if folder is None:
        yield []
        return
    with hold_folder(folder, "another process writes its samples to this folder; wait for it, or name another one"):
        for part in folder.glob(".*.part"):  # a write that was cut off
            part.unlink(missing_ok=True)
        for old in folder.glob("block-*.npz") if not (folder / PLAN).is_file() else ():
            raise InputError("the folder contains blocks of a chain without its plan; remove them, or name another "
                             "folder", file=old)  # nobody knows what they are of
        claim_folder(folder / PLAN, "a chain", "identity", identity, schema=SCHEMA)
        blocks: list[Block] = []
        while (file := _name_block(folder, len(blocks))).is_file():
            blocks.append(read_arrays(file))
        yield blocks


def _name_block(folder: Path, number: int) -> Path:
    return folder / f"block-{number:06d}.npz"


def write_arrays(path: Path, arrays: Block) -> None:
    """Write arrays into a file, whole or not at all, and on the disk before it returns.

    Raises:
        InputError: It cannot be written.
    """
    def write(draft: Path) -> None:
        with open(draft, "wb") as file:
            np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
            file.flush()
            os.fsync(file.fileno())

    write_whole(path, write)
    if hasattr(os, "O_DIRECTORY"):  # the renaming goes to the disk too, where the system can
        handle = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        os.fsync(handle)
        os.close(handle)


def read_arrays(path: Path) -> Block:
    """Arrays of a file; nothing in it is run.

    Raises:
        InputError: It is damaged.
    """
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as found:
            return {name: found[name] for name in found.files}
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile):
        raise InputError("the block is damaged; remove it and those after it, and the chain continues from there",
                         file=path) from None
