"""What an exam asks: every case drawn from the exam's seed and its own number alone."""

import dataclasses as dc
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError
from .benches import BENCHES, Bench, Hidden
from .faults import FAULTS
from .simulators.strength import reach_strength


TRUTHS = ("nothing", "one", "two", "outside")
PATTERN = ("nothing", "one", "nothing", "one", "two", "nothing", "one", "outside")
NOISES = ("white", "ar1")
WEAKEST, STRONGEST = 0.5, 8.0  # strength: rms over noise that a refitted reference model leaves
FAULTY = 0.25  # share of the cases with a fault, where faults are drawn


@dc.dataclass(frozen=True)
class Exam:
    """What is drawn from; two exams that are equal ask the same.

    Attributes:
        family: of the records.
        seed: of everything drawn.
        truths: kinds of what is hidden, out of TRUTHS.
        noise: `white`, `ar1` (correlation 0.3 to 0.9, partly white in a third of the cases) or `drawn`: even odds.
        fault: `none`, `drawn` (one of FAULTS in a quarter of the cases), or one of FAULTS in every case.
        edition: of the drawing; the present one of the family's bench where not given.
    """

    family: str
    seed: int = 0
    truths: tuple[str, ...] = TRUTHS
    noise: str = "drawn"
    fault: str = "drawn"
    edition: int = 0

    def __post_init__(self):
        for name, value, allowed in (("--family", self.family, BENCHES), ("--noise", self.noise, (*NOISES, "drawn")),
                                     ("--fault", self.fault, ("none", "drawn", *FAULTS))):
            if value not in allowed:
                raise InputError(f"{value!r} is none of {', '.join(allowed)}", option=name)
        for kind in self.truths:
            if kind not in TRUTHS:
                raise InputError(f"{kind!r} is none of {', '.join(TRUTHS)}", option="--truth")
        if not self.truths:
            raise InputError(f"name at least one of {', '.join(TRUTHS)}", option="--truth")
        if self.seed < 0:
            raise InputError("the seed is a whole number from 0 on", option="--seed")
        object.__setattr__(self, "edition", self.edition or self.bench.edition)

    @property
    def bench(self) -> Bench:
        """Where its campaigns are made."""
        return BENCHES[self.family]


@dc.dataclass(frozen=True)
class Case:
    """One question with its answer.

    Attributes:
        index: its number in the exam.
        kind: of what is hidden, out of TRUTHS.
        seed: of the campaign's random numbers.
        setting: of the bench; `base` in it are the reference model's parameters.
        effects: that are hidden, with their parameters.
        asked, strengths: of every effect, the strength drawn and the one that its parameters have.
        noise: `rho` and `white_share`.
        fault: one of FAULTS, or None.
    """

    index: int
    kind: str
    seed: int
    setting: Mapping[str, Any]
    effects: Mapping[str, Mapping[str, Any]]
    asked: Mapping[str, float]
    strengths: Mapping[str, float]
    noise: Mapping[str, float]
    fault: str | None


def start_generator(exam: Exam, *more: int) -> np.random.Generator:
    """Random numbers of their own for every exam, case and purpose."""
    return np.random.default_rng([exam.edition, exam.seed, list(BENCHES).index(exam.family), *more])


def find_kind(exam: Exam, index: int) -> tuple[str, int]:
    """Kind of a case, and how many cases of that kind come before it."""
    pattern = [kind for kind in PATTERN if kind in exam.truths]
    rounds, place = divmod(index, len(pattern))
    kind = pattern[place]
    return kind, rounds * pattern.count(kind) + pattern[:place].count(kind)


def draw_case(exam: Exam, index: int) -> Case:
    """Draw one case; the others do not matter to it.

    Single and outside effects come in turn, in an order drawn once for the exam; pairs are drawn at random.
    """
    generator = start_generator(exam, 1, index)
    kind, rank = find_kind(exam, index)
    seed = int(generator.integers(2**31))
    bench, setting = exam.bench, exam.bench.draw_setting(generator)
    noise = draw_noise_kind(exam, generator)
    faulty = generator.random() < FAULTY
    fault = str(generator.choice(list(FAULTS)))
    fault = {"none": None, "drawn": fault if faulty else None}.get(exam.fault, exam.fault)
    pool = dict(bench.outside if kind == "outside" else bench.catalogue)
    if kind == "two":
        order = [str(name) for name in generator.permutation(list(pool))]
    else:
        order = [str(name) for name in start_generator(exam, 2).permutation(list(pool))]
        order = order[rank % len(order) :] + order[: rank % len(order)]
    wanted = {"nothing": 0, "two": 2}.get(kind, 1)
    effects, asked, strengths = hide(order, pool, wanted, bench.prepare, setting, seed, generator)
    return Case(index, kind, seed, setting, effects, asked, strengths, noise, fault)


def draw_noise_kind(exam: Exam, generator: np.random.Generator) -> dict[str, float]:
    """Correlation of the noise from one sample to the next, and the share of its variance that is white."""
    kind, rho = generator.choice(NOISES), float(generator.uniform(0.3, 0.9))
    share = float(generator.choice([0.0, 0.0, 0.4]))
    if (exam.noise if exam.noise != "drawn" else kind) == "white":
        return {"rho": 0.0, "white_share": 0.0}
    return {"rho": rho, "white_share": share}


def hide(order: list[str], pool: Mapping[str, Hidden], wanted: int, prepare: Callable, setting: Mapping, seed: int,
         generator: np.random.Generator) -> tuple[dict, dict, dict]:
    """Effects, strengths asked and strengths reached: the first of `order` that the setting can show at all.

    An effect that cannot reach the strength drawn for it gets one drawn below what it can reach, one that cannot stay
    below it keeps the least it has (presliding takes all friction from a sample at zero slip, however short it is); one
    that cannot come between the weakest and the strongest gives place to the next.
    """
    effects, asked, strengths = {}, {}, {}
    measure = prepare(setting, seed) if wanted else None
    for name in order:
        if len(effects) == wanted:
            break
        hidden, share = pool[name], float(generator.uniform())
        drawn = hidden.draw(generator)

        def leave(amplitude, name=name, hidden=hidden, drawn=drawn):
            assert measure is not None
            return measure({name: hidden.build(amplitude, drawn)})

        strength = WEAKEST * (STRONGEST / WEAKEST) ** share
        amplitude, found = reach_strength(leave, strength, hidden.most)
        if amplitude == hidden.most and found < strength:
            if found < WEAKEST:
                continue
            strength = WEAKEST * (found / WEAKEST) ** share
            amplitude, found = reach_strength(leave, strength, hidden.most)
        if not WEAKEST * 0.97 < found < STRONGEST * 1.03:
            continue
        effects[name] = hidden.build(amplitude, drawn)
        asked[name], strengths[name] = float(strength), float(found)
    return effects, asked, strengths


def write_case(exam: Exam, case: Case, folder: Path) -> dict[str, Any] | None:
    """Simulate a case and write its campaign, which says nothing of what is hidden; returns what the fault did."""
    campaign = exam.bench.make(f"case-{case.index:04d}", case.seed, case.effects, case.setting, case.noise)
    done = None
    if case.fault is not None:
        done = FAULTS[case.fault](exam.bench.traces(campaign), start_generator(exam, 3, case.index))
    exam.bench.write(folder, campaign)
    return done
