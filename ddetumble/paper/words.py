"""Numbers and lists in the sentences of the booklet."""

from collections.abc import Sequence
from typing import Any

import numpy as np


def join(parts: Sequence[str]) -> str:
    """`a, b and c`."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def sign(value: float, digits: int) -> str:
    """A number with a minus sign where it is negative."""
    return f"{value:.{digits}f}".replace("-", "−")


def say_share(value: float) -> str:
    """A share in per cent."""
    return f"{100 * value:.1f} %"


def tidy(value: Any) -> Any:
    """None in place of a number that JSON does not have; anything else as it is."""
    return value if not isinstance(value, (float, np.floating)) or np.isfinite(value) else None
