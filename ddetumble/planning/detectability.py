"""What a campaign could see before any test of it: how small an effect, and which pairs would look alike.

Every effect is taken at the size that `selection.detectability` finds; two of them look alike where the cosine
between what can be seen of them is near one. A campaign that nobody has measured yet is a table of planned tests, read
strictly, with samples as the reference model has them.
"""

import dataclasses as dc
import math
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from .._display import Progress, stay_silent
from .._errors import ComputationError, InputError, error_place, offer_names
from .._numerics import map_threads, scalar
from ..contact.effect import AbstractEffect, is_scored, parameters_of, read_field
from ..dynamics.impact import RTOL
from ..dynamics.spinning import ATTITUDES, RATES
from ..families import Family, list_families, name_family, open_campaign
from ..inference.archive import Model, resolve_model
from ..inference.assembly import adapt_reference, default_starts, guess_start
from ..inference.files import AbstractWritten, list_versions, make_plain
from ..inference.models import ResolvedModel
from ..measurement.campaign import Campaign, Column, Uncertainty
from ..measurement.checks import check_values, read_known
from ..measurement.columns import expand_role, read_pairs
from ..measurement.kinds import list_kinds
from ..measurement.layout import split_heading
from ..measurement.quantities import describe_quantity, format_plain, join_words
from ..measurement.tables import convert_column, read_table
from ..measurement.units import check_unit, convert_text, parse_quantity, parse_uncertainty, si_unit
from ..selection.detectability import Signature, detectable_length, find_size, measure_signature, reach_limit
from ..selection.problem import SelectionProblem, pose_selection, require_computed
from .setting_ranges import read_channels, read_noise


# |cos| from which no size tells two effects apart: above it the 0.1 % that differs is lost in linearisation.
SAME = 0.9995
BEFORE = 2e-3  # s, that an impact record begins before first touch, so that the time origin is seen
MOST = 1000  # times a plan is made; beyond that it is no plan
AFTER = 1.45  # contact times that it lasts, so that a contact prolonged by an effect still ends within it


@dc.dataclass(frozen=True)
class Visible:
    """One effect of the catalogue."""

    effect: str  # id
    parameter: str  # its amplitude
    unit: str  # of `size`
    # Public value of the amplitude that would be found with 95 % power, at the shape that shows most; None where no
    # size that physics allows would be.
    size: float | None
    shapes: dict[str, float]  # values of its shape parameters there, public
    visible: float  # fraction of its own signature (squared length) that refits leave
    closest: str | None  # effect whose signature is most like it
    cosine: float  # of the two
    # Multiple of the departure of `size` from the null from which it is told from `closest`; None where no value that
    # physics allows is.
    told: float | None
    sizes: dict[str, float]  # of each component of a vector, by public name
    units: dict[str, str] = dc.field(default_factory=dict)  # of the shapes


@dc.dataclass(frozen=True)
class Needed:
    """How often a plan has to be made so that an effect of a size that was asked for is detected with 95 % power."""

    name: str  # of the amplitude, `effect-id.symbol`
    value: float  # public
    unit: str
    length: float  # of what the plan, made once, shows of it at the shape that shows most [standard deviations]
    repeats: int | None  # of the whole plan; None where `MOST` are too few
    records: int | None  # in all

    def __str__(self) -> str:
        what = f"{self.name} = {self.value:.3g} {self.unit}".rstrip().removesuffix(" 1")
        if self.repeats is None:
            return f"{MOST} times this plan would not detect {what} with 95 % power."
        often = "Once" if self.repeats == 1 else f"{self.repeats} times"
        return f"{often} this plan, {self.records} records, would detect {what} with 95 % power."


@dc.dataclass(frozen=True)
class Visibility(AbstractWritten):
    """The map; `to_dict()` is `map.json`."""

    file: ClassVar[str] = "map.json"
    campaign: str  # name, as the next two
    family: str
    model: str
    records: int  # of the campaign
    samples: int
    effects: tuple[Visible, ...]  # of the catalogue, in its order
    names: tuple[str, ...]  # rows and columns of `cosines`: effects that can be seen
    # |cos| between what can be seen of two effects, the largest over their shapes, shape (names, names).
    cosines: np.ndarray
    length: float  # of a signature that is found with 95 % power [standard deviations of the noise]
    alike: tuple[tuple[str, str], ...]  # pairs that cannot be told apart
    sentence: str  # in plain words
    notes: tuple[str, ...] = ()
    needed: tuple[Needed, ...] = ()  # records for the sizes that were asked for

    def __str__(self) -> str:
        """The map for a terminal."""
        width = max(len(e.effect) for e in self.effects)
        rows = [f"{'effect':<{width}}  {'detected from':<38}  most similar"]
        for e in self.effects:
            size = _say_size(e.parameter, e.size, e.unit) if e.size is not None else "undetectable"
            if e.size is not None and e.shapes:
                size += f" ({', '.join(_say_size(n.split('.', 1)[1], x, e.units[n]) for n, x in e.shapes.items())})"
            near = "" if e.closest is None else f"{e.closest} ({e.cosine:.2f}), " + (
                "never distinguishable" if e.told is None else f"distinguishable at {e.told:.2g} times that")
            rows.append(f"{e.effect:<{width}}  {size:<38}  {near}".rstrip())
        return "\n".join([self.sentence, *map(str, self.needed), "", *rows, "", *(f"- {note}" for note in self.notes)])

    def to_dict(self) -> dict[str, Any]:
        """As JSON can hold it."""
        return make_plain(self) | {"versions": list_versions()}


def _say_size(name: str, value: float, unit: str) -> str:
    return f"{name} = {value:.3g}" + ("" if unit in ("", "1") else f" {unit}")


def map_effects(plan: Campaign | str | Path, model: Model = "paper", *, effects: Sequence[type[AbstractEffect]] = (),
                channels: Sequence[str] | None = None, uncertainties: Sequence[str] | None = None,
                values: Sequence[str] | None = None, length: str | None = None, interval: str | None = None,
                sizes: Mapping[str, str] | Sequence[str] | None = None, progress: Progress | None = None) -> Visibility:
    """Compute which effects a planned campaign would detect, at which size, and which pairs it could not distinguish.

    Args:
        plan: a campaign or its folder, of which conditions, times, noise and uncertainties count; or a table of planned
            tests (`read_plan`, which says what the other arguments are).
        model: reference model, see `ddetumble.inference.models`; a fitted folder brings its values.
        effects: of one's own, mapped beside the catalogue.
        channels, uncertainties, values, length, interval: of a table.
        sizes: `EFFECT.NAME=VALUE UNIT` of amplitudes: how often the plan has to be made to detect them is told.
        progress: called with a sentence and the share done.

    Raises:
        InputError: plan or option make no sense.
        ComputationError: the reference model cannot be computed there.
    """
    report = progress or stay_silent
    table = None if isinstance(plan, Campaign) or not Path(plan).is_file() else Path(plan)
    if table is not None:
        campaign, resolved = read_plan(table, model, channels=channels, uncertainties=uncertainties, values=values,
                                       length=length, interval=interval)
    else:
        campaign = open_campaign(plan)
        resolved = resolve_model(model, name_family(campaign))
    report("computing the reference model", 0.05)
    bench = pose_selection(campaign, resolved.reference, tuple(effects), resolved.effects)
    # At the values given, or at those guessed from samples that are there.
    u = bench.start if table is not None else guess_start(campaign, bench.space, bench.start, bench.base)
    solution = require_computed(bench, bench.problem.solve(bench.base, u, moving=False))
    goal = detectable_length(len(bench.list_directions((), depth=float(solution.state.max()))))
    jobs = [(effect, f"{effect.id}.{p.name}", start) for effect in bench.catalogue for p in parameters_of(effect)
            if is_scored(p) for start in default_starts(effect)]
    done: list[int] = []

    def lay(job) -> tuple[np.ndarray, dict[str, float]]:
        """Coordinates with the shapes of an effect put in, and these."""
        effect, name, start = job
        origin, shapes = solution.u.copy(), {}
        for n, value in start.items():
            k = bench.space.index[n]
            other = bench.space.slots[k].parameter
            if n == name:
                continue
            if n.split(".", 1)[0] == effect.id:
                origin[k] = value if other.kind == "shape" else other.default
            if other.kind == "shape":
                shapes[n] = float(origin[k])
        return origin, shapes

    def find(job) -> _Seen | None:
        """The size of one amplitude at which its signature has the wanted length."""
        (effect, name, _), (origin, shapes) = job, lay(job)
        found = find_size(bench.problem, solution, origin, name, goal)
        done.append(1)
        report(f"looking for every effect: {effect.id}", 0.1 + 0.85 * len(done) / len(jobs))
        return None if found is None or not np.isfinite(found.size) else _Seen(effect.id, shapes, found)

    asked = _read_sizes(bench, sizes, {name for _, name, _ in jobs})
    seen = [one for one in map_threads(find, jobs) if one is not None]
    groups = {e.id: [s for s in seen if s.effect == e.id] for e in bench.catalogue}
    found = _describe(bench, resolved.name, groups, goal, table is not None)
    needed = []
    for name, value in asked.items():
        p = bench.space.parameter(name)
        longest = max(measure_signature(bench.problem, solution, lay(job)[0], name, p.transform.to_unconstrained(value))
                      for job in jobs if job[1] == name)
        # Every repeat shows as much again, its squared length.
        times = math.ceil((goal / longest) ** 2 * (1 - 1e-9)) if longest > goal / math.sqrt(MOST) else None
        needed.append(Needed(name, value, bench.space.unit(name, bench.start), longest, times,
                             None if times is None else times * bench.records.count))
    return dc.replace(found, needed=tuple(needed))


def _read_sizes(bench: SelectionProblem, sizes: Mapping[str, str] | Sequence[str] | None, names: Collection[str]
                ) -> dict[str, float]:
    """Public values of amplitudes by name."""
    found = {}
    for name, text in read_pairs("size", sizes).items():
        with error_place(option=f"--size {name}"):
            if name not in names:
                raise InputError(f"there is no such amplitude; {offer_names(name, sorted(names), 'there are')}")
            p, unit = bench.space.parameter(name), bench.space.unit(name, bench.start)
            value = convert_text(text, unit or "1")
            field = p.transform.find_field(value)
            if not p.bounds[0] <= field <= p.bounds[1] or not p.transform.allows(value):
                raise InputError(f"{text!r} is beyond what the effect can be")
            found[name] = value
    return found


@dc.dataclass(frozen=True)
class _Seen:
    """What can be seen of one amplitude of an effect at one shape."""

    effect: str
    shapes: dict[str, float]
    signature: Signature

    def deviate(self, bench: SelectionProblem) -> float:
        """Size in typical changes of its parameter."""
        p = bench.space.slots[bench.space.index[self.signature.name]].parameter
        return abs(self.signature.size - p.default) / p.typical


def _imitate(one: _Seen, others: Sequence[_Seen]) -> float:
    """Largest part (as a cosine) of a signature that another effect can take over, at any one of its shapes."""
    best = 0.0
    for shapes in {tuple(sorted(o.shapes.items())) for o in others}:
        columns = [o.signature.column for o in others if tuple(sorted(o.shapes.items())) == shapes]
        q, _ = np.linalg.qr(np.stack(columns, axis=1))
        best = max(best, float(np.linalg.norm(q.T @ one.signature.column)))
    return min(best, 1.0)


def _describe(bench: SelectionProblem, model: str, groups: Mapping[str, Sequence[_Seen]], goal: float, planned: bool
              ) -> Visibility:
    names = tuple(e for e, own in groups.items() if own)
    cosines = np.eye(len(names))
    for i, a in enumerate(names):
        for j, b in enumerate(names[:i]):
            cosines[i, j] = cosines[j, i] = max([_imitate(s, groups[b]) for s in groups[a]]
                                                + [_imitate(s, groups[a]) for s in groups[b]])

    def publish(fields: dict[str, float]) -> dict[str, float]:
        return {n: bench.space.parameter(n).transform.from_unconstrained(v) for n, v in fields.items()}

    effects = []
    for effect in bench.catalogue:
        own = sorted(groups[effect.id], key=lambda s: s.deviate(bench))
        if not own:
            first = next(p for p in parameters_of(effect) if is_scored(p))
            unit = bench.space.unit(f"{effect.id}.{first.name}", bench.start)
            effects.append(Visible(effect.id, first.name, unit, None, {}, 0.0, None, 0.0, None, {}))
            continue
        best, name = own[0], own[0].signature.name
        sizes: dict[str, float] = {}
        for s in own:
            sizes.setdefault(s.signature.name, s.signature.size)
        k, p = names.index(effect.id), bench.space.slots[bench.space.index[name]].parameter
        row = np.where(np.arange(len(names)) == k, -1.0, cosines[k])
        near = int(np.argmax(row)) if len(names) > 1 else None
        cosine = 0.0 if near is None else float(row[near])
        told = max(float(np.sqrt(bench.settings.decisive / (1.0 - cosine**2)) / goal), 1.0) if cosine < SAME else None
        if told is not None and told * abs(best.signature.size - p.default) > reach_limit(p):
            told = None
        effects.append(Visible(
            effect.id, p.name, bench.space.unit(name, bench.start), p.transform.from_unconstrained(best.signature.size),
            publish(best.shapes), best.signature.visible, None if near is None else names[near], cosine, told,
            publish(sizes), {n: bench.space.unit(n, bench.start) for n in best.shapes}))
    alike = tuple((names[i], names[j]) for i in range(len(names)) for j in range(i + 1, len(names))
                  if cosines[i, j] >= bench.settings.collinear)

    unseen = [e.effect for e in effects if e.size is None]
    shown = f"{len(effects) - len(unseen)} of {len(effects)}"
    sentence = f"These {bench.records.count} records would detect {shown} effects of the catalogue"
    sentence += f"; they cannot detect {', '.join(unseen)}" if unseen else ""
    sentence += (f". They could not distinguish {'; '.join(f'{a} and {b}' for a, b in alike)}: "
                 f"{bench.family.suggest(bench.campaign.channels)}." if alike else
                 ". They could distinguish any two of these.")
    values = join_words([_say_size(n, v["estimate"], v["unit"]) for n in bench.base
                         for v in [bench.space.public(n, bench.start, 0.0)]])
    limits = bench.settings
    notes = (
        f"The sizes are detected with 95 % power by the family-wise test of discover (level {limits.level_each:g}), "
        "with white noise and nuisances as stated.",
        "Of most effects a size half as large takes four times as many records; --size counts them for yours.",
        f"Two effects count as similar from |cos| = {limits.collinear:g}, and as distinguishable from "
        f"Δχ² = {limits.decisive:.0f}.",
        *([f"The reference model has {values}{'' if planned else ', or what was guessed from the samples'}."]
          if values else []),
        *([f"{tell_records(bench.campaign)} State yours by --channel, --interval, --length and --uncertainty."]
          if planned else []), *bench.warnings)
    return Visibility(bench.campaign.name, bench.family.name, model, bench.records.count,
                      int(bench.records.lengths.sum()), tuple(effects), names, cosines, goal, alike, sentence, notes)


def tell_records(plan: Campaign) -> str:
    """What the records of a plan, or of a campaign, are taken to be: noise, uncertainties, interval and length, in
    units that people use."""
    clock = plan.independent

    def show(name: str, value: float, unit: str) -> str:
        shown = describe_quantity(name, np.array([value]), unit=unit)
        return f"{format_plain(float(f'{value * shown.scale:.3g}'))} {shown.unit}".rstrip()

    def tell(name: str, column: Column) -> str:
        spread = column.uncertainty
        if spread is None:
            return ""
        size = (show(name, spread.absolute or 0.0, column.unit) if spread.relative is None else
                f"{100 * spread.relative:.2g} %")
        return f"{describe_quantity(name).name if name != 'time' else 'time origin'} {size}"

    noise = list(filter(None, map(tell, plan.channels, plan.channels.values())))
    parts = [f"a noise of {join_words(noise)}" if noise else "a noise that is measured"]
    if clock is not None and plan.samples is not None:
        first = plan.samples["record"].to_numpy() == plan.record_keys[0]
        x = plan.samples[clock.name].to_numpy(dtype=float)[first]
        if x.size > 1:
            step, length = (show(clock.name, value, clock.unit) for value in (x[1] - x[0], x[-1] - x[0]))
            parts += [f"a sample every {step}", f"a length of {length}"]
    columns = [*plan.conditions.items(), *([("time", clock)] if clock is not None and clock.name == "time" else [])]
    known = list(filter(None, (tell(name, column) for name, column in columns)))
    return f"The records have {join_words(parts)}" + (
        f"; the settings have an uncertainty of {join_words(known)}." if known else "; the settings are exact.")


def read_plan(path: Path | str, model: Model = "paper", *, channels: Sequence[str] | None = None,
              uncertainties: Sequence[str] | None = None, values: Sequence[str] | None = None,
              length: str | None = None, interval: str | None = None) -> tuple[Campaign, ResolvedModel]:
    """Read a table of planned tests, and compute what the reference model says of them.

    Args:
        path: CSV file, one row a test: conditions with their units in the headings (`approach_speed [m/s]`; of
            tumbling bodies the rates at t = 0, `angular_velocity_x0 [rad/s]`), optionally `record` and `repeats`.
        model: reference model.
        channels: `NAME: NOISE UNIT` of what is measured; the main channel at its usual noise where not given.
        uncertainties: `NAME=VALUE` of conditions and of `time`; the usual ones where not given.
        values: `NAME=VALUE UNIT` of the reference model's parameters; its defaults where not given.
        length, interval: of a record, with their unit.

    Returns:
        A campaign whose samples are the model's, and the resolved model.

    Raises:
        InputError: the table or an option makes no sense.
        ComputationError: the model cannot be computed there.
    """
    table = read_table(path)
    names = {heading: split_heading(heading) for heading in table.columns}
    there = {name for name, _ in names.values()}
    fitting = [f for f in list_families() if set(f.needs or f.starts[:1]) <= there]
    if not fitting:
        needs = "; ".join(f"{f.name}: {', '.join(f.needs or f.starts)}" for f in list_families())
        raise InputError("the columns fit no kind of test; the kinds need these columns (by family: "
                         f"{needs}), but the file has {', '.join(name for name, _ in names.values())}", file=table.file)
    family = max(fitting, key=lambda one: len(one.needs))
    columns, repeats = {}, np.ones(len(table), dtype=int)
    for heading, (name, unit) in names.items():
        if name == "record":
            continue
        numbers = convert_column(table, heading)
        if unit is None and si_unit(name) != "1":
            raise InputError(f"the heading has no unit; write it like '{name} [{si_unit(name)}]'", file=table.file,
                             column=heading)
        found = check_unit(unit or "1", name).convert(numbers)
        check_values(name, found, table, "records", None)
        if name == "repeats":
            repeats = found.astype(int)
        else:
            columns[name] = found
    need = [n for n in (*family.needs, *family.starts) if n not in columns]
    if need:
        raise InputError(f"there is no column {need[0]!r}; the file has {', '.join(names)}", file=table.file)
    columns = {name: np.repeat(found, repeats) for name, found in columns.items()}

    resolved, known = resolve_model(model, family.name), {}
    units = {p.name: p.unit or "1" for p in parameters_of(resolved.reference)}
    for name, text in read_pairs("value", values).items():
        with error_place(option=f"--value {name}"):
            known[name] = read_known(name, text, units.get(name, ""))
    given = {**family.plan.uncertainties,
             **{expand_role(k, family.kind): v for k, v in read_pairs("uncertainty", uncertainties).items()}}
    strange = [n for n in given if n not in columns and n != "time" and n not in family.plan.uncertainties]
    if strange:
        raise InputError(f"--uncertainty: the plan has no condition {strange[0]!r}; its conditions are "
                         f"{', '.join(columns)}")
    stated = {n: parse_uncertainty(v, check_unit(si_unit(n), n), n) for n, v in given.items()}
    noise = _read_channels(channels, family)
    abscissa, length = family.independent, length or family.plan.length
    step = parse_quantity(interval or family.plan.interval, abscissa)
    last = None if length is None else parse_quantity(length, abscissa)
    if not step > 0 or (last is not None and not last > 3 * step):
        raise InputError("the interval must be positive and the length must exceed a few intervals")

    records = pd.DataFrame({n: v for n, v in columns.items() if n not in family.starts},
                           index=pd.Index([f"r{k + 1:02d}" for k in range(repeats.sum())], name="record"))
    # A fit of the planned campaign would not free geometry and material that are given.
    unknown = {n for kind in list_kinds().values() for n in kind.unknown}
    plan = Campaign(
        Path(path).stem, "planned", family.kind.name, None,
        {**dict.fromkeys(family.kind.unknown), **{n: v for n, v in known.items() if n not in unknown}}, records,
        {n: Column(n, si_unit(n), stated.get(n)) for n in records.columns},
        Column(abscissa, si_unit(abscissa), stated.get("time")),
        {c: Column(c, si_unit(c), Uncertainty(sd)) for c, sd in noise.items()})
    law = _set_values(adapt_reference(plan, resolved.reference), known).extend(resolved.effects)
    samples = _simulate(plan, law, family, columns, step, last)
    return (dc.replace(plan, samples=samples), dc.replace(resolved, reference=_set_values(resolved.reference, known)))


def _read_channels(channels: Sequence[str] | None, family: Family) -> dict[str, float]:
    """Standard deviation of the noise of what is measured, SI."""
    usual = family.plan.noise
    pairs = read_channels(channels or usual)
    for name, parts in (("attitude", ATTITUDES[:4]), ("angular_velocity", RATES)):
        if name in pairs:
            pairs |= dict.fromkeys(parts, pairs.pop(name))
    found = {}
    for name in (*family.main, *pairs):
        if name not in family.channels:
            raise InputError(f"--channel: {name!r} is not a channel of these tests, which are "
                             + ", ".join(family.channels))
        found[name] = read_noise(name, pairs.get(name) or usual.get(name, ""))
    return found


def _set_values(reference, known: Mapping[str, float]):
    fields = {p.name: p.field for p in parameters_of(reference)}
    strange = [n for n in known if n not in fields]
    if strange:
        raise InputError(f"--value: the model has no parameter {strange[0]!r}; its parameters are {', '.join(fields)}")
    for name, value in known.items():
        reference = eqx.tree_at(lambda r, f=fields[name]: read_field(r, f), reference, scalar(value))
    return reference


def _simulate(plan: Campaign, law, family: Family, columns: Mapping[str, np.ndarray], step: float, last: float | None
              ) -> pd.DataFrame:
    """Samples of all planned tests as the law has them."""
    count, channels = len(plan.records), tuple(plan.channels)
    conditions = {**{n: jnp.full(count, value, dtype=float) for n, value in family.defaults.items()},
                  "sequence": jnp.arange(1.0, count + 1.0), **{n: jnp.asarray(v) for n, v in columns.items()}}

    @eqx.filter_jit
    def observe(time, span, inputs):
        def one(c, t, s, i):
            return family.observe(law, c, t, SimpleNamespace(span=s, rtol=jnp.asarray(RTOL), inputs=i), channels)

        return jax.vmap(one)(conditions, time, span, inputs)

    if last is not None:
        times = np.arange(-BEFORE if family.has_contact else 0.0, last + 0.5 * step, step)
        span = np.full(count, 1.005 * last)
    else:
        # A contact lasts a few times the static time scale: guessed long, then as long as it was.
        span = np.full(count, 0.5)
        for _ in range(3):
            ends = np.asarray(observe(jnp.zeros((count, 2)), jnp.asarray(span), {}).end)
            span = np.where(np.isfinite(ends) & (ends > 0), np.minimum(1.5 * ends, span), span)
        times = np.arange(-BEFORE, AFTER * float(span.max()) / 1.5 + 0.5 * step, step)
        span = np.minimum(span, times.max())
    times = np.tile(times, (count, 1))
    inputs = {name: jnp.asarray(x) for name, x in family.lay_inputs(list(times), columns).items()}
    found = observe(jnp.asarray(times), jnp.asarray(span), inputs)
    failed = np.asarray(found.failed)
    if failed.any():
        raise ComputationError(f"the model could not be integrated for the planned record "
                               f"{plan.record_keys[int(np.argmax(failed))]!r}; check its conditions and units")
    assert plan.independent is not None
    frame = {"record": np.repeat(plan.record_keys, times.shape[1]), plan.independent.name: times.ravel()}
    frame |= {c: np.asarray(found.channels)[:, k].ravel() for k, c in enumerate(channels)}
    return pd.DataFrame(frame)
