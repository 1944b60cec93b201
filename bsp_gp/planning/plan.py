"""Which experiment tells most about which of several laws holds.

What a law predicts for the rows of an experiment is normal: its mean is the motion under the best
constants, its covariance that of the noise and of the motion under constants as they may be. The
information is that between the law and the rows, by Monte Carlo over rows that the laws foresee;
*none of these* is one of them, whose rows lie about those of the others as far as these lie apart
and a part of what forces do beyond.
"""

from dataclasses import dataclass, field

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.masses import with_unit_masses
from bsp_gp.planning.means import moved
from bsp_gp.planning.reach import n_calm, n_foreseen, nearest
from bsp_gp.planning.rivals import rivals_of
from bsp_gp.randomness import generator

NONE = 0.05
"""Chance, beforehand, that none of the rivals holds."""
FOREIGN = 0.1
"""Part of what forces do by which a foreign one may differ."""
N_DRAWS = 12
"""Constants of a law as they may be."""
N_ROWS = 64
"""Rows that a law may lead to."""
SUBSTEPS = 24
FARTHEST = 1e5
"""Standard deviations of the noise."""
SURE = 0.95
"""A rival so probable stands."""
NOTHING = 0.02
"""Bits: experiments that promise less part nothing."""


@dataclass(frozen=True, eq=False)
class Option:
    """An experiment and what it promises.

    Attributes
    ----------
    experiment : Experiment
    bits : float
        Expected information about which law holds, or about the constant that was asked for.
    power : float
        Chance that the right law is more than 95 % probable afterwards.
    apart : ndarray, shape (H, H)
        Standard deviations by which the rows of two laws lie apart.
    """

    experiment: object
    bits: float
    power: float
    apart: np.ndarray


@dataclass(frozen=True, eq=False)
class Plan:
    """The best experiments within some means.

    Attributes
    ----------
    options : tuple of Option
        The best first.
    rivals : tuple of Rival
    inseparable : tuple of (str, str)
        Pairs that no experiment within the means parts.
    about : str
        The constant that was asked for; "" = which law.
    """

    options: tuple
    rivals: tuple
    inseparable: tuple = ()
    about: str = ""
    n_tried: int = field(default=0)

    @property
    def is_worth_it(self):
        """Whether the best experiment is expected to tell anything."""
        return bool(self.options) and self.options[0].bits > NOTHING

    def to_dict(self):
        """For a file: JSON with plain numbers."""
        return {
            "about": self.about or "law", "n_tried": self.n_tried,
            "rivals": [{"law": r.text, "probability": r.probability} for r in self.rivals],
            "experiments": [
                {"bits": o.bits, "power": o.power, **o.experiment.to_dict()} for o in self.options
            ],
            "inseparable": [list(pair) for pair in self.inseparable],
        }  # fmt: skip


def plan(rivals, means, *, rng=None, about="", n_tried=96, n_told=5, up=None):
    """The experiments within means that tell most.

    Parameters
    ----------
    rng : numpy.random.Generator, int or None
    about : str
        A constant of the likeliest law about which something is asked, in place of which law.
    n_tried : int
        Experiments that are looked at, a third of them near the best of the others.
    n_told : int
    up : str, optional
        Axis that points up.

    Raises
    ------
    SettingsError
        If there is no rival, or the constant is none of the likeliest law.
    """
    if not rivals:
        raise SettingsError("there is no law to plan for; close the loop on some data first")
    if about and about not in rivals[0].names:
        raise SettingsError(
            f"the likeliest law has no uncertain constant {about!r}; it has "
            f"{', '.join(rivals[0].names) or 'none'}"
        )
    draw_rng, move_rng, rng = generator(rng).spawn(3)
    chosen = rivals[:1] if about else rivals
    seed = int(rng.integers(2**62))

    def judged(experiments):
        """Every experiment on the same draws, so that they differ by themselves alone."""
        streams = np.random.default_rng(seed).spawn(2)
        draws = [r.draws(streams[0], N_DRAWS) for r in chosen]
        seen = foreseen(chosen, draws, experiments, means, streams[0], up)
        asked = draws[0][about] if about else None
        return [
            _option(e, chosen, *one, streams[1].spawn(1)[0], asked)
            for e, one in zip(experiments, seen, strict=True)
        ]

    n_first = max(n_tried - n_tried // 3, 1)
    options = judged([means.draw(draw_rng) for _ in range(n_first)])
    for _ in range(3):
        options.sort(key=lambda o: -o.bits)
        near = [moved(o.experiment, means, move_rng) for o in options[:4]]
        near = [moved(e, means, move_rng) for e in near for _ in range(max(n_tried // 36, 1))]
        options += judged(near)
    options.sort(key=lambda o: -o.bits)
    apart = np.max([o.apart for o in options], axis=0)
    inseparable = tuple(
        (chosen[a].text, chosen[b].text)
        for a in range(len(chosen)) for b in range(a) if apart[a, b] < 1.0
    )  # fmt: skip
    return Plan(tuple(options[:n_told]), tuple(rivals), inseparable, about, len(options))


def next_experiment(report, means, **settings):
    """`plan` for the rivals that a report holds; see there."""
    return plan(rivals_of(report), means, up=report.dataset.get("up"), **settings)


def foreseen(rivals, draws, experiments, means, rng, up=None):
    """What laws predict for the rows of experiments.

    Parameters
    ----------
    draws : sequence of dict
        Constants of each as they may be, the best first.
    rng : numpy.random.Generator
        Of the errors with which bodies are put and set off.

    Returns
    -------
    list of (ndarray (H, D, n), ndarray (n,), ndarray (n,))
        Per experiment: coordinates under every law and draw of its constants (the best first;
        beyond the range of numbers: nan), those of no force, and the noise's standard deviation.
    """
    scenes = with_unit_masses_of(experiments)
    tracks = np.stack([
        moved_by(r.law, d, scenes, means, rng, up) for r, d in zip(rivals, draws, strict=True)
    ])  # fmt: skip
    free = moved_by(ForceLaw((), {}), {}, scenes, means, rng, up)[0]
    out = []
    for k in range(len(experiments)):
        rows, straight = tracks[:, :, 1:, k], free[1:, k]
        count = _n_foreseeable(tracks[0, :, :, k], free[:, k], scenes[k])
        rows[:, :, count:], straight[count:] = 0.0, 0.0  # alike under all laws
        rows = rows.reshape(*rows.shape[:2], -1)
        sigma = means.sigma(np.nan_to_num(rows[:, 0].mean(axis=0)))
        sigma = np.maximum(sigma, 1e-9 * (np.nanmax(np.abs(rows)) if rows.size else 1.0))
        out.append((rows, straight.reshape(-1), sigma))
    return out


def _n_foreseeable(track, free, scene):
    """Rows behind the first that fits can use: which the likeliest law foresees, or are calm.

    `track` has moving bodies under draws of the constants, (D, T, R, d), the best first.
    """
    still = np.delete(scene.positions[:1], scene.dynamic, axis=1)
    bodies = np.concatenate([track[0], np.repeat(still, track.shape[1], axis=0)], axis=1)
    near = nearest(bodies, range(track.shape[2]))
    departure = np.linalg.norm(track[0] - free, axis=-1).max(axis=1)
    return max(n_foreseen(track, near), n_calm(departure, near), 1) - 1


def with_unit_masses_of(experiments):
    """Scenes of experiments; bodies of unknown mass have the mass 1."""
    return [with_unit_masses(e.scene(f"e{k}")) for k, e in enumerate(experiments)]


def moved_by(law, draws, scenes, means, rng, up=None):
    """Tracks (D, T, E, R, d) of the moving bodies under draws of the constants."""
    (batch,) = stack(scenes, up)
    values = law.values(batch.bodies)
    count = max((len(value) for value in draws.values()), default=N_DRAWS)
    for name, value in draws.items():
        values["field"][name] = value[:, None, None]
        values["pair"][name] = value[:, None, None, None]
    receivers = batch.bodies.receivers
    p = np.stack([s.positions[0, s.dynamic] for s in scenes])
    v = np.stack([s.first.velocity[s.dynamic] for s in scenes])
    p, v = (np.repeat(a[None], count, axis=0) for a in (p, v))
    for state, error in zip((p, v), means.errors, strict=True):
        state[1:] += error * rng.standard_normal(state[1:].shape)
    track = rollout(law, batch, p, v, substeps=SUBSTEPS, values=values)
    shape = (count, len(batch.times), len(scenes), len(receivers), p.shape[-1])
    return np.moveaxis(track, 0, 1).reshape(shape)


def normals(rows, free, sigma):
    """Mean (n,) and root of the covariance (n, n) of every law's rows, and of none of these."""
    means_, roots = [], []
    for one in rows:
        one = one[np.isfinite(one).all(axis=1)]
        best = one[0]
        spread = _bounded((one[1:] - best) / np.sqrt(max(len(one) - 1, 1)), sigma)
        means_.append(best)
        roots.append(np.linalg.cholesky(np.diag(sigma**2) + spread.T @ spread))
    means_ = np.array(means_)
    middle = means_.mean(axis=0)
    apart = (means_ - middle) / np.sqrt(len(means_))
    force = means_ - free
    spread = _bounded(np.concatenate([apart, FOREIGN * force / np.sqrt(len(means_))]), sigma)
    own = np.diag(sigma**2 + _bounded(FOREIGN * np.abs(force).mean(axis=0), sigma) ** 2)
    roots.append(np.linalg.cholesky(own + spread.T @ spread))
    return np.vstack([means_, middle]), np.stack(roots)


def _bounded(moves, sigma):
    """Moves as far as covariances can hold them beside the noise; farther off tells no more."""
    return np.clip(moves, -FARTHEST * sigma, FARTHEST * sigma)


def log_densities(y, centres, roots):
    """Log densities of rows (k, n) under every normal, (H, k)."""
    out = []
    for centre, root in zip(centres, roots, strict=True):
        white = np.linalg.solve(root, (y - centre).T)
        out.append(-0.5 * np.square(white).sum(axis=0) - np.log(np.diag(root)).sum())
    return np.array(out)


def weights_of(rivals):
    """Probabilities with that of none of these, (H + 1,)."""
    given = np.array([r.probability for r in rivals])
    return np.append((1 - NONE) * given / given.sum(), NONE)


def information(weights, centres, roots, rng, count=N_ROWS):
    """Bits that rows tell of the law, and the chance that the right one is sure afterwards.

    Parameters
    ----------
    weights : ndarray, shape (H,)
    centres, roots : ndarray, shapes (H, n) and (H, n, n)
        Of the normals that the laws foresee.
    count : int
        Rows per law.

    Returns
    -------
    (float, float)
    """
    bits, power, kept = 0.0, 0.0, weights > 0
    weights, centres, roots = weights[kept], centres[kept], roots[kept]
    half = rng.standard_normal((count // 2, centres.shape[1]))
    white = np.concatenate([half, -half])
    for k, weight in enumerate(weights):
        y = centres[k] + white @ roots[k].T
        posterior = log_densities(y, centres, roots) + np.log(weights)[:, None]
        posterior -= posterior.max(axis=0)
        share = posterior[k] - np.log(np.exp(posterior).sum(axis=0))
        bits += weight * float(np.mean(share) - np.log(weight))
        power += weight * float(np.mean(np.exp(share) > SURE))
    return max(bits / np.log(2), 0.0), power


def _option(experiment, rivals, rows, free, sigma, rng, asked):
    """An experiment judged; one that leads out of the range of numbers tells nothing."""
    count = len(rivals)
    with np.errstate(invalid="ignore", over="ignore"):  # what is out of range is looked at next
        rows, free, sigma = rows / sigma, free / sigma, np.ones_like(sigma)  # squares of far rows
    if not np.isfinite(rows[:, 0]).all() or not np.isfinite(free).all():
        return Option(experiment, 0.0, 0.0, np.zeros((count, count)))
    centres, roots = normals(rows, free, sigma)
    gaps = np.zeros((count, count))
    for a in range(count):
        for b in range(a):
            both = roots[a] @ roots[a].T + roots[b] @ roots[b].T
            gap = centres[a] - centres[b]
            gaps[a, b] = gaps[b, a] = np.sqrt(gap @ np.linalg.solve(both / 2, gap))
    if asked is not None:
        return Option(experiment, _bits_about(asked, rows[0], sigma), np.nan, gaps)
    bits, power = information(weights_of(rivals), centres, roots, rng)
    return Option(experiment, bits, power, gaps)


def _bits_about(values, rows, sigma):
    """Bits about a constant: by how much the error of the best linear guess of it falls."""
    able = np.isfinite(rows).all(axis=1)
    moves, rows = values[able] - values[able].mean(), (rows[able] - rows[able].mean(axis=0)) / sigma
    inner = rows @ rows.T / len(moves)  # in the space of the draws
    left = moves @ np.linalg.solve(np.eye(len(moves)) + inner, moves) / (moves @ moves)
    return float(-0.5 * np.log2(np.clip(left, 1e-12, 1.0)))
