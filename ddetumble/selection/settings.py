"""Thresholds that decide a verdict, each with its reason; a result keeps those it was made with."""

import dataclasses as dc

from ..measurement.faults import ScreeningSettings


@dc.dataclass(frozen=True)
class OutlierSettings:
    """When a record counts as an outlier, and when a data error explains it.

    Attributes:
        p_value: of a record's lack of fit, over all records together, below which it is no chance: far below the level
            of a verdict, as a record that is left out is lost to every verdict.
        adequate: p-value above which the other records count as fitted well without it.
        factor: excess of its mean square over that of any other, where the model lacks something too.
        far: the same where no condition can switch an effect on, and for a gain that no neighbour shares.
        fewest: records with which one can be judged: two against one.
        farther: excess over that of the others with so few records.
        clear: mean square, in noise variances, that it has at least.
        one_in: at most one record in so many is left out.
        same: share by which values of neighbours may differ and count as the same.
        every: records of which every one is left out in turn; of more, the worst and the one that bends the fit most.
        candidates: worst records of more than `every` that are left out in turn.
        removed: share of a misfit that leaving out one record has to remove before the search is repeated without it.
        fits: p-value above which a record fits with a data error corrected.
        small: the same as an excess: below one noise variance no plot shows it.
        wide: standard deviations of a sample that is off by itself.
        few: largest share of a record's samples that may be off.
        close: share by which the first guess of a ratio of units may be off.
        kinematic_slack: the same for rates of rotation against Euler's equations, before any fit.
        kinematic_spread: share by which the other records' ratios may differ there.
        kinematic_noise: share of the changes of rates that Euler's equations may leave there.
    """

    p_value: float = 1e-5
    adequate: float = 0.01
    factor: float = 3.0
    far: float = 100.0
    fewest: int = 3
    farther: float = 1000.0
    clear: float = 4.0
    one_in: int = 4
    same: float = 0.03
    every: int = 6
    candidates: int = 3
    removed: float = 0.5
    fits: float = 1e-3
    small: float = 1.0
    wide: float = 6.0
    few: float = 0.03
    close: float = 0.25
    kinematic_slack: float = 0.06
    kinematic_spread: float = 0.1
    kinematic_noise: float = 0.2


@dc.dataclass(frozen=True)
class BaselineSettings:
    """When the baseline of a channel (offset and drift) counts as another in every record.

    Attributes:
        p_value: of what free baselines remove, and of readings before first touch.
        removed: share of the misfit that they have to remove where the readings before first touch show them.
        removed_unseen: the same where nothing but the fit says so.
        common: standard errors of the mean over records, from which on a baseline is the same in all: that may be
            physics.
        explained: share of the baselines' scatter that conditions may explain: more may be physics.
        significant: standard errors of a record's own baseline; at least half the records have to show one.
        fewest: records.
        samples: before first touch that tell a baseline.
    """

    p_value: float = 1e-4
    removed: float = 0.6
    removed_unseen: float = 0.9
    common: float = 4.0
    explained: float = 0.5
    significant: float = 4.0
    fewest: int = 4
    samples: int = 3


@dc.dataclass(frozen=True)
class SelectionSettings:
    """What decides a verdict of `discover`.

    Differences of cross-validated deviance are in noise variances: a parameter that does nothing changes it by about
    one, so that 9 is a difference of three standard deviations, and 50 one that no unknown correlation of the noise
    turns.

    Attributes:
        level: probability of calling a complete model incomplete, shared by the three statistics of the lack of fit.
        significant: difference of cross-validated deviance that is not chance, and the penalty of a parameter.
        decisive: difference that decides whatever its standard error.
        most_effects: effects that are added at most: with more, nearly any records can be fitted.
        finalists: candidates that are fitted to the end: those that predict best.
        further_finalists: beside them, of those that fit better and predict worse.
        better_fit: share of the misfit that the best removes, by which another has to remove more to stay in doubt.
        majority: share of the conditions that an addition has to predict better where the gain is not significant over
            their scatter.
        screening_samples: samples of a record on which candidates are screened.
        screening_steps: Gauss-Newton steps of a screening fit.
        strayed: typical changes that a parameter has moved from its guess, from which on fits start from the guess too.
        same_fit: drop of chi-square, to the end of a fit, within which its lack of fit is not judged again.
        early: share of a left-out record that gives what it starts from, where records run on from where they start.
        bootstrap: draws of the parametric bootstrap of the score statistic of few long records.
        certain: p-value of the smooth misfit below which one effect that removes all of it is no imitation.
        imitation: share of what one unlisted force gains below which effects together only imitate it.
        effects_before_rivals: additions before the other reference models are tried: three make up for nearly any
            wrong one.
        rival_references: other reference models that are searched, those that fit best by themselves: each takes as
            long as the first.
        farthest_reference: times the misfit of the model that was asked for, beyond which another is no rival.
        same_reference: relative difference of chi-square within which two reference models are one.
        largest_part: share of a misfit from which an effect removes most of it.
        shown: standard errors of an amplitude that would have been found.
        power: probability with which the smallest detectable amplitude is found.
        collinear: |cosine| of two signatures from which on they cannot be told apart.
        invisible: share of its signature below which an effect cannot be identified.
        rounds: of leaving out faulty records and beginning again, at most.
        most_samples: that are searched: hundreds of fits to them take some ten minutes.
        screening, outliers, baseline: what counts as a fault of the data.
    """

    level: float = 0.01
    significant: float = 9.0
    decisive: float = 50.0
    most_effects: int = 3
    finalists: int = 5
    further_finalists: int = 2
    better_fit: float = 0.25
    majority: float = 0.6
    screening_samples: int = 768
    screening_steps: int = 8
    strayed: float = 3.0
    same_fit: float = 1.0
    early: float = 0.25
    bootstrap: int = 4000
    certain: float = 1e-6
    imitation: float = 0.5
    effects_before_rivals: int = 2
    rival_references: int = 2
    farthest_reference: float = 4.0
    same_reference: float = 1e-6
    largest_part: float = 0.8
    shown: float = 4.5
    power: float = 0.95
    collinear: float = 0.97
    invisible: float = 0.002
    rounds: int = 4
    most_samples: int = 100_000
    screening: ScreeningSettings = ScreeningSettings()
    outliers: OutlierSettings = OutlierSettings()
    baseline: BaselineSettings = BaselineSettings()

    @property
    def level_each(self) -> float:
        """Level of each of the three statistics of the lack of fit (Bonferroni)."""
        return self.level / 3.0

    def is_significant(self, difference: float, error: float) -> bool:
        """Whether a paired difference of cross-validated deviance, with its standard error, is beyond chance."""
        return difference >= self.significant and difference >= 2.0 * error

    def is_beaten(self, difference: float, error: float) -> bool:
        """Whether a model so much worse is rejected: significantly worse, or decisively."""
        return difference >= self.decisive or self.is_significant(difference, error)


DEFAULT = SelectionSettings()
