"""Errors of constants from how parts of the tracks disagree: a jackknife that leaves out groups.

Where a law leaves more than noise, errors that count noise alone say nothing of its constants: what
it lacks pulls them elsewhere in another part of the tracks. Parts are left out in turn, and the
others fitted by one step of the linearisation (Efron & Tibshirani 1993, An Introduction to the
Bootstrap, chapter 11).
"""

import numpy as np

STRETCHES = 4
"""Parts of a recording: as long as may be, since what a law lacks lasts."""
GROUPS = 8
"""Groups of recordings at the most, where there are as many recordings as stretches or more."""


def jackknife_errors(found):
    """Standard errors of a fit's constants, (k,), and of how many parts.

    They are 0 where what is left of the tracks does not tell a constant.
    """
    n_constants = len(found.parameters)
    part, n_parts = _parts(found)
    if not n_constants or found.is_failed:
        return np.zeros(n_constants), n_parts
    level = np.array(found.noise.levels)[found.channels.axis]
    weight = np.where(found.channels.seen & np.isfinite(level), 1.0 / level, 0.0)
    shared, local, left = (
        np.nan_to_num(rows) * weight
        for rows in (
            found.shared_columns[:n_constants], found.local_columns, found.residual[None]
        )
    )  # fmt: skip
    out = []
    with np.errstate(all="ignore"):
        for k in range(n_parts):
            kept = part != k
            out.append(_step(shared * kept, local * kept, left * kept, found.channels.chain))
    steps = np.array(out)
    if not np.isfinite(steps).all():
        return np.zeros(n_constants), n_parts
    spread = np.square(steps - steps.mean(axis=0)).sum(axis=0)
    return np.sqrt((n_parts - 1) / n_parts * spread), n_parts


def _parts(found):
    """The part (T, C) that every row belongs to, and how many there are."""
    channels = found.channels
    n_scenes = len(channels.scene_names)
    if n_scenes >= STRETCHES:
        count = min(n_scenes, GROUPS)
        return np.broadcast_to(channels.scene * count // n_scenes, channels.seen.shape), count
    number = np.cumsum(channels.seen, axis=0) - 1
    n_rows = np.maximum(channels.seen.sum(axis=0), 1)
    return np.maximum(number, 0) * STRETCHES // n_rows, STRETCHES


def _step(shared, local, left, chain):
    """Change of the constants by which least squares explain what is left, (k,)."""
    k = len(shared)
    square, towards = np.zeros((k, k)), np.zeros(k)
    for own in np.unique(chain):
        mine = chain == own
        n_rows = left.shape[1] * np.count_nonzero(mine)
        columns, states, rows = (
            values[..., mine].reshape(len(values), n_rows) for values in (shared, local, left)
        )
        size = np.linalg.norm(states, axis=1)
        basis = np.linalg.qr((states[size > 0] / size[size > 0, None]).T)[0]
        columns, rows = (values - (values @ basis) @ basis.T for values in (columns, rows))
        square += columns @ columns.T
        towards += columns @ rows[0]
    size = np.sqrt(np.diag(square))
    size = np.where(size > 0, size, np.inf)
    return np.linalg.lstsq(square / np.outer(size, size), towards / size, rcond=1e-12)[0] / size
