"""What sensors on a damped bob show: rates of its place, each as often differentiated as asked."""

import numpy as np


def swung(times, size, square, order, sigma, rng):
    """A rate of x'' = -square x - 0.1 x', `order` times differentiated, with noise, (T,)."""
    rate = -0.05 + 1j * np.sqrt(square - 0.05**2)
    exact = (size * rate**order * np.exp(rate * times)).real
    return exact + sigma * rng.standard_normal(len(times))
