"""Draw the pictures of README.md from a shipped campaign and a shipped scenario: `python -m docs.make_images`, from the
repository's root.
"""

import io
from pathlib import Path

import ddetumble as dd
from ddetumble import discover, find_data
from ddetumble.figures import draw_error_by_step, draw_fit, draw_ranking, draw_signatures, render_png
from ddetumble.figures.planning import draw_motion
from ddetumble.reports.plan import follow_plan


CAMPAIGN = "impact-b"
SCENARIO = "fast-coning"
FOLDER = Path(__file__).resolve().parent / "images"
DPI = 110
GAP = 30  # between figures [pixels]


def main() -> None:
    """Discover, compare, plan, draw, and write `discovery.png`, `ranking.png`, `signatures.png` and `plan.png`."""
    compare_by_hand()
    found = discover(find_data() / CAMPAIGN)
    models = {"reference model": found.steps[0].traces}
    if found.effects:
        models[f"with {' and '.join(found.effects)}"] = found.steps[-1].traces
    FOLDER.mkdir(exist_ok=True)
    write_picture([draw_fit(models, count=4)], FOLDER / "discovery.png")
    steps = draw_error_by_step(found)
    write_picture([draw_ranking(found.candidates, found.effects), steps], FOLDER / "ranking.png")
    print(found.sentence)
    planned = dd.plan(find_data() / "scenarios" / f"{SCENARIO}.toml")
    write_picture([draw_motion(*follow_plan(planned.problem, planned.sequence), planned.sequence.instants)],
                  FOLDER / "plan.png")
    print(planned)


def compare_by_hand() -> None:
    """README's loop by hand: what each step changes of the paper's model, beside what that one leaves."""
    campaign, model = dd.read_campaign(find_data() / "impact-h"), dd.Ball()
    wall = model + dd.effects.WallStiffness()
    steps = dd.compare(campaign, model, wall, wall + dd.effects.ArmServo())
    print(steps)
    traces = {name: one.traces for name, one in zip(steps.names, steps, strict=True)}
    write_picture([draw_signatures(traces, "normal_force", count=2)], FOLDER / "signatures.png")


def write_picture(figures, path: Path) -> None:
    """Write figures below each other as one picture."""
    from PIL import Image

    parts = [Image.open(io.BytesIO(render_png(figure, DPI))).convert("RGB") for figure in figures]
    size = max(part.width for part in parts), sum(part.height for part in parts) + GAP * (len(parts) - 1)
    whole = Image.new("RGB", size, "white")
    top = 0
    for part in parts:
        whole.paste(part, (0, top))
        top += part.height + GAP
    whole.save(path, optimize=True)
    print(f"{path.name}: {whole.width} x {whole.height} pixels, {path.stat().st_size / 1024:.0f} KiB")


if __name__ == "__main__":
    main()
