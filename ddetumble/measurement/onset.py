"""Contact onset of raw force traces: when each force starts to rise, and how well that is known.

A threshold always comes late, as the force at the onset is nought with a horizontal tangent. The rise up to half of the
peak is therefore fitted with the curve that the contact law gives there. A stiff wall or a dashpot makes a force start
as a straight line or with a jump instead, and a gauge that rings bends the rise; which of these it is, all traces of a
campaign tell together.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .rise import Located, Rise, Rises, Start, find_rise


# Fraction of the force at REACH that a linear spring carries; a wall that carries half of it is no inflated ball's.
SLOPES = (0.025, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 1.0)
SLOPE_SD = 0.15  # of a half-normal prior of that fraction, beside as much weight on 0
SLOPE_SPREAD = 0.25  # by which that fraction differs between the records of a campaign (0.2 over pressures and speeds)
SLOPED = 9.0  # fall of chi-square from which a force begins with a slope: three standard deviations
DECISIVE = 16.0  # the same of a jump or a gauge that rings, which have more to choose from: four standard deviations
EVEN = 9.0  # where these are as likely as not: seldom to begin with (a tenth), and one of some ten told apart
OWN_STEP = 4.0  # fall of chi-square a trace that chance lets a jump of its own reach, found by a scan
PROMISING = 6.0  # fall of chi-square below which a frequency is not looked for more closely: chance does as much
FEW = 8  # traces with the least noise, on which the frequency of a gauge is looked for
DELAY = 2.0  # sampling intervals by which an anti-aliasing filter delays: a Butterworth of order 8 at 0.4 of the rate


@dataclass(frozen=True)
class Onset:
    """Where contact begins in a trace.

    Args:
        time: Time of first touch on the trace's own axis [s].
        sd: Its standard error, of this trace alone [s].
    """

    time: float
    sd: float


@dataclass(frozen=True)
class Onsets:
    """Where contact begins in the traces of a campaign.

    Args:
        each: Onset of every trace.
        common_sd: Standard error that all onsets share [s]: of the shape of the rise, which is one for the campaign,
            and of the delay of the measuring chain, which no trace shows.
        start: `curved` as in the reference model, `sloped` or `stepped`.
        ringing: Natural frequency [Hz] and damping ratio of a gauge that rings, or None.
        misfit: Chi-square per degree of freedom of the rises.
    """

    each: tuple[Onset, ...]
    common_sd: float
    start: str
    ringing: tuple[float, float] | None
    misfit: float


def find_onsets(times: Sequence, forces: Sequence) -> Onsets:
    """Find the contact onsets of a campaign's impacts.

    Args:
        times: Sampling times of each trace, increasing, shape (samples,) each [s].
        forces: Normal force of each, positive while pressing [N]; NaN is left out.

    Raises:
        InputError: A trace without force above the noise, or with fewer than five samples before contact or three on
            the rise.
    """
    return locate_onsets([find_rise(t, f) for t, f in zip(times, forces, strict=True)])


def locate_onsets(traces: Sequence[Rise], names: Sequence[str] = ()) -> Onsets:
    """Onsets of the traces of a campaign, each cut down by `find_rise`; `names` of the records, for messages.

    Every rise is fitted with the reference model's curve; its onset, offset and height are its own. The errors of this
    fit are each trace's own. All traces together tell whether the force starts with a slope or a jump instead, or
    whether the gauge rings (a second-order sensor): each of these is taken only where chi-square falls decisively. What
    remains open is an error that all traces share, and so is the delay of the measuring chain.

    Raises:
        InputError: A force that rises too little above its noise, or contact too early in a trace.
    """
    rises = Rises(traces, names)
    plain = rises.scan(Start())
    sloped = [rises.refine(Start(slope), plain.time) for slope in SLOPES]
    known = min(float(found.chi2.sum()) for found in (plain, *sloped))
    others = (rises.scan(Start(stepped=True)), _find_ringing(rises, plain))
    scale = max(known / rises.degrees, 1.0)
    gains = (known - np.array([found.chi2.sum() for found in others])) / scale - [OWN_STEP * len(rises.step), 0.0]
    base = others[int(np.argmax(gains))] if gains.max() > DECISIVE else plain
    if base is not plain:
        sloped = [rises.refine(replace(base.start, slope=slope), base.time) for slope in SLOPES]
    found = (base, *sloped, *(others if base is plain else ()))
    scores = np.array([one.chi2.sum() for one in found[: len(SLOPES) + 1]])
    misfit = float(scores.min() / rises.degrees)
    weights = _weigh_slopes() * np.exp(-0.5 * (scores - scores.min()) / max(misfit, 1.0))
    weights /= weights.sum()
    table = np.stack([one.time for one in found])
    decided = scores[0] - scores.min() > SLOPED * max(misfit, 1.0)
    time = weights @ table[: len(weights)] if decided else base.time
    if base is plain:  # a jump or a gauge that rings may still be there
        weights = np.concatenate([weights, np.exp(0.5 * (gains - EVEN))])
        weights /= weights.sum()
    open_ = table - time
    common = np.mean(open_, axis=1)
    apart = weights @ ((open_ - common[:, None]) ** 2 + (SLOPE_SPREAD * (table - base.time)) ** 2)
    own = np.sqrt(max(misfit, 1.0) * (base.noise_sd**2 + base.shape_sd**2) + apart)
    rises.check(time, own)
    delay = DELAY * float(np.median(rises.step))
    common_sd = float(np.sqrt(weights @ common**2 + max(misfit, 1.0) * np.mean(base.shape_sd) ** 2 + delay**2))
    kind = "stepped" if base.start.stepped else "sloped" if decided else "curved"
    each = tuple(Onset(float(t), float(sd)) for t, sd in zip(time, own, strict=True))
    return Onsets(each, common_sd, kind, base.start.ringing, misfit)


def _weigh_slopes() -> np.ndarray:
    """Prior weights of no slope and of `SLOPES`: one half, and a half-normal density over the intervals about them."""
    slopes = np.array(SLOPES)
    edges = np.concatenate([[0.0], np.sqrt(slopes[:-1] * slopes[1:]), [1.2]])
    density = np.exp(-0.5 * (slopes / SLOPE_SD) ** 2) * np.diff(edges)
    return np.concatenate([[0.5], 0.5 * density / density.sum()])


def _find_ringing(rises: Rises, plain: Located) -> Located:
    """Onsets for a gauge that rings so as to leave least: natural frequency and damping ratio in turns."""
    few = np.argsort(-rises.height * rises.weight.max(axis=1))[:FEW]
    some, guess = Rises([rises.rises[i] for i in few]), plain.time[few]
    # From half a period in the rise, below which it looks like another contact, to what the sampling can follow.
    lowest, highest = 0.5 / float(np.median(rises.length)), 0.2 / float(np.median(rises.step))
    frequencies = np.geomspace(lowest, max(highest, 2.0 * lowest), 16)
    tried = [some.refine(Start(ringing=(float(f), d)), guess, 4) for f in frequencies for d in (0.05, 0.2)]
    best = min(tried, key=lambda found: found.chi2.sum())
    if plain.chi2[few].sum() - best.chi2.sum() < PROMISING:
        return rises.refine(best.start, plain.time)
    best = _narrow(some, best, np.array([np.log(frequencies[1] / frequencies[0]) / 2.0, 0.7]), 6)
    return _narrow(rises, rises.refine(best.start, plain.time), np.array([0.02, 0.2]), 3)


def _narrow(rises: Rises, best: Located, steps: np.ndarray, turns: int) -> Located:
    """A gauge that leaves less: steps in the logarithms of frequency and damping, each turn smaller ones."""
    for _ in range(turns):
        for k, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
            assert best.start.ringing is not None
            factor = np.exp(sign * steps * (np.arange(2) == k))
            gauge = (float(best.start.ringing[0] * factor[0]), float(min(best.start.ringing[1] * factor[1], 0.9)))
            best = min((best, rises.refine(Start(ringing=gauge), best.time, 4)), key=lambda found: found.chi2.sum())
        steps = 0.6 * steps
    return best
