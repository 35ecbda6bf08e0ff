"""The page of a joint fit or of a population: the answer, estimates side by side, the tables."""

from pathlib import Path

from ..figures import draw_forest
from ..inference.joint import JointFit
from ..inference.population import PopulationFit
from ..measurement.quantities import clean, join_words
from .page import Section, Table, draw_picture, write_page


def report_joint(result: JointFit | PopulationFit, folder) -> Path:
    """Write the page of a joint fit or of a population, and its figure; returns its path.

    Raises:
        InputError: The folder cannot be written.
    """
    caption = "Every line is a 95 % interval; the band is that of all together."
    picture = draw_picture("estimates", caption, draw_forest, result.intervals)
    tables = [Table(rows[0], rows[1:]) for rows in result.tables]
    names = result.singles if isinstance(result, JointFit) else result.specimens
    return write_page(clean(join_words(names), 110), clean(result.sentence, 600), [
        Section("Estimates", figures=[picture], tables=tables, points=[clean(note, 400) for note in result.notes])],
        folder)
