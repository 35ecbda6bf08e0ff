"""A plan of tests that nobody has made yet: its table, read strictly, and a campaign without noise made of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from .._errors import ComputationError, InputError
from ..dynamics.impact import RTOL
from ..dynamics.spinning import ATTITUDES, RATES
from ..families import Family, list_families
from ..inference.assembly import adapt_reference
from ..inference.models import ResolvedModel
from ..measurement.campaign import Campaign, Column, Uncertainty
from ..measurement.checks import check_known, check_values
from ..measurement.headings import expand_role, read_pairs
from ..measurement.kinds import list_kinds
from ..measurement.layout import split_heading
from ..measurement.tables import Table, convert_column, read_table
from ..measurement.units import check_unit, parse_quantity, parse_uncertainty, si_unit


BEFORE = 2e-3  # s, that an impact record begins before first touch
AFTER = 1.45  # contact times that it lasts


def read_plan(path: Path | str, resolve, *, channels: Sequence[str] | None = None,
              uncertainties: Sequence[str] | None = None, values: Sequence[str] | None = None,
              length: str | None = None, interval: str | None = None) -> tuple[Campaign, ResolvedModel]:
    """Read a table of planned tests, and compute what the reference model says of them.

    Args:
        path: CSV file, one row a test: conditions with their units in the headings (`approach_speed [m/s]`; of
            tumbling bodies the rates at t = 0, `angular_velocity_x0 [rad/s]`), optionally `record` and `repeats`.
        resolve: family to reference model.
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
    family = _choose_family([name for name, _ in names.values()], table)
    columns, repeats = {}, np.ones(len(table), dtype=int)
    for heading, (name, unit) in names.items():
        if name == "record":
            continue
        numbers = convert_column(table, heading)
        if unit is None and si_unit(name) != "1":
            raise InputError(f"the heading has no unit; write it like '{name} [{si_unit(name)}]'", file=table.file,
                             column=heading)
        found = check_unit(unit or "1", name).convert(numbers)
        check_values(name, found, Table(table.file, {name: table.columns[heading]}, table.lines), "records", None)
        if name == "repeats":
            repeats = found.astype(int)
        else:
            columns[name] = found
    need = [n for n in (*family.needs, *family.starts) if n not in columns]
    if need:
        raise InputError(f"there is no column {need[0]!r}; the file has {', '.join(names)}", file=table.file)
    rows = np.repeat(np.arange(len(table)), repeats)
    resolved = resolve(family.name)
    known = _read_values(values)
    noise = _read_channels(channels, family)
    stated = _read_uncertainties(uncertainties, family, columns)
    records = pd.DataFrame({n: v[rows] for n, v in columns.items() if n not in family.starts},
                           index=pd.Index([f"r{k + 1:02d}" for k in range(len(rows))], name="record"))
    abscissa, length = family.independent, length or family.plan.length
    unit = si_unit(abscissa)
    step = parse_quantity(interval or family.plan.interval, abscissa)
    last = None if length is None else parse_quantity(length, abscissa)
    if not step > 0 or (last is not None and not last > 3 * step):
        raise InputError("the interval has to be positive and the length longer than a few of them")
    plan = Campaign(
        Path(path).stem, "planned", family.kind.name, None, {**dict.fromkeys(family.kind.unknown), **_held(known)},
        records,
        {n: Column(n, si_unit(n), stated.get(n)) for n in records.columns},
        Column(abscissa, unit, stated.get("time")),
        {c: Column(c, si_unit(c), Uncertainty(sd)) for c, sd in noise.items()})
    law = _set_values(adapt_reference(plan, resolved.reference), known).extend(resolved.effects)
    samples = _simulate(plan, law, family, {n: v[rows] for n, v in columns.items()}, tuple(noise), step, last)
    return Campaign(plan.name, plan.title, plan.family, None, plan.known, records, plan.conditions, plan.independent,
                    plan.channels, samples), ResolvedModel(resolved.name, _set_values(resolved.reference, known),
                                                           resolved.text, resolved.effects)


def _choose_family(names: Sequence[str], table: Table) -> Family:
    """The family whose needs are there; of several the one that needs most."""
    found = [f for f in list_families() if set(f.needs or f.starts[:1]) <= set(names)]
    if not found:
        needs = "; ".join(f"{f.name}: {', '.join(f.needs or f.starts)}" for f in list_families())
        raise InputError("the columns name no kind of test, and each needs some of its own (of the family "
                         f"{needs}); the file has {', '.join(names)}", file=table.file)
    return max(found, key=lambda family: len(family.needs))


def _read_values(values: Sequence[str] | None) -> dict[str, float]:
    found = {}
    for name, text in read_pairs("value", values).items():
        try:
            found[name] = parse_quantity(text, name)
            check_known(name, found[name])
        except InputError as error:
            raise InputError(error.problem, option=f"--value {name}") from None
    return found


def _held(known: Mapping[str, float]) -> dict[str, float]:
    """What a fit of the planned campaign would not free: geometry and material, not the unknown ones."""
    unknown = {n for kind in list_kinds().values() for n in kind.unknown}
    return {n: v for n, v in known.items() if n not in unknown}


def _read_channels(channels: Sequence[str] | None, family: Family) -> dict[str, float]:
    usual = family.plan.noise
    pairs = read_pairs("channel", [c.replace(":", "=", 1) for c in channels] if channels else usual)
    if "attitude" in pairs:
        noise = pairs.pop("attitude")
        pairs |= dict.fromkeys(ATTITUDES[:4], noise)
    if "angular_velocity" in pairs:
        noise = pairs.pop("angular_velocity")
        pairs |= dict.fromkeys(RATES, noise)
    found = {}
    for name in (*family.main, *pairs):
        if name not in family.channels:
            raise InputError(f"--channel: {name!r} is no channel of these tests; they are "
                             + ", ".join(family.channels))
        text = pairs.get(name) or usual.get(name, "")
        noise = parse_uncertainty(text, check_unit(si_unit(name), name), name)
        if noise.absolute is None:
            raise InputError(f"--channel {name}: the noise has to be absolute, with a unit")
        found[name] = noise.absolute
    return found


def _read_uncertainties(entries: Sequence[str] | None, family: Family, columns: Mapping[str, Any]
                        ) -> dict[str, Uncertainty]:
    usual = family.plan.uncertainties
    given = {**usual, **{expand_role(k, family.kind): v for k, v in read_pairs("uncertainty", entries).items()}}
    strange = [n for n in given if n not in columns and n != "time" and n not in usual]
    if strange:
        raise InputError(f"--uncertainty: the plan has no condition {strange[0]!r}; it has {', '.join(columns)}")
    return {n: parse_uncertainty(v, check_unit(si_unit(n), n), n) for n, v in given.items()}


def _set_values(reference, known: Mapping[str, float]):
    from ..contact.effect import parameters_of, read_field

    fields = {p.name: p.field for p in parameters_of(reference)}
    strange = [n for n in known if n not in fields]
    if strange:
        raise InputError(f"--value: the model has no parameter {strange[0]!r}; it has {', '.join(fields)}")
    for name, value in known.items():
        reference = eqx.tree_at(lambda r, f=fields[name]: read_field(r, f), reference, jnp.asarray(value))
    return reference


def _simulate(plan: Campaign, law, family: Family, columns: Mapping[str, np.ndarray], channels: tuple[str, ...],
              step: float, last: float | None) -> pd.DataFrame:
    """Samples of all planned tests as the law has them."""
    count = len(plan.records)
    conditions = {n: jnp.asarray(v) for n, v in columns.items()} | {"sequence": jnp.arange(1.0, count + 1.0)}
    if "sequence" in columns:
        conditions["sequence"] = jnp.asarray(columns["sequence"])
    for name, value in family.defaults.items():
        conditions.setdefault(name, jnp.asarray(np.full(count, value)))

    @eqx.filter_jit
    def observe(time, span, inputs):
        def one(c, t, s, i):
            return family.observe(law, c, t, SimpleNamespace(span=s, rtol=jnp.asarray(RTOL), inputs=i), channels)

        return jax.vmap(one)(conditions, time, span, inputs)

    if last is not None:
        first = -BEFORE if family.has_contact else 0.0
        times = np.tile(np.arange(first, last + 0.5 * step, step), (count, 1))
        span = np.full(count, 1.005 * last)
    else:
        # A contact lasts a few times the static time scale: guessed long, then as long as it was.
        span = np.full(count, 0.5)
        for _ in range(3):
            ends = np.asarray(observe(jnp.zeros((count, 2)), jnp.asarray(span), {}).end)
            span = np.where(np.isfinite(ends) & (ends > 0), np.minimum(1.5 * ends, span), span)
        longest = AFTER * float(span.max()) / 1.5
        times = np.tile(np.arange(-BEFORE, longest + 0.5 * step, step), (count, 1))
        span = np.minimum(span, times.max())
    inputs = {name: jnp.asarray(x) for name, x in family.lay_inputs(list(times), columns).items()}
    found = observe(jnp.asarray(times), jnp.asarray(span), inputs)
    if bool(np.asarray(found.failed).any()):
        bad = plan.record_keys[int(np.argmax(np.asarray(found.failed)))]
        raise ComputationError(f"the model could not be integrated for the planned record {bad!r}; check its "
                               "conditions and units")
    assert plan.independent is not None
    frame = {"record": np.repeat(plan.record_keys, times.shape[1]), plan.independent.name: times.ravel()}
    frame |= {c: np.asarray(found.channels)[:, k].ravel() for k, c in enumerate(channels)}
    return pd.DataFrame(frame)
