"""`python -m ddetumble` does the same as `ddetumble`."""

import sys

from .cli import main


if __name__ == "__main__":
    sys.exit(main())
