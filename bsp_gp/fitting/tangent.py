"""A fit linearised: what a cause would change, beside everything that is free, is a column.

With the whitened residual r and the projection Q beside initial states and constants, columns C
have the score ``S = (C'Qr)' (C'QC)+ (C'Qr)``, chi-squared with their rank as degrees of freedom
under the fitted law (Rao 1948), amplitudes ``(C'QC)+ C'Qr``, and an expected signal-to-noise ratio
from ``C'QC`` (LOOP §3). Forces have columns through `bsp_gp.fitting.response`.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import stats
from scipy.special import chdtrc, gammaln

from bsp_gp.fitting.channels import join
from bsp_gp.fitting.shooting import Shooting, cut_windows
from bsp_gp.fitting.tracks import ChainNoise
from bsp_gp.fitting.weighing import as_normal
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion

ENDLESS = 1e100
"""Changes of a track, metres for each unit of a number, beyond which they are none."""
INDEPENDENT = 1e-9
"""Part of the length of a column, squared, that must lie beyond all that is free."""
STEP_ERROR = 0.02
"""Error of the integration of columns over a whole track, in standard deviations of a position."""


@dataclass(frozen=True)
class Score:
    """Score of some columns.

    Attributes
    ----------
    statistic : float
        Chi-squared that they would gain.
    amplitudes, errors : ndarray, shape (c,)
        inf errors where the data determine nothing.
    p_value : float
        Of these columns alone.
    covariance : ndarray, shape (c, c)
        Of the amplitudes, as far as the data determine them.
    """

    statistic: float
    rank: int
    amplitudes: np.ndarray
    errors: np.ndarray
    p_value: float
    covariance: np.ndarray


class Tangent:
    """The tangent of a fit.

    Attributes
    ----------
    residual : ndarray, shape (n,)
        Whitened, everything free projected out; chain by chain, rows (T, channels of the chain).
    chains : list of ndarray of int
        Channels of each chain.
    own : list of ndarray, shape (q, n of the chain)
        Orthonormal whitened changes by its initial states.
    """

    def __init__(self, fit):
        self.fit = fit = as_normal(fit)
        channels = fit.channels
        self.whitener = fit.noise.whitener(channels)
        self.chains = [np.flatnonzero(channels.chain == c) for c in np.unique(channels.chain)]
        own = self._whitened(fit.local_columns)
        rows = [own[:, :, index] for index in self.chains]
        self.own = [_basis(r.reshape(len(r), r.shape[1] * r.shape[2])) for r in rows]
        self._shared = _basis(self._less_own(self._whitened(fit.shared_columns)))
        whole = np.where(np.isfinite(fit.residual), fit.residual, 0.0)
        self.residual = self.projected(whole[None])[0]

    def _whitened(self, columns):
        seen = self.fit.channels.seen
        return self.whitener.whiten(np.where(seen, np.nan_to_num(columns), 0.0))

    def _less_own(self, white):
        """Whitened columns (c, T, C) less what initial states can take up, (c, n)."""
        parts = []
        for index, basis in zip(self.chains, self.own, strict=True):
            part = white[:, :, index].reshape(len(white), white.shape[1] * len(index))
            parts.append(part - (part @ basis.T) @ basis)
        return np.concatenate(parts, axis=1)

    def projected(self, columns):
        """Columns (c, T, C), metres, whitened and beside everything free, (c, n)."""
        rows = self._less_own(self._whitened(columns))
        return rows - (rows @ self._shared.T) @ self._shared

    def noise(self, rng, count):
        """Residuals that noise alone would leave, (count, n)."""
        draws = rng.standard_normal((count, *self.fit.channels.seen.shape))
        rows = self._less_own(draws * self.fit.channels.seen)
        return rows - (rows @ self._shared.T) @ self._shared

    @cached_property
    def noise_dof(self):
        """Degrees of freedom behind the level of the noise; inf where it is known."""
        fit = self.fit
        return float(max(fit.n_rows - fit.n_free, 1)) if fit.noise.is_free.any() else np.inf

    def score(self, columns):
        """Score columns (c, T, C), metres per unit of a cause's strength."""
        whitened = self._whitened(columns)
        size = np.square(whitened).sum(axis=(1, 2))
        rows = self.projected(columns)
        return score_of(rows, self.residual, size, self.noise_dof)


def instrument_columns(fit, part):
    """What a part changes of the tracks of a fit per unit of each of its numbers, (c, T, C)."""
    return columns_beside(fit, (*fit.law.frame, part), dict.fromkeys(part.names, 0.0))


def columns_beside(fit, frame, constants):
    """What further constants change of the tracks of a fit per unit of each, (c, T, C).

    Parameters
    ----------
    frame : tuple of Part
        Of its law, with the constants in it.
    constants : dict of str to float
        With which tracks are as they are.
    """
    law = replace(fit.law, frame=frame, constants={**fit.law.constants, **constants})
    parameters = (*fit.parameters, *((name, "") for name in constants))
    values = np.concatenate([fit.values, list(constants.values())])
    level, out = STEP_ERROR * np.nanmin(fit.noise.levels), []
    for chains, nodes in zip(fit.groups, fit.nodes, strict=True):
        motion = Motion(law, chains, parameters)
        motion.set_constants(values)
        flow = Flow(motion, level / np.maximum(chains.lengths, 1), fit.paper_steps)
        plain = ChainNoise(chains.times, np.ones(chains.observed.shape))
        shooting = Shooting(flow, plain, cut_windows(chains.lengths))
        condensed = shooting.linearise(values, nodes, flow.quick_mesh(nodes))[-1]
        out.append(shooting.columns(condensed, flow.n_state)[1][len(fit.values) :])
    columns = np.nan_to_num(join(out))
    # Friction that is seen through an instrument has no events: what it makes endless says nothing.
    is_lost = (np.abs(columns) > ENDLESS).any(axis=(1, 2), keepdims=True)
    return np.where(is_lost, 0.0, columns)


def score_of(rows, residual, size, noise_dof=np.inf):
    """Score projected columns (c, n) that had the squared sizes (c,) before projection."""
    length = np.sqrt(np.where(size > 0, size, 1.0))
    unit = rows / length[:, None]
    values, vectors = np.linalg.eigh(unit @ unit.T)
    used = values > INDEPENDENT
    turned = vectors[:, used].T @ (unit @ residual)
    statistic = float(np.square(turned) @ (1 / values[used])) if used.any() else 0.0
    amplitudes = vectors[:, used] @ (turned / values[used]) / length
    covariance = (vectors[:, used] / values[used]) @ vectors[:, used].T / np.outer(length, length)
    errors = np.sqrt(np.diag(covariance))
    lost = np.square(vectors[:, ~used]).sum(axis=1) > 1e-6
    rank = int(used.sum())
    return Score(
        statistic, rank, amplitudes, np.where(lost, np.inf, errors),
        p_of_gain(statistic, rank, noise_dof), covariance,
    )  # fmt: skip


def p_of_gain(gain, rank, noise_dof=np.inf):
    """Chance that noise alone gains so much chi-squared in so many directions."""
    if not rank:
        return np.ones_like(gain, dtype=float)[()]
    if np.isfinite(noise_dof):
        return stats.f.sf(np.asarray(gain) / rank, rank, noise_dof)
    return stats.chi2.sf(gain, rank)


def as_pair(gain, rank):
    """The gain in two directions that is as unlikely as this one in `rank` of them."""
    gain, half = np.asarray(gain, dtype=float), np.asarray(rank) / 2
    with np.errstate(divide="ignore", invalid="ignore"):
        near = np.log(chdtrc(rank, gain))
        # Where the chance itself is no longer a number: the upper incomplete gamma far out.
        x = gain / 2
        far = half * np.log(x) - x - np.log(x - half + 1) - gammaln(half)
        return np.where(np.isfinite(near), -2 * near, -2 * far)


def _basis(rows):
    """Orthonormal rows that span rows (k, n)."""
    size = np.linalg.norm(rows, axis=1)
    rows = rows[size > 0] / size[size > 0, None]
    if not len(rows):
        return rows
    _, s, basis = np.linalg.svd(rows, full_matrices=False)
    return basis[s > 1e-7 * s[0]]
