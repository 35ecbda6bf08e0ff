"""The missing force in a report: the sentence, the pictures, the simple laws."""

from collections.abc import Sequence
from pathlib import Path

from .. import figures
from ..measurement.quantities import clean, describe_quantity, format_number, format_share, format_value
from ..selection.result import MissingForce
from .page import Section, Table, draw_picture, write_page


def write_missing(missing: MissingForce, folder, *, title: str, status: Sequence[str] = ()) -> Path:
    """Write what `draw_missing_force` returned as one self-contained page; `title` and `status` as of `write_page`.

    Raises:
        InputError: The folder cannot be written.
    """
    return write_page(title, missing.sentence, show_missing(missing, sentence=False), folder, "missing.html",
                      status=status)


def show_missing(missing: MissingForce, sentence: bool = True) -> list[Section]:
    """The sections of a missing force; `sentence` repeats its sentence where the page has another."""
    paragraphs = [missing.sentence] if sentence else []
    if not missing.shapes:
        return [Section("The missing force", paragraphs, points=missing.notes)]
    best = missing.shapes[0]
    spectrum = (", and the spectrum of the force (grey: two standard deviations of the noise)"
                if best.spectrum.shape[1] > 2 else "")
    pictures = [draw_picture(
        "missing-shape", "The missing force, fitted inside the equation of motion, with ± two posterior standard "
        "deviations, a simple law that describes it (dashed, where it holds for the same values of the model's "
        "parameters), and below, in grey, the density of the samples. Beside it: the share of the misfit of left-out "
        f"conditions that each explains{spectrum}.", figures.draw_missing_shape, missing,
        alt=f"Missing {clean(best.way)} over {clean(best.variable)}.")]
    if len(missing.shapes) > 1:
        pictures.append(draw_picture(
            "missing-rivals", "The same over the other variables that came close, each fitted alone, with the "
            "difference from the best in noise variances of left-out conditions.", figures.draw_missing_rivals,
            missing))
    rows = []
    for shape in missing.shapes:
        shown, error = describe_quantity(shape.variable, shape.x), shape.standard_error
        parts = f", {' and '.join(shape.parts)}" if shape.parts[0] else ""
        rows.append((
            clean(f"{shape.way} over {shape.variable}{parts}"), shape.intervals,
            format_share(missing.share(shape.loss)), "–" if shape.difference == 0 else
            f"{format_value(shape.difference, error)} ± {format_value(error, error)}", format_share(shape.visible),
            "–" if shape.begins is None else f"{format_number(shown.scale * shape.begins)} {shown.unit}".rstrip()))
    tables = [Table(
        ("force", "knots", "misfit explained", "difference from the best", "visible", "differs from zero from"), rows,
        "Non-parametric forces of one variable; differences are in noise variances of left-out conditions. Visible: "
        "the share of the force's own signature that the model's parameters and the settings cannot imitate.")]
    rows = []
    for k, law in enumerate(missing.laws):
        values = "; ".join(f"{n} = {format_value(e.estimate, e.sd)} ± {format_value(e.sd, e.sd)} {e.unit}".rstrip()
                           for n, e in law.parameters.items())
        behind = (f"{format_number(law.difference)} ± {format_number(law.standard_error)}",
                  format_number(law.chi2 - missing.laws[0].chi2)) if k else ("–", "–")
        rows.append((clean(law.text), clean(values, 300), "–" if missing.lone else
                     format_share(missing.share(law.loss)), *behind, "yes" if law.converged else "no"))
    if rows:
        tables.append(Table(
            ("simple law", "parameters (SI)", "misfit explained", "difference from the first", "fits worse by",
             "converged"),
            rows, "Laws that would describe it, fitted inside the equation of motion; differences are in noise "
            "variances. Of the laws that left-out conditions do not distinguish, the one that fits best comes first; "
            f"each parameter costs {missing.settings.significant:g}."))
    return [Section("The missing force", paragraphs, pictures, tables, missing.notes)]
