"""The report of a posterior: draws, parameters, checks against the records, left-out conditions, as one page."""

import math
from pathlib import Path

from .. import figures
from .._sentences import say
from ..measurement import quantities as q
from ..posterior.loo import WAYS
from ..posterior.predictive_check import STATISTICS
from ..posterior.result import Posterior
from ..posterior.target import CampaignTarget
from .coefficient import show_coefficients
from .page import Picture, Section, Table, flatten, write_page


HEADLINE = 105  # characters of intervals in the first sentence: two lines of a page


def write_posterior(posterior: Posterior, folder) -> Path:
    """Write what the draws of `sample` say, examined or not, as one page; returns its path.

    Raises:
        InputError: The folder cannot be written.
    """
    status = [q.clean(posterior.title, 120), f"{posterior.log_density.size} draws by {posterior.sampler}"]
    if isinstance(posterior.target, CampaignTarget):
        status.insert(1, f"{len(posterior.target.parts)} records")
    c = posterior.convergence
    facts = [("effective sample size", f"{c.effective:.0f}", "of the worst parameter"),
             ("R-hat", q.format_number(c.rhat, 4), "1 is perfect agreement")]
    if (checks := posterior.predictive) is not None:
        found = "fails" if checks.rejected else "nothing stands out"
        facts.append(("predictive check", found, q.say_p(checks.p_value)))
    if posterior.left_out is not None:
        facts.append(("left-out conditions", q.format_number(posterior.left_out.elpd, 5),
                      "expected log predictive density"))
    plain = posterior.to_dict()
    rows = [("sampler", posterior.sampler),
            *(row for key in ("settings", "statistics", "target", "versions") for row in flatten(plain[key]))]
    sections = [*(show(posterior) for show in (_show_parameters, show_coefficients, _show_priors, _show_predictive,
                                               _show_left_out, _show_chains)),
                Section("Provenance", tables=[Table(("item", "value"), rows)])]
    return write_page(f"Posterior: {posterior.title}", _say_posterior(posterior), [s for s in sections if s], folder,
                      badge="converged" if posterior.converged else "not converged", status=status, facts=facts)


def _say_posterior(posterior: Posterior) -> str:
    """The answer in one or two sentences: parameters that effects add first, as many as have room."""
    told = []
    names = sorted(posterior.parameters, key=lambda n: "." not in n)
    for name in names:
        p = posterior.parameters[name]
        unit = f" {q.clean(p.unit, 16)}" if p.unit not in ("", "1") else ""
        low, high = (q.format_value(end, p.sd) for end in (p.q025, p.q975))
        told.append(f"{q.clean(name if '.' in name else name.replace('_', ' '), 60)} {low} to {high}{unit}")
        if len(told) > 1 and len(q.join_words(told)) > HEADLINE:
            told.pop()
            break
    checks = posterior.predictive
    return say("posterior.intervals", told=told, rest=len(names) - len(told), converged=posterior.converged,
               checks=checks, p="" if checks is None else q.say_p(checks.p_value))


def _show_parameters(posterior: Posterior) -> Section:
    rows = [(q.clean(name, 60), *(q.format_value(x, p.sd) for x in (p.q50, p.sd, p.q025, p.q975)),
             q.clean(p.unit, 16) or "–", f"{q.format_value(p.fit, p.fit_sd)} ± {q.format_value(p.fit_sd, p.fit_sd)}",
             f"{p.effective:.0f}", f"{p.rhat:.3f}") for name, p in posterior.parameters.items()]
    header = ("parameter", "median", "sd", "2.5 %", "97.5 %", "unit", "fit", "effective sample size", "R-hat")
    caption = ("Marginals on the diagonal, with the 95 % interval dotted; below it, pairs with contours that hold 68 "
               "and 95 % of the draws. Dashed: the Gaussian that the fit reports. Where the two differ, rely on "
               "the draws.")
    hidden = len(posterior.parameters) - 10
    points = list(posterior.notes)
    if hidden > 0:
        points.append(f"The figures leave out {hidden} parameters; posterior.nc contains all.")
    picture = Picture("corner", caption, figures.draw_corner(posterior), f"Corner plot of {len(rows)} parameters.")
    tables = [Table(header, rows)]
    if posterior.derived:
        tables.append(Table(
            ("quantity", "median", "sd", "2.5 %", "97.5 %", "unit"),
            [(q.clean(name, 60), *(q.format_value(x, d.sd) for x in (d.q50, d.sd, d.q025, d.q975)),
              q.clean(d.unit, 16) or "–") for name, d in posterior.derived.items()],
            "What follows from the parameters."))
    return Section("Parameters", figures=[picture], tables=tables, points=points)


def _show_priors(posterior: Posterior) -> Section | None:
    found = posterior.prior
    if found is None:
        return None
    rows = []
    for name, one in found.parameters.items():
        middle, low, high = one.prior or (math.nan,) * 3
        told, first, last = (q.format_value(x, high - low) for x in (middle, low, high))
        prior = "–" if one.prior is None else f"{told} ({first} to {last})"
        unit = q.clean(posterior.parameters[name].unit, 16) or "–"
        rows.append((q.clean(name, 60), prior, unit, q.format_share(one.share) if one.prior is not None else "–",
                     f"{one.distance:+.1f}" if one.prior is not None else "–",
                     *((f"{one.moved:+.2f}", f"{one.widened:.2f}") if found.trusted else ("–", "–"))))
    header = ("parameter", "prior (95 %)", "unit", "share of the prior", "distance [sd]", "mean moves by [sd]",
              "sd times")
    caption = ("Share of the prior: of what is known about a parameter, what its prior gives. Distance: of the mean "
               "from that of the prior, in deviations that it would have by chance. The last two columns: what priors "
               "twice as wide would change.")
    pictures = []
    if found.replicates is not None and isinstance(posterior.target, CampaignTarget):
        pictures = [Picture("prior-predictive", "Records drawn from the priors alone, before any data, and those that "
                            "were measured.",
                            figures.draw_prior_predictive(found.replicates, posterior.target.fit.source.family),
                            "Measured records in the bands that the priors expect.")]
    return Section("What the priors do", [found.sentence], pictures, [Table(header, rows, caption)])


def _show_predictive(posterior: Posterior) -> Section | None:
    checks = posterior.predictive
    if checks is None or not isinstance(posterior.target, CampaignTarget):
        return None
    paragraphs = [checks.sentence, (
        f"For {checks.draws} draws of the parameters, and of each record's settings, replicated records were made with "
        "noise of the fitted size and correlation. A p-value is the probability of a replicate at least as extreme as "
        "the measurement; a small one means that the model does not produce such a record.")]
    caption = (f"Above: p-values of every record; below the grey edge a record stands out among {checks.comparisons} "
               "comparisons. Below: " + ("every record" if checks.replicates.are_values else
                                          "the two most unusual records and two others") +
               ", measured minus the mean of the replicates, over the range that contains 90 % of these.")
    picture = Picture("predictive", caption, figures.draw_predictive(checks, posterior.target.fit.source.family),
                      "P-values by record, and residuals of records over their replicates.")
    names = q.vary(one.conditions for one in checks.records)
    rows = [(q.clean(one.record, 30), q.describe_conditions(one.conditions, names), str(one.samples),
             *(cell for name, p_value in one.p_values.items()
               for cell in (q.format_number(getattr(one, name)), q.format_p(p_value))))
            for one in checks.records]
    marked = frozenset(i for i, one in enumerate(checks.records) if one.record in checks.outstanding)
    words = {"chi_square": "χ² / dof", "largest": "largest residual", "lag": "neighbours"}
    header = ("record", "conditions", "samples", *(cell for name in checks.records[0].p_values
                                                   for cell in (words[name], "p")))
    totals = ", ".join(f"{STATISTICS[name]} {q.say_p(value)}" for name, value in checks.totals.items())
    table = Table(header, rows, f"Marked records stand out individually. All records together: {totals}.", marked)
    return Section("Does the model produce such records?", paragraphs, [picture], [table])


def _show_left_out(posterior: Posterior) -> Section | None:
    scores = posterior.left_out
    if scores is None or len(scores.scores) < 2:
        return None
    names = q.vary(one.conditions for one in scores.scores)
    rows = [(q.describe_conditions(one.conditions, names) or q.clean(", ".join(one.records), 40), str(len(one.records)),
             f"{one.elpd:.2f}", f"{one.pareto_k:.2f}", WAYS[one.way], "yes" if one.trusted else "no")
            for one in scores.scores]
    error = scores.standard_error
    size = f" ± {q.format_value(error, error)}" if math.isfinite(error) else ""
    paragraphs = [
        f"The expected log predictive density of left-out conditions is {q.format_value(scores.elpd, error)}{size} "
        f"({scores.text}). The number is meaningful only in comparison with that of another model of the same campaign "
        "with the same noise, as `ddetumble average` makes it."]
    header = ("condition", "records", "log density", "Pareto k", "method", "reliable")
    caption = "Logarithm of the predictive density of the records of every condition, given all others."
    picture = Picture("left-out", caption, figures.draw_left_out([scores]),
                      f"Log predictive density of {len(rows)} conditions.")
    return Section("Left-out conditions", paragraphs, [picture], [Table(header, rows)])


def _show_chains(posterior: Posterior) -> Section:
    word = "ensemble" if posterior.x.shape[2] > 1 else "chain"
    pictures = [
        Picture("trace", "The draws in the order in which they were made: a converged chain is a level band without "
                "drift or steps.", figures.draw_traces(posterior)),
        Picture("ranks", f"Ranks of the draws of each {word} among all draws: uniform if they agree. The band is "
                "that of as many independent draws.", figures.draw_ranks(posterior)),
    ]
    share = posterior.statistics.get("accepted")
    told = f"; {q.format_share(share)} of the moves were accepted" if isinstance(share, float) else ""
    state = posterior.state[:1].upper() + posterior.state[1:]
    times = [(q.clean(name, 60), f"{time:.0f}", f"{size:.0f}", f"{rhat:.3f}") for name, time, size, rhat in zip(
        posterior.target.names, posterior.convergence.times, posterior.convergence.sizes, posterior.convergence.rhats,
        strict=True)]
    table = Table(("parameter", "autocorrelation time", "effective sample size", "R-hat"), times,
                  "Autocorrelation time: steps of a walker that are worth one independent draw.")
    return Section("The chains", [f"{state}{told}."], pictures, [table])
