"""Thresholds that decide a verdict, each with its reason; a result keeps those it was made with."""

import dataclasses as dc

from ..inference.noise_estimation import NoiseSettings
from ..inference.record_scatter import ScatterSettings
from ..inference.variance_components import SpreadSettings, WanderSettings
from ..measurement.faults import ScreeningSettings


@dc.dataclass(frozen=True)
class OutlierSettings:
    """When a record counts as an outlier, and when a data error explains it."""

    # Of a record's lack of fit, over all records together, below which it is no chance: far below the level of a
    # verdict, as a record that is left out is lost to every verdict.
    p_value: float = 1e-5
    adequate: float = 0.01  # p-value above which the other records count as fitted well without it
    factor: float = 3.0  # excess of its mean square over that of any other, where the model lacks something too
    far: float = 100.0  # the same where no condition can switch an effect on, and for a gain that no neighbour shares
    fewest: int = 3  # records with which one can be judged: two against one
    farther: float = 1000.0  # excess over that of the others with so few records
    clear: float = 4.0  # mean square, in noise variances, that it has at least
    one_in: int = 4  # at most one record in so many is left out
    same: float = 0.03  # share by which values of neighbours may differ and count as the same
    every: int = 6  # records of which every one is left out in turn; of more, the worst and what bends the fit most
    candidates: int = 3  # worst records of more than `every` that are left out in turn
    # Share of a misfit that leaving out one record removes before the search is repeated without: half of it, or so
    # many times what one of as many records would take.
    removed: float = 0.5
    carried: float = 3.0
    # Share by which a setting of two records differs before these may be exchanged: scatter of settings that lie nearer
    # makes some pair fit better exchanged.
    apart: float = 0.1
    exchanged: float = 0.2  # share of their own misfit that two records keep at most with the settings of each other
    fits: float = 1e-3  # p-value above which a record fits with a data error corrected
    small: float = 1.0  # the same as an excess: below one noise variance no plot shows it
    wide: float = 6.0  # standard deviations of a sample that is off by itself
    conditions: int = 2  # that share a level at which a gauge is taken to be at its limit
    few: float = 0.03  # largest share of a record's samples that may be off
    close: float = 0.25  # share by which the first guess of a ratio of units may be off
    kinematic_slack: float = 0.06  # the same for rates of rotation against Euler's equations, before any fit
    kinematic_spread: float = 0.1  # share by which the other records' ratios may differ there
    kinematic_noise: float = 0.2  # share of the changes of rates that Euler's equations may leave there


@dc.dataclass(frozen=True)
class BaselineSettings:
    """When the baseline of a channel (offset and drift) counts as another in every record."""

    p_value: float = 1e-4  # of what free baselines remove, and of readings before first touch
    removed: float = 0.6  # share of the misfit that they remove where the readings before first touch show them
    removed_unseen: float = 0.9  # the same where nothing but the fit says so
    common: float = 4.0  # standard errors of the mean over records, from which on it is the same in all: maybe physics
    explained: float = 0.5  # share of the baselines' scatter that conditions may explain: more may be physics
    significant: float = 4.0  # standard errors of a record's own baseline; at least half the records show one
    fewest: int = 4  # records
    samples: int = 3  # before first touch that tell a baseline


@dc.dataclass(frozen=True, repr=False)
class SelectionSettings:
    """What decides a verdict of `discover`.

    Differences of cross-validated deviance are in noise variances: a parameter that does nothing changes it by about
    one, so that 9 is a difference of three standard deviations, and 50 one that no unknown correlation of the noise
    turns.

    Attributes:
        level: probability of calling a complete model incomplete, shared by the three statistics of the lack of fit.
        significant: difference of cross-validated deviance that is not chance, and the penalty of a parameter.
        decisive: difference that decides whatever its standard error.
        standard_errors: of a paired difference over conditions, below which it may be chance: about 95 %.
        tie: difference below which two models predict alike, and the one with fewer parameters is taken.
        most_effects: effects that are added at most: with more, nearly any records can be fitted.
        effects_of_values: the same of tests that give one value each: among all pairs of effects one fits nearly any
            ten numbers.
        finalists: candidates that are fitted to the end: those that predict best.
        further_finalists: beside them, of those that fit better and predict worse.
        better_fit: share of the misfit that the best removes, by which another has to remove more to stay in doubt.
        majority: share of the conditions that an addition has to predict better where the gain is not significant over
            their scatter.
        same_error: share by which an addition may raise the cross-validated error where its loss in noise variances
            falls beyond chance: what no sentence calls a change.
        screening_samples: samples of a record on which candidates are screened.
        screening_steps: Gauss-Newton steps of a screening fit.
        unfinished: share of the best candidate's gain that a screening fit which has not converged may still make.
        astray: rise of chi-square over the model without the effect, beyond which its fit went astray.
        strayed: typical changes that a parameter has moved from its guess, from which on fits start from the guess too.
        same_fit: drop of chi-square, to the end of a fit, within which its lack of fit is not judged again.
        early: share of a left-out record that gives what it starts from, where records run on from where they start.
        bent: times the linearised loss of a condition that is left out, from which on the exact one shows that the step
            to the fit without it was too long, and that fit is made: what a shape such as a speed scale does to a force
            is no straight line.
        far_off: noise variances a sample of a condition that is left out, from which on its linearised loss is no
            figure to go by, and the fit without it is made: a model that misses by so much may as well be one whose
            straight line led it far away.
        bootstrap: draws of the parametric bootstrap of the score statistic of few long records.
        certain: p-value of the smooth misfit below which one effect that removes all of it is no imitation.
        imitation: share of what one unlisted force gains below which effects together only imitate it.
        effects_before_rivals: additions before the other reference models are tried: three make up for nearly any
            wrong one.
        rival_references: other reference models that are searched, those that fit best by themselves: each takes as
            long as the first.
        farthest_reference: times the misfit of the model that was asked for, beyond which another is no rival.
        same_reference: relative difference of chi-square within which two reference models are one.
        far: chi-square per degree of freedom that is left, from which on other reference models are fitted by
            themselves, as one may come nearer: twice the noise.
        nearer: times the error of what was found, below which another reference model is named to begin with.
        largest_part: share of a misfit from which an effect removes most of it.
        shown: standard errors of an amplitude that would have been found.
        power: probability with which the smallest detectable amplitude is found.
        collinear: |cosine| of two signatures from which on they cannot be told apart.
        invisible: share of its signature below which an effect cannot be identified.
        effort: rounds, in each of which every effect is tried beside some model, after which a search ends and the
            verdict says what was left out: room for every search that a verdict may need (a pair with its exchanges,
            loose settings, baselines that wander, a record left out, other units, other reference models), four rounds
            each.
        rounds: of leaving out faulty records and beginning again, at most.
        most_samples: that are searched: hundreds of fits to them take some ten minutes.
        little: share of a misfit that a force of any variable removes on left-out conditions, up to which the misfit
            may be no force's: what noise happens to share with one, and
        repeats: p-value of a misfit that repeats over the records, above which it is none: at 1 % a wear that no
            catalogue holds passed for a baseline that wanders.
        outweighs: share of the misfit that is left to noise or settings of no kind that is modelled, which effects
            beside it have to remove at least: in the exam, true ones removed ten times as much and more, and 0.03 and
            0.2 of it those that were found where nothing was hidden.
        repeats_rough: the same of baselines that are rough beyond doubt, as a random walk is and no force's misfit.
        bias: standard deviation of an error that all records share, as a share of the setting: a gauge that was not
            calibrated lately.
        rounding: times the largest error of the mean that the digits of a gauge make, up to which a change of its
            readings may be rounding.
        noise: what decides how the noise is taken.
        spread: when settings count as scattering more than stated.
        wander: when what is slow in the residuals is a baseline that wanders.
        scatter: when intervals are those of the scatter of records.
        screening, outliers, baseline: what counts as a fault of the data.
    """

    level: float = 0.01
    significant: float = 9.0
    decisive: float = 50.0
    standard_errors: float = 2.0
    tie: float = 1e-6
    most_effects: int = 3
    effects_of_values: int = 1
    finalists: int = 5
    further_finalists: int = 2
    better_fit: float = 0.25
    majority: float = 0.6
    same_error: float = 0.01
    screening_samples: int = 768
    screening_steps: int = 8
    unfinished: float = 0.25
    astray: float = 1.0
    strayed: float = 3.0
    same_fit: float = 1.0
    early: float = 0.25
    bent: float = 2.0
    far_off: float = 4.0
    bootstrap: int = 4000
    certain: float = 1e-6
    imitation: float = 0.5
    effects_before_rivals: int = 2
    rival_references: int = 2
    farthest_reference: float = 4.0
    same_reference: float = 1e-6
    far: float = 4.0
    nearer: float = 0.5
    largest_part: float = 0.8
    shown: float = 4.5
    power: float = 0.95
    collinear: float = 0.97
    invisible: float = 0.002
    effort: int = 40
    rounds: int = 4
    most_samples: int = 100_000
    little: float = 0.2
    repeats: float = 0.05
    outweighs: float = 1.0
    repeats_rough: float = 0.005
    bias: float = 0.02
    rounding: float = 1.0
    noise: NoiseSettings = NoiseSettings()
    spread: SpreadSettings = SpreadSettings()
    wander: WanderSettings = WanderSettings()
    scatter: ScatterSettings = ScatterSettings()
    screening: ScreeningSettings = ScreeningSettings()
    outliers: OutlierSettings = OutlierSettings()
    baseline: BaselineSettings = BaselineSettings()

    def __repr__(self) -> str:
        """What differs from the defaults."""
        own = [f"{f.name}={getattr(self, f.name)!r}" for f in dc.fields(self) if getattr(self, f.name) != f.default]
        return f"SelectionSettings({', '.join(own)})"

    @property
    def level_each(self) -> float:
        """Level of each of the three statistics of the lack of fit (Bonferroni)."""
        return self.level / 3.0

    def is_significant(self, difference: float, error: float) -> bool:
        """Whether a paired difference of cross-validated deviance, with its standard error, is beyond chance."""
        return difference >= self.significant and difference >= self.standard_errors * error

    def is_beaten(self, difference: float, error: float) -> bool:
        """Whether a model so much worse is rejected: significantly worse, or decisively."""
        return difference >= self.decisive or self.is_significant(difference, error)


DEFAULT = SelectionSettings()
