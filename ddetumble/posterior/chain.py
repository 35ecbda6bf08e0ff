"""Chains: run in blocks until they are long enough, and kept on disk so that the same call goes on with them.

A block is a file that is there whole or not at all; one process at a time writes. (emcee's HDF backend holds one
ensemble's chain and random state, but neither the adapted proposal nor NUTS, and appends in place.)
"""

import contextlib
import dataclasses as dc
import io
import json
import os
import zipfile
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, ClassVar, final

import filelock
import numpy as np

from .._display import Progress
from .._errors import InputError
from ..inference.files import make_plain, write_json, write_whole
from .diagnostics import Convergence, judge_chains
from .result import Posterior, summarise_posterior
from .target import AbstractTarget, digest


SCHEMA = "ddetumble.chain/3"
PLAN, START = "chain.json", "start.npz"
Block = dict[str, np.ndarray]


@dc.dataclass(frozen=True)
class Settings:
    """How to sample.

    Attributes:
        walkers: of each ensemble, even; 0 for twice as many as parameters and four, at least 16. NUTS has one.
        ensembles: independent ones, or chains of NUTS.
        burn: first steps, from which the proposals are adapted and which are left out then.
        block: steps between checkpoints.
        effective: independent draws wanted of every parameter.
        most: steps after the burn-in at which to stop whatever was reached.
        seed: of the random numbers.
    """

    walkers: int = 0
    ensembles: int = 4
    burn: int = 100
    block: int = 50
    effective: int = 2000
    most: int = 5000
    seed: int = 0

    def check(self) -> None:
        """Refuse numbers that make no sense.

        Raises:
            InputError: One does not.
        """
        for name, least in (("ensembles", 1), ("burn", 0), ("block", 1), ("effective", 1), ("most", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name} has to be at least {least}; it is {getattr(self, name)}", option=name)

    def fixed(self) -> dict[str, Any]:
        """What must not change while a chain goes on: how long it is to become may."""
        return {name: value for name, value in dc.asdict(self).items() if name not in ("effective", "most")}


class AbstractSampler(ABC):
    """A way to make steps of several independent chains.

    Attributes:
        name: of the sampler.
        target: what is sampled.
        settings: how.
    """

    name: ClassVar[str]

    def __init__(self, target: AbstractTarget, settings: Settings):
        self.target, self.settings = target, settings

    @staticmethod
    @abstractmethod
    def count_walkers(settings: Settings, free: int) -> int:
        """Walkers of every chain, for so many parameters."""

    @abstractmethod
    def advance(self, steps: int) -> Block:
        """So many steps of all chains.

        Returns:
            `x`, shape (chains, steps, walkers, free), `log_density`, shape (chains, steps, walkers), and whatever
            `resume` and `count` need.
        """

    @abstractmethod
    def resume(self, block: Block) -> None:
        """Go on from the end of a block."""

    @abstractmethod
    def adapt(self, draws: np.ndarray) -> None:
        """Adapt the proposals to the second half of the burn-in, shape (draws, free)."""

    @abstractmethod
    def count(self, blocks: list[Block], late: list[Block]) -> dict[str, Any]:
        """Statistics of all blocks and of those after the burn-in: share of accepted moves, evaluations and so on."""


@final
class Chain:
    """Blocks of steps, on disk too if there is a folder.

    Attributes:
        folder: where they are kept, or None.
        blocks: what `AbstractSampler.advance` gave, in order.
    """

    def __init__(self, folder: Path | None = None):
        self.folder, self.blocks = folder, []
        while folder is not None and (file := self._name(len(self.blocks))).is_file():
            self.blocks.append(read_arrays(file))

    def _name(self, number: int) -> Path:
        assert self.folder is not None
        return self.folder / f"block-{number:06d}.npz"

    @property
    def steps(self) -> int:
        """How many there are, the burn-in included."""
        return sum(block["x"].shape[1] for block in self.blocks)

    def append(self, block: Block) -> None:
        """Keep the next block."""
        if self.folder is not None:
            write_arrays(self._name(len(self.blocks)), block)
        self.blocks.append(block)

    def keep(self, arrays: Block) -> Block:
        """What the chain started from: written the first time, read back ever after."""
        if self.folder is None:
            return arrays
        path = self.folder / START
        if not path.is_file():
            write_arrays(path, arrays)
        return read_arrays(path)

    def join(self, name: str) -> np.ndarray:
        """An array of all blocks, along the steps."""
        return np.concatenate([block[name] for block in self.blocks], axis=1)


def run_chains(sampler: type[AbstractSampler], target: AbstractTarget, settings: Settings, folder: Path | None = None,
               progress: Progress = lambda text, share: None) -> Posterior:
    """Sample until every parameter has as many independent draws as wanted and the chains agree.

    Args:
        sampler: which one.
        target: the density.
        settings: how.
        folder: where blocks are kept; a chain that is there goes on. None keeps nothing.
        progress: called with a sentence and the share done.

    Raises:
        InputError: The folder is in use, or holds a chain of something else.
        ComputationError: The model cannot be computed where the chains start.
    """
    settings.check()
    settings = dc.replace(settings, walkers=sampler.count_walkers(settings, len(target.names)))
    with open_chain(folder, {**target.identity, "sampler": sampler.name, **settings.fixed()}) as chain:
        return _run(sampler(target.thaw(chain.keep(target.freeze())), settings), chain, progress)


def _run(sampler: AbstractSampler, chain: Chain, progress: Progress) -> Posterior:
    settings, free, resumed = sampler.settings, len(sampler.target.names), chain.steps
    nothing = np.zeros((settings.ensembles, 0, settings.walkers, free))

    def judge() -> Convergence:
        x = chain.join("x")[:, settings.burn:] if chain.blocks else nothing
        return judge_chains(x, settings.effective)

    convergence = judge()
    if chain.blocks:
        sampler.resume(chain.blocks[-1])
    while True:
        done = chain.steps
        if done == settings.burn and settings.burn:
            sampler.adapt(chain.join("x")[:, settings.burn // 2:].reshape(-1, free))
        if is_due(done, settings):
            convergence = judge()
            if convergence.enough or done >= settings.burn + settings.most:
                break
        left = settings.burn - done  # a block ends with the burn-in
        chain.append(sampler.advance(min(settings.block, left) if left > 0 else settings.block))
        share = max(convergence.effective / settings.effective, (chain.steps - settings.burn) / settings.most)
        progress(f"step {chain.steps}: {convergence.describe()}", float(np.clip(share, 0.0, 1.0)))
    ends = np.cumsum([block["x"].shape[1] for block in chain.blocks])
    late = [block for block, end in zip(chain.blocks, ends, strict=True) if end > settings.burn]
    statistics = {**sampler.count(chain.blocks, late), "resumed": resumed}
    return summarise_posterior(sampler.target, sampler.name, dc.asdict(settings), chain.join("x")[:, settings.burn:],
                               chain.join("log_density")[:, settings.burn:], convergence, statistics)


def is_due(done: int, settings: Settings) -> bool:
    """Whether chains are judged after so many steps: ever more seldom, and the same for a chain that was stopped."""
    number = (done - settings.burn) // settings.block
    return done >= settings.burn + settings.most or number < 8 or number % (1 << (number.bit_length() - 3)) == 0


@contextlib.contextmanager
def open_chain(folder: Path | None, identity: Mapping[str, Any]) -> Iterator[Chain]:
    """The chain in a folder, locked as long as it is open; in memory only without a folder.

    Raises:
        InputError: Another process holds it, it is damaged or of something else, or it cannot be written.
    """
    if folder is None:
        yield Chain()
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        held = filelock.FileLock(folder / ".lock", timeout=0).acquire()
    except filelock.Timeout:
        raise InputError("another process is sampling into this folder; wait for it, or name another folder",
                         file=folder) from None
    except OSError as error:
        raise InputError(f"the folder cannot be written ({error.strerror or error})", file=folder) from None
    with held:
        for part in folder.glob(".*.part"):  # a write that was cut off
            part.unlink(missing_ok=True)
        _check_plan(folder, make_plain(identity))
        yield Chain(folder)


def _check_plan(folder: Path, identity: dict[str, Any]) -> None:
    """Write what the chain is of, or compare it with what is there."""
    plan = folder / PLAN
    if not plan.is_file():
        for old in folder.glob("block-*.npz"):  # without its plan nobody knows what it is of
            raise InputError("the folder holds blocks of a chain without its plan; remove them, or name another "
                             "folder", file=old)
        write_json(plan, {"schema": SCHEMA, "identity": identity, "digest": digest(identity)})
        return
    try:
        found = json.loads(plan.read_text(encoding="utf-8"))
        there, schema = dict(found["identity"]), found["schema"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError("this is no plan of a chain; remove the folder, or name another", file=plan) from None
    if schema != SCHEMA:
        raise InputError(f"the chain is of another version ({schema}); name another folder", file=plan)
    different = []
    for name in sorted({*there, *identity}):
        a, b = there.get(name), identity.get(name)
        if a != b:
            short = all(len(str(x)) < 40 for x in (a, b))
            different.append(f"{name} is {a!r} there and {b!r} now" if short else f"{name} differs")
    if different:
        raise InputError(f"the folder holds a chain of something else: {'; '.join(different)}. Name another folder, "
                         "or remove this one to begin again", file=plan)


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
        raise InputError("the block is damaged; remove it and those after it, and the chain goes on from there",
                         file=path) from None
