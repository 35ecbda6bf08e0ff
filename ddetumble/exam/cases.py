"""Cases of an exam: every one sampled from the exam's seed and its own number alone."""

import dataclasses as dc
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError
from .faults import FAULTS
from .simulators.campaigns import write_package
from .simulators.generator import CaseGenerator, Hidden
from .simulators.impact_campaigns import IMPACT
from .simulators.oblique_campaigns import OBLIQUE
from .simulators.slip_campaigns import SLIP
from .simulators.strength import reach_strength
from .simulators.tumbling_campaigns import TUMBLE


GENERATORS: dict[str, CaseGenerator] = {one.name: one for one in (IMPACT, SLIP, OBLIQUE, TUMBLE)}
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
        edition: of the drawing; the present one of the family's generator where not given.
    """

    family: str
    seed: int = 0
    truths: tuple[str, ...] = TRUTHS
    noise: str = "drawn"
    fault: str = "drawn"
    edition: int = 0

    def __post_init__(self):
        for name, value, allowed in (("--family", self.family, GENERATORS), ("--noise", self.noise, (*NOISES, "drawn")),
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
        object.__setattr__(self, "edition", self.edition or self.generator.edition)

    @property
    def generator(self) -> CaseGenerator:
        """Of its cases."""
        return GENERATORS[self.family]


@dc.dataclass(frozen=True)
class Case:
    """One question with its answer.

    Attributes:
        index: its number in the exam.
        kind: of what is hidden, out of TRUTHS.
        effects: that are hidden, with their parameters.
        asked, strengths: of every effect, the strength drawn and the one that its parameters have.
        noise: `rho` and `white_share`.
        fault: one of FAULTS, or None.
        setting: of the generator; `base` in it are the reference model's parameters.
        seed: of the campaign's random numbers.
    """

    index: int
    kind: str
    effects: Mapping[str, Mapping[str, Any]]
    asked: Mapping[str, float]
    strengths: Mapping[str, float]
    noise: Mapping[str, float]
    fault: str | None
    setting: Mapping[str, Any]
    seed: int


def start_random(exam: Exam, *more: int) -> np.random.Generator:
    """Random numbers of their own for every exam, case and purpose."""
    return np.random.default_rng([exam.edition, exam.seed, list(GENERATORS).index(exam.family), *more])


def find_kind(exam: Exam, index: int) -> tuple[str, int]:
    """Kind of a case, and how many cases of that kind come before it."""
    pattern = [kind for kind in PATTERN if kind in exam.truths]
    rounds, place = divmod(index, len(pattern))
    kind = pattern[place]
    return kind, rounds * pattern.count(kind) + pattern[:place].count(kind)


def sample_case(exam: Exam, index: int) -> Case:
    """Sample one case; the others do not matter to it.

    Single and outside effects come in turn, in an order drawn once for the exam; pairs are drawn at random.
    """
    random, family = start_random(exam, 1, index), exam.generator
    kind, rank = find_kind(exam, index)
    seed = int(random.integers(2**31))
    setting = family.draw_setting(random)
    noise = draw_noise_kind(exam, random)
    faulty = random.random() < FAULTY
    fault = str(random.choice(list(FAULTS)))
    fault = {"none": None, "drawn": fault if faulty else None}.get(exam.fault, exam.fault)
    pool = dict(family.outside if kind == "outside" else family.catalogue)
    if kind == "two":
        order = [str(name) for name in random.permutation(list(pool))]
    else:
        order = [str(name) for name in start_random(exam, 2).permutation(list(pool))]
        order = order[rank % len(order) :] + order[: rank % len(order)]
    wanted = {"nothing": 0, "two": 2}.get(kind, 1)
    effects, asked, strengths = hide(order, pool, wanted, family.prepare, setting, seed, random)
    return Case(index, kind, effects, asked, strengths, noise, fault, setting, seed)


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
    family = exam.generator
    campaign = family.make(f"case-{case.index:04d}", case.seed, case.effects, **case.setting, **case.noise)
    done = None
    if case.fault is not None:
        readings = [record.values[:, : len(family.channels)] for record in campaign.records]
        done = FAULTS[case.fault](readings, start_random(exam, 3, case.index))
    write_package(folder, campaign)
    return done
