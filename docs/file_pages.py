"""Write `docs/scenario.md` and `docs/fit.md`, every key of the files that users write: `python -m docs.file_pages`.

The keys, defaults and their meaning are read off `ddetumble.planning.scenario_file` and
`ddetumble.inference.specification`, so that the pages cannot differ from what is checked.
"""

import sys
from pathlib import Path

from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from ddetumble.inference import specification
from ddetumble.planning import scenario_file as scenario


FOLDER = Path(__file__).resolve().parent
SCENARIO = (("", scenario.Scenario), ("debris", scenario.DebrisTable), ("ball", scenario.BallTable),
          ("arm", scenario.ArmTable), ("limits", scenario.LimitTable), ("goal", scenario.GoalTable),
          ("errors", scenario.ErrorTable), ("uncertainty", scenario.UncertaintyTable),
          ("uncertainty.parameters.NAME", scenario.SpreadTable))
FIT = (("", specification.Specification), ("sampler", specification.Sampler), ("priors.NAME", specification.Prior))
BEFORE_FIT = """\
# What a `fit.toml` may say

Made by `python -m docs.file_pages`. One TOML file says everything about a fit and gives the same result wherever it is:
`ddetumble fit FILE.toml`, `ddetumble sample FILE.toml -o DIR`, `dd.fit("FILE.toml")`. Results of a fit go beside it.
Numbers are in the units that `ddetumble effects` and `ddetumble models` show. A name with a dot (`wall-stiffness.q`)
needs quotes, or a table of its own. Keys that are not listed are refused, with their name.

```toml
schema = "ddetumble.fit/1"
title = "A wall with a free exponent"
campaign = "impact-h"
effects = ["arm-servo", "wall-stiffness"]

[free]
"wall-stiffness.q" = 1.5      # starts there; `true` starts at the default

[fixed]
outer_diameter = 0.060        # m

[priors]
restitution = { mean = 0.7, sd = 0.05 }

[bounds]
"wall-stiffness.k_w" = [0.0, 1e5]
```
"""
BEFORE_SCENARIO = """\
# What `ddetumble plan` reads and writes

Made by `python -m docs.file_pages`. A scenario is one TOML file; numbers are SI, angles in degrees where the key
says so; a text with a unit does as well (`"3 deg/s"`, `"12 cm"`, `"76 N"`), in a list for all of its values that are
not zero, or for none. Keys that are not listed are refused, with their name. The smallest scenario:

```toml
schema = "ddetumble.plan/1"

[debris]
angular_velocity = [0.05, 0.0, 0.02]
```

What a plan takes for granted: the body is rigid, convex and free. The arm's velocity and the direction to the chaser
are in the frame in which the debris' centre of mass rests: after an impact the chaser follows the drift, which
`plan.json` states. The ball alone must keep clear of the rest of the body, not the arm behind it. A ball that reaches
over an edge is left out: the contact disc keeps `limits.edge` from every edge. The arm pushes with its apparent mass;
it drives the ball as well where the fitted model holds `arm-servo`. `plan_for = "mean"` and `"tail"` plan each impact
of a sequence for itself.
"""
AFTER_SCENARIO = """\
## `plan.json`

| key | meaning |
| --- | --- |
| `schema` | `ddetumble.plan-result/2` |
| `scenario`, `title`, `version` | file, its title, version of ddetumble |
| `sentence` | the answer in words |
| `possible`, `reached` | whether any impact helps, null if the search failed; whether `wanted_share` is reached |
| `wanted_share`, `share_left`, `axial_share` | of the angular momentum: wanted, left, what no normal force can take |
| `goal` | what was wanted small: its name, its value `before` and `after`, `share_left` of it |
| `within` | `measured` where the plan stays within what was measured |
| `share_left_beyond` | of the momentum, by the plan that need not; that in `goal` is of the goal |
| `impulse`, `duration` | sizes of all contact impulses added up [N s]; from time 0 to the last separation [s] |
| `fewest_impacts` | lower bound on their number; null where none can be given |
| `joint` | what optimising all impacts jointly made of it (`taken`), or one impact less would leave; with `prices` |
| `relaxations` | limits each of which, looser, would allow an impact worth its while, the first or a further one |
| `impacts` | a row each: place, instant, velocity, pressure, peak, impulse, momentum and rates after, certificate |
| `refused` | the best further impact, where it is not allowed or not worth its while |
| `contact` | what strikes: fits by folder, all parameters; `assumed`: by key what nothing says |
| `measured` | values over which the ball's fits were measured; empty for the paper's ball |
| `misfits` | the ball's fits that leave significantly more than the noise of their own campaign; `ratio`: how much |
| `doubts` | sizes in the scenario that no debris, ball or arm is expected to have, with what is expected, SI |
| `prices` | what an impact would gain by looser limits, in shares of the goal at the start; of all together: `joint` |
| `rules` | a straight blow and the paper's rule at the place of the first impact: what they leave |
| `errors` | what errors of arm and motion make of the first impact, each alone and all together |
| `errors_after` | what all errors together leave after every impact of a sequence |
| `uncertainty` | distribution of the momentum left, by model, and whether it matters which is true |

An impact's vectors: `point` is in body components; `arm_velocity`, `normal`, `impulse` and `angular_momentum` are
inertial; `angular_velocity` is in body components; `debris_velocity` is the drift that the impact gives, and
`chaser_velocity` the recoil of a chaser of the stated mass, if nothing else holds it. `certificate.stationarity` is
what is left of the gradient after the binding constraints' share, over the gradient; `gradient_error` its largest
difference from central differences; `finding` says what they amount to: `optimum`, `not an optimum` (more than 2 % of
the gradient is left), `nothing left` or `no limit holds`, where the gradient vanishes and both say nothing; `binding`
names the limits that hold the impact, with their multipliers. `limits_reached` names those that it keeps by less than 1
% (of an edge 1 mm), whether they cost anything or not. `extrapolated` lists what lies outside of `measured`.
`wanted_share` and `reached` are null where the goal is not the momentum and `goal.share` is the usual one. In `errors`
and `errors_after`, `raised` is the share of the draws that end with more momentum than there was before the first
impact, `untaken` the share in which none is taken, these among them; `goal` and `goal_q95` are of the goal what `mean`
and `q95` are of the momentum; `missed` and `violated` are of this impact, `ever_missed` and `ever_violated` of it or
any before. In `refused`, `estimate` is the least that closed forms see allowed, and `missed` says whether that is worth
its while: then the search has failed. In `joint`, `alone` lists the number, share left, impulse and duration of the
impacts planned one after the other. In `relaxations`, `key` is the scenario's, `given` its value, and `needed` one at
which such an impact was integrated, the tightest that was found.
"""


def show_default(field: FieldInfo) -> str:
    """The default as TOML has it; empty where the key is required."""
    value = field.default
    if value is PydanticUndefined:
        return "required"
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if value is None or value in ((), {}) or not isinstance(value, (str, int, float, tuple)):
        return ""
    if isinstance(value, tuple):
        return f"`[{', '.join(f'{x:g}' for x in value)}]`"
    return f'`"{value}"`' if isinstance(value, str) else f"`{value:g}`"


def list_keys(tables) -> list[str]:
    """Lines of the tables of all keys; `tables` are the names of TOML tables, the top one first, and what is read."""
    lines = []
    for name, table in tables:
        title = f"## `[{name}]`" if name else "## At the top"
        lines += [title, "", "| key | default | meaning |", "| --- | --- | --- |"]
        for key, field in table.model_fields.items():
            if name == "" and key in dict(tables):
                continue
            shown = field.alias or key
            meaning = (field.description or "").replace("|", chr(92) + "|")
            lines.append(f"| `{shown}` | {show_default(field)} | {meaning} |")
        lines.append("")
    return lines


def write_pages() -> dict[str, str]:
    """The pages, by name of their files."""
    return {"scenario.md": "\n".join([BEFORE_SCENARIO, *list_keys(SCENARIO), AFTER_SCENARIO]),
            "fit.md": "\n".join([BEFORE_FIT, *list_keys(FIT)])}


if __name__ == "__main__":
    for page, text in write_pages().items():
        (FOLDER / page).write_text(text, encoding="utf-8")
        sys.stdout.write(f"{page}\n")
