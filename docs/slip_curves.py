"""Fit friction curves made from the paper's polynomials, and K and tan delta_L: `python -m docs.slip_curves -o FOLDER`.

Writes `result.json`, three figures and a `README.md` that says what came out. The committed ones are in
`fits/slip-curves`.
"""

import argparse
import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ddetumble._errors import ComputationError, InputError
from ddetumble.contact.friction import (
    CHANGES_SIGN_AT,
    DIVERGES_ABOVE,
    POLYNOMIALS,
    composite_modulus,
    rubber_coefficient,
    slip_coefficient,
    slip_coefficients,
)
from ddetumble.figures.palette import AFTER, BEFORE, GREY, INK, PLACE
from ddetumble.figures.style import dress, new_figure, render_png, styled
from ddetumble.inference.curve_fit import (
    SlipRecord,
    evaluate_polynomials,
    fit_rubber,
    fit_slip_curve,
    fit_slip_polynomials,
    say_sd,
)
from ddetumble.inference.files import list_versions, write_json


SEED = 20
SLIPS = np.arange(0.0, 40.25, 0.5) * 1e-3  # [m]
SD = 3e-4  # of the coefficient: a gauge of 0.01 N at 10 N, and ten strokes averaged
LOW = np.round(np.linspace(5.0, 28.0, 12), 1)  # loads at which Eq. 10 makes sense [N]
HIGH = np.array([40.0, 44.4, 50.0, 60.0, 71.0])  # loads of Table 3 [N]
ENOUGH = 4  # readings of a curve that is fitted
GAUGE = 100.0  # range of the force gauge [N]
MEASURED = 0.218  # friction over normal force, Table 4 over Table 3
RUBBER = {"K": 0.8, "tan delta_L": 0.15}
RATIO = 0.5  # sigma_0/p_r
MODULUS = float(composite_modulus(jnp.asarray(7.8e6), jnp.asarray(0.47)))
PRESSURES = np.array([0.5e6, 1.0e6, 1.5e6, 2.5e6])
REPEATS, RUBBER_SD = 8, 2e-3


def evaluate_slip(slips, load: float) -> np.ndarray:
    """Eqs. 9 and 10 at slips [m] and a load [N], e = 1."""
    return np.asarray(slip_coefficient(jnp.asarray(slips), slip_coefficients(jnp.asarray(load))))


def make_curve(load: float, generator) -> SlipRecord:
    """A curve from Eqs. 9 and 10 with noise, as far as the gauge reads."""
    value = evaluate_slip(SLIPS, load)
    beyond = np.abs(value) * load > GAUGE
    last = int(np.argmax(beyond)) if beyond.any() else len(value)
    noise = SD * generator.standard_normal(len(value))
    return SlipRecord(SLIPS[:last], (value + noise)[:last], float(load), SD)


def fit_alone(records, levels: bool) -> dict:
    """A fit of every curve by itself, or the sentence that says why there is none."""
    found = {}
    for record in records:
        try:
            found[record.load] = fit_slip_curve(record.slip, record.coefficient, record.load, record.sd,
                                                levels=levels)
        except (InputError, ComputationError) as error:
            found[record.load] = str(error)
    return found


def make_rubber(pressures, generator):
    """Coefficients of Eq. 8 with noise."""
    constant, loss, ratio, modulus = (jnp.asarray(x) for x in (*RUBBER.values(), RATIO, MODULUS))
    clean = np.asarray(rubber_coefficient(constant, loss, ratio, jnp.asarray(pressures), modulus))
    return clean + RUBBER_SD * generator.standard_normal(len(pressures))


def main(folder: Path) -> None:
    """Make, fit, draw and write."""
    generator = np.random.default_rng(SEED)
    low = [make_curve(load, generator) for load in LOW]
    high = [make_curve(load, generator) for load in HIGH]
    several, one = np.repeat(PRESSURES, REPEATS), np.full(REPEATS * len(PRESSURES), PRESSURES[1])
    readings = make_rubber(several, generator), make_rubber(one, generator)
    singles, far = fit_alone(low, True), fit_alone(high, False)
    polynomials = fit_slip_polynomials(low)
    try:
        beyond = fit_slip_polynomials([record for record in high if len(record.slip) >= ENOUGH])
    except (InputError, ComputationError) as error:
        beyond = str(error)
    free = "four pressures, sigma_0/p_r free"
    rubber = {"one pressure": fit_rubber(one, readings[1], RUBBER_SD, modulus=MODULUS, strength_ratio=RATIO),
              "four pressures": fit_rubber(several, readings[0], RUBBER_SD, modulus=MODULUS, strength_ratio=RATIO),
              free: fit_rubber(several, readings[0], RUBBER_SD, modulus=MODULUS)}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "curves.png").write_bytes(render_png(draw_curves(low, high, singles, far), 110))
    (folder / "coefficients.png").write_bytes(render_png(draw_coefficients(singles, far, polynomials), 110))
    (folder / "profiles.png").write_bytes(render_png(draw_profiles(singles, rubber), 110))
    plain = {"seed": SEED, "sd": SD, "versions": list_versions(), "polynomials": polynomials.to_dict(),
             "polynomials_40_to_50": beyond if isinstance(beyond, str) else beyond.to_dict(),
             "loads": {f"{k:g}": v if isinstance(v, str) else v.to_dict() for k, v in (singles | far).items()},
             "rubber": {k: v.to_dict() for k, v in rubber.items()}}
    write_json(folder / "result.json", plain)
    (folder / "README.md").write_text(describe(low, high, singles, far, polynomials, beyond, rubber), encoding="utf-8")
    print(f"{folder}: README.md, result.json and three figures")


@styled
def draw_curves(low, high, singles, far):
    """Readings and fits, at loads where Eq. 10 makes sense and at those of Table 3."""
    figure = new_figure(4.2)
    left, right = figure.subplots(1, 2)
    shades = _shade(len(low))
    for record, shade in zip(low, shades, strict=True):
        dress(left).plot(record.slip * 1e3, record.coefficient, ".", ms=2.5, color=shade)
        left.plot(SLIPS * 1e3, _follow(singles[record.load], SLIPS), lw=1.0, color=shade)
    for k in (0, len(low) // 2, -1):
        left.annotate(f"{low[k].load:g} N", (40.5, low[k].coefficient[-1]), color=INK, fontsize=8.5, va="center",
                      annotation_clip=False)
    left.set(xlabel="slip [mm]", ylabel="friction coefficient of the slip term [-]", xlim=(0, 40),
             title="5 to 28 N: readings and fits of a...d, each load alone")
    dress(right).axhspan(-1, 1, color=PLACE, lw=0)
    fine = np.linspace(0.0, 12e-3, 400)
    for record, shade in zip(high, _shade(len(high)), strict=True):
        force = evaluate_slip(fine, record.load) * record.load / GAUGE
        right.plot(fine * 1e3, force, lw=1.2, color=shade, label=f"{record.load:g} N")
        right.plot(record.slip * 1e3, record.coefficient * record.load / GAUGE, ".", ms=4, color=shade)
    right.set_yscale("symlog", linthresh=0.1)
    right.set_yticks([-1e4, -1e3, -100, -10, -1, -0.1, 0, 0.1, 1, 10, 100, 1e3, 1e4])
    right.yaxis.set_major_formatter("{x:g}")
    right.set(xlabel="slip [mm]", ylabel="friction over the gauge's range [-]", xlim=(0, 12), ylim=(-1e4, 1e4),
              title="40 to 71 N: Eq. 10 leaves the gauge's range (shaded)")
    right.legend(loc="upper right", ncols=2)
    return figure


@styled
def draw_coefficients(singles, far, polynomials):
    """a...d over the load: Eq. 10, each load alone with its interval, and the fitted polynomials with their band."""
    figure = new_figure(5.6)
    loads = np.linspace(2.0, 75.0, 200)
    values, sds = (np.array(x) for x in zip(*(evaluate_polynomials(polynomials, x) for x in loads), strict=True))
    limits = {"a": (-0.6, 0.8), "b": (-1.0, 1.5), "c": (-3.0, 0.5), "d": (-2.8, 0.6)}
    for k, (axes, name) in enumerate(zip(figure.subplots(2, 2).ravel(), "abcd", strict=True)):
        dress(axes).axvspan(LOW[0], LOW[-1], color=PLACE, lw=0)
        axes.fill_between(loads, values[:, k] - 1.96 * sds[:, k], values[:, k] + 1.96 * sds[:, k], color=AFTER,
                          alpha=0.25, lw=0, label="fitted polynomial, 95 %")
        axes.plot(loads, values[:, k], color=AFTER, lw=1.0)
        p, q, r = POLYNOMIALS[name]
        axes.plot(loads, p + loads * (q + loads * r), "--", color=INK, lw=1.0, label="Eq. 10")
        for label, fits, shade in (("one load alone, 95 %", singles, GREY), ("40 to 71 N alone, 95 %", far, BEFORE)):
            _draw_alone(axes, fits, name, label, shade, limits[name])
        unit = " [1/mm]" if name in "bd" else " [-]"
        axes.set(xlabel="load [N]" if k > 1 else "", ylabel=name + unit, ylim=limits[name], xlim=(2, 75))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4)
    return figure


def _draw_alone(axes, fits, name, label, shade, limits):
    """Intervals of fits at single loads, mirrored to c < 0, Eq. 10's sign; what has no end reaches the frame."""
    first = True
    for load, fit in fits.items():
        if isinstance(fit, str):
            continue
        if math.isnan(fit.coefficients[name].low):
            continue
        found, sign = fit.coefficients[name], -1.0 if name in "cd" and fit.coefficients["c"].estimate > 0 else 1.0
        ends = sorted((sign * found.low, sign * found.high))
        low, high = max(ends[0], limits[0] * 2), min(ends[1], limits[1] * 2)
        axes.plot([load, load], [low, high], color=shade, lw=1.3, label=label if first else None)
        axes.plot(load, sign * found.estimate, "o", ms=3.5, color=shade)
        first = False


@styled
def draw_profiles(singles, rubber):
    """Rise of chi-square with one coefficient held: what is known has a well, what is not stays below the line."""
    figure = new_figure(3.4)
    left, middle, right = figure.subplots(1, 3)
    loads = {LOW[3]: AFTER, LOW[9]: BEFORE, LOW[11]: GREY}
    for axes, name in ((left, "a"), (middle, "d")):
        for load, shade in loads.items():
            fit = singles[float(load)]
            profile = next(p for p in fit.profiles if p.name == name)
            x = profile.values - fit.coefficients["a"].estimate if name == "a" else profile.values
            axes.plot(x, profile.rise, ".-", ms=4, lw=1.1, color=shade, label=f"{load:g} N")
    left.set_xticks([-1e-3, 0.0, 1e-3, 2e-3])
    left.set(xlabel="a less its estimate [-]", xlim=(-1e-3, 2e-3), title="one load: a is known")
    middle.set(xlabel="d [1/mm]", xscale="log", xlim=(1e-4, 1e2), title="one load: d hardly is")
    looks = (("one pressure", BEFORE, "-"), ("four pressures", AFTER, "-"), ("sigma_0/p_r free", GREY, "--"))
    for fit, (label, shade, dash) in zip(rubber.values(), looks, strict=True):
        profile = fit.profiles[0]
        right.plot(profile.values / fit.coefficients["K"].estimate, profile.rise, dash, marker=".", ms=4, lw=1.1,
                   color=shade, label=label)
    right.set(xlabel="K over its estimate [-]", xscale="log", xlim=(0.1, 20), title="Eq. 8: K needs several pressures")
    left.set_ylabel("rise of chi-square [-]")
    for axes, place in ((left, "upper right"), (middle, "upper left"), (right, "upper right")):
        dress(axes).axhline(3.84, color=INK, lw=0.8, ls=":")
        axes.set_ylim(-0.3, 10)
        axes.legend(loc=place, fontsize=8.5)
    middle.set_xticks([1e-4, 1e-2, 1.0, 100.0])
    right.set_xticks([0.1, 1.0, 10.0])
    for axes in (middle, right):
        axes.xaxis.set_major_formatter("{x:g}")
        axes.xaxis.set_minor_formatter("")
    return figure


def _shade(count: int):
    from matplotlib import colormaps

    return [colormaps["viridis"](0.9 * k / max(count - 1, 1)) for k in range(count)]


def _follow(fit, slips):
    """The fitted curve, e = 1."""
    a, b, c, d = fit.values
    s = slips * 1e3
    return a + a * (0.5 * (c - 1.0) * np.exp((b + d) * s) - 0.5 * (c + 1.0) * np.exp((b - d) * s))


def _tabulate(fits, records) -> list[str]:
    """A row a load: how many readings, each coefficient with its 95 % interval, and Eq. 10's with d > 0."""
    rows = ["| load [N] | readings | a | b [1/mm] | c | d [1/mm] | Eq. 10: a, b, c, d |", "| --- " * 7 + "|"]
    for record in records:
        fit, start = fits[record.load], f"| {record.load:g} | {len(record.slip)} |"
        a, b, c, d = (float(x) for x in slip_coefficients(jnp.asarray(record.load))[:4])
        truth = f"{a:.3g}, {b:.3g}, {math.copysign(c, c * d):.4g}, {abs(d):.3g}"
        if isinstance(fit, str):
            rows.append(f"{start} no fit: {fit} | | | | {truth} |")
            continue
        cells = [f"{c.estimate:.4g} ({_reach(c)})" for c in fit.coefficients.values()]
        rows.append(f"{start} {' | '.join(cells)} | {truth} |")
    return rows


def _tabulate_polynomials(fit) -> tuple[list[str], int]:
    """A row a coefficient, Eq. 10's beside it; and how many intervals with two ends hold Eq. 10's."""
    rows, held = ["| coefficient | Eq. 10 | fitted | sd | 95 % interval | |", "| --- " * 6 + "|"], 0
    for name, c in fit.coefficients.items():
        truth = POLYNOMIALS[name[0]][int(name[1])]
        holds = c.low <= truth <= c.high
        held += holds and c.bounded
        word = "not known" if not c.bounded else "holds Eq. 10's" if holds else "misses Eq. 10's"
        rows.append(f"| {name} {f'[{c.unit}]' if c.unit else ''} | {truth:.5g} | {c.estimate:.5g} | {say_sd(c.sd)} | "
                    f"{_reach(c)} | {word} |")
    return rows, held


def _reach(c) -> str:
    """An interval in words."""
    if math.isnan(c.low):
        return "no interval"
    low, high = math.isfinite(c.low) and (c.bounded or c.low != 0.0), math.isfinite(c.high)
    if low and high:
        return f"{c.low:.4g} to {c.high:.4g}"
    return f"above {c.low:.4g}" if low else f"below {c.high:.4g}" if high else "no bound"


def _list_notes(fit, skip: int = 0) -> list[str]:
    return [f"- {note}" for note in fit.notes[skip:]]


def describe(low, high, singles, far, polynomials, beyond, rubber) -> str:
    """The folder's README."""
    rows, held = _tabulate_polynomials(polynomials)
    at, sd = evaluate_polynomials(polynomials, 71.0)
    a = [fit.coefficients["a"] for fit in singles.values()]
    hold = sum(c.low <= POLYNOMIALS["a"][0] + load * POLYNOMIALS["a"][1] <= c.high
               for load, c in zip(singles, a, strict=True))
    both = sum(all(f.coefficients[n].bounded for n in "bcd") for f in singles.values())
    lines = [
        "# Friction curves", "",
        "The friction coefficients of the paper, fitted to simulated readings, so that what comes out can be compared",
        "with what went in: a...e of Eq. 9 at one load, the polynomials of Eq. 10 over several loads, and K and",
        "tan delta_L of Eq. 8. Made by", "",
        "    python -m docs.slip_curves -o fits/slip-curves", "",
        f"A stroke has {len(SLIPS)} readings over 40 mm, each with a standard deviation of {SD:g} in the coefficient;",
        f"e is held at 1; random numbers start from {SEED}. Intervals are 95 % and come from refits with the",
        "coefficient held (profile likelihood). [result.json](result.json) has every number and sentence.", "",
        "![curves](curves.png)", "",
        "## 5 to 28 N: recovered", "",
        f"**All {len(low)} curves together** give back the polynomials that made them: {held} of {len(rows) - 2}",
        f"intervals hold Eq. 10's value. Chi-square is {polynomials.chi2:.0f} with {polynomials.readings} readings and",
        f"{len(rows) - 2} coefficients.", "", *rows, "",
        "The sums b + d are known far better than b and d: " + _say_sums(polynomials) + ".", "",
        *_list_notes(polynomials), "",
        f"**One load alone** gives a ({hold} of {len(a)} intervals hold Eq. 10's), but b, c and d have an interval",
        f"with two ends at {both} of {len(low)} loads only. Near 24.2 N, where Eq. 10's d vanishes, c and d are lost,",
        "as only their product acts.", "",
        *_tabulate(singles, low), "",
        f"What the fit at {LOW[3]:g} N says:", "", *_list_notes(singles[float(LOW[3])]), "",
        "![coefficients](coefficients.png)", "",
        "The shaded loads are those of the fitted curves. Single loads are drawn with c < 0, the sign of Eq. 10; the",
        "fits themselves have d > 0. A bar that reaches the frame has no end; a fit",
        "without intervals is left out.", "",
        "## 40 to 71 N: not recovered", "",
        "These are the loads of Table 3. There Eq. 10 makes no friction: its curves grow without limit from",
        f"{DIVERGES_ABOVE:.1f} N on, as b + |d| is positive, and a is negative above {CHANGES_SIGN_AT:.1f} N.",
        f"The force leaves the range of a {GAUGE:g} N gauge after some millimetres or less; at 44.4 N, where a",
        "vanishes, there is next to no curve.", "", *_tabulate(far, high), "",
        "At 40 N one growing exponential is so strong that all four coefficients follow from it. That is a property of",
        "readings made by the formula and no support for it: no friction grows e-fold every 2 mm.", "",
    ]  # fmt: skip
    for load, fit in far.items():
        if not isinstance(fit, str):
            lines += [f"What the fit at {load:g} N says:", "", *_list_notes(fit, 1), ""]
    if isinstance(beyond, str):
        lines += [f"**Eq. 10's polynomials** cannot be fitted to these curves: {beyond}", ""]
    else:
        rows, held = _tabulate_polynomials(beyond)
        lines += [
            f"**Eq. 10's polynomials**, fitted to the curves that have {ENOUGH} readings or more, match these",
            f"(chi-square is {beyond.chi2:.0f} with {beyond.readings} readings) and are far from those that made them:",
            f"{held} of {len(rows) - 2} coefficients get an interval that holds Eq. 10's.", "", *rows, "",
            *_list_notes(beyond), "",
        ]
    lines += [
        "**Nor do the polynomials fitted from 5 to 28 N** say anything about these loads. At 71 N they give",
        f"a = {at[0]:.3f} +- {sd[0]:.1g}: a narrow band around a negative friction, where the paper measured",
        f"{MEASURED:g} (Table 4 over Table 3, all of Eq. 11). The band says how well the readings fix the polynomial,",
        "not whether friction follows one. The test that would: strokes at 40 to 71 N, each fitted by itself.", "",
        "## K and tan delta_L", "",
        f"Made with K = {RUBBER['K']:g}, tan delta_L = {RUBBER['tan delta_L']:g} and sigma_0/p_r = {RATIO:g};",
        f"{len(PRESSURES) * REPEATS} readings each, standard deviation {RUBBER_SD:g}.", "",
        "![profiles](profiles.png)", "",
    ]  # fmt: skip
    for label, fit in rubber.items():
        table = [line for line in str(fit).splitlines() if not line.startswith("- ")]
        lines += [f"**{label.capitalize()}**", "", "```", *table, "```", "", *_list_notes(fit), ""]
    return "\n".join(lines).rstrip() + "\n"


def _say_sums(polynomials) -> str:
    parts = [f"{name.split(' [')[0]} to {sd:.2g}, {name[:2]} to {polynomials.coefficients[name[:2]].sd:.2g}"
             for name, (_, sd) in polynomials.derived.items()]
    return "; ".join(parts)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("fits/slip-curves"), help="folder to write to")
    main(parser.parse_args().output)
