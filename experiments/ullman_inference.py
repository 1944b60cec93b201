"""From the Gaussian likelihood of a movie's coefficients to a posterior over its hidden classes.

A movie's hidden classes: the mass of each colour (1, 3, 9), the friction of each mat colour
(0, 5, 20), the global pull (none or one of four), the force of each pair of colours (attract,
none, repel). All combinations are enumerated, none is preferred a priori. Given the shared
constants each combination states every coefficient,

  drag  = gamma * class of the mat * m^drag_mass
  pull  = g * direction * m^pull_mass
  pair  = k * (+1 | 0 | -1) * m_receiver^pair_mass * m_source^pair_source

up to a discrepancy of the forms themselves (`slack`, Gaussian, independent for each coefficient).
"""

import itertools
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.special import logsumexp
from ullman_model import CLASSES

MASS_NAMES = dict(zip(CLASSES["mass"], ("light", "medium", "heavy"), strict=True))
FRICTION_NAMES = dict(zip(CLASSES["friction"], ("smooth", "weak", "strong"), strict=True))
DIRECTIONS = {
    "none": (0.0, 0.0),
    "north": (0.0, -1.0),  # y of the picture points down
    "south": (0.0, 1.0),
    "west": (-1.0, 0.0),
    "east": (1.0, 0.0),
}
PAIR_NAMES = {1.0: "attract", 0.0: "none", -1.0: "repel"}
KINDS = ("drag", "pull", "pair")


@dataclass(frozen=True)
class Constants:
    """What all movies share. Strengths in px and frames; exponents of the masses; slack.

    `slack` is the standard deviation of a coefficient about its form, per kind: for drag in
    1/frame, for pull and pair in units of the strength itself.
    """

    gamma: float = 1e-3
    g: float = 0.1
    k: float = 1.0
    drag_mass: float = 0.0
    pull_mass: float = -1.0
    pair_mass: float = -1.0
    pair_source: float = 0.0
    slack: tuple = (5e-4, 0.01, 0.01)

    FITTED = ("gamma", "g", "k", "drag_mass", "pull_mass", "pair_mass", "pair_source")


@dataclass(frozen=True, eq=False)
class Question:
    """One thing to be told: category, item, its options, and where it enters the patterns."""

    category: str
    item: str
    options: tuple


def questions_of(summary):
    """Questions that can be asked of a movie, in the wording of the questionnaire's table."""
    mats = tuple(dict.fromkeys(n[2] for n in summary.names if n[0] == "drag"))
    pairs = tuple(n[1:] for n in summary.names if n[0] == "pair" and _ordered(n))
    return (
        [Question("mass", c, tuple(MASS_NAMES.values())) for c in summary.present],
        [Question("friction", m, tuple(FRICTION_NAMES.values())) for m in mats],
        [Question("global", "global", tuple(DIRECTIONS))],
        [Question("pairwise", pair_item(a, b), tuple(PAIR_NAMES.values())) for a, b in pairs],
    )


ORDER = ("red", "blue", "yellow")


def _ordered(name):
    return ORDER.index(name[1]) <= ORDER.index(name[2])


def pair_item(a, b):
    """Name of a pair of colours in human.csv."""
    a, b = sorted((a, b), key=ORDER.index)
    return f"{a}-{b}"


def patterns(summary):
    """Unit patterns of the non-mass classes: three arrays [n_options, K] of 0, +-1 or class.

    Returns
    -------
    drag, pull, pair : lists of (choice tuple, ndarray (K,))
        All combinations of friction classes; of the pull; of the pair signs.
    """
    names = summary.names
    _, friction, _, pairs = questions_of(summary)
    drag, pull, pair = [], [], []
    for choice in itertools.product(CLASSES["friction"], repeat=len(friction)):
        value = dict(zip((q.item for q in friction), choice, strict=True))
        drag.append((choice, np.array([value[n[2]] if n[0] == "drag" else 0.0 for n in names])))
    for name, direction in DIRECTIONS.items():
        pull.append(
            ((name,), np.array([direction[n[2]] if n[0] == "pull" else 0.0 for n in names]))
        )
    for choice in itertools.product(PAIR_NAMES, repeat=len(pairs)):
        value = dict(zip((q.item for q in pairs), choice, strict=True))
        pair.append(
            (
                choice,
                np.array([value[pair_item(*n[1:])] if n[0] == "pair" else 0.0 for n in names]),
            )
        )
    return drag, pull, pair


def mass_factors(names, masses, constants):
    """Factor of each coefficient from the masses (dict colour -> mass), shape (K,)."""
    factor = []
    for kind, a, b in names:
        if kind == "drag":
            factor.append(masses[a] ** constants.drag_mass)
        elif kind == "pull":
            factor.append(masses[a] ** constants.pull_mass)
        else:
            factor.append(masses[a] ** constants.pair_mass * masses[b] ** constants.pair_source)
    return np.array(factor)


def _with_slack(gram, b, constant, slack):
    """The Gaussian likelihood with an independent deviation of each coefficient integrated out."""
    inner = np.linalg.inv(gram + np.diag(slack**-2.0))
    constant = constant + 0.5 * b @ inner @ b
    constant += 0.5 * np.linalg.slogdet(inner)[1] - np.sum(np.log(slack))
    kept = np.eye(len(b)) - inner @ gram
    return gram @ kept, kept.T @ b, constant


def softened(summary, masses, h, constants):
    """Likelihood of the coefficients under mass assignment `masses`, with slack."""
    names = summary.names
    # A strength may come out negative where hardly any movie shows that force; a spread may not.
    scale = {"drag": 1.0, "pull": abs(constants.g), "pair": abs(constants.k)}
    slack = np.array([constants.slack[KINDS.index(n[0])] * scale[n[0]] for n in names])
    factor = mass_factors(names, masses, constants)
    e = summary.evidence
    return (*_with_slack(e.gram[h], e.b[h], e.constant[h], slack), factor)


def joint(summary, constants):
    """Log likelihood of all combinations: array [masses, frictions, pulls, pairs]."""
    drag, pull, pair = patterns(summary)
    d = constants.gamma * np.array([p for _, p in drag])
    g = constants.g * np.array([p for _, p in pull])
    k = constants.k * np.array([p for _, p in pair])
    table = []
    for masses, h in summary.assignments:
        gram, b, constant, factor = softened(summary, masses, h, constants)
        parts = [x * factor for x in (d, g, k)]
        single = [x @ b - 0.5 * np.einsum("nk,kl,nl->n", x, gram, x) for x in parts]
        cross = [parts[0] @ gram @ parts[1].T, parts[0] @ gram @ parts[2].T,
                 parts[1] @ gram @ parts[2].T]  # fmt: skip
        table.append(
            constant
            + single[0][:, None, None] + single[1][None, :, None] + single[2][None, None, :]
            - cross[0][:, :, None] - cross[1][:, None, :] - cross[2][None, :, :]
        )  # fmt: skip
    return np.array(table)


def movie_table(summaries, constants, joint_of=joint):
    """Log likelihood of all combinations of a movie, the order of its mats integrated out."""
    return logsumexp([joint_of(s, constants) for s in summaries], axis=0) - np.log(len(summaries))


def answers(summary, table):
    """Marginal posterior of every askable item.

    Returns
    -------
    list of (category, item, dict answer -> probability)
    """
    log_p = table - logsumexp(table)
    p = np.exp(log_p)
    mass, friction, pull, pairs = questions_of(summary)
    drag_choices, pull_choices, pair_choices = ([c for c, _ in x] for x in patterns(summary))
    result = []
    per_mass = p.sum(axis=(1, 2, 3))
    for q in mass:
        values = {}
        for (masses, _), weight in zip(summary.assignments, per_mass, strict=True):
            name = MASS_NAMES[masses[q.item]]
            values[name] = values.get(name, 0.0) + weight
        result.append((q.category, q.item, values))
    for group, choices, axes, labels in (
        (friction, drag_choices, (0, 2, 3), FRICTION_NAMES),
        (pull, pull_choices, (0, 1, 3), {n: n for n in DIRECTIONS}),
        (pairs, pair_choices, (0, 1, 2), PAIR_NAMES),
    ):
        weights = p.sum(axis=axes)
        for k, q in enumerate(group):
            values = dict.fromkeys(labels.values(), 0.0)
            for choice, weight in zip(choices, weights, strict=True):
                values[labels[choice[k]]] += weight
            result.append((q.category, q.item, values))
    return result


def best_choice(summary, table):
    """Masses, h and unit patterns of the most probable combination."""
    m, f, g, k = np.unravel_index(np.argmax(table), table.shape)
    drag, pull, pair = patterns(summary)
    masses, h = summary.assignments[m]
    return masses, h, drag[f][1], pull[g][1], pair[k][1]


def rough_constants(fits):
    """Starting strengths from free fits alone: the strongest well-measured coefficients.

    `fits` is a list of (names, c, sd). With masses 1, 3, 9 the largest pull and pair
    coefficients belong to the light discs, the largest drag to the roughest mat.
    """
    pools = {kind: [] for kind in KINDS}
    for names, c, sd in fits:
        for name, value, error in zip(names, c, sd, strict=True):
            if abs(value) > 10 * error:
                pools[name[0]].append(abs(value))
    top = {kind: np.quantile(pool, 0.9) if pool else 1.0 for kind, pool in pools.items()}
    return Constants(gamma=top["drag"] / max(CLASSES["friction"]), g=top["pull"], k=top["pair"])


def learn(summaries, start, iterations=6):
    """Shared constants from unlabelled movies: assign the best classes, refit, repeat.

    Hard expectation-maximisation; each refit is a least-squares fit of the constants to the
    Gaussian likelihoods of the movies, robust (soft-L1) against single coefficients.

    Returns
    -------
    Constants, ndarray
        Fitted values and the standard errors of `Constants.FITTED`.
    """
    constants, errors = start, None
    for _ in range(iterations):
        before = constants
        choices = [best_choice(s, joint(s, constants)) for s in summaries]
        constants, errors = _refit(summaries, choices, constants)
        constants = replace(constants, slack=_slack(summaries, choices, constants))
        change = [abs(getattr(constants, n) - getattr(before, n)) for n in Constants.FITTED]
        if max(change) < 1e-4:
            break
    return constants, errors


def _predicted(summary, choice, constants):
    masses, _, drag, pull, pair = choice
    factor = mass_factors(summary.names, masses, constants)
    return factor * (constants.gamma * drag + constants.g * pull + constants.k * pair)


def _refit(summaries, choices, constants):
    """Constants by robust least squares on whitened coefficients."""
    kept = []
    for summary, choice in zip(summaries, choices, strict=True):
        gram, b, _, _ = softened(summary, choice[0], choice[1], constants)
        values, vectors = np.linalg.eigh(0.5 * (gram + gram.T))
        good = values > 1e-9 * max(values.max(), 1.0)
        root = np.sqrt(values[good])[:, None] * vectors[:, good].T
        kept.append((summary, choice, root, (vectors[:, good].T @ b) / np.sqrt(values[good])))

    def residuals(x):
        trial = replace(constants, **dict(zip(Constants.FITTED, x, strict=True)))
        return np.concatenate(
            [target - root @ _predicted(s, c, trial) for s, c, root, target in kept]
        )

    start = [getattr(constants, n) for n in Constants.FITTED]
    fit = least_squares(residuals, start, loss="soft_l1", f_scale=2.0, x_scale=np.maximum(
        np.abs(start), 0.1))  # fmt: skip
    scale = max(1.0, np.mean(np.minimum(fit.fun**2, 9.0)))
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * scale
    fitted = dict(zip(Constants.FITTED, map(float, fit.x), strict=True))
    return replace(constants, **fitted), np.sqrt(np.diag(covariance))


def _slack(summaries, choices, constants):
    """Spread of the coefficients about their forms that measurement error does not explain.

    Robust: 1.5 times the 0.8-quantile of what is left, over the Gaussian 0.8-quantile 1.28.
    """
    left = {kind: [] for kind in KINDS}
    scale = {"drag": 1.0, "pull": constants.g, "pair": constants.k}
    for summary, choice in zip(summaries, choices, strict=True):
        masses, h = choice[:2]
        prior = np.array([{"drag": 1e2, "pull": 1e2, "pair": 1.0}[n[0]] for n in summary.names])
        covariance = np.linalg.inv(summary.evidence.gram[h] + np.diag(prior))
        c = covariance @ summary.evidence.b[h]
        off = np.abs(c - _predicted(summary, choice, constants))
        for name, value, error in zip(
            summary.names, off, np.sqrt(np.diag(covariance)), strict=True
        ):
            unit = 1.0 if name[0] == "drag" else scale[name[0]]
            tight = {"drag": 2e-3, "pull": 0.02, "pair": 0.02}[name[0]]
            if error / unit < tight:
                left[name[0]].append(np.sqrt(max(value**2 - error**2, 0.0)) / unit)
    floor = (1e-4, 1e-3, 1e-3)
    return tuple(
        float(max(floor[k], 1.5 * np.quantile(left[kind], 0.8) / 1.28)) if left[kind] else
        (5e-4, 0.01, 0.01)[k]
        for k, kind in enumerate(KINDS)
    )  # fmt: skip


STRENGTH_RANGE = {"drag": (3e-5, 3e-2), "pull": (3e-3, 3.0), "pair": (3e-2, 30.0)}
"""Row B: each strength is log-uniform over three decades (per class unit, px, frames)."""


def joint_free(summary, constants):
    """Like `joint`, with the three strengths unknown in every movie (forms as in `constants`).

    The likelihood is Gaussian in the strengths of each combination; their log-uniform priors are
    integrated by Laplace's rule about the best strengths allowed.
    """
    drag, pull, pair = patterns(summary)
    units = [np.array([p for _, p in x]) for x in (drag, pull, pair)]
    table = []
    for masses, h in summary.assignments:
        # Slack of an unknown strength: in proportion to the largest that the forms allow.
        gram, b, constant, factor = softened(summary, masses, h, constants)
        parts = [x * factor for x in units]
        linear = [x @ b for x in parts]
        own = [np.einsum("nk,kl,nl->n", x, gram, x) for x in parts]
        shape = tuple(len(x) for x in parts)
        bb = np.stack(np.broadcast_arrays(
            linear[0][:, None, None], linear[1][None, :, None], linear[2][None, None, :]
        ), axis=-1)  # fmt: skip
        a = np.zeros((*shape, 3, 3))
        a[..., 0, 0] = own[0][:, None, None]
        a[..., 1, 1] = own[1][None, :, None]
        a[..., 2, 2] = own[2][None, None, :]
        a[..., 0, 1] = a[..., 1, 0] = (parts[0] @ gram @ parts[1].T)[:, :, None]
        a[..., 0, 2] = a[..., 2, 0] = (parts[0] @ gram @ parts[2].T)[:, None, :]
        a[..., 1, 2] = a[..., 2, 1] = (parts[1] @ gram @ parts[2].T)[None, :, :]
        used = np.stack(np.broadcast_arrays(*(
            np.abs(u).max(axis=1).reshape([-1 if i == k else 1 for i in range(3)]) > 0
            for k, u in enumerate(units)
        )), axis=-1)  # fmt: skip
        table.append(constant + _integrated(a.reshape(-1, 3, 3), bb.reshape(-1, 3),
                                            used.reshape(-1, 3)).reshape(shape))  # fmt: skip
    return np.array(table)


def _integrated(a, b, used, rounds=12):
    """log of the integral over strengths s of exp(b s - s a s / 2) with log-uniform priors.

    Coordinate ascent within the allowed range; Laplace's rule in each used strength, with its
    weight cut at one where the data say little.
    """
    low, high = (np.array([STRENGTH_RANGE[k][i] for k in KINDS]) for i in (0, 1))
    diagonal = np.maximum(np.einsum("nkk->nk", a), 1e-12)
    s = np.clip(b / diagonal, low, high) * used
    for _ in range(rounds):
        for k in range(3):
            rest = b[:, k] - np.einsum("nj,nj->n", a[:, k], s) + a[:, k, k] * s[:, k]
            s[:, k] = np.where(used[:, k], np.clip(rest / diagonal[:, k], low[k], high[k]), 0.0)
    value = np.einsum("nk,nk->n", b, s) - 0.5 * np.einsum("nk,nkl,nl->n", s, a, s)
    width = np.sqrt(2 * np.pi / diagonal) / np.maximum(s, low)
    weight = np.minimum(width / np.log(high / low), 1.0)
    return value + np.sum(np.where(used, np.log(weight), 0.0), axis=1)
