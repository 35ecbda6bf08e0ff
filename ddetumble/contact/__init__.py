"""Contact mechanics: depression in, force out."""

from .._settings import configure as _configure


_configure()
