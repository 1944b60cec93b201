"""The physics of the movies as features and contacts for `impulses`.

Lengths are px and times are frames here; the coefficients of the features are
  drag  (colour of disc, colour of mat): -v |v|^(power - 1) while the centre is on the mat,
  pull  (colour of disc, axis):          a constant acceleration along x or y,
  pair  (receiver colour, source colour): towards the other disc, as (100 px / r)^p.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from impulses import Contacts, Evidence, MotionNoise, motion_evidence
from ullman_movies import COLOURS

CLASSES = {"mass": (1.0, 3.0, 9.0), "friction": (0.0, 5.0, 20.0)}
SLACK = 3.0  # px within which a contact is possible
SLOW = 0.25  # px a frame: slower motion has no direction
LENGTH = 100.0  # px, unit of distance in pair forces


@dataclass(frozen=True)
class Form:
    """Shapes of the force terms, shared by all movies and never by their answers."""

    drag_power: float = 1.0
    pair_power: float = 2.0
    overlap: str = "first"
    region: str = "touch"
    noise: MotionNoise = field(default_factory=MotionNoise)


def velocities(positions, half=4):
    """Smoothed velocities, shape (T, N, 2), px a frame: the best of three local lines.

    Lines over the rows before, after and around; the one with the least scatter is taken, so
    that no line runs across a bounce.
    """
    n_times = len(positions)
    result = np.full(positions.shape, np.nan)
    for k in range(positions.shape[1]):
        x = positions[:, k]
        for t in range(n_times):
            best = np.inf
            for a, b in ((t - half, t + half), (t - half, t), (t, t + half)):
                rows = np.arange(max(a, 0), min(b, n_times - 1) + 1)
                rows = rows[np.isfinite(x[rows, 0])]
                if len(rows) < 3:
                    continue
                u = rows - rows.mean()
                slope = u @ x[rows] / (u @ u)
                left = x[rows] - x[rows].mean(axis=0) - np.outer(u, slope)
                scatter = (np.sum(left**2) + 0.2) / (2 * len(rows) - 4 + 1e-9) + 0.3 / (u @ u)
                if scatter < best:
                    best, result[t, k] = scatter, slope
    return result


def contacts_of(movie, slack=SLACK, events=None):
    """Where contacts are possible, from positions alone; see `Contacts`."""
    x = filled(movie.positions)
    n_times, n = x.shape[:2]
    ahead = np.empty_like(x)  # where each disc would be in the next frame, seen from this one
    ahead[1:] = 2 * x[1:] - x[:-1]
    ahead[0] = x[0]
    back = np.empty_like(x)  # where it would have been before, seen from the next two
    back[:-2] = 2 * x[1:-1] - x[2:]
    back[-2:] = x[-2:]
    after = np.concatenate([x[1:], x[-1:]])
    views = [x, after, ahead, back]
    left, top, right, bottom = movie.arena
    walls = np.zeros((n_times, n, 2), dtype=bool)
    for view in views:
        for axis, (low, high) in enumerate(((left, right), (top, bottom))):
            reach = movie.radii + slack
            walls[:, :, axis] |= (view[:, :, axis] < low + reach) | (
                view[:, :, axis] > high - reach
            )
    pairs = [[] for _ in range(n_times)]
    slip = np.zeros((n_times, n, 2))
    step = np.maximum(np.abs(after - x), np.abs(np.concatenate([x[:1], x[:-1]]) - x))
    slip += np.where(walls.any(axis=2)[:, :, None], step.max(axis=2, keepdims=True), 0.0)
    for i in range(n):
        for j in range(i):
            near = movie.radii[i] + movie.radii[j] + slack
            gap = np.min([np.linalg.norm(v[:, i] - v[:, j], axis=1) for v in views], axis=0)
            for t in np.flatnonzero(gap < near):
                normal = x[t, j] - x[t, i]
                normal = normal / max(np.linalg.norm(normal), 1e-9)
                pairs[t].append((i, j, normal))
                for k in (i, j):
                    slip[t, k] = np.maximum(slip[t, k], step[t, k].max())
    if events is None:
        events = np.zeros((n_times, n), dtype=bool)
    slip = np.where(events[:, :, None], np.maximum(slip, step.max(axis=2, keepdims=True)), slip)
    return Contacts(tuple(tuple(p) for p in pairs), walls, slip, events)


def filled(positions):
    """Gaps bridged by straight lines, for features and contacts only (never as data)."""
    x = positions.copy()
    rows = np.arange(len(x))
    for k in range(x.shape[1]):
        for axis in (0, 1):
            known = np.isfinite(x[:, k, axis])
            x[:, k, axis] = np.interp(rows, rows[known], x[known, k, axis])
    return x


def on_mats(movie, x, form, order):
    """Which mats act on each disc: (colours present, weights (T, N, n_colours)).

    The region is ``centre`` (the centre is on the mat) or ``touch`` (any part of the disc's
    bounding box is). Where a disc is on two mats, ``first`` lets only the first of `order` act,
    ``all`` both.
    """
    colours = tuple(dict.fromkeys(m[0] for m in movie.mats))
    weights = np.zeros((*x.shape[:2], len(colours)))
    taken = np.zeros(x.shape[:2], dtype=bool)
    reach = movie.radii if form.region == "touch" else np.zeros(len(movie.radii))
    for index in order:
        colour, left, top, right, bottom = movie.mats[index][:5]
        inside = (x[..., 0] > left - reach) & (x[..., 0] < right + reach)
        inside &= (x[..., 1] > top - reach) & (x[..., 1] < bottom + reach)
        if form.overlap == "first":
            inside &= ~taken
        taken |= inside
        weights[..., colours.index(colour)] += inside
    return colours, np.minimum(weights, 1.0)


def mat_orders(movie, form):
    """Orders in which mats may take precedence: one, or both if the picture cannot tell.

    Of two mats that lie over one another the lower one (more of it hidden) goes first; for mats
    apart, which one acts on a disc that is on both is not visible, and both orders are kept.
    """
    indices = tuple(range(len(movie.mats)))
    if form.overlap != "first" or len(movie.mats) != 2 or movie.mats[0][0] == movie.mats[1][0]:
        return [indices]
    (_, l0, t0, r0, b0, hidden0), (_, l1, t1, r1, b1, hidden1) = movie.mats
    across = min(r0, r1) - max(l0, l1)
    along = min(b0, b1) - max(t0, t1)
    if across > 3 and along > 3 and abs(hidden0 - hidden1) > 0.01:
        return [(0, 1) if hidden0 > hidden1 else (1, 0)]
    x = filled(movie.positions)
    everything = Form(overlap="all", region=form.region)
    both = np.any(on_mats(movie, x, everything, indices)[1].sum(axis=2) > 1)
    return [(0, 1), (1, 0)] if both else [indices]


def features_of(movie, form, order=None):
    """Feature accelerations of all coefficients, shape (T, N, 2, K), and their names."""
    x = filled(movie.positions)
    v = velocities(movie.positions)
    v = np.where(np.isfinite(v), v, 0.0)
    speed = np.linalg.norm(v, axis=2, keepdims=True)
    drag = np.where(speed > SLOW, -v * np.maximum(speed, SLOW) ** (form.drag_power - 1), -v * 0.0)
    if form.drag_power == 1.0:
        drag = -v
    order = mat_orders(movie, form)[0] if order is None else order
    mats, weights = on_mats(movie, x, form, order)
    present = [c for c in COLOURS if c in movie.colours]
    is_of = {c: np.array([k == c for k in movie.colours]) for c in present}
    columns, names = [], []
    for c in present:
        for k, mat in enumerate(mats):
            columns.append(drag * (weights[..., k] * is_of[c])[..., None])
            names.append(("drag", c, mat))
    for c in present:
        for axis in (0, 1):
            pull = np.zeros_like(x)
            pull[:, is_of[c], axis] = 1.0
            columns.append(pull)
            names.append(("pull", c, axis))
    apart = x[:, None, :, :] - x[:, :, None, :]  # [t, i, j]: from i to j
    r = np.maximum(np.linalg.norm(apart, axis=3, keepdims=True), 40.0)
    towards = apart / r * (LENGTH / r) ** form.pair_power
    for a in present:
        for b in present:
            if a == b and is_of[a].sum() < 2:
                continue
            pull = np.einsum("tijd,i,j->tid", towards, is_of[a] * 1.0, is_of[b] * 1.0)
            columns.append(pull)
            names.append(("pair", a, b))
    return np.stack(columns, axis=3), tuple(names)


def mass_hypotheses(movie):
    """Distinct mass ratios of the colours present: (H, N) masses, and the 3^k assignments.

    Returns
    -------
    masses : ndarray, shape (H, N)
    assignments : list of (dict colour -> mass, h)
    """
    import itertools

    present = [c for c in COLOURS if c in movie.colours]
    rows, assignments = [], []
    for values in itertools.product(CLASSES["mass"], repeat=len(present)):
        ratio = tuple(v / values[0] for v in values)
        if ratio not in rows:
            rows.append(ratio)
        assignments.append((dict(zip(present, values, strict=True)), rows.index(ratio)))
    masses = np.array([[row[present.index(c)] for c in movie.colours] for row in rows], dtype=float)
    return masses, assignments


@dataclass(frozen=True, eq=False)
class Summary:
    """All that the inference needs to know of one movie."""

    name: str
    evidence: Evidence
    names: tuple
    assignments: tuple
    present: tuple
    n_events: int


def scales(names):
    """Prior standard deviations of free coefficients, wide: 0.1 a frame, 0.1 and 1 px/frame²."""
    return np.array([{"drag": 0.1, "pull": 0.1, "pair": 1.0}[n[0]] for n in names])


def free_fit(evidence, names):
    """Best hypothesis with free coefficients (Gaussian priors of `scales`).

    Returns
    -------
    h : int
    c, covariance : ndarray, shapes (K,), (K, K)
    log_evidence : ndarray, shape (H,)
    """
    prior = np.diag(scales(names) ** -2.0)
    log_evidence, fits = [], []
    for h in range(len(evidence.constant)):
        covariance = np.linalg.inv(evidence.gram[h] + prior)
        c = covariance @ evidence.b[h]
        value = evidence.constant[h] + 0.5 * evidence.b[h] @ c
        value += 0.5 * (np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(prior)[1])
        log_evidence.append(value)
        fits.append((c, covariance))
    h = int(np.argmax(log_evidence))
    return h, *fits[h], np.array(log_evidence)


def _onsets(outlying):
    """First frames of the runs of outliers of each body, shape (T, N)."""
    before = np.zeros_like(outlying)
    before[1:] = outlying[:-1]
    before[2:] |= outlying[:-2]
    before[3:] |= outlying[:-3]
    return outlying & ~before


def summarise(movie, form, gate=4.0, passes=8):
    """Gaussian likelihoods of a movie's coefficients, one `Summary` for each order of its mats.

    Frames in which, under the best hypothesis with free coefficients, a disc leaves its
    prediction by more than `gate` standard deviations are marked as unexplained (nothing is
    believed about its velocity there), onset by onset, until none is left.
    """
    orders = mat_orders(movie, form)
    masses, assignments = mass_hypotheses(movie)
    events = [np.zeros(movie.positions.shape[:2], dtype=bool) for _ in orders]
    present = tuple(c for c in COLOURS if c in movie.colours)
    kept = []
    for k, order in enumerate(orders):
        features, names = features_of(movie, form, order)
        for _ in range(passes):
            contacts = contacts_of(movie, events=events[k])
            evidence = motion_evidence(movie.positions, features, contacts, masses, form.noise)
            h, c, _, _ = free_fit(evidence, names)
            z = np.abs(evidence.residuals(c, h)).max(axis=2)
            marked = _changed(z > gate)
            if not (marked & ~events[k]).any():
                break
            events[k] |= marked
        kept.append(
            Summary(movie.name, evidence, names, tuple(assignments), present, int(events[k].sum()))
        )
    if len(kept) > 1:  # comparable only if the same frames are believed
        together = np.logical_or.reduce(events)
        contacts = contacts_of(movie, events=together)
        kept = [
            replace(
                summary,
                evidence=motion_evidence(
                    movie.positions, features_of(movie, form, order)[0], contacts, masses,
                    form.noise,
                ),
                n_events=int(together.sum()),
            )
            for summary, order in zip(kept, orders, strict=True)
        ]  # fmt: skip
    return kept


def likelier(summaries):
    """The order of mats with the larger evidence under free coefficients."""
    return max(summaries, key=lambda s: free_fit(s.evidence, s.names)[3].max())


def _changed(outlying):
    """Frames in which a velocity must have changed: the one or two before a run of outliers."""
    onset = _onsets(outlying)
    marked = np.zeros_like(outlying)
    marked[:-1] |= onset[1:]
    marked[:-2] |= onset[2:]
    return marked
