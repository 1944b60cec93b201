"""Where functions that cost an integration each leave the positive, for many of them at once."""

import numpy as np

BISECTIONS = 60
FEW, FIRST = 8, 9
"""Instants up to which each is looked for at many lengths at once; lengths of the first look."""
CROWD = np.array([-1.0, 1.0])[:, None] * 0.5 ** np.array([1, 2, 4, 7, 11, 16, 22, 29])
CROWD = np.sort(np.append(CROWD, 0.0))
"""Where the further ones lie about a root that is foreseen, in parts of what is left."""
CLOSE = 1e-14
"""Part of what was between to which a root is found."""


def roots(margin, low, high, near=0.0):
    """Lengths before and behind which margins leave the positive, (M,) each, all at once.

    Both are the same where a margin is on the edge already.

    Parameters
    ----------
    margin : callable
        ``margin(length, which)`` of some of the margins.
    low, high : ndarray, shape (M,)
        Positive at the first, not at the second.
    near : ndarray, shape (M,), or float
        Part of its own length to which a root is found, if that is not as close as `CLOSE`.
    """
    near = np.broadcast_to(near, low.shape)
    return (_narrowed if len(low) <= FEW else _bisected)(margin, low, high, near)


def _narrowed(margin, low, high, near):
    """The roots of few margins: a step costs little more at many lengths than at one.

    Lengths of every round crowd about the place where a curve through the last ones is zero.
    """
    width = high - low

    def values(u, which):
        lengths = low[which, None] + u * width[which, None]
        found = margin(lengths.ravel(), np.repeat(which, u.shape[1]))
        return found.reshape(u.shape)

    open_ = np.arange(len(low))
    u = np.tile(np.linspace(0.0, 1.0, FIRST), (len(low), 1))
    f = values(u, open_)
    before, behind = low.copy(), np.where(f[:, 0] <= 0, low, high)  # on the edge already
    more = (f[:, 0] > 0) & ~(f[:, -1] > 0)
    for _ in range(BISECTIONS):
        u, f, open_ = u[more], f[more], open_[more]
        if not len(open_):
            break
        own, k = np.arange(len(open_)), np.argmin(f > 0, axis=1)  # the first behind
        a, b, at_a, at_b = u[own, k - 1], u[own, k], f[own, k - 1], f[own, k]
        before[open_] = low[open_] + a * width[open_]
        behind[open_] = np.where(b < 1.0, low[open_] + b * width[open_], high[open_])
        is_near = np.abs((b - a) * width[open_]) <= near[open_] * np.abs(behind[open_])
        more = ~(is_near | (b - a <= CLOSE) | (at_b == 0))
        new = _near_root(u, f, k)[:, None] + (b - a)[:, None] * CROWD
        new = np.clip(new, a[:, None], b[:, None])
        u = np.column_stack([a, new, b])
        f = np.column_stack([at_a, np.empty_like(new), at_b])
        if more.any():
            f[more, 1:-1] = values(new[more], open_[more])
    return before, behind


def _near_root(u, f, k):
    """Where the inverse curve through two places before roots and two behind them is zero.

    The chord where there are none, or where they do not fall one after the other; the middle where
    there is no chord.
    """
    own = np.arange(len(u))[:, None]
    at = k[:, None] + np.arange(-2, 2)
    is_inside = (at[:, 0] >= 0) & (at[:, -1] < u.shape[1])
    at = np.clip(at, 0, u.shape[1] - 1)
    x, y = u[own, at], f[own, at]
    a, b, fa, fb = x[:, 1], x[:, 2], y[:, 1], y[:, 2]
    with np.errstate(all="ignore"):  # what divides by zero is not taken
        chord = a + (b - a) * fa / (fa - fb)
        for n in range(1, 4):
            x = (x[:, 1:] * y[:, :-n] - x[:, :-1] * y[:, n:]) / (y[:, :-n] - y[:, n:])
    chord = np.where(np.isfinite(chord), chord, (a + b) / 2)
    falls = is_inside & (np.diff(f[own, at], axis=1) < 0).all(axis=1)
    return np.where(falls & (a <= x[:, 0]) & (x[:, 0] <= b), x[:, 0], chord)


def _bisected(margin, low, high, near):
    """The roots of many margins: by secants (Illinois), by halves where those gain little."""
    low, high = low.copy(), high.copy()
    everyone = np.arange(len(low))
    at_low, at_high = margin(low, everyone), margin(high, everyone)
    out = np.where(at_low <= 0, low, high)  # on the edge already
    side, width = np.zeros(len(low), dtype=int), np.abs(high - low)
    is_slow = np.zeros(len(low), dtype=bool)
    open_ = everyone[at_low > 0]
    for _ in range(BISECTIONS):
        if not len(open_):
            break
        a, b, fa, fb = low[open_], high[open_], at_low[open_], at_high[open_]
        enough = np.maximum(CLOSE * width[open_], near[open_] * np.abs(b))
        # Where one end stays, aim so far beyond the root that the other comes as near.
        beyond = np.sign(b - a) * np.minimum(enough, np.abs(b - a)) / 2
        middle = a + (b - a) * fa / (fa - fb) + side[open_] * beyond
        is_inside = (np.minimum(a, b) < middle) & (middle < np.maximum(a, b))
        middle = np.where(is_inside & ~is_slow[open_], middle, (a + b) / 2)
        value = margin(middle, open_)
        up = value > 0
        again = side[open_] == np.where(up, 1, -1)
        low[open_], high[open_] = np.where(up, middle, a), np.where(up, b, middle)
        at_low[open_] = np.where(up, value, np.where(again, fa / 2, fa))
        at_high[open_] = np.where(up, np.where(again, fb / 2, fb), value)
        left = np.abs(high[open_] - low[open_])
        is_slow[open_] = again & (left > 0.5 * np.abs(b - a))
        side[open_] = np.where(up, 1, -1)
        out[open_] = high[open_]
        # The root may lie far nearer to the start than the old end.
        enough = np.maximum(CLOSE * width[open_], near[open_] * np.abs(high[open_]))
        open_ = open_[~((left <= enough) | (value == 0))]
    return low, out
