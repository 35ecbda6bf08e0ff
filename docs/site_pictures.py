"""Draw the pictures of the documentation: `python -m docs.site_pictures [catalogue] [gallery]`.

Of the catalogue, each effect's signature in a shipped campaign (minutes); of the gallery, what its own blocks of code
draw, run as they are printed.
"""

import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

import ddetumble as dd
from ddetumble.contact.effect import is_scored
from ddetumble.figures.palette import AFTER, BEFORE, GREY
from ddetumble.figures.style import dress, head_figure, key_line, new_figure, render_png, styled
from ddetumble.inference.assembly import default_starts, guess_start
from ddetumble.measurement.quantities import describe_quantity
from ddetumble.selection.detectability import find_size, reach_limit
from ddetumble.selection.problem import SelectionProblem, pose_selection


FOLDER = Path(__file__).resolve().parent
CAMPAIGNS = ("impact-b", "slip-a", "oblique-a", "tumble-c")  # one of each family; they have what effects ask for
STRENGTH = 3.0  # rms over the noise that an effect as drawn leaves a refitted model: plain to see
DPI = 100


class Seen(NamedTuple):
    """An effect in the record that shows most of it."""

    effect: str
    size: str  # of its amplitude
    visible: float  # share of the signature that no refit imitates
    channel: str
    abscissa: str
    place: np.ndarray  # abscissa of the samples
    model: np.ndarray  # reference model, the same with the effect, and the part of their difference that is left
    grown: np.ndarray
    left: np.ndarray


def see_effects(campaign: dd.Campaign) -> Iterator[Seen]:
    """What the effects of the catalogue do to the records of a campaign, each at its first start."""
    model = dd.inference.resolve_model("paper", dd.families.name_family(campaign)).reference
    posed = pose_selection(campaign, model)
    start = guess_start(campaign, posed.space, posed.start, posed.base)
    solution = posed.problem.solve(posed.base, start, moving=False)
    weights = np.asarray(posed.records.stack.weights)[: posed.records.count]
    goal = STRENGTH * float(np.sqrt((weights > 0).sum()))
    assert campaign.independent is not None
    for effect in dd.effects.catalogue(dd.families.name_family(campaign)):
        if effect in posed.catalogue:
            yield see_effect(posed, solution, weights, effect, goal, campaign.independent.name)


def see_effect(posed: SelectionProblem, solution, weights, effect, goal: float, abscissa: str) -> Seen:
    """One effect where it shows most, at a size that leaves the wanted length, or as near as physics allows."""
    p = next(p for p in dd.effects.parameters_of(effect) if is_scored(p))
    name, u = f"{effect.id}.{p.name}", solution.u.copy()
    for shape, value in default_starts(effect)[0].items():
        if posed.space.parameter(shape).kind == "shape":
            u[posed.space.index[shape]] = value
    found = find_size(posed.problem, solution, u, name, goal)
    if found is None:
        raise SystemExit(f"{effect.id} changes nothing in {posed.campaign.name}")
    # Where no size would leave so much, the one that was tried last is the farthest that physics allows.
    value = found.size if np.isfinite(found.size) else p.default + (p.sign or 1) * reach_limit(p)
    u[posed.space.index[name]] = value
    moved = posed.problem.solve([], u, solution.z, moving=False)
    records = posed.records
    left = (found.length * found.column).reshape(records.count, -1)[:, : weights[0].size].reshape(weights.shape)
    change = (moved.channels - solution.channels)[: records.count] * weights
    record, channel = np.unravel_index(np.argmax(np.sum(change * left, axis=2)), left.shape[:2])
    inside = weights[record, channel] > 0
    shown = posed.space.public(name, u, 0.0)["estimate"]
    unit = posed.space.unit(name, u)
    return Seen(effect.id, f"{p.name} = {shown:.3g} {unit if unit != '1' else ''}".strip(), found.visible,
                records.channels[channel], abscissa,
                np.asarray(records.stack.time)[record][inside], solution.channels[record, channel][inside],
                moved.channels[record, channel][inside],
                left[record, channel][inside] / weights[record, channel][inside])


@styled
def draw_seen(seen: Seen):
    """Two panels: a record without and with the effect, and their difference beside what no refit imitates of it."""
    along = describe_quantity(seen.abscissa, seen.place)
    of = describe_quantity(seen.channel, seen.model)
    x, figure = along.scale * seen.place, new_figure(2.5, 7.2)
    left, right = figure.subplots(1, 2)
    for axes in (left, right):
        dress(axes).set_xlabel(along.label)
    left.plot(x, of.scale * seen.model, color=GREY, lw=1.4)
    left.plot(x, of.scale * seen.grown, color=AFTER, lw=1.6)
    left.set_ylabel(of.label)
    right.axhline(0.0, color=GREY, lw=0.8)
    right.plot(x, of.scale * (seen.grown - seen.model), color=AFTER, lw=1.4)
    right.plot(x, of.scale * seen.left, color=BEFORE, lw=1.6)
    right.set_title(f"visible share {100 * seen.visible:.2g} %")
    left.set_title(seen.size)
    head_figure(figure, [key_line(GREY), key_line(AFTER), key_line(BEFORE)],
                ["reference model", "with the effect; its signature", "of it what no refit imitates"])
    return figure


def draw_catalogue() -> None:
    """A picture for every effect of the catalogue."""
    folder = FOLDER / "catalogue"
    folder.mkdir(exist_ok=True)
    for name in CAMPAIGNS:
        for seen in see_effects(dd.read_campaign(name)):
            (folder / f"{seen.effect}.png").write_bytes(render_png(draw_seen(seen), DPI))
            print(f"{seen.effect}: {seen.size}, visible share {seen.visible:.3g}")


def draw_gallery() -> None:
    """Run the blocks of the gallery in its own folder, where each leaves its picture."""
    text = (FOLDER / "gallery.md").read_text(encoding="utf-8")
    folder = FOLDER / "gallery"
    folder.mkdir(exist_ok=True)
    os.chdir(folder)
    exec("\n".join(re.findall(r"^```python\n(.*?)^```", text, re.M | re.S)), {})


def shrink(folder: Path) -> None:
    """Keep 48 colours of every picture, a quarter of its size: they are kept in the repository."""
    for path in folder.glob("*.png"):
        Image.open(path).convert("RGB").quantize(48).save(path, optimize=True)


if __name__ == "__main__":
    for part in sys.argv[1:] or ("catalogue", "gallery"):
        {"catalogue": draw_catalogue, "gallery": draw_gallery}[part]()
        shrink(FOLDER / part)
