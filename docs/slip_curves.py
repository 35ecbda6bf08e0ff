"""Fit friction curves made from the paper's polynomials, and K and tan delta_L: `python -m docs.slip_curves -o FOLDER`.

Writes `result.json`, three figures and a `README.md` that says what came out. The committed ones are in
`fits/slip-curves`.
"""

import argparse
import itertools
import math
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pandas as pd

import ddetumble as dd
from ddetumble.contact.friction import (
    CHANGES_SIGN_AT,
    DIVERGES_ABOVE,
    POLYNOMIALS,
    composite_modulus,
    rubber_coefficient,
    slip_coefficient,
    slip_coefficients,
)
from ddetumble.figures import draw_fit, new_figure, render_png, styled
from ddetumble.figures.palette import AFTER, BEFORE, GREY, INK, PLACE
from ddetumble.figures.style import dress
from ddetumble.inference.files import list_versions, write_json
from ddetumble.measurement.campaign import Column, Uncertainty
from ddetumble.selection.series import make_traces


SEED = 20
SLIPS = np.arange(0.0, 40.25, 0.5) * 1e-3  # [m]
NOISE, GAUGE = 0.01, 100.0  # of the force gauge, and its range [N]
LOW = np.round(np.linspace(5.0, 28.0, 12), 1)  # loads at which Eq. 10 makes sense [N]
HIGH = np.array([40.0, 44.4, 50.0])  # of Table 3's loads those at which the gauge reads more than two samples [N]
PRESSURES = np.array([0.5e6, 1.0e6, 1.5e6, 2.5e6])
MEASURED = 0.218  # friction over normal force, Table 4 over Table 3
RUBBER = {"adhesion_constant": 0.8, "loss_factor": 0.15}
KNOWN = {"tensile_strength": 10e6, "real_contact_pressure": 20e6, "elastic_modulus": 7.8e6, "poisson_ratio": 0.47}
SETTINGS = {"normal_load": 0.003, "internal_pressure": 0.005}  # relative, one standard deviation
# Other rubbers than the one that made the readings, in the coordinates of `eq10`, to begin at.
OTHERS = ({"a_0": 0.3, "a_1": -0.05, "sum_0": -0.3, "difference_0": -0.6, "c_0": -0.7},
          {"a_0": 0.6, "a_1": -0.05, "sum_0": -0.1, "difference_0": -1.0, "c_0": -1.5},
          {"a_0": 0.3, "a_1": 0.1, "sum_0": -0.3, "difference_0": -0.6, "c_0": 0.5})
HIGHER = dict.fromkeys(("sum_1", "sum_2", "difference_1", "difference_2", "c_1", "c_2"), 0.0)
ALONE = HIGHER | {"a_1": 0.0} | RUBBER  # held where there is one load
TRUTH = {f"{name}{k}": value for name in "abcd" for k, value in enumerate(POLYNOMIALS[name]) if name != "a" or k < 2}


def make_campaign(loads: Sequence[float], pressures: Sequence[float], generator, *, slip_term: bool = True,
                  exact: bool = False, free: Sequence[str] = ()) -> dd.Campaign:
    """Strokes by Eqs. 8 to 11 with e = 1, at every load [N] and pressure [Pa], as far as the gauge reads.

    Args:
        generator: of the noise and of errors of the settings.
        slip_term: whether Eq. 9 acts.
        exact: settings are as stated.
        free: of what is known of the rubber, what is not.
    """
    settings, parts = [], []
    constant, loss, modulus = *map(jnp.asarray, RUBBER.values()), composite_modulus(*map(jnp.asarray, (7.8e6, 0.47)))
    for k, (load, pressure) in enumerate(itertools.product(loads, pressures)):
        value = float(rubber_coefficient(constant, loss, jnp.asarray(0.5), jnp.asarray(pressure), modulus))
        curve = np.asarray(slip_coefficient(jnp.asarray(SLIPS), slip_coefficients(jnp.asarray(load))))
        force = (value + slip_term * curve) * load + NOISE * generator.standard_normal(len(SLIPS))
        read = np.cumsum(np.abs(force) > GAUGE) == 0
        parts.append(pd.DataFrame({"record": f"r{k + 1:02d}", "slip": SLIPS[read], "tangential_force": force[read]}))
        errors = 1.0 + (1.0 - exact) * np.array(list(SETTINGS.values())) * generator.standard_normal(2)
        settings.append({"normal_load": load * errors[0], "internal_pressure": pressure * errors[1],
                         "slip_speed": 0.02})
    records = pd.DataFrame(settings, index=pd.Index([part["record"][0] for part in parts], name="record"))
    units = {"normal_load": "N", "internal_pressure": "Pa", "slip_speed": "m/s"}
    conditions = {n: Column(n, unit, None if exact or n not in SETTINGS else Uncertainty(relative=SETTINGS[n]))
                  for n, unit in units.items()}
    known = {**{n: None if n in free else value for n, value in KNOWN.items()}, **dict.fromkeys(RUBBER)}
    return dd.Campaign("curves", "Simulated friction curves", "slip", None, known, records, conditions,
                       Column("slip", "m"), {"tangential_force": Column("tangential_force", "N", Uncertainty(NOISE))},
                       pd.concat(parts, ignore_index=True))


def fit_alone(loads: Sequence[float], generator) -> dict[float, dd.Fit]:
    """A fit of the curve at every load by itself: a, b + d, b - d and c, with settings and Eq. 8's part known."""
    return {float(load): dd.fit(make_campaign([load], [1e6], generator, exact=True), "eq10", fixed=ALONE,
                                noise="stated") for load in loads}


def find_truth(load: float, fit: dd.Fit) -> dict[str, float]:
    """a, b + d, b - d and c of Eq. 10 in the order of rates that a fit found: the other is the same curve."""
    a, b, c, d = (float(x) for x in slip_coefficients(jnp.asarray(load))[:4])
    sign = math.copysign(1.0, d * (fit.parameters["sum_0"].estimate - fit.parameters["difference_0"].estimate))
    return {"a_0": a, "sum_0": b + sign * d, "difference_0": b - sign * d, "c_0": sign * c}


def main(folder: Path) -> None:
    """Make, fit, draw and write."""
    generator = np.random.default_rng(SEED)
    campaign = make_campaign(LOW, PRESSURES[[0, 3]], generator)
    lows = [dd.fit(campaign, dd.contact.SlipCurves(**begin), noise="stated") for begin in ({}, *OTHERS)]
    low = lows[0]
    high = dd.fit(make_campaign(HIGH, PRESSURES[[0, 3]], generator, exact=True), "eq10", noise="stated")
    singles = fit_alone([5.0, 11.3, 19.6, 23.8, 28.0, 40.0, 50.0], generator)
    profiles = {load: {name: fit.profile(name) for name in fit.parameters} for load, fit in singles.items()}
    rubber = {}
    for label, pressures, free in (("one pressure", PRESSURES[1:2], []), ("four pressures", PRESSURES, []),
                                   ("four pressures, sigma_0 free", PRESSURES, ["tensile_strength"])):
        campaign = make_campaign([8.0, 16.0, 24.0], pressures, generator, slip_term=False)
        rubber[label] = dd.fit(campaign, "eq8", free=free, noise="stated")
    folder.mkdir(parents=True, exist_ok=True)
    traces = {"eq10": make_traces(low.source, low.problem.records, low.solution, low.noise)}
    for name, figure in (("curves", draw_fit(traces, count=4)), ("coefficients", draw_coefficients(low)),
                         ("alone", draw_alone(singles, profiles))):
        (folder / f"{name}.png").write_bytes(render_png(figure, 110))
    write_json(folder / "result.json", {
        "seed": SEED, "versions": list_versions(), "low": low.to_dict(), "high": high.to_dict(),
        "alone": {f"{load:g}": fit.to_dict() | {"profiles": profiles[load]} for load, fit in singles.items()},
        "rubber": {label: fit.to_dict() for label, fit in rubber.items()}})
    (folder / "README.md").write_text(describe(lows, high, singles, profiles, rubber), encoding="utf-8")
    print(f"{folder}: README.md, result.json and three figures")


def evaluate_polynomials(fit: dd.Fit, name: str, loads) -> tuple[np.ndarray, np.ndarray]:
    """One of a, b + d, b - d, c at loads [N] by fitted polynomials, and its standard deviation, shape of `loads`."""
    names = list(fit.parameters)
    own = [k for k, one in enumerate(names) if one.startswith(name + "_")]
    powers = ((np.asarray(loads) - 15.0) / 10.0)[:, None] ** np.array([int(names[k][-1]) for k in own])
    values = powers @ np.array([fit.parameters[names[k]].estimate for k in own])
    return values, np.sqrt(np.einsum("ij,jk,ik->i", powers, fit.covariance[np.ix_(own, own)], powers))


@styled
def draw_coefficients(low: dd.Fit):
    """a, b + d, b - d and c over the load: Eq. 10, and the fitted polynomials with their band."""
    figure, loads = new_figure(5.0), np.linspace(2.0, 75.0, 200)
    a, b, c, d, _ = (np.asarray(x) for x in slip_coefficients(jnp.asarray(loads)))
    panels = figure.subplots(2, 2).ravel()
    for axes, (name, label, truth, ends) in zip(panels, (
            ("a", "a [-]", a, (-0.7, 0.9)), ("c", "c [-]", c, (-3.5, 0.0)),
            ("sum", "b + d [1/mm]", b + d, (-2.0, 0.3)), ("difference", "b - d [1/mm]", b - d, (-0.6, 4.5))),
            strict=True):
        values, sd = evaluate_polynomials(low, name, loads)
        dress(axes).axvspan(LOW[0], LOW[-1], color=PLACE, lw=0)
        axes.fill_between(loads, values - 1.96 * sd, values + 1.96 * sd, color=AFTER, alpha=0.25, lw=0,
                          label="fitted to 5 to 28 N (shaded), 95 %")
        axes.plot(loads, values, color=AFTER, lw=1.0)
        axes.plot(loads, truth, "--", color=INK, lw=1.0, label="Eq. 10")
        axes.set(xlabel="load [N]", ylabel=label, xlim=(2, 75), ylim=ends)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=2)
    return figure


@styled
def draw_alone(singles, profiles):
    """Fits of single loads less the truth: 95 % by profile likelihood; what has no end reaches the frame."""
    figure, limits = new_figure(5.0), {"a_0": 2e-3, "c_0": 0.5, "sum_0": 0.3, "difference_0": 0.3}
    labels = {"a_0": "a [-]", "c_0": "c [-]", "sum_0": "b + d [1/mm]", "difference_0": "b - d [1/mm]"}
    for axes, (name, limit) in zip(figure.subplots(2, 2).ravel(), limits.items(), strict=True):
        dress(axes).axhline(0.0, color=INK, lw=0.8, ls="--")
        for load, fit in singles.items():
            truth = find_truth(load, fit)[name]
            ends = np.clip(np.array(profiles[load][name]) - truth, -2 * limit, 2 * limit)
            shade = GREY if load < 30 else BEFORE
            axes.plot([load, load], ends, color=shade, lw=1.5)
            axes.plot(load, fit.parameters[name].estimate - truth, "o", ms=4, color=shade)
        axes.set(xlabel="load [N]", ylabel=f"{labels[name]}, less Eq. 10's", ylim=(-limit, limit))
    return figure


def _reach(ends: tuple[float, float], widest: float = 20.0) -> str:
    """An interval in words; an end further away than any friction curve has it is none."""
    low, high = (abs(end) < widest for end in ends)
    if low and high:
        return f"{ends[0]:.4g} to {ends[1]:.4g}"
    return f"above {ends[0]:.4g}" if low else f"below {ends[1]:.4g}" if high else "no bound"


def _tabulate(fit: dd.Fit) -> tuple[list[str], int]:
    """A row a coefficient of Eq. 10; and how many determined ones lie within two standard deviations of the truth."""
    rows, held = ["| coefficient | Eq. 10 | fitted | sd | |", "| --- " * 5 + "|"], 0
    for name, truth in TRUTH.items():
        found = fit.derived[name]
        known, near = math.isfinite(found.sd), abs(found.estimate - truth) <= 1.96 * found.sd
        held += known and near
        word = "not determined" if not known else "holds Eq. 10's" if near else "misses Eq. 10's"
        spread = f"{found.sd:.2g}" if known else "-"
        rows.append(f"| {name} {f'[{found.unit}]' if found.unit else ''} | {truth:.5g} | {found.estimate:.5g} | "
                    f"{spread} | {word} |")
    return rows, held


def _tabulate_alone(singles, profiles) -> list[str]:
    """A row a load: how many readings, and each coefficient with its interval and the truth."""
    rows = ["| load [N] | readings | a | b + d [1/mm] | b - d [1/mm] | c | Eq. 10: a, b + d, b - d, c |",
            "| --- " * 7 + "|"]
    for load, fit in singles.items():
        cells = [f"{fit.parameters[n].estimate:.4g} ({_reach(profiles[load][n])})" for n in fit.parameters]
        truth = ", ".join(f"{value:.4g}" for value in find_truth(load, fit).values())
        rows.append(f"| {load:g} | {fit.samples} | {' | '.join(cells)} | {truth} |")
    return rows


def _list_points(fit: dd.Fit, count: int) -> list[str]:
    return [f"- {text}" for text in fit.cannot_tell_apart[:count]]


def describe(lows: Sequence[dd.Fit], high: dd.Fit, singles, profiles, rubber) -> str:
    """The folder's README."""
    low, *others = lows
    rows, held = _tabulate(low)
    beyond, _ = _tabulate(high)
    (at,), (sd,) = evaluate_polynomials(low, "a", np.array([71.0]))
    lost = [name for name, found in high.derived.items() if not math.isfinite(found.sd)]
    lines = [
        "# Friction curves", "",
        "The friction coefficients of the paper, fitted to simulated strokes, so that what comes out can be compared",
        "with what went in: the polynomials of Eq. 10 over several loads, a...d of Eq. 9 at one load, and K and",
        "tan delta_L of Eq. 8, all by `dd.fit` with the models `eq10` and `eq8`. Made by", "",
        "    python -m docs.slip_curves -o fits/slip-curves", "",
        f"A stroke has {len(SLIPS)} readings over 40 mm with a noise of {NOISE:g} N; loads are known to 0.3 % and",
        f"pressures to 0.5 %; e is held at 1; random numbers start from {SEED}.",
        "[result.json](result.json) has every number and sentence.", "",
        "![curves](curves.png)", "",
        "## 5 to 28 N: recovered", "",
        f"{low.records} curves at {len(LOW)} loads and two pressures give back the polynomials that made them: "
        f"{held} of {len(TRUTH)}",
        f"hold Eq. 10's value within 1.96 standard deviations. Reduced chi-square is {low.chi2_reduced:.2f}. The fit",
        "begins at Eq. 10, where `eq10` has its defaults. Chi-square has several valleys: begun at three other rubbers",
        f"the fit ends at {', '.join(f'{fit.chi2_reduced:.2f}' for fit in others)} times its degrees of freedom; of "
        f"{sum(fit.goodness.misfit for fit in others)} of these the report says",
        "that the model does not describe the data.", "",
        *rows, "",
        f"K is {low.parameters['adhesion_constant'].estimate:.3f} ± {low.parameters['adhesion_constant'].sd:.2g} (made",
        f"with {RUBBER['adhesion_constant']:g}), tan delta_L {low.parameters['loss_factor'].estimate:.4f} ± "
        f"{low.parameters['loss_factor'].sd:.2g} ({RUBBER['loss_factor']:g}). The fit says of itself:", "",
        *_list_points(low, 2), "",
        "![coefficients](coefficients.png)", "",
        "## One load alone", "",
        "Settings and the part of Eq. 8 are held at their true values here. The curve is a constant and two",
        "exponentials with the rates b + d and b - d; exchanging them and turning the sign of c gives the same curve,",
        "(c, d) to (-c, -d). Intervals are 95 % by profile likelihood (`Fit.profile`). a is known everywhere; near",
        "24.2 N, where Eq. 10's d vanishes, c and the smaller exponential are lost, as only c d acts.", "",
        *_tabulate_alone(singles, profiles), "",
        "![one load alone](alone.png)", "",
        "## 40 to 50 N: not recovered", "",
        "These are loads of Table 3. There Eq. 10 makes no friction: its curves grow without limit from",
        f"{DIVERGES_ABOVE:.1f} N on, as b + |d| is positive, and a is negative above {CHANGES_SIGN_AT:.1f} N. The",
        f"force leaves the range of a {GAUGE:g} N gauge after some millimetres; at 44.4 N, where a vanishes, there is",
        "next to no curve. At 60 and 71 N the gauge reads one or two samples a stroke. Growth by a power of e every",
        "2 mm makes single curves at 40 and 50 N look well known: a property of readings made by the formula, and no",
        "support for",
        f"it. Even a fit of the polynomials to all of them that begins at the truth leaves {len(lost)} of {len(TRUTH)}",
        f"coefficients undetermined; its reduced chi-square is {high.chi2_reduced:.2f}.", "",
        *beyond, "",
        "**Nor do the polynomials fitted from 5 to 28 N** say anything about these loads. At 71 N they give",
        f"a = {at:.3f} ± {sd:.1g}: a narrow band around a negative friction, where the paper measured {MEASURED:g}",
        "(Table 4 over Table 3, all of Eq. 11). The band says how well the readings fix the polynomial, not whether",
        "friction follows one. The test that would: strokes at 40 to 71 N.", "",
        "## K and tan delta_L", "",
        f"Strokes without the slip term at 8, 16 and 24 N, made with K = {RUBBER['adhesion_constant']:g} and tan",
        f"delta_L = {RUBBER['loss_factor']:g}. K and sigma_0/p_r enter Eq. 8 as a product only, at any pressure and",
        "load; at a single pressure K and tan delta_L do, too, in all but name: Eq. 8 is one number there.", "",
    ]  # fmt: skip
    for label, fit in rubber.items():
        lines += [f"**{label.capitalize()}**", ""]
        lines += [f"- {name} = {p.estimate:.4g} ± " + (f"{p.sd:.2g}" if p.determined else "unknown")
                  + (f" {p.unit}" if p.unit else "") for name, p in fit.parameters.items()]
        if label.endswith("free"):
            names, values = list(fit.parameters), [p.estimate for p in fit.parameters.values()]
            k, s = names.index("adhesion_constant"), names.index("tensile_strength")
            lines.append(f"- K sigma_0/p_r = {values[k] * values[s] / KNOWN['real_contact_pressure']:.4g} (made with "
                         f"{RUBBER['adhesion_constant'] * 0.5:g})")
        lines += [*_list_points(fit, 2), ""]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("fits/slip-curves"), help="folder to write to")
    main(parser.parse_args().output)
