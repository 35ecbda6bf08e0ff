"""`python -m ddetumble.cli` does the same as `ddetumble`."""

import sys

from .application import main


sys.exit(main())
