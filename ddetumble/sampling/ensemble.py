"""emcee: independent ensembles of walkers, in blocks, until autocorrelation and agreement say that it is enough."""

import dataclasses as dc
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import emcee
import numpy as np

from .._errors import ComputationError, InputError
from .._numerics import map_threads
from .adaptation import FEW, PARTS, adapt_mixture, start_mixture
from .checkpoint import ChainFolder
from .diagnostics import Convergence, judge_chains
from .moves import Mixture, mix_moves
from .target import AbstractTarget, draw_inside


Progress = Callable[[str, float], None]


@dc.dataclass(frozen=True)
class Settings:
    """How to sample.

    Attributes:
        walkers: of each ensemble, even; 0 for twice as many as parameters and four, at least 16.
        ensembles: independent ones.
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

    def check(self, free: int) -> "Settings":
        """The same with the number of walkers filled in.

        Raises:
            InputError: A number makes no sense.
        """
        walkers = self.walkers or max(16, 2 * free + 4)
        if walkers % 2 or walkers < 2 * free + 2 or walkers < 6:
            raise InputError(f"walkers has to be even and at least {max(6, 2 * free + 2)} with {free} parameters; it "
                             f"is {walkers}", option="walkers")
        for name, least in (("ensembles", 1), ("burn", 0), ("block", 1), ("effective", 1), ("most", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise InputError(f"{name} has to be at least {least}; it is {getattr(self, name)}", option=name)
        return dc.replace(self, walkers=walkers)

    def fixed(self) -> dict[str, Any]:
        """What must not change while a chain goes on: how long it is to become may."""
        return {name: value for name, value in dc.asdict(self).items() if name not in ("effective", "most")}


@dc.dataclass(frozen=True, eq=False)
class Chains:
    """Draws of all ensembles.

    Attributes:
        x: coordinates, shape (ensembles, steps, walkers, free), burn-in included.
        log_density: shape (ensembles, steps, walkers).
        burn: steps to leave out.
        accepted: share of accepted moves after the burn-in.
        evaluations: of the density; failures: how many of these the model could not compute.
        convergence: as it stood at the end.
        resumed: steps that were there before.
    """

    x: np.ndarray
    log_density: np.ndarray
    burn: int
    accepted: float
    evaluations: int
    failures: int
    convergence: Convergence
    resumed: int

    @property
    def kept(self) -> np.ndarray:
        """Draws after the burn-in, shape (ensembles, steps, walkers, free)."""
        return self.x[:, self.burn:]


class _Ensemble:
    """One ensemble of walkers."""

    def __init__(self, target: AbstractTarget, settings: Settings, number: int):
        self.target, self.settings = target, settings
        self.random = np.random.RandomState(np.random.SeedSequence([settings.seed, number]).generate_state(8))
        self.evaluations = self.failures = 0
        self.proposal, self.share = start_mixture(target), FEW
        self.sampler: emcee.EnsembleSampler | None = None
        self.state: emcee.State | None = None

    def density(self, x: np.ndarray) -> np.ndarray:
        """Of points, shape (points, free) to (points,), counted."""
        # Moves of all walkers come at once, others by halves: one size, one compiled program.
        half = self.settings.walkers // 2
        parts = [self.target.log_density(x[k: k + half]) for k in range(0, len(x), half)]
        found = np.concatenate(parts)
        self.evaluations += len(found)
        inside = np.all((x >= self.target.low) & (x <= self.target.high), axis=1)
        self.failures += int(np.sum(inside & ~np.isfinite(found)))
        return found

    def begin(self) -> None:
        """Walkers from the fit's Gaussian; those where the model fails are drawn again."""
        rng = np.random.default_rng(self.random.randint(0, 2**32, size=4, dtype=np.uint64))
        x = draw_inside(self.target, rng, self.settings.walkers, 1.2)
        for _ in range(20):
            value = self.density(x)
            bad = ~np.isfinite(value)
            if not bad.any():
                break
            x[bad] = draw_inside(self.target, rng, self.settings.walkers, 1.2)[: int(bad.sum())]
        else:
            raise ComputationError("the model cannot be computed at draws from the fit's Gaussian: the fit is too "
                                   "uncertain to sample from; add priors or bounds, or fix a parameter")
        self.state = emcee.State(x, log_prob=value, random_state=self.random.get_state())

    def resume(self, block: dict[str, np.ndarray], k: int) -> None:
        """Go on from a block."""
        keys, rest = block["random_keys"][k], block["random_rest"][k]
        state = ("MT19937", keys, int(rest[0]), int(rest[1]), float(rest[2]))
        self.state = emcee.State(block["x"][k, -1], log_prob=block["log_density"][k, -1], random_state=state)
        own = {name: block[name][k] for name in ("portion", "mean", "covariance")}
        self.proposal = Mixture.load(own, self.target.low, self.target.high)
        self.share = float(block["share"][k])

    def advance(self, steps: int) -> dict[str, np.ndarray]:
        """So many steps; everything that a block holds of this ensemble."""
        settings, free = self.settings, len(self.target.names)
        if self.state is None:
            self.begin()
        if self.sampler is None:
            self.sampler = emcee.EnsembleSampler(settings.walkers, free, self.density, vectorize=True,
                                                 moves=mix_moves(self.proposal, self.share))
        self.sampler.reset()
        for state in self.sampler.sample(self.state, iterations=steps, skip_initial_state_check=True):
            self.state = state
        assert self.state is not None and self.state.random_state is not None
        _, keys, place, has, cached = self.state.random_state
        x, value = self.sampler.get_chain(), self.sampler.get_log_prob()
        assert x is not None and value is not None
        counts = np.array([self.evaluations, self.failures, int(self.sampler.backend.accepted.sum())])
        self.evaluations = self.failures = 0
        return {"x": x, "log_density": value, "random_keys": np.asarray(keys), "counts": counts,
                "random_rest": np.array([place, has, cached], dtype=float), "share": np.asarray(self.share),
                **self.proposal.state(PARTS)}

    def adapt(self, proposal: Mixture, share: float) -> None:
        """New proposal after the burn-in."""
        self.proposal, self.share, self.sampler = proposal, share, None


def run_ensembles(target: AbstractTarget, settings: Settings, folder: Path | None = None,
                  progress: Progress | None = None) -> Chains:
    """Sample until every parameter has as many independent draws as wanted and the ensembles agree.

    Args:
        target: the density.
        settings: how.
        folder: where blocks are kept; a chain that is there goes on. None keeps nothing.
        progress: called with a sentence and the share done.

    Raises:
        InputError: The folder is in use, or holds a chain of something else.
        ComputationError: The model cannot be computed where the walkers start.
    """
    settings = settings.check(len(target.names))
    if folder is None:
        return _run(target, settings, None, progress or _quiet)
    identity = {**target.identity, "sampler": "emcee", **settings.fixed()}
    with ChainFolder(folder, identity) as chain:
        return _run(target.thaw(chain.keep(target.freeze())), settings, chain, progress or _quiet)


def _run(target: AbstractTarget, settings: Settings, chain: ChainFolder | None, report: Progress) -> Chains:
    ensembles = [_Ensemble(target, settings, k) for k in range(settings.ensembles)]
    blocks: list[dict[str, np.ndarray]] = [chain.read(k) for k in range(chain.blocks)] if chain else []
    resumed = sum(b["x"].shape[1] for b in blocks)
    done = resumed
    convergence = _judge(blocks, settings)
    if blocks:
        for k, ensemble in enumerate(ensembles):
            ensemble.resume(blocks[-1], k)
    while True:
        if done == settings.burn and settings.burn:
            draws = _join(blocks, "x")[:, settings.burn // 2:].reshape(-1, len(target.names))
            seed = np.random.SeedSequence([settings.seed, settings.ensembles, 1])
            proposal, share = adapt_mixture(target, ensembles[0].density, draws, seed)
            for ensemble in ensembles:
                ensemble.adapt(proposal, share)
        if is_due(done, settings):
            convergence = _judge(blocks, settings)
            if convergence.enough or done >= settings.burn + settings.most:
                break
        steps = min(settings.block, settings.burn - done if done < settings.burn else settings.block)
        parts = map_threads(lambda e, n=steps: e.advance(n), ensembles)
        block = {name: np.stack([part[name] for part in parts]) for name in parts[0]}
        blocks.append(block)
        if chain:
            chain.append(block)
        done += steps
        share = max(convergence.effective / settings.effective, (done - settings.burn) / settings.most)
        report(f"step {done}: {_describe(convergence)}", float(np.clip(share, 0.0, 1.0)))
    counts = np.sum([b["counts"].sum(axis=0) for b in blocks], axis=0)
    late = [b for b, end in zip(blocks, np.cumsum([b["x"].shape[1] for b in blocks]), strict=True)
            if end > settings.burn]
    moves = sum(b["x"][..., 0].size for b in late)
    accepted = float(sum(b["counts"][:, 2].sum() for b in late) / max(moves, 1))
    return Chains(_join(blocks, "x"), _join(blocks, "log_density"), settings.burn, accepted, int(counts[0]),
                  int(counts[1]), convergence, resumed)


def is_due(done: int, settings: Settings) -> bool:
    """Whether chains are judged after so many steps: ever more seldom, and the same for a chain that was stopped."""
    number = (done - settings.burn) // settings.block
    return done >= settings.burn + settings.most or number < 8 or number % (1 << (number.bit_length() - 3)) == 0


def _join(blocks: Sequence[dict[str, np.ndarray]], name: str) -> np.ndarray:
    return np.concatenate([b[name] for b in blocks], axis=1)


def _judge(blocks: Sequence[dict[str, np.ndarray]], settings: Settings) -> Convergence:
    done = sum(b["x"].shape[1] for b in blocks)
    if done <= settings.burn:
        return judge_chains(np.zeros((settings.ensembles, 0, settings.walkers, 1)), settings.effective)
    return judge_chains(_join(blocks, "x")[:, settings.burn:], settings.effective)


def _describe(convergence: Convergence) -> str:
    if not np.isfinite(convergence.rhat):
        return "settling"
    return f"{convergence.effective:.0f} independent draws, R-hat {convergence.rhat:.3f}"


def _quiet(text: str, share: float) -> None:
    """Report nothing."""
