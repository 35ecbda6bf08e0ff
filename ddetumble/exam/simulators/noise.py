"""Measurement noise with a stated marginal standard deviation."""

import numpy as np


def draw_noise(generator, count, deviation, rho=0.0, white_share=0.0):
    """Return `count` samples of AR(1) noise, plus white noise where `white_share` > 0.

    x_i = rho x_{i-1} + sqrt(1 - rho^2) s e_i, started in its stationary state, so that every sample has
    standard deviation s and the correlation at lag k is rho^k. `white_share` is the white part's share of the
    variance: the sum keeps the stated `deviation`, and its correlation at lag k is (1 - white_share) rho^k.
    """
    if not 0.0 <= white_share <= 1.0 or not -1.0 < rho < 1.0:
        raise ValueError(f"white share {white_share} or rho {rho} out of range")
    shocks = generator.standard_normal(count)
    if rho:
        for i in range(1, count):
            shocks[i] = rho * shocks[i - 1] + np.sqrt(1.0 - rho**2) * shocks[i]
    if white_share:
        white = generator.standard_normal(count)
        shocks = np.sqrt(1.0 - white_share) * shocks + np.sqrt(white_share) * white
    return deviation * shocks
