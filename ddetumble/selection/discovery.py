"""What `discover` returns: verdict, steps, candidates, and the fitted models themselves."""

import dataclasses as dc
import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .._display import AbstractPrinted
from .._errors import InputError
from ..families import find_family
from ..inference.archive import FILE, AbstractFitted, FittedModel, save_model
from ..inference.files import list_fields, list_versions, make_plain, write_json
from ..inference.findings import AbstractRivals, Fit
from ..measurement.faults import Fault
from ..measurement.quantities import clean
from .bias import SettingBias
from .confidence import Confidence, find_confidence, list_allowances
from .explanations import Added, Explanation, Makers
from .lack_of_fit import FEWEST
from .result import (
    EXPLANATIONS,
    OPEN,
    RESULT,
    RIVALS,
    Candidate,
    MissingForce,
    Place,
    Rounding,
    SettingSpread,
    Step,
    list_shifts,
)
from .series import measure_ratio
from .settings import DEFAULT, SelectionSettings
from .text import align, choose_view, format_candidates, format_steps, say_places, say_verdict, show_estimate, wrap


FEWEST_ROUNDS = 10  # to search on with: one or two effects take about as many


@dc.dataclass(frozen=True)
class Discovery(AbstractFitted, AbstractRivals, AbstractPrinted):
    """Everything that `discover` found; `to_dict()` is `result.json`.

    Attributes:
        campaign: name; `title`, `family`, `sha256` likewise from the campaign.
        model: name of the reference model.
        verdict: `nothing-missing`, `explained`, `improved`, `unexplained` or `undecided`.
        effects: ids found, in the order in which they were added.
        steps: reference model first.
        candidates: all effects of the family, best first.
        where: where the misfit of the reference model (or what is left after the last step) sits.
        noise_nrmse: noise over rms signal.
        noise: by channel: `stated_sd`, `sd`, `correlation`, `white_share`, `text`.
        sentence: plain words: what is missing, how sure, what to measure next.
        notes: further sentences (what was assumed, what could not be seen).
        faults: of the data, and what was done about them.
        doubts: what has to be settled first: units that may be wrong, estimates beyond what physics allows.
        references: other reference models that were tried beside the one that was asked for, and how far they came.
        settings: the thresholds that decided.
        counts: `records`, `samples`, `conditions` that were searched, and `seconds` it took.
        spread: settings that scatter more than stated, which the fits allow for.
        biases: errors of single settings, shared by all records, that explain them as well as the effects do.
        shared_error: of one setting in all records, which the models allow for beside what the campaign states.
        reason: why the verdict is `undecided`: `unit`, `setting`, `record`, `rounding`, `noise`, `conditions` (too
            few), `effort` (rounds were spent) or `records` (too few or too short); empty for any other.
        rounding: effects that change no more than the digits of the gauge might; the verdict is then `undecided`.
        dropped: effects that gave way to an error of a setting, to rounding, or to noise of no kind that is modelled,
            each with those it was not told from.
        explanations: models between which the verdict leaves open; none where it leaves nothing open but the `rivals`.
        irregular: whether the misfit that is left is none of a force's: no force of any variable removes any of it on
            conditions that are left out, and nothing of it repeats over the records. If the verdict is `undecided`,
            that could not be judged, it outweighs what effects remove, or baselines that wander fit as well as a force
            might.
        unrepeated: whether the verdict is `undecided` as so few records do not show if the misfit repeats over them: it
            may be noise or settings that are not as stated.
        unsearched: searches that were left out for want of rounds (`settings.effort`), if the verdict is `undecided` as
            they might have found something else.
        missing: the missing force itself, for the verdicts `improved` and `unexplained`.
        made: what makes the fits: of every step, of the rivals of the last one, and of the explanations.
    """

    campaign: str
    title: str
    family: str
    sha256: str
    model: str
    verdict: str
    effects: tuple[str, ...]
    steps: tuple[Step, ...]
    candidates: tuple[Candidate, ...]
    where: tuple[Place, ...]
    noise_nrmse: float
    noise: Mapping[str, Mapping[str, Any]]
    sentence: str
    notes: tuple[str, ...] = ()
    settings: SelectionSettings = DEFAULT
    counts: Mapping[str, Any] = dc.field(default_factory=dict)
    faults: tuple[Fault, ...] = ()
    doubts: tuple[str, ...] = ()
    references: tuple[Mapping[str, Any], ...] = ()
    spread: tuple[SettingSpread, ...] = ()
    biases: tuple[SettingBias, ...] = ()
    shared_error: SettingBias | None = None
    reason: str = ""
    rounding: Rounding | None = None
    dropped: Added = ()
    explanations: tuple[Explanation, ...] = ()
    irregular: bool = False
    unrepeated: bool = False
    unsearched: tuple[str, ...] = ()
    missing: MissingForce | None = None
    made: tuple[Makers, Makers, Makers] = dc.field(default=((), (), ()), repr=False, compare=False)

    @functools.cached_property
    def fits(self) -> tuple[Fit, ...]:
        """Every step as `fit` returns one, the reference model first."""
        return tuple(make() for make in self.made[0])

    @functools.cached_property
    def rivals(self) -> tuple[Fit, ...]:
        """Models that the last one could not be told from, as `fit` returns one."""
        return tuple(make() for make in self.made[1])

    @functools.cached_property
    def explanation_fits(self) -> tuple[Fit, ...]:
        """The `explanations` as `fit` returns one; an error that all records share is a parameter, `NAME_shift`."""
        return tuple(make() for make in self.made[2])

    @property
    def allowances(self) -> tuple[str, ...]:
        """What of noise and settings was taken otherwise than stated."""
        return list_allowances(self.noise, spread=self.spread, biases=self.biases, shared_error=self.shared_error,
                               irregular=self.irregular)

    @property
    def confidence(self) -> Confidence | None:
        """How often such verdicts were right in the sealed exam; None where that is not known: of values, and of so few
        records that the exam hides nothing in them."""
        found = find_confidence(self.family, self.verdict, bool(self.allowances))
        if found is None or not self.counts:
            return found
        few = self.counts["records"] < FEWEST and not find_family(self.family).free_running
        return None if few or self.counts["samples"] == self.counts["records"] else found

    @property
    def more_effort(self) -> int | None:
        """Rounds to search with in place of those after which the search was cut short, twice as many; None where the
        verdict does not depend on what was left out."""
        return max(FEWEST_ROUNDS, 2 * self.counts["rounds"]) if self.unsearched else None

    @property
    def best(self) -> Fit:
        """The model of the last step as `fit` returns one.

        Raises:
            InputError: The discovery was put together by hand, without its fits.
        """
        if not self.made[0]:
            raise InputError("this discovery does not contain its fitted models")
        return self.fits[-1]

    def fitted_model(self) -> FittedModel:
        """The model of the last step by itself: what predictions and designs go on from."""
        return self._mark(self.best)

    def _mark(self, fit: Fit) -> FittedModel:
        """A fitted model with the verdict of this discovery."""
        found, last = fit.fitted_model(), self.steps[-1]
        is_open = self.verdict in OPEN or (self.verdict == "undecided" and last.lack_of_fit.rejected)
        misfit = measure_ratio(last.traces) if is_open and self.noise_nrmse > 0 else None
        return dc.replace(found, extra={**found.extra, "verdict": self.verdict, "misfit": misfit})

    def __str__(self) -> str:
        """The findings in at most 100 columns: the sentence, the steps, the best candidates, parameters, and where."""
        records = len({trace.record for step in self.steps[-1:] for trace in step.traces})
        campaign = clean(self.campaign, 40) or "a campaign without a name"
        head = f"[{say_verdict(self.verdict)}] {campaign}, {records} records, "
        parts = [wrap(clean(self.sentence, 4000)), wrap(head + f"reference model {clean(self.model, 30)}"),
                 format_steps(self.steps, self.model, self.noise_nrmse)]
        if self.candidates:
            parts.append(format_candidates(self.candidates, self.steps, self.effects))
        if self.steps and self.steps[-1].parameters:
            rows = []
            for name, one in self.steps[-1].parameters.items():
                value, sd, low, high = show_estimate(one)
                rows.append((clean(name, 40), f"{value} +- {sd}", f"[{low}, {high}]", clean(one.unit, 16)))
            parts.append(align(("parameter", "estimate", "95 % interval", ""), rows, "l" * 4))
        if self.where:
            view = choose_view([trace for step in self.steps[:1] for trace in step.traces], self.family)
            places = [wrap(one, "  ") for one in say_places(self.where, view)]
            parts.append("\n".join(["Where the misfit sits:", *places]) if places else "")
        if self.missing is not None:
            parts.append("\n".join(["The missing force:", wrap(clean(self.missing.sentence, 4000), "  "),
                                   *(wrap(clean(note, 2000), "  ") for note in self.missing.notes)]))
        if self.notes:
            parts.append("\n".join(["Notes:", *(wrap(clean(note, 2000), "  ") for note in self.notes)]))
        return "\n\n".join(part for part in parts if part)

    def save(self, folder: Path | str) -> Path:
        """Write `result.json`, and `model.json` with the grown model for `predict`, into a folder; returns the first.

        Every model that could not be told from the best one is written to `rivals/NUMBER/model.json`, and
        every one of the `explanations` to `explanations/NUMBER/model.json`.

        Raises:
            InputError: the folder cannot be written.
        """
        folder = Path(folder)
        if self.made[0]:
            save_model(folder, self.fitted_model())
            for part, fits in ((RIVALS, self.rivals), (EXPLANATIONS, self.explanation_fits)):
                for old in (folder / part).glob(f"*/{FILE}"):  # of an earlier discovery
                    old.unlink()
                for number, one in enumerate(fits, 1):
                    save_model(folder / part / str(number), self._mark(one) if part == RIVALS else one.fitted_model())
        write_json(folder / RESULT, {**self.to_dict(), "versions": list_versions()})
        return folder / RESULT

    def to_dict(self) -> dict[str, Any]:
        """`result.json` of `discover`: plain numbers, text, lists."""
        last, names = self.steps[-1], ("campaign", "family", "model", "verdict", "effects", "sentence", "noise_nrmse",
                                       "noise", "references", "doubts", "notes", "faults", "sha256", "irregular")
        return make_plain({
            **{name: getattr(self, name) for name in names},
            "steps": [{
                **list_fields(s, "alternatives", "parameters", "correlations", "traces", "shifts"),
                "nuisances": list_shifts(s.shifts), "alternatives": [a["effect"] for a in s.alternatives],
                "paired_differences": s.alternatives,
            } for s in self.steps],
            "candidates": [{
                **list_fields(c, "heldout_difference", "standard_error"),
                "paired_difference": c.heldout_difference, "paired_standard_error": c.standard_error,
            } for c in self.candidates],
            "where": [{k: v for k, v in list_fields(w).items() if v is not None} for w in self.where],
            "parameters": last.parameters, "correlations": last.correlations, "nuisances": list_shifts(last.shifts),
            "lack_of_fit": self.steps[0].lack_of_fit, "setting_spread": self.spread,
            "setting_biases": self.biases, "shared_error": self.shared_error, "rounding": self.rounding,
            "reason": self.reason, "unsearched": self.unsearched,
            "dropped": [{"effect": effect, "alternatives": others} for effect, others in self.dropped],
            "explanations": self.explanations,
            "allowances": self.allowances,
            "confidence": self.confidence,
            "missing_force": self.missing and self.missing.to_dict(settings=False),
            "settings": {"level": self.settings.level, **self.counts, "thresholds": self.settings},
        })
