"""From `unexplained` to `explained` by an effect of one's own: writes the tutorial with its figures and numbers.

    python -m docs.own_effect -o docs/own-effect
"""

import argparse
from pathlib import Path

from ddetumble import check_effect, discover, find_data, read_campaign
from ddetumble.figures import draw_fit, draw_missing_shape, render_png
from ddetumble.inference.models import list_effects


CAMPAIGN = "impact-f"
HERE = Path(__file__).resolve().parent
TRIES = (("own-effect/rim_stop.py", "a plain spring beyond a depth"), ("end_stop.py", "Hertz's power beyond a depth"))


def write_row(found, text: str) -> str:
    """One line of the ledger."""
    last = found.steps[-1]
    return (f"| {text} | {found.verdict} | {last.chi2_reduced:.2f} | {100 * last.nrmse:.2f} % | "
            f"{100 * last.heldout_nrmse:.2f} % | {100 * found.noise_nrmse:.2f} % |")


def read_code(path: Path) -> str:
    """Imports and class in a file of an effect, as text."""
    text = path.read_text(encoding="utf-8")
    return text[text.index("from typing"):].rstrip()


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    given.output.mkdir(parents=True, exist_ok=True)
    campaign = read_campaign(find_data() / CAMPAIGN)
    first = discover(campaign)
    if first.missing is None:
        raise SystemExit(f"{CAMPAIGN} is {first.verdict}, and there is no missing force to draw")
    (given.output / "missing-force.png").write_bytes(render_png(draw_missing_shape(first.missing)))
    rows, sentences, found, own = [write_row(first, "the catalogue alone")], [], first, []
    for file, text in TRIES:
        own = list_effects(HERE / file)
        for one in own:
            check_effect(one).require()
        found = discover(campaign, effects=own)
        rows.append(write_row(found, text))
        sentences.append(found.sentence)
    models = {"reference model": found.steps[0].traces, f"with {own[0].id}": found.steps[-1].traces}
    (given.output / "fit.png").write_bytes(render_png(draw_fit(models, count=4)))
    lines = [
        "# From a misfit that nothing in the catalogue explains to a law of your own", "",
        "Made by `python -m docs.own_effect -o docs/own-effect`: text, numbers and figures.", "",
        f"**1. Ask.** `ddetumble discover {CAMPAIGN} -o discovery` answers:", "", f"> {first.sentence}", "",
        "**2. Look at the force that is missing.** It was fitted inside the equation of motion, whatever its shape "
        f"(`ddetumble missing {CAMPAIGN}` draws it by itself):", "", "![missing force](missing-force.png)", "",
        "Nothing up to some 6 mm, then a force that rises, loading and unloading alike: something sits there that "
        "is touched late, and gives back what it takes.", "",
        "**3. Write it.** `ddetumble effects --new rim-stop -o mine` writes an effect that works and the test of its "
        "contract. Give it a law; a first guess is a spring:", "", "```python", read_code(HERE / TRIES[0][0]), "```",
        "",
        "**4. Try it.**", "", "```sh", "pytest mine", f"ddetumble discover {CAMPAIGN} --effects-from mine/rim_stop.py",
        "```", "", f"> {sentences[0]}", "",
        "**5. Believe the verdict, not the gain.** The list of simple laws beside the picture has a power near 3/2, "
        "that of two curved bodies (Hertz):", "", "```python", read_code(HERE / TRIES[1][0]), "```", "",
        f"> {sentences[1]}", "", "![fit](fit.png)", "", "**The error at each step:**", "",
        "| what was tried | verdict | chi-square / dof | error | held-out error | noise |", "| --- | --- | --- | --- | "
        "--- | --- |", *rows, ""]
    (given.output / "README.md").write_text("\n".join(lines), encoding="utf-8")
    print("\n".join(rows))


if __name__ == "__main__":
    main()
