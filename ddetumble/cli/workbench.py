"""The command `workbench`, which opens a campaign in the browser."""

import importlib.util
import secrets
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Annotated

import typer

from .._errors import ComputationError, InputError
from .options import CampaignName, Model, command, option
from .places import locate_campaign


HOST = "127.0.0.1"  # nobody else's machine can reach it


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
        raise InputError('the workbench needs marimo; install it with: pip install "ddetumble[workbench]"')
    with socket.socket() as probe:
        if port is not None and probe.connect_ex((HOST, port)) == 0:
            raise InputError(f"port {port} is taken; name another one, or none", option="--port")
    from ..families import name_family
    from ..inference.archive import resolve_model
    from ..measurement.package import read_campaign

    resolve_model(model, name_family(read_campaign(path)))  # what is wrong with either is said here, not on the page
    page = Path(__file__).parent.parent / "workbench" / "page.py"
    # The page is for this machine alone, and for who has the word in its address: other users of the machine have not.
    words = [sys.executable, "-m", "marimo", "run", str(page), "--host", HOST, "--no-sandbox", "--no-check",
             "--token", "--token-password-file", "-", *(["--port", str(port)] if port else []),
             *([] if browser else ["--headless"]), "--", "--campaign", campaign, "--model", model]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that the page ends with the command
    if subprocess.run(words, check=False, text=True, input=secrets.token_urlsafe(16)).returncode:
        raise ComputationError("the page has ended with an error, which stands above")
