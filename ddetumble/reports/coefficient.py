"""The coefficient that records are spoken of in, such as that of friction, with its band, as a part of a page."""

from .. import figures
from .._errors import ComputationError
from ..inference.findings import Fit
from ..measurement.quantities import describe_quantity
from ..posterior.result import Posterior
from ..selection.coefficient import trace_coefficients
from .page import Picture, Section


def show_coefficients(found: Fit | Posterior) -> Section | None:
    """The coefficient of a few records, with the band that a fit or a posterior leaves; None where they have none."""
    try:
        traced = trace_coefficients(found)
    except ComputationError as error:
        return Section("The coefficient along the record", [f"It could not be computed: {error}."])
    if traced is None:
        return None
    channel, load, along = (describe_quantity(name).name for name in (traced.channel, traced.load, traced.along))
    source = "covariance of the fit" if isinstance(found, Fit) else "draws"
    caption = (f"The {channel} over the {load}, as it is stated, of the records at the lowest, a middle and the "
               f"highest {load}; below, the difference from the model. The band is the 95 % interval of the model's "
               f"coefficient, from the {source}: neither noise nor the scatter of settings is in it.")
    picture = Picture("coefficient", caption, figures.draw_coefficients(traced),
                      f"The {traced.name} over {along}, with its band, of {len(traced.curves)} records.",
                      figures.draw_coefficients(traced, narrow=True))
    return Section(f"The {traced.name}", figures=[picture])
