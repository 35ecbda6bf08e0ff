"""The command line: thin commands that call the package's verbs and print what these return.

Nothing heavy is imported here; each command imports what it needs when it runs.
"""

from .application import app, main


__all__ = ["app", "main"]
