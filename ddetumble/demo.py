"""The whole story on shipped data: the paper's tables, then a campaign with a hidden effect."""

from collections.abc import Callable
from pathlib import Path

from ._settings import find_data


CAMPAIGN = "impact-a"


def run_demo(folder: Path | str, echo: Callable[[str], None] = print) -> Path:
    """Run the story, tell it line by line, and write the reports.

    Args:
        folder: where `paper/report.html` and `discovery/report.html` go; made if it is not there.
        echo: called with every line.

    Returns:
        Path of the discovery's report.
    """
    from .discrepancy.comparison import compare
    from .discrepancy.discovery import discover
    from .measurement.package import read_campaign
    from .paper import judge_campaign, write_paper
    from .report import describe, write_report

    folder = Path(folder)
    echo("1. The paper. Its printed peaks, and what eleven numbers can say (Table 3):")
    echo("   " + judge_campaign(read_campaign(find_data() / "paper" / "table-3")).sentence)
    page = write_paper(folder / "paper", echo=lambda line: None)
    echo(f"   Its contradictions, each with two numbers and a figure: {page}")
    campaign = read_campaign(find_data() / CAMPAIGN)
    echo("")
    echo(f"2. A campaign of {len(campaign.record_keys)} impacts ({campaign.name}). The paper's model beside it:")
    for line in compare(campaign).text().splitlines()[:12]:
        echo("   " + line)
    echo("")
    echo("3. Which effect is missing? Every one of the catalogue is added in turn, refitted and tried on left-out "
         "tests:")
    found = discover(campaign)
    for line in describe(found).splitlines():
        echo("   " + line)
    found.save(folder / "discovery")
    report = write_report(found, folder / "discovery")
    echo("")
    echo("4. The grown model predicts other tests:  ddetumble predict "
         f"{folder / 'discovery'} CONDITIONS.csv -o predictions.csv")
    echo(f"Report: {report}")
    return report
