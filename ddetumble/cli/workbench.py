"""The command `workbench`, which opens a campaign in the browser."""

import importlib.util
import secrets
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from .options import CampaignName, Model, command, option
from .places import locate_campaign


@command("workbench", "Work on a campaign in the browser: sliders, fits, and the error step by step.",
         "workbench impact-h", "workbench my-campaign -m my-fit --port 8080 --no-browser")
def open_workbench(
    campaign: CampaignName,
    model: Model = "paper",
    port: Annotated[int | None, option("N", "Port of the page; a free one if not given.", min=1024, max=65535)] = None,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in a browser.")] = True,
):
    """Work on a campaign in the browser, on this machine only: records beside the model, effects on sliders, fits, the
    error step by step, and every step as Python lines. Ctrl-C ends it.
    """
    path = locate_campaign(campaign)
    if importlib.util.find_spec("marimo") is None:
        raise InputError("the workbench needs marimo; install it with: pip install 'ddetumble[workbench]'")
    from ..families import name_family
    from ..inference.archive import resolve_model
    from ..measurement.package import read_campaign

    resolve_model(model, name_family(read_campaign(path)))  # what is wrong with either is said here, not on the page
    page = Path(__file__).parent.parent / "workbench" / "page.py"
    # The page is for this machine alone, and for who has the word in its address: other users of the machine have not.
    words = [sys.executable, "-m", "marimo", "run", str(page), "--host", "127.0.0.1", "--no-sandbox", "--no-check",
             "--token", "--token-password-file", "-", *(["--port", str(port)] if port else []),
             *([] if browser else ["--headless"]), "--", "--campaign", campaign, "--model", model]
    return subprocess.run(words, check=False, text=True, input=secrets.token_urlsafe(16)).returncode
