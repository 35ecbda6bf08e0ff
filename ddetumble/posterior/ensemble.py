"""emcee: independent ensembles of walkers, which move by independent proposals and by each other's places."""

from functools import partial
from typing import Any, final

import emcee
import numpy as np

from .._errors import ComputationError, InputError
from .._numerics import map_threads
from .chain import AbstractSampler, Block, Settings
from .proposal import FEW, Mixture, adapt_mixture, seed_random, start_mixture
from .target import TOO_UNCERTAIN, AbstractTarget


# Of differential evolution and stretch moves among those that are not independent: the first mix better, the second
# need no tuning.
OTHERS = (0.7, 0.3)
# Than the fit's Gaussian, of the places where walkers begin: R-hat shows what does not mix only from a wide start.
WIDER = 1.2
BEGINNINGS = 20  # draws of these at most, where the model fails at some: if so many fail, the fit is too uncertain


def mix_moves(proposal: Mixture, share: float) -> list[tuple[emcee.moves.Move, float]]:
    """The moves with the share of steps that each makes; `share` is that of independent ones by the proposal."""
    rest = 1.0 - share
    # No snooker move: emcee 3.1.6 weighs it with half the exponent that it needs, which narrows posteriors.
    return [(emcee.moves.MHMove(proposal), share), (emcee.moves.DEMove(), OTHERS[0] * rest),
            (emcee.moves.StretchMove(), OTHERS[1] * rest)]


@final
class Ensembles(AbstractSampler):
    """Several ensembles of walkers, each with its own random numbers."""

    name = "emcee"

    def __init__(self, target: AbstractTarget, settings: Settings):
        super().__init__(target, settings)
        self.proposal, self.share = start_mixture(target), FEW
        self.states: list[emcee.State] = []
        self.counts = np.zeros((settings.ensembles, 2), dtype=int)  # evaluations and failures since the last block

    @staticmethod
    def count_walkers(settings: Settings, free: int) -> int:
        """As the base class has it.

        Raises:
            InputError: emcee cannot move so many.
        """
        walkers = settings.walkers or max(16, 2 * free + 4)
        if walkers % 2 or walkers < 2 * free + 2 or walkers < 6:
            raise InputError(f"walkers must be even and at least {max(6, 2 * free + 2)} with {free} parameters; it "
                             f"is {walkers}", option="walkers")
        return walkers

    def density(self, number: int, x: np.ndarray) -> np.ndarray:
        """Of points, shape (points, free) to (points,); evaluations and failures count for an ensemble."""
        # Moves of all walkers come at once, others by halves: one size, one compiled program.
        half = self.settings.walkers // 2
        found = np.concatenate([self.target.log_density(x[k: k + half]) for k in range(0, len(x), half)])
        self.counts[number] += len(found), np.sum(self.target.holds(x) & ~np.isfinite(found))
        return found

    def _begin(self, number: int) -> emcee.State:
        """Walkers from the fit's Gaussian; those where the model fails are drawn again."""
        random = seed_random(self.settings.seed, number)
        rng = np.random.default_rng(random.randint(0, 2**32, size=4, dtype=np.uint64))
        x = self.target.draw_inside(rng, self.settings.walkers, WIDER)
        for _ in range(BEGINNINGS):
            value = self.density(number, x)
            bad = ~np.isfinite(value)
            if not bad.any():
                return emcee.State(x, log_prob=value, random_state=random.get_state())
            x[bad] = self.target.draw_inside(rng, self.settings.walkers, WIDER)[: int(bad.sum())]
        raise ComputationError(TOO_UNCERTAIN)

    def advance(self, steps: int) -> Block:
        """As the base class has it."""
        numbers = range(self.settings.ensembles)
        if not self.states:
            self.states = map_threads(self._begin, numbers)
        parts = map_threads(lambda k: self._advance(k, steps), numbers)
        self.counts[:] = 0
        means, covariances = map(np.stack, zip(*self.proposal.parts, strict=True))
        return {**{name: np.stack([part[name] for part in parts]) for name in parts[0]}, "mean": means,
                "covariance": covariances, "portion": self.proposal.portions, "share": np.array(self.share)}

    def _advance(self, number: int, steps: int) -> Block:
        sampler = emcee.EnsembleSampler(self.settings.walkers, len(self.target.names), partial(self.density, number),
                                        vectorize=True, moves=mix_moves(self.proposal, self.share))
        state: Any = sampler.run_mcmc(self.states[number], steps, skip_initial_state_check=True)
        self.states[number], (_, keys, place, has, cached) = state, state.random_state
        return {"x": np.asarray(sampler.get_chain()), "log_density": np.asarray(sampler.get_log_prob()),
                "random_keys": np.asarray(keys), "random_rest": np.array([place, has, cached], dtype=float),
                "counts": np.array([*self.counts[number], sampler.backend.accepted.sum()], dtype=int)}

    def resume(self, block: Block) -> None:
        """As the base class has it."""
        self.states = [
            emcee.State(x, log_prob=value, random_state=("MT19937", keys, int(place), int(has), float(cached)))
            for x, value, keys, (place, has, cached) in zip(block["x"][:, -1], block["log_density"][:, -1],
                                                            block["random_keys"], block["random_rest"], strict=True)]
        self.proposal = Mixture(list(zip(block["mean"], block["covariance"], strict=True)), self.target.low,
                                self.target.high, block["portion"])
        self.share = float(block["share"])

    def refine(self, draws: np.ndarray) -> None:
        """As the base class has it."""
        self.target = self.target.refine(draws)

    def adapt(self, draws: np.ndarray) -> None:
        """As the base class has it."""
        # Densities are computed again, as the target may have been refined since.
        self.states = [emcee.State(state.coords, random_state=state.random_state) for state in self.states]
        random = seed_random(self.settings.seed, self.settings.ensembles, 1)
        self.proposal, self.share = adapt_mixture(self.target, partial(self.density, 0), draws, random)

    def count(self, blocks: list[Block], late: list[Block]) -> dict[str, Any]:
        """As the base class has it."""
        evaluations, failures, _ = np.sum([block["counts"].sum(axis=0) for block in blocks], axis=0)
        moves = sum(block["log_density"].size for block in late)
        accepted = float(sum(block["counts"][:, 2].sum() for block in late) / max(moves, 1))
        return {"accepted": accepted, "evaluations": int(evaluations), "failures": int(failures)}
