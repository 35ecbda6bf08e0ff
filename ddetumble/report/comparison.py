"""The report of a comparison: one model against the measurements, nothing added."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from ..figures.labels import clean
from ..selection.result import Place, Trace
from .findings import show_failures, show_fits
from .page import Section, write_page


def write_comparison(
    sentence: str,
    models: Mapping[str, Sequence[Trace]],
    folder,
    *,
    title: str = "Model against measurement",
    noise: Mapping | None = None,
    where: Sequence[Place] | None = None,
    status: Sequence[str] = (),
    facts: Sequence[tuple[str, str, str]] = (),
    sections: Sequence[Section] = (),
    name: str = "comparison.html",
) -> Path:
    """Write a comparison of one or two models with a campaign as a page; figures as PNG in `figures/` beside it.

    Args:
        sentence: the first thing on the page.
        models: traces by the model's name; of two, the simpler first.
        folder: where to write.
        title: of the page, shown by the browser.
        noise: by channel, as in `Discovery.noise`.
        where: places of the misfit; None where nobody looked for them.
        status: short facts for the line below the sentence, such as the campaign's name.
        facts: boxes of (what, value, remark).
        sections: further parts, after the figures.
        name: of the page's file.

    Returns:
        Path of the page.

    Raises:
        InputError: The folder cannot be written.
    """
    models = {clean(label, 60): traces for label, traces in models.items()}
    parts = [show_fits(models), show_failures(models, noise, where), *sections]
    return write_page(title, sentence, parts, folder, name, status=[clean(one, 120) for one in status], facts=facts)
