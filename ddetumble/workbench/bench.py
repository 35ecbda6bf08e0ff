"""A campaign on the workbench: the steps of the loop by hand, each a value with the Python lines that do the same.

Nothing here is changed in place, and nothing draws: a function takes a bench and returns another one, or a result.
"""

import dataclasses as dc
import functools
import math
import os
import tempfile
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

import ddetumble as dd


REACH = 2.0  # of the size from which fits start, that a slider goes to
BEYOND = 1.25  # of an estimate, that its slider goes to
Progress = Callable[[str, float], object] | None


@dc.dataclass(frozen=True)
class Step:
    """One row of the error ledger: a fitted model."""

    number: int  # from 1
    done: str  # in words
    code: tuple[str, ...]  # lines that make `step_NUMBER`
    needs: int  # number of the step that these lines start from; 0 where they need the campaign alone
    model: str  # MODEL that its fits extend
    effects: tuple[str, ...]  # ids, beside those that the model itself has
    fit: dd.Fit
    errors: dd.Comparison
    found: dd.Discovery | None = None  # where `discover` made it

    @functools.cached_property
    def law(self) -> Any:
        """The fitted law, with every effect that it has, whatever brought it."""
        return self.fit.fitted_model().law()

    @property
    def name(self) -> str:
        """Number and model, as rows of a ledger and legends of figures say it."""
        return f"{self.number}: {' + '.join([self.fit.model, *(effect.id for effect in self.law.effects)])}"


@dc.dataclass(frozen=True)
class Bench:
    """A campaign, the steps taken, and the one that is looked at."""

    source: str  # the campaign, as it was named
    campaign: dd.Campaign
    steps: tuple[Step, ...] = ()
    current: int = 1  # number of a step

    @property
    def step(self) -> Step:
        """The step that is looked at."""
        return self.steps[self.current - 1]

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that the model is compared in."""
        return tuple(dict.fromkeys(trace.channel for trace in self.step.errors.traces))

    @property
    def are_values(self) -> bool:
        """Whether a test gives one value, and no curve."""
        return all(trace.is_value for trace in self.step.errors.traces)

    def take(self, step: Step) -> "Bench":
        """With one step more, which is looked at."""
        return dc.replace(self, steps=(*self.steps, step), current=step.number)

    def go_back(self, number: int) -> "Bench":
        """The same steps, of which another one is looked at: what comes next starts from there."""
        if not 1 <= number <= len(self.steps):
            raise dd.InputError(f"there is no step {number}; there are {len(self.steps)}")
        return dc.replace(self, current=number)


@dc.dataclass(frozen=True)
class Control:
    """A parameter that can be moved, and fitted or held. Values are those of its field: of an inverse, 1/parameter."""

    name: str
    about: dd.effects.Parameter
    value: float  # where the step left it
    low: float
    high: float
    fitted: bool  # whether the step fitted it
    usual: bool  # whether `fit` fits it unless it is told otherwise
    held: float  # where `fit` holds it otherwise

    @property
    def shown(self) -> float:
        """The value, rounded for people: a control that stands there was not moved."""
        return _shorten(self.value)

    @property
    def slides(self) -> bool:
        """Whether it is the amplitude of an effect, which a slider moves from nothing to plain to see."""
        return self.about.kind == "amplitude"

    @property
    def step(self) -> float:
        """From one position to the next, a number of one digit: a slider has two to five hundred positions, and a
        number goes in steps of a hundredth or two of its value."""
        wanted = (self.high - self.low) / 200 if self.slides else abs(self.shown) / 50
        if not wanted > 0 or not math.isfinite(wanted):
            return 1.0
        power = 10.0 ** math.floor(math.log10(wanted))
        return _shorten(power * max(one for one in (1.0, 2.0, 5.0) if one * power <= wanted * (1 + 1e-9)))

    def tell(self, value: float | None) -> str:
        """Name, value and unit where the control stands at `value`, with all the digits that `choose` takes of it."""
        over = "1/" if self.about.transform.reciprocal else ""
        number = np.format_float_positional(_shorten(self.shown if value is None else value), trim="-")
        return f"{over}{self.name} = {number} {over * bool(self.about.unit)}{self.about.unit}".rstrip()

    def publish(self, value: float) -> float:
        """A value of the field in the parameter's public unit."""
        return float(self.about.transform.publish(value))


@dc.dataclass(frozen=True)
class Choice:
    """A model as the controls say it: effects beside the model's own, what was moved, and what is held.

    Values by name are those of the fields, as of `Control`.
    """

    effects: tuple[str, ...] = ()
    moved: Mapping[str, float] = dc.field(default_factory=dict)
    held: frozenset[str] = frozenset()


@dc.dataclass(frozen=True)
class Done:
    """What an action returned, and lines that do the same."""

    result: Any
    code: str


def open_bench(source: str, model: str = "paper", progress: Progress = None) -> Bench:
    """Read a campaign and fit a model to it, which is the first step.

    Raises:
        InputError: The campaign or the model cannot be read.
    """
    bench = Bench(source, dd.read_campaign(source))
    return _fit(bench, model, (), {}, [], f"fitted {model}", progress)


def list_effects(bench: Bench) -> dict[str, Any]:
    """Classes of effects that can extend the model of the step, by id: those of the catalogue that its records could
    show.
    """
    own = {effect.id for effect in bench.step.law.effects} - {*bench.step.effects}
    return {effect.id: effect for effect in bench.step.fit.space.effects
            if effect.id not in own and getattr(dd.effects, effect.__name__, None) is effect}


def list_controls(bench: Bench, effects: Iterable[str]) -> list[Control]:
    """Controls of the reference model, of the effects that the model has, and of those that are chosen."""
    step, first = bench.step, bench.steps[0].fit
    law, usable, found = step.law, list_effects(bench), []
    there = {effect.id for effect in law.effects}
    chosen = [e for e in law.effects if e.id not in step.effects or e.id in effects]
    chosen += [usable[name]() for name in effects if name not in there]
    for owner in (law.reference, *chosen):
        for one in dd.effects.parameters_of(owner):
            name = one.name if owner is law.reference else f"{owner.id}.{one.name}"
            value = float(functools.reduce(getattr, one.field.split("."), owner))
            known = name in first.parameters or name in first.fixed
            low, high = _find_range(one, value)
            new = owner is not law.reference and owner.id not in there
            found.append(Control(
                name, one, value, low, high, one.free if new else name in step.fit.parameters,
                name in first.parameters if known else one.free,
                one.transform.find_field(first.fixed[name]) if name in first.fixed else one.default))
    return found


def _find_range(one: dd.effects.Parameter, value: float) -> tuple[float, float]:
    """Ends of a slider: from the null of an amplitude, on the sides that physics allows, to where it is plain to see;
    the bounds of anything else.
    """
    low, high = one.bounds
    if one.kind != "amplitude":
        return low, high
    reach = max([REACH * abs(start - one.default) for start in one.starts] or [one.typical])
    reach = max(reach, BEYOND * abs(value - one.default))
    ends = one.default - (reach if one.sign <= 0 else 0.0), one.default + (reach if one.sign >= 0 else 0.0)
    if not one.transform.reciprocal:
        low, high = max(low, min(one.limits[0], one.default)), min(high, max(one.limits[1], one.default))
    # An estimate may lie beyond its null, on the side that physics does not allow.
    shown = _shorten(value)
    return min(_shorten(max(ends[0], low), 3), shown), max(_shorten(min(ends[1], high), 3), shown)


def _shorten(value: float, digits: int = 6) -> float:
    return float(f"{value:.{digits}g}")


def choose(controls: Iterable[Control], effects: Iterable[str], values: Mapping[str, float],
           fitted: Mapping[str, bool]) -> Choice:
    """What the controls say, where they stand at `values` and `fitted`; what is not given stands where it was.

    Of a value as many digits count as are shown.
    """
    controls = list(controls)
    moved = {one.name: _shorten(float(values[one.name])) for one in controls
             if values.get(one.name) is not None and values[one.name] not in (one.value, one.shown)}
    return Choice(tuple(effects), moved,
                  frozenset(one.name for one in controls if not fitted.get(one.name, one.fitted)))


def simulate(bench: Bench, choice: Choice, progress: Progress = None) -> Done | None:
    """The model where the controls stand, computed exactly and not fitted, beside the measurements: a `Comparison`.

    None where it is the model of the step itself. Only the settings of the records move, within their uncertainty.
    """
    step, law = bench.step, bench.step.law
    places = [(law.reference, "law.reference", "")]
    places += [(effect, f"law.effects[{k}]", effect.id) for k, effect in enumerate(law.effects)
               if effect.id not in step.effects or effect.id in choice.effects]
    usable, there = list_effects(bench), {effect.id for effect in law.effects}
    parts, texts = [], []
    for module, text, owner in places:
        made, told = _replace(module, text, _list_moved(module, owner, choice.moved))
        parts.append(made)
        texts.append(told)
    for name in choice.effects:
        own = {} if name in there else _list_moved(usable[name], name, choice.moved)
        if own:
            parts.append(usable[name](**own))
            texts.append(f"dd.effects.{usable[name].__name__}({_write_arguments(own)})")
    if texts == ["law.reference", *(f"law.effects[{k}]" for k in range(len(law.effects)))]:
        return None
    made = parts[0]
    for part in parts[1:]:
        made = made + part
    lines = [f"law = step_{step.number}.fitted_model().law()", f"law = {' + '.join(texts)}",
             "trial = dd.compare(campaign, law, refit=False)", "print(trial)"]
    result = dd.compare(bench.campaign, made, refit=False, progress=progress)
    return Done(result, write_code(bench, step.number, *lines))


def _list_moved(module: Any, owner: str, moved: Mapping[str, float]) -> dict[str, float]:
    """Fields of a model or an effect (of that id) that were moved."""
    prefix = f"{owner}." if owner else ""
    return {one.field: moved[prefix + one.name] for one in dd.effects.parameters_of(module)
            if prefix + one.name in moved}


def _replace(module: Any, text: str, values: Mapping[str, float]) -> tuple[Any, str]:
    """A module with fields replaced, those of its parts by their path, and the expression that makes it."""
    whole: dict[str, Any] = {path: value for path, value in values.items() if "." not in path}
    told = [_write_arguments(whole)] if whole else []
    for part in dict.fromkeys(path.partition(".")[0] for path in values if "." in path):
        inner = {path.partition(".")[2]: value for path, value in values.items() if path.startswith(f"{part}.")}
        whole[part], expression = _replace(getattr(module, part), f"{text}.{part}", inner)
        told.append(f"{part}={expression}")
    return (dc.replace(module, **whole), f"dataclasses.replace({text}, {', '.join(told)})") if whole else (module, text)


def _write_arguments(values: Mapping[str, float]) -> str:
    return ", ".join(f"{name}={_write_number(value)}" for name, value in values.items())


def _write_number(value: float) -> str:
    """A number that Python reads back to the last digit."""
    return repr(float(value)) if math.isfinite(value) else f'float("{float(value)}")'


def fit(bench: Bench, choice: Choice, progress: Progress = None) -> Bench:
    """Fit the model that the controls say: what is held stays where it stands, all else is fitted. One step more.

    Raises:
        InputError: The choice makes no sense, such as when nothing is left to fit.
        ComputationError: The model could not be integrated.
    """
    fixed: dict[str, float] = {}
    free: list[str] = []
    said = []
    for one in list_controls(bench, choice.effects):
        value = choice.moved.get(one.name, one.value)
        if one.name not in choice.held:
            if not one.usual:
                free.append(one.name)
                said.append(f"{one.name} freed")
        elif one.usual or not math.isclose(value, one.held, rel_tol=1e-9):
            fixed[one.name] = one.publish(value)
            said.append(f"{one.name} held at {fixed[one.name]:.4g} {one.about.unit}".rstrip())
    model = bench.step.model
    told = "; ".join(["fitted " + " + ".join([model, *choice.effects]), *said])
    return _fit(bench, model, choice.effects, fixed, free, told, progress)


def _fit(bench: Bench, model: str, effects: tuple[str, ...], fixed: Mapping[str, float], free: list[str], done: str,
         progress: Progress) -> Bench:
    number, more = len(bench.steps) + 1, {}
    arguments = ["campaign", repr(model), *([repr(list(effects))] if effects else [])]
    if free:
        more["free"] = free
        arguments.append(f"free={free!r}")
    if fixed:
        more["fixed"] = fixed
        arguments.append(f"fixed={{{', '.join(f'{name!r}: {_write_number(value)}' for name, value in fixed.items())}}}")
    found = dd.fit(bench.campaign, model, effects, progress=progress, **more)
    return bench.take(Step(number, done, (f"step_{number} = dd.fit({', '.join(arguments)})",), 0, model, effects, found,
                           dd.compare(bench.campaign, found)))


def discover(bench: Bench, progress: Progress = None) -> Bench:
    """Let `discover` go on from the model of the step; what it ends with is one step more."""
    step, number = bench.step, len(bench.steps) + 1
    alone = not step.law.effects  # a model without effects is the reference model, and needs no step
    found = dd.discover(bench.campaign, step.model if alone else step.fit, progress=progress)
    # Where it went over to another reference model, that one is extended from here on.
    best, first = found.best, bench.steps[0]
    model = step.model if found.model == step.fit.model else found.model
    own = {effect.id for effect in first.law.effects} if model == first.model else set()
    effects = tuple(effect.id for effect in best.fitted_model().law().effects if effect.id not in own)
    done = f"discover from step {step.number}: {', '.join([found.verdict, *found.effects])}"
    code = (f"found_{number} = dd.discover(campaign, {repr(step.model) if alone else f'step_{step.number}'})",
            f"step_{number} = found_{number}.best")
    return bench.take(Step(number, done, code, 0 if alone else step.number, model, effects, best,
                           dd.compare(bench.campaign, best), found))


def draw_missing(bench: Bench, progress: Progress = None) -> Done:
    """The force that the model of the step lacks: a `MissingForce`."""
    step, alone = bench.step, not bench.step.law.effects
    line = f"missing = dd.draw_missing_force(campaign, {repr(step.model) if alone else f'step_{step.number}'})"
    result = dd.draw_missing_force(bench.campaign, step.model if alone else step.fit, progress=progress)
    return Done(result, write_code(bench, 0 if alone else step.number, line, "print(missing)"))


def design(bench: Bench, rival: int | None = None, progress: Progress = None) -> Done:
    """The next test: that tells the step from a rival one, or from those of its discovery; else that narrows its
    parameters most. A `Design`.
    """
    step = bench.step
    models: Any = step.found or step.fit
    text, needed = f"{'found' if step.found else 'step'}_{step.number}", [step.number]
    if rival is not None:
        models, text = [step.fit, bench.steps[rival - 1].fit], f"[step_{step.number}, step_{rival}]"
        needed.append(rival)
    result = dd.design(models, progress=progress)
    return Done(result, _write(bench, needed, (f"test = dd.design({text})", "print(test)")))


def save(bench: Bench, folder: str, progress: Progress = None) -> Done:
    """Write the step, the ledger and their reports into a folder, whole or not at all; returns its path.

    The step is what `ddetumble predict` and `design` go on from (`model.json`); `comparison.html` is the report of all
    steps, `report.html` that of the step's fit or discovery, and `steps.py` holds the lines.

    Raises:
        InputError: The folder holds something already, or cannot be written.
    """
    path, step = Path(folder).expanduser(), bench.step
    if not folder.strip():
        raise dd.InputError("name a folder to save to")
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise dd.InputError("this place is taken already; name a new folder", file=path)
    name = f"{'found' if step.found else 'step'}_{step.number}"
    code = _write(bench, range(1, len(bench.steps) + 1), (
        f"steps = dd.compare(campaign, {', '.join(f'step_{one.number}' for one in bench.steps)})",
        f"steps.save({folder!r})", f"{name}.save({folder!r})", f"print(dd.report(steps, {folder!r}))",
        f"print(dd.report({name}, {folder!r}))"))
    steps: Any = dd.compare(bench.campaign, *(one.fit for one in bench.steps), progress=progress)
    result = step.found or step.fit
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{path.name}-", dir=path.parent, ignore_cleanup_errors=True) as near:
            draft = Path(near) / "draft"
            draft.mkdir()
            steps.save(draft)
            result.save(draft)
            dd.report(steps, draft)
            dd.report(result, draft)
            (draft / "steps.py").write_text(code, encoding="utf-8")
            os.replace(draft, path)
    except OSError as error:
        reason = (error.strerror or type(error).__name__).lower()
        raise dd.InputError(f"the folder cannot be written ({reason})", file=path) from None
    return Done(path, code)


def list_errors(bench: Bench) -> list[dict[str, Any]]:
    """The error ledger, one row a step; errors are RMS residuals in per cent of the RMS of the signal."""
    return [{"step": one.number, "done": one.done, "fitted [%]": _round(one.errors.nrmse),
             "cross-validated [%]": _round(one.errors.heldout_nrmse), "noise [%]": _round(one.errors.noise_nrmse),
             "chi2/dof": float(f"{one.errors.chi2_reduced:.4g}"),
             "misfit left": "yes" if one.errors.lack_of_fit.rejected else "no"} for one in bench.steps]


def _round(error: float) -> float | None:
    return float(f"{100 * error:.4g}") if math.isfinite(error) else None


def write_step(bench: Bench) -> str:
    """Lines that make the step and compare it with the measurements."""
    number = bench.step.number
    return write_code(bench, number, f"print(dd.compare(campaign, step_{number}))")


def write_script(bench: Bench) -> str:
    """Lines that make every step, and set them side by side."""
    steps = ", ".join(f"step_{one.number}" for one in bench.steps)
    return _write(bench, range(1, len(bench.steps) + 1), (f"print(dd.compare(campaign, {steps}))",))


def write_code(bench: Bench, number: int, *lines: str) -> str:
    """Lines that can be run as they stand: what makes a step (of that number; none where it is 0), and then these."""
    return _write(bench, [number] if number else [], lines)


def _write(bench: Bench, wanted: Iterable[int], lines: Iterable[str]) -> str:
    """Lines that make some steps, with those that they need in turn, and then these."""
    needed: set[int] = set()
    for number in wanted:
        while number and number not in needed:
            needed.add(number)
            number = bench.steps[number - 1].needs
    body = [line for number in sorted(needed) for line in bench.steps[number - 1].code] + list(lines)
    head = ["import dataclasses", ""] if any("dataclasses." in line for line in body) else []
    return "\n".join([*head, "import ddetumble as dd", "", f"campaign = dd.read_campaign({bench.source!r})", *body, ""])
