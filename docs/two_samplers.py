"""emcee and NUTS on the same fits: `python -m docs.two_samplers -o fits/two-samplers`.

emcee has each record's nuisances integrated out, NUTS samples them along with the parameters; so that their agreement
tests the integral as well. Writes `result.json` and `README.md`.
"""

import argparse
from pathlib import Path

from ddetumble import sample
from ddetumble.inference.files import list_versions, write_json
from docs.slip_posterior import compare


ROOT = Path(__file__).resolve().parent.parent
FITS = ("restitution-mass", "friction-constants")


def study(name: str) -> dict:
    """Both samplers on one specified fit."""
    file = ROOT / "fits" / name / "fit.toml"
    emcee = sample(file, effective=3000)
    nuts = sample(file, sampler="nuts", effective=2000, burn=200, block=250)
    return {"fit": name, "records": len(emcee.target.parts), "emcee": emcee.to_dict(), "nuts": nuts.to_dict(),
            "compared": compare(emcee, nuts)}


def describe(found: list[dict]) -> str:
    """README of the folder."""
    lines = ["# Two samplers, one posterior", "", "Made by `python -m docs.two_samplers -o fits/two-samplers`. emcee "
             "integrates every record's nuisances out; NUTS (numpyro) samples them with the parameters.", "",
             "| fit | records | parameter | emcee: mean, sd | NUTS: mean, sd | difference of means [its error] | "
             "sd over sd |", "| --- | --- | --- | --- | --- | --- | --- |"]
    for one in found:
        for row in one["compared"]:
            a, b = (one[which]["parameters"][row["name"]] for which in ("emcee", "nuts"))
            lines.append(f"| {one['fit']} | {one['records']} | {row['name']} | {a['mean']:.6g}, {a['sd']:.3g} | "
                         f"{b['mean']:.6g}, {b['sd']:.3g} | {row['difference']:+.1f} | {row['ratio']:.3f} ± "
                         f"{row['ratio_error']:.3f} |")
    lines.append("")
    for one in found:
        a, b = one["emcee"], one["nuts"]
        lines.append(f"- {one['fit']}: emcee {a['state']}, R-hat {a['rhat']:.4f}, {a['effective']:.0f} independent "
                     f"draws; NUTS {b['state']}, R-hat {b['rhat']:.4f}, {b['effective']:.0f} independent draws, "
                     f"{b['statistics']['divergences']} divergences.")
    return "\n".join([*lines, ""])


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, required=True)
    given = parser.parse_args()
    found = [study(name) for name in FITS]
    given.output.mkdir(parents=True, exist_ok=True)
    write_json(given.output / "result.json", {"fits": found, "versions": list_versions()})
    text = describe(found)
    (given.output / "README.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
