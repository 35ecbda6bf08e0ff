"""Cases of an exam: every one sampled from the exam's seed and its own number alone, simulated, and answered."""

import dataclasses as dc
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from .._errors import InputError
from ..selection.discovery import Discovery
from .faults import FAULTS
from .simulators.benches import BENCHES, perturb
from .simulators.campaigns import write_package
from .simulators.generator import CaseGenerator, Hidden
from .simulators.impact_campaigns import IMPACT
from .simulators.oblique_campaigns import OBLIQUE
from .simulators.slip_campaigns import SLIP
from .simulators.strength import reach_strength
from .simulators.tumbling_campaigns import TUMBLE


GENERATORS: dict[str, CaseGenerator] = {one.name: one for one in (IMPACT, SLIP, OBLIQUE, TUMBLE)}
TRUTHS = ("nothing", "one", "two", "outside")  # that are drawn unless an exam says what
COUNTS = {"nothing": 0, "one": 1, "two": 2, "three": 3, "outside": 1}  # of what each kind hides
PATTERN = ("nothing", "one", "nothing", "one", "two", "nothing", "one", "outside", "three")
NOISES = ("white", "ar1")
WEAKEST, STRONGEST = 0.5, 8.0  # strength: rms over noise that a refitted reference model leaves
TWOFOLD = 0.25  # share of the drawn benches that are of two kinds
FEWEST, FEW = 3, 8  # tests of a plan of few
FAULTY = 0.25  # share of the cases with a fault, where faults are drawn


@dc.dataclass(frozen=True)
class Exam:
    """What is drawn from; two exams that are equal ask the same.

    Attributes:
        family: of the records.
        seed: of everything drawn.
        truths: kinds of what is hidden, out of COUNTS; all but `three` where not given.
        noise: `white`, `ar1` (correlation 0.3 to 0.9, partly white in a third of the cases) or `drawn`: even odds.
        fault: `none`, `drawn` (one of FAULTS in a quarter of the cases), or one of FAULTS in every case.
        bench: `stated` (noise and settings are as the campaign says), one of BENCHES that the family can show, or
            `drawn`: any of these, in a quarter of the cases two together.
        tests: `full` (12 and more, or three bodies and more), or `few`: 3 to 8 tests, often at one pressure, speed
            or load. Few hide nothing: a refit there takes up most effects whole, so that they have no strength.
        edition: of the drawing; the present one of the family's generator where not given.
    """

    family: str
    seed: int = 0
    truths: tuple[str, ...] = TRUTHS
    noise: str = "drawn"
    fault: str = "drawn"
    edition: int = 0
    bench: str = "stated"
    tests: str = "full"

    def __post_init__(self):
        generator = GENERATORS.get(self.family)
        suited = BENCHES if generator is None else generator.benches
        for option, values, allowed in (("--family", (self.family,), GENERATORS), ("--truth", self.truths, COUNTS),
                                        ("--noise", (self.noise,), (*NOISES, "drawn")),
                                        ("--fault", (self.fault,), ("none", "drawn", *FAULTS)),
                                        ("--bench", (self.bench,), ("stated", "drawn", *suited)),
                                        ("--tests", (self.tests,), ("full", "few"))):
            for value in values:
                if value not in allowed:
                    raise InputError(f"{value!r} is none of {', '.join(allowed)}", option=option)
        if not self.truths:
            raise InputError(f"name at least one of {', '.join(COUNTS)}", option="--truth")
        if self.tests == "few" and set(self.truths) != {"nothing"}:
            raise InputError("few tests can hide nothing, as a refit takes up most effects; add --truth nothing",
                             option="--tests")
        if self.seed < 0:
            raise InputError("the seed is a whole number from 0 on", option="--seed")
        object.__setattr__(self, "edition", self.edition or self.generator.edition)

    @property
    def generator(self) -> CaseGenerator:
        """Of its cases."""
        return GENERATORS[self.family]

    @property
    def title(self) -> str:
        """What it is an exam of."""
        return f"Exam of the family {self.family}"

    @property
    def setting(self) -> str:
        """How its cases are drawn."""
        return (f"Drawn from seed {self.seed}: hidden {', '.join(self.truths)}; noise {self.noise}; faults "
                f"{self.fault}; bench {self.bench}; tests {self.tests}. Strength is the rms over the stated noise that "
                "a refitted reference model leaves, linearised about the truth (which overstates strong effects of "
                "friction), measured by the simulator that made the records, which shares no code with the package.")

    @property
    def options(self) -> str:
        """The command line's options that mean it."""
        text = f"--family {self.family} --seed {self.seed}"
        text += "".join(f" --truth {kind}" for kind in self.truths if self.truths != TRUTHS)
        for option, usual in (("noise", "drawn"), ("fault", "drawn"), ("bench", "stated"), ("tests", "full")):
            value = getattr(self, option)
            text += f" --{option} {value}" if value != usual else ""
        return text

    def draw(self, case: "Case | int") -> tuple[dict[str, Any], Callable[[Path], Iterator[dict[str, Any]]]]:
        """Fields of the row of a case, or of the case of that number, and what answers it in a folder."""
        case = sample_case(self, case) if isinstance(case, int) else case
        return dc.asdict(case), partial(answer_case, self, case)

    def to_dict(self) -> dict[str, Any]:
        """Its fields as files keep them; `bench` and `tests`, which came later, only where they are not as before."""
        before = {"bench": "stated", "tests": "full"}
        return {name: value for name, value in dc.asdict(self).items() if before.get(name) != value}


@dc.dataclass(frozen=True)
class Case:
    """One question with its answer."""

    index: int  # its number in the exam
    kind: str  # of what is hidden, out of COUNTS
    effects: Mapping[str, Mapping[str, Any]]  # that are hidden, with their parameters
    asked: Mapping[str, float]  # strength drawn for every effect
    strengths: Mapping[str, float]  # and the one that its parameters have
    noise: Mapping[str, float]  # `rho` and `white_share`
    fault: str | None  # one of FAULTS
    setting: Mapping[str, Any]  # of the generator; `base` in it are the reference model's parameters
    seed: int  # of the campaign's random numbers
    bench: Sequence[str] = ()  # kinds out of BENCHES; none where everything is as stated


def start_random(exam: Exam, *more: int) -> np.random.Generator:
    """Random numbers of their own for every exam, case and purpose."""
    return np.random.default_rng([exam.edition, exam.seed, list(GENERATORS).index(exam.family), *more])


def find_kind(exam: Any, index: int) -> tuple[str, int]:
    """Kind of a case out of an exam's `truths`, and how many cases of that kind come before it."""
    pattern = [kind for kind in PATTERN if kind in exam.truths]
    rounds, place = divmod(index, len(pattern))
    kind = pattern[place]
    return kind, rounds * pattern.count(kind) + pattern[:place].count(kind)


def sample_case(exam: Exam, index: int) -> Case:
    """Sample one case; the others do not matter to it.

    Single and outside effects come in turn, in an order drawn once for the exam; several are drawn at random.
    """
    random, family = start_random(exam, 1, index), exam.generator
    kind, rank = find_kind(exam, index)
    seed = int(random.integers(2**31))
    setting = family.draw_setting(random)
    if exam.tests == "few":
        setting = thin_plan(setting, start_random(exam, 6, index))
    # All of it is drawn whatever the exam asks for, so that other options change nothing else about a case.
    drawn = str(random.choice(NOISES))
    noise = {"rho": float(random.uniform(0.3, 0.9)), "white_share": float(random.choice([0.0, 0.0, 0.4]))}
    if (drawn if exam.noise == "drawn" else exam.noise) == "white":
        noise = {"rho": 0.0, "white_share": 0.0}
    faulty, fault = random.random() < FAULTY, str(random.choice(list(FAULTS)))
    fault = {"none": None, "drawn": fault if faulty else None}.get(exam.fault, exam.fault)
    pool = family.outside if kind == "outside" else family.catalogue
    pool = {name: hidden for name, hidden in pool.items() if hidden.since <= exam.edition}
    several = COUNTS[kind] > 1
    order = [str(name) for name in (random if several else start_random(exam, 2)).permutation(list(pool))]
    if not several:
        order = order[rank % len(order):] + order[: rank % len(order)]
    effects, asked, strengths = {}, {}, {}
    if kind != "nothing":
        measure = family.prepare(setting, seed)
        for name in order:
            found = hide(name, pool[name], measure, random)
            if found is not None:
                effects[name], asked[name], strengths[name] = found
            if len(effects) == COUNTS[kind]:
                break
    return Case(index, kind, effects, asked, strengths, noise, fault, setting, seed, draw_bench(exam, index))


def thin_plan(setting: Mapping[str, Any], random: np.random.Generator) -> dict[str, Any]:
    """The setting with 3 to 8 tests: of each list of conditions some, often one alone; as it is without any list."""
    lists = {name: values for name, values in setting.items() if isinstance(values, list)}
    kept = dict(setting)
    while lists:
        counts = {name: int(random.integers(1, len(values) + 1)) for name, values in lists.items()}
        repeats = {"repeats": int(random.integers(1, 3))} if "repeats" in setting else {}
        if FEWEST <= math.prod([*counts.values(), *repeats.values()]) <= FEW:
            chosen = {name: sorted(map(float, random.choice(values, counts[name], replace=False)))
                      for name, values in lists.items()}
            return kept | chosen | repeats
    return kept


def draw_bench(exam: Exam, index: int) -> tuple[str, ...]:
    """Kinds of a case's bench, from random numbers of their own: the case is else the same on every bench."""
    if exam.bench == "drawn":
        random = start_random(exam, 4, index)
        order, twofold = random.permutation(list(exam.generator.benches)), random.random() < TWOFOLD
        return tuple(str(kind) for kind in order[: 1 + twofold])
    return () if exam.bench == "stated" else (exam.bench,)


def hide(name: str, hidden: Hidden, measure: Callable[[Mapping[str, Any]], float], random: np.random.Generator
         ) -> tuple[dict[str, Any], float, float] | None:
    """Parameters of an effect, the strength asked for and the one reached; None where the setting cannot show it.

    An effect that cannot reach the strength drawn for it gets one drawn below what it can reach, one that cannot stay
    below it keeps the least it has (presliding takes all friction from a sample at zero slip, however short it is); one
    that cannot come between the weakest and the strongest gives place to the next.
    """
    share = float(random.uniform())
    drawn = hidden.draw(random)

    def leave(amplitude):
        return measure({name: hidden.build(amplitude, drawn)})

    strength = WEAKEST * (STRONGEST / WEAKEST) ** share
    amplitude, found = reach_strength(leave, strength, hidden.most)
    if amplitude == hidden.most and found < strength:
        if found < WEAKEST:
            return None
        strength = WEAKEST * (found / WEAKEST) ** share
        amplitude, found = reach_strength(leave, strength, hidden.most)
    if not WEAKEST * 0.97 < found < STRONGEST * 1.03:
        return None
    return hidden.build(amplitude, drawn), float(strength), float(found)


def write_case(exam: Exam, case: Case, folder: Path) -> dict[str, Any]:
    """Simulate a case and write its campaign, which says nothing of what is hidden.

    Returns:
        What the row keeps beside the case: `fault_details` and `bench_details` say what fault and bench did, and `told`
        names effects that say the same as the bench.
    """
    family = exam.generator
    campaign = family.make(f"case-{case.index:04d}", case.seed, case.effects, **case.setting, **case.noise)
    done, disturbed = None, {}
    if case.bench:
        kinds = list(BENCHES)
        campaign, disturbed = perturb(campaign, {kind: start_random(exam, 5, case.index, kinds.index(kind))
                                                 for kind in case.bench})
    if case.fault is not None:
        readings = [record.values[:, : len(family.channels)] for record in campaign.records]
        done = FAULTS[case.fault](readings, start_random(exam, 3, case.index))
    write_package(folder, campaign)
    told = {effect for kind, one in disturbed.items() for effect in family.same.get(one.get("of", kind), ())}
    return {"fault_details": done, "bench_details": disturbed, "told": sorted(told)}


def answer_case(exam: Exam, case: Case, folder: Path) -> Iterator[dict[str, Any]]:
    """Further fields of a row as they come: what was written, and what `discover` says of that, which is all it sees,
    beside the truth.
    """
    from ..selection.discover import discover

    yield write_case(exam, case, folder / "campaign")
    found = discover(folder / "campaign")
    found.save(folder / "discovery")
    yield mark_discovery(found, name_truth(case.setting["base"], case.effects)) | {
        "heldout_over_noise": predict_heldout(exam, case, folder / "discovery")}


def mark_discovery(found: Discovery, truth: Mapping[str, float]) -> dict[str, Any]:
    """What a row keeps of a discovery, beside the true parameters by the names that results use."""
    first, last = found.steps[0].lack_of_fit, found.steps[-1]
    return {
        "verdict": found.verdict, "found": list(found.effects),
        "sets": [[str(s.added), *(str(a["effect"]) for a in s.alternatives)] for s in found.steps[1:]],
        "p_values": [first.smooth_p_value, first.score_p_value, last.lack_of_fit.smooth_p_value,
                     last.lack_of_fit.score_p_value],
        "intervals": {name: [truth[name], e.estimate, e.q025, e.q975] for name, e in last.parameters.items()
                      if name in truth},
        "claimed_over_noise": last.heldout_nrmse / max(found.noise_nrmse, 1e-300), "sentence": found.sentence,
        "records": int(found.counts["records"]),
        "allowed": list(found.allowances),
        "reported": [{"kind": f.kind, "records": list(f.records), "left_out": f.left_out} for f in found.faults],
    }  # fmt: skip


def name_truth(base: Mapping[str, float], effects: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """True parameters by the names that results use: `wall-stiffness.k_w`, `gyro-bias.bias.0`."""
    truth = dict(base)
    for effect, values in effects.items():
        for symbol, value in values.items():
            if isinstance(value, (list, tuple)):
                truth |= {f"{effect}.{symbol}.{k}": float(x) for k, x in enumerate(value)}
            else:
                truth[f"{effect}.{symbol}"] = float(value)
    return truth


def predict_heldout(exam: Exam, case: Case, model: Path) -> float:
    """rms over noise of the grown model's predictions against noise-free tests at conditions that it has not seen."""
    from ..selection.predict import predict

    family, tests = exam.generator, exam.generator.hold_out(case.effects, case.setting)
    table = predict(model, pd.concat([pd.DataFrame({"record": f"h{k}", **test.conditions, family.along: test.along})
                                      for k, test in enumerate(tests)], ignore_index=True))
    truth = np.concatenate([test.readings for test in tests])
    gaps = (table[list(family.channels)].to_numpy() - truth) / np.array(list(family.channels.values()))
    return float(np.sqrt(np.nanmean(np.square(gaps))))
