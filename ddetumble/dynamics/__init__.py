"""Equations of motion."""

from .._settings import configure as _configure


_configure()
