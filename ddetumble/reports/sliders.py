"""Sliders of a page: what effects would do to the reference model, without a server."""

import base64
import dataclasses as dc
import json

import markupsafe
import numpy as np

from ..inference.files import make_plain
from ..measurement.quantities import describe_quantity
from ..measurement.units import si_unit
from ..selection.preview import Preview
from .page import Section, read_template, read_text


def show_sliders(preview: Preview) -> Section:
    """A slider for every parameter of the reference model and every amplitude of an effect."""
    along = describe_quantity(preview.abscissa, [float(place[-1]) for place in preview.places],
                              si_unit(preview.abscissa))
    drawn = describe_quantity(preview.channel, np.concatenate(preview.measured), preview.unit)
    data = {
        "campaign": preview.campaign, "model": preview.model, "effects": preview.effects,
        "abscissa": along.label, "drawn": drawn.label, "left": dc.replace(drawn, name="residual").label,
        "total": float(preview.chi2.sum()), "levers": [vars(one) for one in preview.levers],
        "records": [{
            "key": key, "samples": int(preview.samples[r]), "chi2": float(preview.chi2[r]),
            "slope": preview.slope[r], "square": preview.square[r].ravel(),
            "place": _pack(along.scale * preview.places[r]), "measured": _pack(drawn.scale * preview.measured[r]),
            "fitted": _pack(drawn.scale * preview.fitted[r]), "change": _pack(drawn.scale * preview.changes[r]),
        } for r, key in enumerate(preview.keys)],
    }  # fmt: skip
    # As few digits as chi-square needs, and nothing that could end the script.
    text = json.dumps(_round(make_plain(data))).replace("<", "\\u003c")
    html = read_template("sliders.html").render(levers=preview.levers, data=text, script=read_text("sliders.js"))
    following = " and ".join([*["initial rates"] * preview.has_starts,
                              *["settings, within their stated uncertainty,"] * preview.has_settings]).rstrip(",")
    return Section("Try an effect by hand", [
        f"Move a slider, and see what the effect would do to the {drawn.name} of a record: "
        "points are measured, grey is the fitted reference model, orange what the sliders make of it; below, what is "
        f"left of the reading.{f' With it move every record’s {following}.' if following else ''} This is a preview "
        "from derivatives: where it is off by more than a tenth of the noise half way to the end, the slider says so. "
        "The command below fits what is shown.",
        markupsafe.Markup(html)])  # made of escaped parts


def _pack(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode()


def _round(value):
    """Numbers with nine digits."""
    if isinstance(value, dict):
        return {key: _round(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_round(one) for one in value]
    return float(f"{value:.9g}") if isinstance(value, float) else value
