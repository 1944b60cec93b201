"""Motion with unknown contact impulses as a linear Gaussian model: one pass, all hypotheses.

Between contacts a body obeys x'' = sum_k c_k phi_k with known *feature* accelerations phi_k (drag
on a mat, a uniform pull, a pull towards another body, ...) and unknown coefficients c_k. During
a contact an impulse of unknown size acts along the normal: on one body at a wall, equal and
opposite on two touching bodies. Positions are observed with noise. Everything is linear in the
positions, the velocities, the impulses and the coefficients, so that a Kalman filter carrying
one column for the data and one for each feature (de Jong 1991, "The diffuse Kalman filter",
Annals of Statistics 19) gives the exact Gaussian likelihood of *all* coefficients at once, as a
Gram matrix. No acceleration is ever measured by differencing: the features are integrated twice.
What is often thrown away is kept: the motion along a wall while a body slides on it, and the
motion of the common centre of mass while two bodies touch. Masses enter through the recoil only;
they are hypotheses, run side by side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class MotionNoise:
    """Standard deviations of the linear Gaussian model, in lengths and frames.

    Attributes
    ----------
    position : float
        Of an observed coordinate.
    velocity : float
        Of the random change of a velocity in one frame, for whatever the features leave out.
    normal, tangential : float
        Of the change of the velocity of approach by a contact in one frame, along its normal and
        across it.
    wall_tangential : float
        Of the change of a velocity along a wall by a contact with it.
    event : float
        Of a velocity change in a frame that was marked as unexplained.
    """

    position: float = 0.35
    velocity: float = 2e-3
    normal: float = 5.0
    tangential: float = 0.05
    wall_tangential: float = 0.05
    event: float = 5.0


@dataclass(frozen=True, eq=False)
class Contacts:
    """Which bodies may touch what between frame t and t + 1.

    Attributes
    ----------
    pairs : sequence over t of sequences of (i, j, normal)
        Touching bodies and the unit vector from i to j, shape (2,).
    walls : bool ndarray, shape (T, N, 2)
        Contact with a wall whose normal is along that axis.
    slip : ndarray, shape (T, N, 2)
        Standard deviation of the position after a contact frame (a simulator may hold a body
        for a part of the step), lengths.
    events : bool ndarray, shape (T, N)
        Frames in which nothing is believed about the body's velocity.
    """

    pairs: tuple
    walls: np.ndarray
    slip: np.ndarray
    events: np.ndarray


@dataclass(frozen=True, eq=False)
class Evidence:
    """Log likelihood of the coefficients, for each of H mass hypotheses.

    log p(data | c, h) = constant[h] + b[h] · c - c · gram[h] · c / 2

    Attributes
    ----------
    gram : ndarray, shape (H, K, K)
    b : ndarray, shape (H, K)
    constant : ndarray, shape (H,)
    innovations : ndarray, shape (H, T, N, 2, 1 + K)
        Innovations over their standard deviations: data column, then the features.
    """

    gram: np.ndarray
    b: np.ndarray
    constant: np.ndarray
    innovations: np.ndarray

    def residuals(self, coefficients, h=0):
        """Normalised innovations for given coefficients, shape (T, N, 2); nearly N(0, 1)."""
        return self.innovations[h, ..., 0] + self.innovations[h, ..., 1:] @ coefficients

    def estimate(self, h=0, ridge=1e-9):
        """Best coefficients and their covariance under hypothesis `h`, shapes (K,), (K, K)."""
        gram = self.gram[h] + ridge * np.eye(len(self.b[h]))
        covariance = np.linalg.inv(gram)
        return covariance @ self.b[h], covariance


def _impulse_noise(contacts, t, masses, noise):
    """Covariance of the velocity changes in frame t, shape (H, 2N, 2N)."""
    n_hypotheses, n = masses.shape
    q = np.zeros((n_hypotheses, n, 2, n, 2))
    body = np.arange(n)
    for axis in (0, 1):
        q[:, body, axis, body, axis] += noise.velocity**2
        touching = contacts.walls[t, :, axis]
        q[:, body, axis, body, axis] += noise.normal**2 * touching
        q[:, body, 1 - axis, body, 1 - axis] += noise.wall_tangential**2 * touching
        q[:, body, axis, body, axis] += noise.event**2 * contacts.events[t]
    for i, j, normal in contacts.pairs[t]:
        across = np.array([-normal[1], normal[0]])
        for direction, sd in ((normal, noise.normal), (across, noise.tangential)):
            recoil = np.zeros((n_hypotheses, n, 2))
            total = masses[:, i] + masses[:, j]
            recoil[:, i] = (masses[:, j] / total)[:, None] * direction
            recoil[:, j] = -(masses[:, i] / total)[:, None] * direction
            q += sd**2 * recoil[:, :, :, None, None] * recoil[:, None, None]
    return q.reshape(n_hypotheses, 2 * n, 2 * n)


def motion_evidence(positions, features, contacts, masses, noise):
    """Run the filter once and return the Gaussian likelihood of all coefficients.

    Parameters
    ----------
    positions : ndarray, shape (T, N, 2)
        nan where a body was not seen.
    features : ndarray, shape (T, N, 2, K)
        Accelerations for a coefficient of one, lengths per frame²; row t acts from t to t + 1.
    contacts : Contacts
    masses : ndarray, shape (H, N)
        Hypotheses; only ratios matter.
    noise : MotionNoise

    Returns
    -------
    Evidence
    """
    n_times, n = positions.shape[:2]
    n_features = features.shape[3]
    n_hypotheses = len(masses)
    dim = 2 * n
    observed = positions.reshape(n_times, dim)
    inputs = features.reshape(n_times, dim, n_features)
    first = _first_seen(positions).reshape(dim)
    mean = np.zeros((n_hypotheses, 2 * dim, 1 + n_features))  # rows: places, then velocities
    mean[:, :dim, 0] = first
    eye = np.eye(2 * dim)
    spread = np.repeat([100.0, 50.0], dim)  # wide beside any track in px and frames
    p = np.broadcast_to(np.diag(spread**2), (n_hypotheses, 2 * dim, 2 * dim)).copy()
    step = eye.copy()
    step[:dim, dim:] = np.eye(dim)
    # Half of an impulse or input acts before the step and half after it, as in a leapfrog.
    enters = np.concatenate([0.5 * np.eye(dim), np.eye(dim)])
    gram = np.zeros((n_hypotheses, 1 + n_features, 1 + n_features))
    logdet = np.zeros(n_hypotheses)
    innovations = np.zeros((n_hypotheses, n_times, dim, 1 + n_features))
    n_seen = 0
    for t in range(n_times):
        seen = np.flatnonzero(np.isfinite(observed[t]))
        if len(seen):
            e = -mean[:, seen]
            e[:, :, 0] += observed[t, seen]
            s = p[:, seen][:, :, seen] + np.eye(len(seen)) * noise.position**2
            inverse = np.linalg.inv(s)
            half = inverse @ e
            gram += np.swapaxes(e, 1, 2) @ half
            logdet += np.linalg.slogdet(s)[1]
            n_seen += len(seen)
            scale = np.sqrt(np.einsum("hii->hi", s))
            innovations[:, t, seen] = e / scale[:, :, None]
            columns = p[:, :, seen]
            mean = mean + columns @ half
            gain = columns @ inverse
            # Joseph's form: stays positive over thousands of frames with wide impulses.
            kept = np.broadcast_to(eye, p.shape).copy()
            kept[:, :, seen] -= gain
            p = kept @ p @ np.swapaxes(kept, 1, 2)
            p += noise.position**2 * (gain @ np.swapaxes(gain, 1, 2))
        q = _impulse_noise(contacts, t, masses, noise)
        mean = step @ mean
        mean[:, :, 1:] += enters @ inputs[t]
        p = step @ p @ step.T + enters @ q @ enters.T
        p[:, np.arange(dim), np.arange(dim)] += contacts.slip[t].reshape(dim) ** 2
        p = 0.5 * (p + np.swapaxes(p, 1, 2))
    constant = -0.5 * (gram[:, 0, 0] + logdet + n_seen * np.log(2 * np.pi))
    return Evidence(
        gram[:, 1:, 1:],
        -gram[:, 1:, 0],
        constant,
        innovations.reshape(n_hypotheses, n_times, n, 2, 1 + n_features),
    )


def _first_seen(positions):
    """First known position of each body, shape (N, 2)."""
    filled = np.zeros(positions.shape[1:])
    for k in range(positions.shape[1]):
        known = np.flatnonzero(np.isfinite(positions[:, k, 0]))
        if len(known):
            filled[k] = positions[known[0], k]
    return filled
