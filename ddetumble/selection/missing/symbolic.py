"""Simple laws that would draw a missing force: a few forms of one variable, alone and in pairs, by held-out error
and, where that does not tell, by the fit.

Every form is tried over a grid of its shape at the linearised model, for all phases and for the variables that the
flexible terms did not rule out (conditions, which are one value a record, excepted). The best few are fitted inside the
equation of motion, shapes and all; where none comes near the flexible force, the best is tried with a few partners.
A law whose length is not determined is none, nor is one whose length or onset no two samples tell from nothing: what
saturates within a sample is a constant. Amplitudes carry the unit that their form asks for.
"""

import dataclasses as dc
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import block_diag

from ..._numerics import map_threads
from ...effects.free import blank_plan
from ...inference.problem import Solution
from ..cross_validation import compare_losses, leave_out
from ..result import Estimate, Law, Shape
from ..settings import DEFAULT, SelectionSettings
from .free_form import FreeBench, Normal, Term, evaluate_basis, hold_out, measure_ridge, smooth, solve_ridge


REFINED = 5  # forms that are fitted to the end: the rest are behind by more than the screening errs
PARTNERS = 3  # of the best, in pairs: pairs of worse ones are not better
GRID = 24  # onsets that are screened, and half as many lengths: refinement reaches what lies between two
# Least share of a misfit of one condition that a law of it takes away: one that takes less describes the rest.
TAKEN = 0.5
EDGE = 1e-2  # of the logarithm of a power, within which it stands at a bound: 1 % of the power
ALONE = 30_000  # padded samples from which on the fits of laws are worth a program of their own, without idle columns
VAGUE = 0.5  # deviation of the logarithm of a length, above which a law says nothing: uncertain by a factor of 1.6
# Mean and deviation of the shapes' coordinates (onset over the range, logarithm of the power). What one condition alone
# determines would else go anywhere when that is left out, and the linear step with it.
PRIORS = {"x": (0.5, 0.5), "n": (float(np.log(1.5)), 0.4)}


@dc.dataclass(frozen=True)
class Form:
    """One form of a law."""

    name: str
    text: str  # with x for the variable; `(...)+` is 0 where what it holds is negative
    kind: str  # of `effects.free.FORMS`
    shapes: str = ""  # which of onset `x`, length `l` and power `n` are fitted
    power: float = 1.0  # where it is not fitted
    signed: bool | None = None  # for variables that change their sign; None for all
    waves: bool = False  # whether it repeats
    length: float = 0.3  # where it is not fitted, in units of the largest value of the variable
    steep: bool = False  # whether it becomes a constant where its length is shorter than samples lie apart


STEP = 1e-3  # length within which a constant sets in: far below the spacing of samples, and smooth enough to integrate
FORMS = (
    Form("constant", "k (constant)", "saturation", signed=False, length=STEP),
    Form("sign", "k sign(x)", "saturation", signed=True, length=STEP),
    Form("proportional", "k x", "signed power"),
    Form("square", "k x^2", "power", power=2.0, signed=False),
    Form("square against", "k |x| x", "signed power", power=2.0, signed=True),
    Form("power", "k x^n", "power", "n", signed=False),
    Form("onset", "k (x - d)+", "power", "x", signed=False),
    Form("onset, square", "k (x - d)+^2", "power", "x", 2.0, signed=False),
    Form("onset, power", "k (x - d)+^n", "power", "xn", signed=False),
    Form("wave", "a sin(2 pi x/l) + b (cos(2 pi x/l) - 1)", "sine", "l", waves=True),
    Form("sawtooth", "a (2 frac(x/l) - 1)", "sawtooth", "l", signed=False, waves=True),
    Form("decay", "k exp(-x/l)", "decay", "l", signed=False),
    Form("saturation", "k tanh(x/l)", "saturation", "l", steep=True),
)


@dc.dataclass(frozen=True)
class _Guess:
    """A form with a direction and the shape that screening found."""

    form: Form
    term: Term
    phase: str
    direction: np.ndarray
    shape: dict[str, float]
    sizes: np.ndarray
    loss: float


def find_laws(bench: FreeBench, normals: dict[str, Normal], terms: Sequence[Term], ceiling: float,
              lone: bool = False) -> list[Law]:
    """Simple laws in the variables of `terms`, best first.

    Args:
        bench, normals: of the model, and of every term at its finest.
        terms: whose variables and directions are tried.
        ceiling: held-out loss of the best flexible force: pairs are tried where no single law comes near it.
        lone: whether one condition alone shows the misfit. No other can predict it: laws are then those that take at
            least half of it away where they are fitted.
    """
    guesses = [g for term in terms if not term.condition for g in _screen(bench, normals[term.name], term, lone)]
    best: dict[tuple[str, str], _Guess] = {}
    for guess in sorted(guesses, key=lambda g: g.loss):
        # A constant depends on no variable.
        best.setdefault((guess.form.name, guess.term.way if guess.form.name == "constant" else guess.term.variable),
                        guess)

    def fit_all(sums: list[tuple[_Guess, ...]]) -> list[tuple[Law, tuple[_Guess, ...]]]:
        laws = map_threads(lambda own: _fit(bench, own), sums)
        return [(law, own) for law, own in zip(laws, sums, strict=True) if law is not None]

    fitted, settings = fit_all([(g,) for g in list(best.values())[:REFINED]]), bench.selection.settings
    laws = order_laws([law for law, _ in fitted], settings)
    if laws and laws[0].loss > ceiling + settings.significant:
        first, = next(own for law, own in fitted if law is laws[0])
        fitted += fit_all([(first, g) for g in best.values() if g.form is not first.form][:PARTNERS])
    excess = bench.model.solution.chi2 - bench.rows
    laws = order_laws([law for law, _ in fitted if bench.helps(bench.before, law.losses)
                       or (lone and law.chi2 < bench.rows + (1.0 - TAKEN) * excess)], settings)
    compared = [compare_losses(law.losses, laws[0].losses) for law in laws[1:]]
    return laws[:1] + [dc.replace(law, difference=difference, standard_error=error)
                       for law, (difference, error) in zip(laws[1:], compared, strict=True)]


def order_laws(laws: Sequence[Law], settings: SelectionSettings = DEFAULT) -> list[Law]:
    """Laws by held-out error; before them the one that fits best of those that it does not tell from the best.

    One condition that reaches further than all others decides the held-out errors of all laws alike, by a step that is
    linear: their differences are then less than twice their standard error, and say nothing. A parameter costs as much
    as a difference has to be in order to be significant.
    """
    ranked = sorted(laws, key=lambda law: law.loss + settings.significant * law.count)
    near = [law for law in ranked if not settings.is_significant(*compare_losses(law.losses, ranked[0].losses))]
    first = min(near, key=lambda law: _cost(law, settings), default=None)
    return ranked if first is None else [first, *(law for law in ranked if law is not first)]


def find_rivals(laws: Sequence[Law], settings: SelectionSettings = DEFAULT) -> list[Law]:
    """Laws that neither left-out conditions nor the fit tell from the first, but for the first with a term more."""
    return [law for law in laws[1:] if not settings.is_significant(law.difference, law.standard_error)
            and _cost(law, settings) - _cost(laws[0], settings) < settings.decisive
            and not law.text.startswith(laws[0].text + " + ")]


def _cost(law: Law, settings: SelectionSettings) -> float:
    return law.chi2 + settings.significant * law.count


def _screen(bench: FreeBench, normal: Normal, term: Term, lone: bool) -> list[_Guess]:
    """Every form over a grid of its shape, with the linearised model."""
    base, intervals, parts = len(bench.names), term.finest, len(term.parts)
    x = np.linspace(term.low, term.high, 8 * intervals + 1)
    inverse = np.linalg.pinv(evaluate_basis(term, intervals, x) @ smooth(intervals))
    choices = list(zip(term.parts, np.eye(parts), strict=True))
    if parts > 1 and "x" not in term.parts:
        choices.insert(0, ("", np.ones(parts)))
    found = []
    for form in (form for form in FORMS if form.signed in (None, term.low < 0.0)):
        for phase, gate in choices:
            best = None
            for shape in _list_shapes(form, term):
                own = inverse @ np.stack(evaluate(form, x, shape, term.scale), axis=1)
                small = normal.turn(np.asarray(block_diag(np.eye(base), np.kron(gate[:, None], own))))
                free = np.zeros(base + own.shape[1])
                price = bench.selection.settings.significant * (own.shape[1] + len(form.shapes))
                loss = measure_ridge(small, free) + price if lone else float(hold_out(small, free).sum())
                if np.isfinite(loss) and (best is None or loss < best.loss):
                    sizes = solve_ridge(small, free)[base:] * bench.scale
                    best = _Guess(form, term, phase, gate @ term.directions, shape, sizes, loss)
            if best is not None:
                found.append(best)
    return found


def _list_shapes(form: Form, term: Term) -> list[dict[str, float]]:
    """Shapes to begin with, in units of the largest value of the variable."""
    grids = {"x": [0.0], "l": [form.length], "n": [form.power]}
    if "x" in form.shapes:
        grids["x"] = list(np.linspace(0.05, 0.9, GRID))
    if "n" in form.shapes:
        grids["n"] = [1.0, 1.5, 2.0, 3.0]
    if form.waves:
        grids["l"] = list(1.0 / np.arange(1.0, 0.45 * term.finest, 0.125))
    elif "l" in form.shapes:
        grids["l"] = list(np.geomspace(0.02, 2.0, GRID // 2))
    return [{"x": x, "l": length, "n": n} for x in grids["x"] for n in grids["n"] for length in grids["l"]]


def evaluate(form: Form, x: np.ndarray, shape: dict[str, float], scale: float) -> list[np.ndarray]:
    """The functions of a form that are linear in its amplitudes, each shape (places,)."""
    y, phase = x / scale, 2.0 * np.pi * x / (scale * shape["l"])
    return {
        "power": lambda: [np.maximum(y - shape["x"], 0.0) ** shape["n"]],
        "signed power": lambda: [np.sign(y) * np.abs(y) ** shape["n"]],
        "sine": lambda: [np.sin(phase), np.cos(phase) - 1.0],
        "sawtooth": lambda: [2.0 * (phase / (2.0 * np.pi) % 1.0) - 1.0],
        "decay": lambda: [np.exp(-y / shape["l"])],
        "saturation": lambda: [np.tanh(y / shape["l"])],
    }[form.kind]()


def _fit(bench: FreeBench, guesses: Sequence[_Guess]) -> Law | None:
    """Fit laws together inside the equation of motion; None where that failed."""
    plan = blank_plan(bench.ground, bench.records.stack.time.shape[0])
    u, names = bench.start.copy(), []
    for slot, g in enumerate(guesses, 1):
        bench.place_law(plan, slot, g.term, g.form.kind, g.direction)
        own = {"a": g.sizes[0] / (1.0 if slot == 1 else 4.0)}
        if g.form.kind == "sine":
            own["b"] = g.sizes[1]
        own |= {"x": g.shape["x"], "l": np.log(g.shape["l"]), "n": np.log(g.shape["n"])}
        for letter, value in own.items():
            u[bench.space.index[_name(bench, letter, slot)]] = value
        names += [_name(bench, letter, slot) for letter in own if letter in "ab" or letter in g.form.shapes]
    priors = {n: PRIORS[letter] for n in names if (letter := n.split(".")[1][0]) in PRIORS}
    solution = bench.fit(plan, names, priors, u, bench.z, 20, bench.records.stack.values.size < ALONE)
    if solution is None:
        return None
    sd = dict(zip(solution.names, np.sqrt(np.diag(solution.covariance())), strict=True))
    if any(not sd[name] <= VAGUE for name in names if name.split(".")[1].startswith("l_")):
        return None
    for slot, g in enumerate(guesses, 1):
        if not is_resolved(bench, solution, g, slot):
            other = next((f for f in FORMS if g.form.steep and f.length == STEP and f.signed == (g.term.low < 0)), None)
            if other is None:
                return None
            simpler = dc.replace(g, form=other, shape={**g.shape, "l": other.length})
            return _fit(bench, [*guesses[:slot - 1], simpler, *guesses[slot:]])
    loss, parameters = leave_out(solution, bench.groups), {}
    losses = np.array([loss[bench.groups == g].sum() for g in np.unique(bench.groups)])
    for slot, g in enumerate(guesses, 1):
        mark = "" if len(guesses) == 1 else f" {slot}"
        parameters |= _publish(bench, solution, g, slot, mark)
        x = np.linspace(g.term.low, g.term.high, 201)
        if g.term.way == "share" and np.min(_draw(g.form, parameters, mark, x)) <= -1.0:
            return None  # a share of a force that turns it round somewhere is none
    terms = [g.term for g in guesses]
    return Law(" + ".join(_write(g, bench.ground.base) for g in guesses), tuple(t.variable for t in terms),
               tuple(t.way for t in terms), tuple(g.phase for g in guesses), tuple(g.form.name for g in guesses),
               parameters, float(losses.sum()), losses, float(solution.chi2), len(names), bool(solution.converged),
               0.0, 0.0)


def _name(bench: FreeBench, letter: str, slot: int) -> str:
    """Name of a parameter of the law in a slot, from 1."""
    return f"{bench.simple.id}.{letter}_{slot}"


def _write(guess: _Guess, base: str) -> str:
    """A law in one line; `base` is what its share is one of."""
    text = guess.form.text.replace("x", guess.term.variable) if "exp" not in guess.form.text else (
        guess.form.text.replace("-x", f"-{guess.term.variable}"))
    if guess.term.way == "share":
        text = f"({text}) times the {base}"
    if guess.term.way.startswith(("torque", "drag")):
        return f"{guess.term.way} {text}" + (f" about {guess.phase}" if guess.phase else "")
    return text + (f" while {guess.phase}" if guess.phase else "")


def is_resolved(bench: FreeBench, solution: Solution, guess: _Guess, slot: int) -> bool:
    """Whether samples tell the shape of a fitted law from that of a simpler one.

    A length has to span a sample (a wave two), an onset to lie behind the first, and a power off its bounds.
    """
    x, length, power = (float(solution.u[bench.space.index[_name(bench, letter, slot)]]) for letter in "xln")
    spacing, scale, shapes = measure_spacing(bench, guess.term.variable), guess.term.scale, guess.form.shapes
    low, high = (bound[bench.space.index[_name(bench, "n", slot)]] for bound in bench.space.bounds())
    return not (("l" in shapes and np.exp(length) * scale < (2.0 if guess.form.waves else 1.0) * spacing)
                or ("x" in shapes and x * scale < spacing)
                or ("n" in shapes and not low + EDGE < power < high - EDGE))


def _draw(form: Form, parameters: Mapping[str, Estimate], mark: str, x: np.ndarray) -> np.ndarray:
    """A term of a law over places of its variable, in its unit, from the parameters that bear its mark."""
    values = {n.removesuffix(mark): e.estimate for n, e in parameters.items() if not mark or n.endswith(mark)}
    own = {"x": values.get("d", 0.0), "l": values.get("l", form.length * float(np.abs(x).max())),
           "n": values.get("n", form.power)}
    sizes = [values.get("k", values.get("a", 0.0)), values.get("b", 0.0)]
    return np.sum([s * f for s, f in zip(sizes, evaluate(form, x, own, 1.0), strict=False)], axis=0)


def measure_spacing(bench: FreeBench, variable: str) -> float:
    """Median distance of neighbouring samples in a variable, SI."""
    solution, records = bench.model.solution, bench.records
    time = np.asarray(records.stack.time)[: records.count]
    values = {"time": time, bench.family.rate: solution.state_rate}.get(variable, solution.state)
    steps = np.abs(np.diff(values, axis=1))
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0


def amplitude_unit(form: Form, unit: str, variable: str, power: float) -> str:
    """Unit of an amplitude: that of the force over that of the variable to the law's power."""
    if form.kind not in ("power", "signed power"):
        return unit
    per = f"({variable})" if "/" in variable or "*" in variable else variable
    return f"{unit or '1'}/{per}" + ("" if power == 1.0 else f"**{power:.3g}")


def _publish(bench: FreeBench, solution, g: _Guess, slot: int, mark: str) -> dict[str, Estimate]:
    """Amplitudes and shapes of one law in SI units."""
    covariance, place = solution.covariance(), {n: k for k, n in enumerate(solution.names)}
    name = {letter: _name(bench, letter, slot) for letter in "abxln"}
    value = {letter: float(solution.u[bench.space.index[n]]) for letter, n in name.items()}
    free = [letter for letter in "abxln" if name[letter] in place]
    own = covariance[np.ix_([place[name[f]] for f in free], [place[name[f]] for f in free])]
    scale, power = g.term.scale, float(np.exp(value["n"]))
    unit = bench.ground.variables[g.term.variable]
    # A share's amplitude is in units of the force at the reference; its own unit is that of a pure number.
    direction = np.abs(g.direction[g.direction != 0]).max()
    force = "" if g.term.way in ("share",) else ("1/s" if "drag" in g.term.way else bench.ground.unit)
    powered = g.form.kind in ("power", "signed power")
    down = direction / (scale**power if powered else 1.0)

    def estimate(amount: float, gradient: dict[str, float], its_unit: str, text: str) -> Estimate:
        slope = np.array([gradient.get(f, 0.0) for f in free])
        sd = float(np.sqrt(max(slope @ own @ slope, 0.0)))
        return Estimate(amount, sd, amount - 1.96 * sd, amount + 1.96 * sd, its_unit, text)

    size = value["a"] * down
    by_power = {"n": -size * np.log(scale) * power} if powered else {}
    found = {("a" if g.form.waves else "k") + mark: estimate(
        size, {"a": down, **by_power}, amplitude_unit(g.form, force, unit, power), "amplitude")}
    if g.form.kind == "sine":
        found["b" + mark] = estimate(value["b"] * down, {"b": down}, force, "amplitude")
    if "x" in g.form.shapes:
        found["d" + mark] = estimate(value["x"] * scale, {"x": scale}, unit, "onset")
    if "l" in g.form.shapes:
        length = float(np.exp(value["l"])) * scale
        found["l" + mark] = estimate(length, {"l": length}, unit, "wavelength" if g.form.waves else "length")
        if g.form.kind == "sawtooth":
            # Between two samples a jump may lie anywhere: its places are known to their spacing, whatever the fit says.
            blur = measure_spacing(bench, g.term.variable) / np.sqrt(12.0) / max(scale / length, 1.0)
            sd = float(np.hypot(found["l" + mark].sd, blur))
            found["l" + mark] = dc.replace(found["l" + mark], sd=sd, q025=length - 1.96 * sd, q975=length + 1.96 * sd)
    if "n" in g.form.shapes:
        found["n" + mark] = estimate(power, {"n": power}, "", "power")
    return found


def sketch_law(law: Law, shape: Shape, part: int) -> np.ndarray | None:
    """A law over the places of a shape, in its unit, for one of its curves; None where it is of another variable,
    direction or phase."""
    total = np.zeros(len(shape.x))
    for k, (variable, way, phase, name) in enumerate(zip(law.variables, law.ways, law.phases, law.forms, strict=True)):
        if variable != shape.variable or way != shape.way:
            return None
        if phase and phase != shape.parts[part]:
            if not shape.parts[part]:
                return None
            continue
        form = next(f for f in FORMS if f.name == name)
        mark = "" if len(law.forms) == 1 else f" {k + 1}"
        total = total + _draw(form, law.parameters, mark, shape.x)
    if not shape.centred:
        return total
    mean = float(shape.visited @ total / max(float(shape.visited.sum()), 1e-300))
    # As the curve itself is drawn: of a share s, (1 + s)/(1 + mean) - 1.
    return (total - mean) / (1.0 + mean) if shape.way == "share" else total - mean
