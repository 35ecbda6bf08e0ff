"""The whole story on shipped data: a table of the paper, a campaign with a hidden effect, a strike with the result."""

import shlex
from collections.abc import Callable, Iterable
from pathlib import Path

from ._settings import find_data


def run_demo(folder: Path | str, echo: Callable[[str], None] = print) -> Path:
    """Run the story, tell it line by line, and write the reports.

    Args:
        folder: where `discovery/report.html` and `plan/report.html` go; made if it is not there.
        echo: called with every line.

    Returns:
        Path of the discovery's report.
    """
    from .measurement.package import read_campaign
    from .reports import report as write_report
    from .selection.compare import compare
    from .selection.discover import discover

    def tell(lines: Iterable[str]) -> None:
        for line in lines:
            echo(f"   {line}")

    folder = Path(folder)
    echo("1. The paper's model beside the eleven peak forces that the paper printed (Table 3):")
    tell([compare(read_campaign(find_data() / "paper" / "table-3")).sentence,
          "What could explain them:  ddetumble discover paper/table-3",
          "Its contradictions, each with two numbers and a figure:  ddetumble paper"])
    echo("")
    campaign = read_campaign(find_data() / "impact-a")
    count = len(campaign.record_keys)
    echo(f"2. A campaign of {count} impacts ({campaign.name}), compared with the paper's model:")
    tell(str(compare(campaign)).splitlines()[:12])
    echo("")
    echo("3. Which effect is missing? Every effect of the catalogue is added in turn, refitted and cross-validated on "
         "left-out tests:")
    found = discover(campaign)
    tell(str(found).splitlines())
    found.save(folder / "discovery")
    report = write_report(found, folder / "discovery")
    echo("")
    quoted = shlex.quote(str(folder / "discovery"))
    echo(f"4. The extended model predicts other tests:  ddetumble predict {quoted} CONDITIONS.csv -o predictions.csv")
    echo("")
    echo("5. One strike with this ball on the stage of Table 6:")
    tell(_plan_one(folder, count))
    echo(f"Report: {report}")
    return report


def _plan_one(folder: Path, number: int) -> list[str]:
    """Plan a strike with the discovered model, this ball's impact of that number, and say how sure its effect is."""
    from .planning.measured import warn_of_extrapolation
    from .planning.plan import plan_scenario
    from .planning.scenario_file import BallTable, UncertaintyTable, read_scenario
    from .reports.plan import write_plan

    place = (folder / "discovery").resolve()
    ball = BallTable(model=str(place), conditions={"sequence": float(number)})
    scenario = read_scenario(find_data() / "scenarios" / "paper-case-2.toml").model_copy(
        update={"ball": ball, "uncertainty": UncertaintyTable()})
    found = plan_scenario(scenario, place, impacts=1, starts=2)
    if found.assessment is None:
        return [found.sentence]
    page = write_plan(found, folder / "plan")
    left = found.assessment.whole.share_left
    told = (f"It removes {100 * (1 - left.mean):.2f} ± {100 * left.sd:.2f} % of the angular momentum (90 % of the "
            f"draws: {100 * (1 - left.q95):.2f} to {100 * (1 - left.q05):.2f} %).")
    beyond = warn_of_extrapolation(found.ranges, found.impacts, found.problem.conditions)
    return [told, *found.assessment.sentences[1:], *filter(None, [beyond]), f"The page says where, how fast and when: "
                                                                            f"{page}"]
