"""Public names that are imported when they are first used: the stub beside a package is the one list of them."""

import importlib
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any


_LINE = re.compile(r"^from (\.[\w.]*) import (\w+) as (\w+)$", re.MULTILINE)


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """`__getattr__`, `__dir__` and `__all__` of a package whose stub says `from .home import name as name`.

    Type checkers read the same stub, so that nothing heavy is imported before it is used and no name stands twice.

    Args:
        package: its `__name__`.
        file: its `__file__`.
    """
    homes = {public: (home, name) for home, name, public in
             _LINE.findall(Path(file).with_suffix(".pyi").read_text("utf-8"))}

    def find(name: str) -> Any:
        """Import a public name from its home."""
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, inner = homes[name]
        if not home.strip("."):
            return importlib.import_module(f"{home}{inner}", package)
        return getattr(importlib.import_module(home, package), inner)

    return find, lambda: sorted(homes), sorted(homes)
