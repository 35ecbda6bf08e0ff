"""Problems of strangers: the 27 nonlinear regressions of NIST, from both starts, by the optimiser of `dd.fit`.

    python -m docs.nist_study -o fits/nist-strd

Every fit runs with the same code and defaults; nothing is tuned to a problem.
"""

import argparse
import dataclasses as dc
import json
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
import pandas as pd
from jax.numpy import arctan, cos, exp, pi, sin

from ddetumble import find_data
from ddetumble.cli.failures import run_guarded
from ddetumble.cli.progress import show_progress
from ddetumble.figures.palette import AFTER, BEFORE, FLOOR
from ddetumble.figures.style import dress, head_figure, new_figure, render_png, styled
from ddetumble.inference.files import list_versions, write_json
from ddetumble.inference.levenberg_marquardt import BorderedLevenbergMarquardt

from .seal_study import format_table, wrap_page


TOLERANCE, MOST_STEPS = 1e-12, 3000  # of the sum of squares in noise variances: to rounding; curved valleys are long
CAP = 11.0  # digits that NIST prints
STARTS = (1, 2)


def saturate(b, x):
    """b1 (1 - exp(-b2 x))."""
    return b[0] * (1 - exp(-b[1] * x))


def saturate_squared(b, x):
    """b1 (1 - (1 + b2 x/2)^-2)."""
    return b[0] * (1 - (1 + b[1] * x / 2) ** -2)


def saturate_by_root(b, x):
    """b1 (1 - (1 + 2 b2 x)^-1/2)."""
    return b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5)


def saturate_hyperbolically(b, x):
    """b1 b2 x / (1 + b2 x)."""
    return b[0] * b[1] * x / (1 + b[1] * x)


def calibrate_ultrasound(b, x):
    """exp(-b1 x) / (b2 + b3 x)."""
    return exp(-b[0] * x) / (b[1] + b[2] * x)


def add_three_decays(b, x):
    """b1 exp(-b2 x) + b3 exp(-b4 x) + b5 exp(-b6 x)."""
    return b[0] * exp(-b[1] * x) + b[2] * exp(-b[3] * x) + b[4] * exp(-b[5] * x)


def add_two_decays(b, x):
    """b1 + b2 exp(-b4 x) + b3 exp(-b5 x)."""
    return b[0] + b[1] * exp(-x * b[3]) + b[2] * exp(-x * b[4])


def add_two_peaks(b, x):
    """b1 exp(-b2 x) + b3 exp(-(x - b4)^2/b5^2) + b6 exp(-(x - b7)^2/b8^2)."""
    peaks = b[2] * exp(-((x - b[3]) ** 2) / b[4] ** 2) + b[5] * exp(-((x - b[6]) ** 2) / b[7] ** 2)
    return b[0] * exp(-b[1] * x) + peaks


def raise_to_power(b, x):
    """b1 x^b2."""
    return b[0] * x ** b[1]


def divide_quadratics(b, x):
    """(b1 + b2 x + b3 x^2) / (1 + b4 x + b5 x^2)."""
    return (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2)


def divide_cubics(b, x):
    """(b1 + b2 x + b3 x^2 + b4 x^3) / (1 + b5 x + b6 x^2 + b7 x^3)."""
    return (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3)


def divide_monic_quadratics(b, x):
    """b1 (x^2 + b2 x) / (x^2 + b3 x + b4)."""
    return b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3])


def age_insulation(b, x):
    """b1 - b2 x1 exp(-b3 x2), the logarithm of the strength."""
    weeks, temperature = x
    return b[0] - b[1] * weeks * exp(-b[2] * temperature)


def find_quantum_defects(b, x):
    """b1 - b2 x - arctan(b3/(x - b4))/pi."""
    return b[0] - b[1] * x - arctan(b[2] / (x - b[3])) / pi


def add_three_cycles(b, x):
    """b1 + b2 cos(w/12) + b3 sin(w/12) + b5 cos(w/b4) + b6 sin(w/b4) + b8 cos(w/b7) + b9 sin(w/b7), w = 2 pi x."""
    w = 2 * pi * x
    year = b[1] * cos(w / 12) + b[2] * sin(w / 12)
    return b[0] + year + b[4] * cos(w / b[3]) + b[5] * sin(w / b[3]) + b[7] * cos(w / b[6]) + b[8] * sin(w / b[6])


def grow_logistically(b, x):
    """b1 / (1 + exp(b2 - b3 x))."""
    return b[0] / (1 + exp(b[1] - b[2] * x))


def grow_by_richards(b, x):
    """b1 / (1 + exp(b2 - b3 x))^(1/b4)."""
    return b[0] / (1 + exp(b[1] - b[2] * x)) ** (1 / b[3])


def follow_meyer(b, x):
    """b1 exp(b2/(x + b3))."""
    return b[0] * exp(b[1] / (x + b[2]))


def transmit_peak(b, x):
    """b1/b2 exp(-((x - b3)/b2)^2/2)."""
    return b[0] / b[1] * exp(-0.5 * ((x - b[2]) / b[1]) ** 2)


def magnetise(b, x):
    """b1 (b2 + x)^(-1/b3)."""
    return b[0] * (b[1] + x) ** (-1 / b[2])


MODELS = {
    "Misra1a": saturate, "Chwirut2": calibrate_ultrasound, "Chwirut1": calibrate_ultrasound,
    "Lanczos3": add_three_decays, "Gauss1": add_two_peaks, "Gauss2": add_two_peaks, "DanWood": raise_to_power,
    "Misra1b": saturate_squared, "Kirby2": divide_quadratics, "Hahn1": divide_cubics, "Nelson": age_insulation,
    "MGH17": add_two_decays, "Lanczos1": add_three_decays, "Lanczos2": add_three_decays, "Gauss3": add_two_peaks,
    "Misra1c": saturate_by_root, "Misra1d": saturate_hyperbolically, "Roszman1": find_quantum_defects,
    "ENSO": add_three_cycles, "MGH09": divide_monic_quadratics, "Thurber": divide_cubics, "BoxBOD": saturate,
    "Rat42": grow_logistically, "MGH10": follow_meyer, "Eckerle4": transmit_peak, "Rat43": grow_by_richards,
    "Bennett5": magnetise,
}  # fmt: skip


@dc.dataclass(frozen=True)
class Regression:
    """A fit: values and their standard errors, sum of squares, whether it converged, and steps."""

    values: np.ndarray
    errors: np.ndarray
    sum_of_squares: float
    converged: bool
    steps: int


@dc.dataclass(frozen=True)
class StrdProblem:
    """One problem as NIST certifies it.

    Attributes:
        name, difficulty: NIST's.
        x: predictors, shape (readings,) or (predictors, readings).
        y: readings, or their logarithm where the model is one of it, shape (readings,).
        names: of the parameters.
        starts: far and near, shape (2, parameters).
        certified, certified_sd: values and standard deviations, shape (parameters,).
        sum_of_squares, residual_sd: certified.
    """

    name: str
    difficulty: str
    x: np.ndarray
    y: np.ndarray
    names: tuple[str, ...]
    starts: np.ndarray
    certified: np.ndarray
    certified_sd: np.ndarray
    sum_of_squares: float
    residual_sd: float

    def fit(self, start: int) -> Regression:
        """Fit from start 1 or 2: coordinates in units of the start, readings in those of their certified scatter."""
        begin, x, y = (jnp.asarray(part) for part in (self.starts[start - 1], self.x, self.y))
        values, residual, columns, converged, steps = (np.asarray(part) for part in _solve(
            MODELS[self.name], begin, x, y, self.residual_sd))
        squares, degrees = float(residual @ residual), len(residual) - len(values)
        norms = np.linalg.norm(columns, axis=0)
        inverse = np.linalg.pinv((columns / norms).T @ (columns / norms), rcond=1e-15) / np.outer(norms, norms)
        return Regression(values, np.sqrt(np.diag(inverse) * squares / degrees), squares, bool(converged), int(steps))


@partial(jax.jit, static_argnums=0)
def _solve(model, begin, x, y, sd):
    """Values, residual, its derivatives, whether it converged, and steps."""
    unit = jnp.where(begin == 0, 1.0, jnp.abs(begin))
    rows = lambda q: model(begin + unit * q, x) - y
    solver = BorderedLevenbergMarquardt(jnp.asarray(TOLERANCE), jnp.asarray(MOST_STEPS))
    found = optx.least_squares(lambda q, _: ((rows(q[0])[None] / sd, 0.0 * q[1], 0.0 * q[0]), None), solver,
                               (jnp.zeros_like(begin), jnp.zeros((1, 1))), has_aux=True, throw=False, max_steps=None)
    q = found.value[0]
    return (begin + unit * q, rows(q), jax.jacfwd(rows)(q) / unit, solver.has_converged(found.state),
            found.stats["num_steps"])


def read_problems(folder: Path | None = None) -> dict[str, StrdProblem]:
    """The problems under `data/nist-strd`, by name, in NIST's order."""
    folder = folder or find_data() / "nist-strd"
    parameters = dict(tuple(pd.read_csv(folder / "parameters.csv").groupby("problem")))
    found = {}
    for row in pd.read_csv(folder / "problems.csv").to_dict("records"):
        name, table = row["problem"], parameters[row["problem"]]
        readings = pd.read_csv(folder / f"{name}.csv").to_numpy(dtype=float).T
        y = np.log(readings[0]) if row["formula"].startswith("log(y)") else readings[0]
        found[name] = StrdProblem(
            name, row["difficulty"], readings[1] if len(readings) == 2 else readings[1:], y,
            tuple(table["parameter"]), table[["start_1", "start_2"]].to_numpy(dtype=float).T,
            table["certified"].to_numpy(dtype=float), table["certified_sd"].to_numpy(dtype=float),
            float(row["residual_sum_of_squares"]), float(row["residual_sd"]))  # fmt: skip
    return found


def count_digits(found, certified) -> float:
    """Digits that agree: -log10 of the relative error, the smallest of them, at most 11 and at least 0."""
    error = np.abs(np.atleast_1d(found) - certified) / np.abs(certified)
    return float(np.clip(np.min(-np.log10(np.maximum(np.nan_to_num(error, nan=1.0), 10**-CAP))), 0.0, CAP))


@dc.dataclass(frozen=True)
class Attempt:
    """One problem from one start: the fit, and the digits of its values, standard errors and sum of squares."""

    problem: StrdProblem
    start: int
    fit: Regression
    values: float
    errors: float
    squares: float


def attempt(problem: StrdProblem, start: int) -> Attempt:
    """Fit a problem from one start and count digits."""
    fit = problem.fit(start)
    return Attempt(problem, start, fit, count_digits(fit.values, problem.certified),
                   count_digits(fit.errors, problem.certified_sd),
                   count_digits(fit.sum_of_squares, problem.sum_of_squares))


def run_study(report: Callable[..., None] = lambda *_: None) -> list[Attempt]:
    """All problems from both starts."""
    problems, found = read_problems(), []
    for k, problem in enumerate(problems.values()):
        report(problem.name, k / len(problems))
        found += [attempt(problem, start) for start in STARTS]
    return found


def count_reached(attempts: list[Attempt]) -> dict[str, int]:
    """How many fits reach so many digits."""
    return {f"{kind}_to_{least}": sum(getattr(a, kind) >= least for a in attempts)
            for kind in ("values", "errors", "squares") for least in (6, 8, 10)}


@styled
def draw_digits(attempts: list[Attempt]):
    """Digits of values and standard errors, problem by problem."""
    names = list(dict.fromkeys(a.problem.name for a in attempts))
    figure = new_figure(5.4)
    panels = figure.subplots(1, 2, sharey=True)
    for axes, kind, title in zip(panels, ("values", "errors"), ("Fitted values", "Standard errors"), strict=True):
        dress(axes)
        for least in (6, 8):
            axes.axvline(least, color=FLOOR, lw=0.8, ls=":")
        for start, colour, mark, size in ((1, BEFORE, "o", 6.5), (2, AFTER, "D", 3.5)):
            part = [a for a in attempts if a.start == start]
            axes.plot([getattr(a, kind) for a in part], [names.index(a.problem.name) for a in part], mark, color=colour,
                      ms=size, label="start 1, far" if start == 1 else "start 2, nearer")
        axes.set(xlim=(0, CAP + 0.4), xticks=range(0, int(CAP) + 1), xlabel="digits that agree with the certified ones",
                 title=title)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(len(names) - 0.5, -0.5)
    handles, labels = panels[0].get_legend_handles_labels()
    head_figure(figure, handles, labels)
    return figure


def tell_story(attempts: list[Attempt]) -> str:
    """The page, in Markdown."""
    reached, total = count_reached(attempts), len(attempts)
    rows = [[a.problem.name, a.problem.difficulty, str(a.start), f"{a.values:.1f}", f"{a.errors:.1f}",
             f"{a.squares:.1f}", str(a.fit.steps)] for a in attempts]
    missed = [a for a in attempts if a.values < 1]
    short = [a for a in attempts if a.errors < 6 and a not in missed]
    stopped = [f"{a.problem.name} from start {a.start}" for a in attempts if not a.fit.converged]
    return wrap_page(PAGE.format(
        total=total, worst=min(a.values for a in attempts if a not in missed), short=tell_short(short),
        missed=", ".join(f"{a.problem.name} from start {a.start}" for a in missed) or "none",
        stopped="All say that they converged." if not stopped else f"Not converged: {', '.join(stopped)}.",
        table=format_table(["problem", "difficulty", "start", "digits of values", "of standard errors",
                            "of the sum of squares", "steps"], rows), **reached))


def tell_short(short: list[Attempt]) -> str:
    """Which standard errors fall short, in words."""
    if not short:
        return "None falls short."
    found = "; ".join(f"{a.problem.name} from start {a.start} has {a.errors:.1f}" for a in short)
    text = f"Standard errors fall short of 6 digits here: {found}."
    if {a.problem.name for a in short} == {"Lanczos1"}:
        spread = short[0].problem.residual_sd
        eps = spread / (np.finfo(float).eps * np.sqrt(np.mean(short[0].problem.y**2)))
        text += (f" Its readings are exact to 14 digits, and the scatter from which the errors follow, {spread:.1e}, "
                 f"is {eps:.0f} times the rounding of a reading in 64 bits: more digits than about "
                 f"{np.log10(eps):.0f} or {np.log10(eps) + 1:.0f} are not in such numbers.")
    return text


PAGE = """# NIST StRD: nonlinear regression

    python -m docs.nist_study -o fits/nist-strd

Of the 27 problems of NIST's
[Statistical Reference Datasets](https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml) from both of their starts,
the optimiser of `dd.fit` (`inference/levenberg_marquardt.py`) reaches the certified values to 6 digits in
{values_to_6} of {total} fits, to 8 digits in {values_to_8} and
to 10 digits in {values_to_10}; the certified standard deviations to 6 digits in {errors_to_6} and to 8 in
{errors_to_8}; the sum of squares to 10 digits in {squares_to_10}.

![Digits by problem](digits.png)

Digits are -log10 of the relative error, the smallest over a problem's parameters, at most 11, which is what NIST
prints. Missed from these starts: {missed}; the worst of the others has {worst:.1f} digits. {stopped} No problem is
named in the code, and all have the same settings.

{short}

Coordinates are in units of the start. What a far start misses, `dd.fit` leaves to further starts, which effects bring
with them and families guess from the records; here there are none but NIST's two.

{table}

Data: [data/nist-strd](../../data/README.md), whose certified standard deviations rest on readings less parameters as
degrees of freedom. For Rat43 that is 11, where NIST prints 9: its residual standard deviation agrees with 11.
"""


def write_study(attempts: list[Attempt], folder: Path) -> None:
    """Write `README.md`, `result.json` and a figure."""
    folder.mkdir(parents=True, exist_ok=True)
    fits = [{"problem": a.problem.name, "start": a.start, "digits_of_values": round(a.values, 2),
             "digits_of_errors": round(a.errors, 2), "digits_of_squares": round(a.squares, 2), **dc.asdict(a.fit)}
            for a in attempts]
    write_json(folder / "result.json", {"command": "python -m docs.nist_study -o fits/nist-strd",
                                        "versions": list_versions(), "reached": count_reached(attempts), "fits": fits})
    (folder / "README.md").write_text(tell_story(attempts), encoding="utf-8")
    (folder / "digits.png").write_bytes(render_png(draw_digits(attempts), 110))


def main(arguments: list[str] | None = None) -> int:
    """Run the study from the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m docs.nist_study", description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for page, result.json and figure")
    wanted = parser.parse_args(arguments)

    def act() -> None:
        with show_progress("NIST StRD") as report:
            attempts = run_study(report)
        write_study(attempts, wanted.output)
        print(f"{json.dumps(count_reached(attempts))}; {wanted.output / 'README.md'}")

    return run_guarded(act, arguments or sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
