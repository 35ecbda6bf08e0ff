"""Draw the pictures of README.md from a shipped campaign: `python -m docs.make_images`, from the repository's root."""

import io
from pathlib import Path

from ddetumble import discover, find_data
from ddetumble.figures import draw_fit, draw_ledger, draw_ranking, render_png


CAMPAIGN = "impact-b"
FOLDER = Path(__file__).resolve().parent / "images"
DPI = 110
GAP = 30  # between figures [pixels]


def main() -> None:
    """Discover, draw, and write `discovery.png` and `ranking.png`."""
    found = discover(find_data() / CAMPAIGN)
    models = {"reference model": found.steps[0].traces}
    if found.effects:
        models[f"with {' and '.join(found.effects)}"] = found.steps[-1].traces
    FOLDER.mkdir(exist_ok=True)
    write_picture([draw_fit(models, count=4)], FOLDER / "discovery.png")
    write_picture([draw_ranking(found.candidates, found.effects), draw_ledger(found)], FOLDER / "ranking.png")
    print(found.sentence)


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
