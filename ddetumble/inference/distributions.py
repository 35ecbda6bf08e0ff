"""The distributions that tests of a fit are made of, called as those of `scipy.stats`, which gives all others.

It calls the same functions; its import alone would be a tenth of a short command.
"""

import importlib
from typing import Any

import numpy as np
from scipy import special


def __getattr__(name: str) -> Any:
    return getattr(importlib.import_module("scipy.stats"), name)


class chi2:
    """Chi-square, of `df` degrees of freedom."""

    sf = staticmethod(lambda x, df: special.chdtrc(df, np.maximum(x, 0.0)))
    isf = staticmethod(lambda q, df: special.chdtri(df, q))
    ppf = staticmethod(lambda q, df: 2 * special.gammaincinv(df / 2, q))


class f:
    """Fisher's F, of `dfn` and `dfd` degrees of freedom."""

    sf = staticmethod(lambda x, dfn, dfd: special.fdtrc(dfn, dfd, np.maximum(x, 0.0)))
    isf = staticmethod(lambda q, dfn, dfd: special.fdtri(dfn, dfd, 1.0 - q))


class gamma:
    """Gamma, of shape `a` and scale 1."""

    sf = staticmethod(lambda x, a: special.gammaincc(a, np.maximum(x, 0.0)))


class norm:
    """Standard normal."""

    cdf = staticmethod(special.ndtr)
    sf = staticmethod(lambda x: special.ndtr(-x))
    ppf = staticmethod(special.ndtri)


class t:
    """Student's t, of `df` degrees of freedom."""

    ppf = staticmethod(lambda q, df: special.stdtrit(df, q))
