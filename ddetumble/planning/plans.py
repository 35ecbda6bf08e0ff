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
from ..inference.assembly import adapt_reference
from ..inference.families import find_family
from ..inference.models import ResolvedModel
from ..inference.starts import lay_mesh
from ..measurement.campaign import Campaign, Column, Uncertainty
from ..measurement.checks import check_known, check_values
from ..measurement.headings import expand_role, read_pairs
from ..measurement.layout import split_heading
from ..measurement.tables import Table, convert_column, read_table
from ..measurement.units import check_unit, parse_quantity, parse_uncertainty, si_unit


USUAL = {  # noise of the main channels, setting errors, length and interval of a record where nothing is said
    "impact": ({"normal_force": "0.25 N"}, {"initial_pressure": "0.5 %", "approach_speed": "0.3 %", "time": "0.05 ms"}),
    "oblique": ({"normal_force": "0.25 N", "tangential_force": "0.25 N"},
                {"initial_pressure": "0.5 %", "approach_speed": "0.3 %", "time": "0.05 ms"}),
    "slip": ({"tangential_force": "0.04 N"}, {"normal_load": "0.3 %", "internal_pressure": "0.5 %"}),
    "tumble": (dict.fromkeys(RATES, "2e-5 rad/s"), {}),
}  # fmt: skip
LENGTH = {"slip": "12 mm", "tumble": "600 s"}
INTERVAL = {"impact": "0.25 ms", "oblique": "0.25 ms", "slip": "0.1 mm", "tumble": "2 s"}
BEFORE = 2e-3  # s, that an impact record begins before first touch
AFTER = 1.45  # contact times that it lasts
UNKNOWN = {"impact": ("effective_mass", "restitution"), "slip": ("adhesion_constant", "loss_factor", "slip_scale"),
           "tumble": ("inertia_ratio",)}  # fmt: skip


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
    family = _name_family([name for name, _ in names.values()], table)
    kind = "impact" if family == "oblique" else family
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
    need = [n for n in (*find_family(family).needs, *find_family(family).starts) if n not in columns]
    if need:
        raise InputError(f"there is no column {need[0]!r}; the file has {', '.join(names)}", file=table.file)
    rows = np.repeat(np.arange(len(table)), repeats)
    resolved = resolve(family)
    known = _read_values(values, kind)
    noise = _read_channels(channels, family)
    stated = _read_uncertainties(uncertainties, family, columns)
    records = pd.DataFrame({n: v[rows] for n, v in columns.items() if n not in find_family(family).starts},
                           index=pd.Index([f"r{k + 1:02d}" for k in range(len(rows))], name="record"))
    abscissa = "slip" if family == "slip" else "time"
    unit = si_unit(abscissa)
    step = parse_quantity(interval or INTERVAL[family], abscissa)
    last = None if length is None and family not in LENGTH else parse_quantity(length or LENGTH[family], abscissa)
    if not step > 0 or (last is not None and not last > 3 * step):
        raise InputError("the interval has to be positive and the length longer than a few of them")
    plan = Campaign(
        Path(path).stem, "planned", kind, None, {**dict.fromkeys(UNKNOWN[kind]), **_held(known)}, records,
        {n: Column(n, si_unit(n), stated.get(n)) for n in records.columns},
        Column(abscissa, unit, stated.get("time")),
        {c: Column(c, si_unit(c), Uncertainty(sd)) for c, sd in noise.items()})
    law = _set_values(adapt_reference(plan, resolved.reference), known).extend(resolved.effects)
    samples = _simulate(plan, law, family, {n: v[rows] for n, v in columns.items()}, tuple(noise), step, last)
    return Campaign(plan.name, plan.title, plan.family, None, plan.known, records, plan.conditions, plan.independent,
                    plan.channels, samples), ResolvedModel(resolved.name, _set_values(resolved.reference, known),
                                                           resolved.text, resolved.effects)


def _name_family(names: Sequence[str], table: Table) -> str:
    if "normal_load" in names:
        return "slip"
    if "approach_speed" in names:
        return "oblique" if "tangential_speed" in names else "impact"
    if "angular_velocity_x0" in names:
        return "tumble"
    raise InputError("the columns name no kind of test: impacts need approach_speed, friction normal_load, tumbling "
                     f"bodies angular_velocity_x0, _y0, _z0; the file has {', '.join(names)}", file=table.file)


def _read_values(values: Sequence[str] | None, kind: str) -> dict[str, float]:
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
    unknown = {n for names in UNKNOWN.values() for n in names}
    return {n: v for n, v in known.items() if n not in unknown}


def _read_channels(channels: Sequence[str] | None, family: str) -> dict[str, float]:
    pairs = read_pairs("channel", [c.replace(":", "=", 1) for c in channels] if channels else USUAL[family][0])
    if "attitude" in pairs:
        noise = pairs.pop("attitude")
        pairs |= dict.fromkeys(ATTITUDES[:4], noise)
    if "angular_velocity" in pairs:
        noise = pairs.pop("angular_velocity")
        pairs |= dict.fromkeys(RATES, noise)
    found = {}
    for name in (*find_family(family).main, *pairs):
        if name not in find_family(family).channels:
            raise InputError(f"--channel: {name!r} is no channel of these tests; they are "
                             + ", ".join(find_family(family).channels))
        text = pairs.get(name) or USUAL[family][0].get(name, "")
        noise = parse_uncertainty(text, check_unit(si_unit(name), name), name)
        if noise.absolute is None:
            raise InputError(f"--channel {name}: the noise has to be absolute, with a unit")
        found[name] = noise.absolute
    return found


def _read_uncertainties(entries: Sequence[str] | None, family: str, columns: Mapping[str, Any]
                        ) -> dict[str, Uncertainty]:
    kind = "impact" if family == "oblique" else family
    given = USUAL[family][1] | {expand_role(k, kind): v for k, v in read_pairs("uncertainty", entries).items()}
    strange = [n for n in given if n not in columns and n != "time" and n not in USUAL[family][1]]
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


def _simulate(plan: Campaign, law, family: str, columns: Mapping[str, np.ndarray], channels: tuple[str, ...],
              step: float, last: float | None) -> pd.DataFrame:
    """Samples of all planned tests as the law has them."""
    kind, count = find_family(family), len(plan.records)
    conditions = {n: jnp.asarray(v) for n, v in columns.items()} | {"sequence": jnp.arange(1.0, count + 1.0)}
    if "sequence" in columns:
        conditions["sequence"] = jnp.asarray(columns["sequence"])
    if family in ("impact", "oblique"):
        conditions.setdefault("initial_pressure", jnp.zeros(count))

    @eqx.filter_jit
    def observe(time, span, mesh):
        def one(c, t, s, m):
            row = SimpleNamespace(span=s, rtol=jnp.asarray(RTOL), inputs={"mesh": m} if family == "tumble" else {})
            return kind.observe(law, c, t, row, channels)

        return jax.vmap(one)(conditions, time, span, mesh)

    mesh = np.zeros((count, 2))
    if last is not None:
        first = 0.0 if family in LENGTH else -BEFORE
        times = np.tile(np.arange(first, last + 0.5 * step, step), (count, 1))
        span = np.full(count, 1.005 * last)
    else:
        # A contact lasts a few times the static time scale: guessed long, then as long as it was.
        span = np.full(count, 0.5)
        for _ in range(3):
            ends = np.asarray(observe(jnp.zeros((count, 2)), jnp.asarray(span), jnp.asarray(mesh)).end)
            span = np.where(np.isfinite(ends) & (ends > 0), np.minimum(1.5 * ends, span), span)
        longest = AFTER * float(span.max()) / 1.5
        times = np.tile(np.arange(-BEFORE, longest + 0.5 * step, step), (count, 1))
        span = np.minimum(span, times.max())
    if family == "tumble":
        rates = np.stack([columns[n] for n in kind.starts], axis=1)
        mesh = lay_mesh(list(times), np.sqrt(np.sum(rates**2, axis=1)))
    found = observe(jnp.asarray(times), jnp.asarray(span), jnp.asarray(mesh))
    if bool(np.asarray(found.failed).any()):
        bad = plan.record_keys[int(np.argmax(np.asarray(found.failed)))]
        raise ComputationError(f"the model could not be integrated for the planned record {bad!r}; check its "
                               "conditions and units")
    assert plan.independent is not None
    frame = {"record": np.repeat(plan.record_keys, times.shape[1]), plan.independent.name: times.ravel()}
    frame |= {c: np.asarray(found.channels)[:, k].ravel() for k, c in enumerate(channels)}
    return pd.DataFrame(frame)
