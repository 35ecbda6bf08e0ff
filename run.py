#!/usr/bin/env python3
"""Set the toolkit up and run it, from a checkout, with nothing but Python and pip.

    python3 run.py demo                 the whole story on shipped data
    python3 run.py test                 all tests (further arguments go to pytest)
    python3 run.py COMMAND ...          any other command of ddetumble
    python3 run.py notebook             the notebooks in JupyterLab (further arguments go to it)
    python3 run.py site                 the documentation as pages, in build/site (further arguments go to Sphinx)
    python3 run.py setup                set up only, with what the tests need
    python3 run.py release              check that this commit is ready to publish; publishes nothing
    python3 run.py pythons              list the interpreters that would do, best first

The first call makes .venv-3.X beside this file with the newest Python from 3.11 on that it finds on this machine (on
the path, and where pyenv, uv, Homebrew or an installer put them); later calls start at once. Another one:
`python3 run.py --python 3.12 demo`, `--python /path/to/python3`, or the environment variable DDETUMBLE_PYTHON.

This file keeps to what every Python 3 from 3.6 on understands, so that an old `python3` can look for a newer one.
"""

import glob
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys


ROOT = os.path.dirname(os.path.abspath(__file__))
OLDEST = (3, 11)
KNOWN = (3, 14)  # the newest Python for which every pinned version has a wheel
STAMP = "ddetumble-setup.json"
WINDOWS = os.name == "nt"
EXTRAS = {"test": "dev", "setup": "dev", "notebook": "lab", "site": "docs"}  # of pyproject.toml, by command
PLACES = (  # beside the path
    "{PYENV_ROOT}/versions/*/bin/python3",
    "~/.pyenv/versions/*/bin/python3",
    "~/.pyenv/pyenv-win/versions/*/python.exe",
    "{UV_PYTHON_INSTALL_DIR}/*/bin/python3",
    "~/.local/share/uv/python/*/bin/python3",
    "~/.local/bin/python3.*",
    "/usr/local/bin/python3.*",
    "/opt/homebrew/bin/python3.*",
    "/opt/python*/bin/python3",
    "/opt/python/*/bin/python3",
    "/Library/Frameworks/Python.framework/Versions/*/bin/python3",
    "{LOCALAPPDATA}/Programs/Python/Python3*/python.exe",
)
PROBE = """
import importlib.util, json, sys, sysconfig
print(json.dumps({
    "path": sys.executable,
    "version": list(sys.version_info[:3]),
    "fit": sys.version_info.releaselevel == "final" and sys.implementation.name == "cpython"
        and sys.maxsize > 2**32 and not sysconfig.get_config_var("Py_GIL_DISABLED"),
    "venv": bool(importlib.util.find_spec("venv") and importlib.util.find_spec("ensurepip")),
}))
"""


class SetupError(Exception):
    """What went wrong, in words for the terminal."""


def probe(path):
    """What the interpreter at a path says about itself, or None where there is none that runs."""
    try:
        answer = subprocess.run(
            [path, "-I", "-c", PROBE], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, timeout=30, env=environment()
        )
        return json.loads(answer.stdout.decode()) if answer.returncode == 0 else None
    except (OSError, ValueError, subprocess.SubprocessError):
        return None


def list_candidates():
    """Paths that may be interpreters, each once."""
    paths = [sys.executable]
    for place in PLACES:
        name = re.search(r"{(\w+)}", place)
        if name and not os.environ.get(name.group(1)):
            continue
        paths += glob.glob(os.path.expanduser(place.format(**os.environ) if name else place))
    for folder in os.environ.get("PATH", "").split(os.pathsep):
        if os.path.basename(folder) != "shims":  # pyenv's; the interpreters behind them are listed above
            paths += glob.glob(os.path.join(folder, "python3*"))
            paths += glob.glob(os.path.join(folder, "python.exe"))
    seen = {}
    for path in paths:
        if path and re.match(r"^python(3(\.\d+)?)?(\.exe)?$", os.path.basename(path)):
            seen.setdefault(os.path.realpath(path), path)
    return list(seen.values())


def find_interpreters():
    """Interpreters that would do, the best first: the newest, those newer than any known to work last."""
    found = {}
    for path in list_candidates():
        answer = probe(path)
        if answer and answer["fit"] and tuple(answer["version"][:2]) >= OLDEST:
            found.setdefault(os.path.realpath(answer["path"]), answer)
    usable = [answer for answer in found.values() if answer["venv"] or shutil.which("uv")]
    if found and not usable:
        raise SetupError(
            "Python {} at {} lacks the modules venv and ensurepip; install them (on Debian and Ubuntu the package "
            "python3-venv), or uv.".format(*describe(next(iter(found.values()))))
        )
    return sorted(usable, key=lambda a: (tuple(a["version"][:2]) <= KNOWN, a["version"], a["venv"]), reverse=True)


def describe(interpreter):
    """Version as text, and path."""
    return ".".join(map(str, interpreter["version"])), interpreter["path"]


def choose_interpreter(wanted):
    """The interpreter that the user asked for by version or path, or the best there is."""
    if wanted and not re.match(r"^3(\.\d+)*$", wanted):
        answer = probe(os.path.expanduser(wanted))
        if answer is None:
            raise SetupError("{} is no Python that runs; give the path of an interpreter.".format(wanted))
        if tuple(answer["version"][:2]) < OLDEST:
            raise SetupError("{} is Python {}; 3.11 or newer is needed.".format(wanted, describe(answer)[0]))
        return answer
    interpreters = find_interpreters()
    if wanted:
        parts = [int(part) for part in wanted.split(".")]
        interpreters = [a for a in interpreters if a["version"][: len(parts)] == parts]
    if not interpreters:
        raise SetupError(
            "No Python {} was found on this machine (this is {}); install one, or name it with "
            "--python PATH.".format(wanted or "3.11 or newer", sys.version.split()[0])
        )
    return interpreters[0]


def environment(folder=None):
    """The environment for a child: without traces of other environments, with ours first on the path."""
    clean = {k: v for k, v in os.environ.items() if k not in ("PYTHONHOME", "PYTHONPATH", "VIRTUAL_ENV", "PIP_USER")}
    clean.pop("__PYVENV_LAUNCHER__", None)
    if folder:
        binaries = os.path.dirname(locate_python(folder))
        clean.update(VIRTUAL_ENV=folder, PATH=binaries + os.pathsep + clean.get("PATH", ""))
        clean.update(PIP_DISABLE_PIP_VERSION_CHECK="1", PIP_NO_INPUT="1")
        clean.setdefault("UV_NATIVE_TLS", "1")  # uv trusts what the machine trusts, as pip does
    return clean


def locate_python(folder):
    """The interpreter inside a virtual environment."""
    return os.path.join(folder, *(("Scripts", "python.exe") if WINDOWS else ("bin", "python")))


def read_stamp(folder):
    """What the last complete setup of an environment noted; empty if there was none."""
    try:
        with open(os.path.join(folder, STAMP)) as stream:
            return json.load(stream)
    except (OSError, ValueError):
        return {}


def take_fingerprint():
    """Changes when an environment has to be brought up to date: requirements, pins, place of the checkout."""
    digest = hashlib.sha256(ROOT.encode())
    for name in ("pyproject.toml", "constraints/tested.txt"):
        with open(os.path.join(ROOT, name), "rb") as stream:
            digest.update(stream.read())
    return digest.hexdigest()


def set_up(interpreter, extra):
    """Make the virtual environment, or bring it up to date; returns its folder."""
    version, path = describe(interpreter)
    folder = os.path.join(ROOT, ".venv-{}.{}".format(*interpreter["version"]))
    stamp = read_stamp(folder)
    fingerprint = take_fingerprint()
    works = probe(locate_python(folder)) is not None
    extras = sorted(set(stamp.get("extras", []) if works else []) | ({extra} if extra else set()))
    if works and stamp.get("fingerprint") == fingerprint and stamp.get("extras") == extras:
        return folder
    name = os.path.basename(folder)
    say("Setting up {} with Python {} ({}); this happens once and takes a few minutes.".format(name, version, path))
    log = os.path.join(ROOT, name + ".log")
    if os.path.exists(log):
        os.remove(log)
    uv = shutil.which("uv")
    if not works:
        shutil.rmtree(folder, ignore_errors=True)
        run_logged(
            [path, "-m", "venv", folder] if interpreter["venv"] else [uv, "venv", "--seed", "--python", path, folder],
            log,
        )
    elif stamp:
        os.remove(os.path.join(folder, STAMP))
    wanted = ["-e", "{}[{}]".format(ROOT, ",".join(extras)) if extras else ROOT]
    wanted += ["-c", os.path.join(ROOT, "constraints", "tested.txt")]
    python = locate_python(folder)
    pip = [python, "-m", "pip", "install"] + wanted
    if uv:
        try:
            run_logged([uv, "pip", "install", "--python", python] + wanted, log, folder)
        except SetupError:
            say("uv could not install everything; going on with pip.")
            run_logged(pip, log, folder)
    else:
        run_logged(pip, log, folder)
    os.replace(log, os.path.join(folder, "setup.log"))
    with open(os.path.join(folder, STAMP), "w") as stream:
        json.dump({"fingerprint": fingerprint, "extras": extras, "python": path}, stream)
    say("Done. To have the command `ddetumble` at hand: {}".format(tell_activation(name)))
    return folder


def tell_activation(name):
    """The shell's command for activating an environment."""
    return name + "\\Scripts\\activate" if WINDOWS else "source {}/bin/activate".format(name)


def run_logged(command, log, folder=None):
    """Run a step of the setup; its output goes to the log, and on a terminal a line tells what it is at."""
    width = shutil.get_terminal_size().columns - 4
    terminal = sys.stderr.isatty()
    with open(log, "ab") as stream:
        stream.write(("$ " + " ".join(command) + "\n").encode())
        stream.flush()
        child = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment(folder), cwd=ROOT
        )
        for line in child.stdout:
            stream.write(line)
            text = line.decode(errors="replace").strip()
            if terminal and text:
                sys.stderr.write("\r\033[K  " + text[:width])
                sys.stderr.flush()
        if terminal:
            sys.stderr.write("\r\033[K")
        failed = child.wait()
    if failed:
        with open(log, errors="replace") as stream:
            tail = "".join(stream.readlines()[-12:])
        raise SetupError(
            "{}\nThe setup failed; all of its output is in {}. If this Python is the reason, name another one with "
            "--python (python3 run.py pythons lists them).".format(tail, os.path.relpath(log))
        )


def count_workers():
    """Test processes: one a core that this process may use, four at most."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(cores, 4)


def say(text):
    """Tell the user, apart from what the command itself prints."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def open_notebooks(folder, arguments):
    """Open the notebooks in JupyterLab, in the environment of a folder; returns its exit code."""
    python = locate_python(folder)
    if subprocess.call([python, "-I", "-c", "import jupyterlab"], stderr=subprocess.DEVNULL, env=environment(folder)):
        raise SetupError(
            "JupyterLab is not installed in {}; it comes with the extra `lab`: {} -m pip install -e '.[lab]'".format(
                os.path.basename(folder), os.path.relpath(python, ROOT)
            )
        )
    return subprocess.call(
        [python, "-m", "jupyterlab"] + arguments, env=environment(folder), cwd=os.path.join(ROOT, "notebooks")
    )


def build_site(folder, arguments):
    """Build the documentation; whatever does not resolve is an error. Returns Sphinx's exit code."""
    target = os.path.join(ROOT, "build", "site")
    command = [locate_python(folder), "-m", "sphinx", "-W", "--keep-going", "-q", "-c", "docs", ".", target] + arguments
    failed = subprocess.call(command, env=environment(folder), cwd=ROOT)
    if not failed:
        print(os.path.join(target, "index.html"))
    return failed


def main(arguments):
    """Understand the command line, set up, and run; returns the exit code."""
    wanted = os.environ.get("DDETUMBLE_PYTHON")
    if arguments and arguments[0].split("=")[0] == "--python":
        first = arguments.pop(0)
        if "=" not in first and not arguments:
            raise SetupError("--python needs a version or a path.")
        wanted = first.split("=", 1)[1] if "=" in first else arguments.pop(0)
    if not arguments or arguments[0] in ("-h", "--help"):
        print(__doc__.strip())
        return 0 if arguments else 2
    if arguments[0] == "pythons":
        for interpreter in find_interpreters():
            print("{:8} {}".format(*describe(interpreter)))
        return 0
    if arguments[0] == "release":  # makes environments of its own
        path = describe(choose_interpreter(wanted))[1]
        return subprocess.call([path, "-m", "docs.release"] + arguments[1:], env=environment(), cwd=ROOT)
    testing = arguments[0] == "test"
    folder = set_up(choose_interpreter(wanted), EXTRAS.get(arguments[0]))
    if arguments[0] == "setup":
        return 0
    python = locate_python(folder)
    if arguments[0] == "notebook":
        return open_notebooks(folder, arguments[1:])
    if arguments[0] == "site":
        return build_site(folder, arguments[1:])
    if testing:
        command = [python, "-m", "pytest", "-n", str(count_workers()), "--dist", "loadfile",
                   "--no-loadscope-reorder"] + arguments[1:]
        return subprocess.call(command, env=environment(folder), cwd=ROOT)
    return subprocess.call([python, "-m", "ddetumble"] + arguments, env=environment(folder))


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except SetupError as error:
        say(str(error))
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)
