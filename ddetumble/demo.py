"""The whole story on shipped data: the paper's tables, a campaign with a hidden effect, a strike with what was learnt.
"""

from collections.abc import Callable
from pathlib import Path

from ._settings import find_data


CAMPAIGN = "impact-a"
SCENARIO = "paper-case-2"


def run_demo(folder: Path | str, echo: Callable[[str], None] = print) -> Path:
    """Run the story, tell it line by line, and write the reports.

    Args:
        folder: where `paper/report.html`, `discovery/report.html` and `plan/report.html` go; made if it is not there.
        echo: called with every line.

    Returns:
        Path of the discovery's report.
    """
    from .measurement.package import read_campaign
    from .paper import judge_campaign, write_paper
    from .reports import report as write_report
    from .selection.compare import compare
    from .selection.discover import discover

    folder = Path(folder)
    echo("1. The paper. Its printed peaks, and what eleven numbers can say (Table 3):")
    echo("   " + judge_campaign(read_campaign(find_data() / "paper" / "table-3")).sentence)
    page = write_paper(folder / "paper", echo=lambda line: None)
    echo(f"   Its contradictions, each with two numbers and a figure: {page}")
    campaign = read_campaign(find_data() / CAMPAIGN)
    echo("")
    echo(f"2. A campaign of {len(campaign.record_keys)} impacts ({campaign.name}). The paper's model beside it:")
    for line in str(compare(campaign)).splitlines()[:12]:
        echo("   " + line)
    echo("")
    echo("3. Which effect is missing? Every one of the catalogue is added in turn, refitted and tried on left-out "
         "tests:")
    found = discover(campaign)
    for line in str(found).splitlines():
        echo("   " + line)
    found.save(folder / "discovery")
    report = write_report(found, folder / "discovery")
    echo("")
    echo("4. The grown model predicts other tests:  ddetumble predict "
         f"{folder / 'discovery'} CONDITIONS.csv -o predictions.csv")
    echo("")
    echo("5. One strike with this ball, on the stage of Table 6:")
    for line in plan_one(folder, len(campaign.record_keys)):
        echo("   " + line)
    echo(f"Report: {report}")
    return report


def plan_one(folder: Path, number: int) -> list[str]:
    """Plan one strike with the discovered model and say what it takes out, and how sure that is.

    Args:
        folder: of the story; the model is in `discovery`, the plan goes to `plan`.
        number: of the impact on this ball, for effects that know how often it was used.
    """
    from .planning.measured import list_extrapolations, warn_of_extrapolation
    from .planning.plan import plan_scenario
    from .planning.scenario import BallTable, UncertaintyTable, read_scenario
    from .reports.plan import write_plan

    place = (folder / "discovery").resolve()
    ball = BallTable(model=str(place), conditions={"sequence": float(number)})
    scenario = read_scenario(find_data() / "scenarios" / f"{SCENARIO}.toml").model_copy(
        update={"ball": ball, "uncertainty": UncertaintyTable()})
    found = plan_scenario(scenario, place, impacts=1, starts=2)
    if found.assessment is None:
        return [found.sentence]
    page = write_plan(found, folder / "plan")
    left = found.assessment.whole.momentum
    told = (f"It takes {100 * (1 - left.mean):.2f} ± {100 * left.sd:.2f} % of the angular momentum out (90 % of the "
            f"draws: {100 * (1 - left.q95):.2f} to {100 * (1 - left.q05):.2f} %).")
    beyond = warn_of_extrapolation(list_extrapolations(found.ranges, found.impacts, found.problem.conditions))
    return [told, *found.assessment.sentences[1:], *filter(None, [beyond]), f"Where, how fast and when: {page}"]
