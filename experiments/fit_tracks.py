"""Tracks of known laws without the package's engine, and how well they determine constants.

Positions come from closed forms or from scipy's eighth-order integrator at 1e-12. The Cramér-Rao
bound comes from central differences of these tracks in constants and initial states, whitened, with
the states of every scene eliminated.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Scene
from bsp_gp.units import UnitSystem

SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
RTOL = 1e-12
RTOL_COPIES = 1e-10
"""Copies share their steps, so that the errors of these cancel in differences."""
STEP = 3e-7
"""Of central differences, in sizes of constants and tracks; larger ones miss some bounds."""


@dataclass(frozen=True, eq=False)
class Shot:
    """One scene: when it was seen, how it began, how well each point was seen.

    Attributes
    ----------
    times : ndarray, shape (T,), s
    states : ndarray, shape (2, R, d)
        Positions and velocities at the first time; d = 1 is motion along x.
    sigma : ndarray that broadcasts to (T, R, d), m
    """

    times: np.ndarray
    states: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class World:
    """A law with the truth of it.

    Attributes
    ----------
    kind : str
    laws : tuple of str
        As a user types them.
    truth : dict of str to float
        Every constant of the laws, SI.
    entities : tuple of Entity
        The R that move, then the fixed ones.
    shots : tuple of Shot
    track : callable
        ``track(times, constants, states) -> positions``: constants a dict of arrays (B,), states
        (B, 2, R, d), positions (B, T, R, d).
    noise : str
        "declared", "quoted" or "estimated".
    fixed : sequence of places of the entities at rest, m
    mirror : tuple of str
        Constants that may all change their sign together without any change of the track.
    starts, bounds : dict
        What the fit is told.
    facts : dict
        What tells this world, for the table.
    up : str or None
    """

    kind: str
    laws: tuple
    truth: dict
    entities: tuple
    shots: tuple
    track: Callable
    noise: str = "declared"
    fixed: tuple = ()
    mirror: tuple = ()
    starts: dict = field(default_factory=dict)
    bounds: dict = field(default_factory=dict)
    facts: dict = field(default_factory=dict)
    up: str | None = None

    @property
    def values(self):
        """The true constants, in the order of `truth`."""
        return np.array(list(self.truth.values()))


def integrated(acceleration, accuracy=None):
    """A track function of an equation of motion.

    Parameters
    ----------
    acceleration : callable
        ``acceleration(t, p, v, constants)``: p, v of shape (B, R, d), constants a dict of arrays
        (B, 1, 1); returns (B, R, d).
    accuracy : float, optional
        Relative; by default the best that doubles allow.
    """

    def track(times, constants, states):
        columns = {name: np.reshape(c, (-1, 1, 1)) for name, c in constants.items()}

        def slope(t, flat):
            p, v = np.moveaxis(flat.reshape(states.shape), 1, 0)
            return np.stack([v, acceleration(t, p, v, columns)], axis=1).ravel()

        span = times[-1] - times[0]
        rtol = accuracy or (RTOL if len(states) == 1 else RTOL_COPIES)
        size_p, size_v = np.abs(states[:, 0]).max(), np.abs(states[:, 1]).max()
        sizes = np.broadcast_to(
            np.reshape([size_p + size_v * span * STEP, size_v + size_p / span], (2, 1, 1)),
            states.shape,
        )
        with np.errstate(all="ignore"):  # bodies that meet are told of by the integrator
            found = solve_ivp(
                slope, (times[0], times[-1]), states.ravel(), method="DOP853", t_eval=times,
                rtol=rtol, atol=rtol * sizes.ravel(),
            )  # fmt: skip
        if not found.success:
            raise ArithmeticError(f"the true track was not integrated: {found.message}")
        return np.moveaxis(found.y.reshape(*states.shape, -1)[:, 0], -1, 1)

    return track


def linear(matrix):
    """A track function of z' = A z in closed form, z the positions and then the velocities.

    Parameters
    ----------
    matrix : callable
        ``matrix(constants) -> (B, n, n)``; constants a dict of arrays (B,).
    """

    def track(times, constants, states):
        copies, _, n_bodies, n_dims = states.shape
        values, vectors = np.linalg.eig(matrix(constants))
        flat = states.reshape(copies, -1, 1).astype(complex)
        weights = np.linalg.solve(vectors, flat)[..., 0]
        n_places = n_bodies * n_dims
        growth = np.exp(values[:, :, None] * (times - times[0]))
        found = np.einsum("bij,bj,bjt->bti", vectors[:, :n_places], weights, growth)
        return found.real.reshape(copies, len(times), n_bodies, n_dims)

    return track


# --- what is seen ---------------------------------------------------------------------------------


def positions_of(world, shot, values=None, states=None):
    """The track of one scene, shape (T, R, d); by default the true one."""
    values = world.values if values is None else values
    states = shot.states if states is None else states
    constants = {name: np.array([v]) for name, v in zip(world.truth, values, strict=True)}
    return world.track(shot.times, constants, states[None])[0]


def dataset_of(world, rng, name="made"):
    """The world as measured: a data set such as `load_dataset` would give."""
    scenes = []
    for k, shot in enumerate(world.shots):
        exact = positions_of(world, shot)
        sigma = np.broadcast_to(shot.sigma, exact.shape)
        seen = exact + sigma * rng.standard_normal(exact.shape)
        n_axes = max(exact.shape[2], 2)
        positions = np.zeros((len(shot.times), len(world.entities), n_axes))
        quoted = np.full(positions.shape, np.nan)
        positions[:, : exact.shape[1], : exact.shape[2]] = seen
        quoted[:, : exact.shape[1], : exact.shape[2]] = sigma
        positions[:, exact.shape[1] :] = np.reshape(world.fixed, (-1, n_axes))
        scenes.append(
            Scene(
                f"s{k}", shot.times, positions, world.entities,
                sigma=quoted if world.noise == "quoted" else None,
            )  # fmt: skip
        )
    is_declared = world.noise == "declared"
    return Dataset(
        name, tuple(scenes), units=SI, up=world.up,
        noise=(float(np.max(world.shots[0].sigma)),) if is_declared else None,
        noise_memory=None if world.noise == "estimated" else 0.0,
    )  # fmt: skip


# --- how well it determines -----------------------------------------------------------------------


def jacobian(world, shot, values=None, states=None):
    """Whitened central differences of one scene's track.

    Returns
    -------
    by_constants : ndarray, shape (n, k)
    by_states : ndarray, shape (n, m)
    """
    values = world.values if values is None else np.asarray(values, dtype=float)
    states = shot.states if states is None else states
    n_constants, n_states = len(values), states.size
    size_p = np.ptp(positions_of(world, shot, values, states), axis=0).max()
    size_v = size_p / (shot.times[-1] - shot.times[0]) + np.abs(states[1]).max()
    widths = STEP * np.concatenate([
        np.where(values == 0, 1.0, np.abs(values)),
        np.repeat([size_p, size_v], n_states // 2),
    ])  # fmt: skip
    moves = np.concatenate([np.diag(widths), -np.diag(widths)])
    constants = {name: values[k] + moves[:, k] for k, name in enumerate(world.truth)}
    copies = states + moves[:, n_constants:].reshape(-1, *states.shape)
    tracks = world.track(shot.times, constants, copies)
    up, down = np.split(tracks, 2)
    slopes = (up - down) / (2 * widths[:, None, None, None]) / shot.sigma
    slopes = slopes.reshape(len(widths), -1).T
    return slopes[:, :n_constants], slopes[:, n_constants:]


def reduced(by_constants, by_states):
    """What is left of the columns of constants beside those of states."""
    # Columns of one size first: a velocity's may be 1e6 of a place's.
    size = np.linalg.norm(by_states, axis=0)
    scaled = by_states / np.where(size > 0, size, 1.0)
    basis, weights, _ = np.linalg.svd(scaled, full_matrices=False)
    basis = basis[:, weights > 1e-12 * weights[0]]
    return by_constants - basis @ (basis.T @ by_constants)


def bound(world):
    """Cramér-Rao bound of the constants, shape (k, k), noise levels known."""
    information = 0.0
    for shot in world.shots:
        left = reduced(*jacobian(world, shot))
        information = information + left.T @ left
    size = np.sqrt(np.diag(information))
    return np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)


def growth(world):
    """Span times the largest Lyapunov exponent, roughly: growth that is more than linear in time.

    The norm of the state transition (places over the extent, by the initial state) grows linearly
    in regular motion and so doubles from the first half of the span to the whole of it.
    """
    worst = 0.0
    for shot in world.shots:
        _, slopes = jacobian(world, shot)
        shape = (len(shot.times), -1, slopes.shape[1])
        sigma = np.broadcast_to(shot.sigma, (len(shot.times), *shot.states.shape[1:]))
        slopes = slopes.reshape(shape) * sigma.reshape(len(shot.times), -1, 1)
        half = np.searchsorted(shot.times, (shot.times[0] + shot.times[-1]) / 2)
        size_v = shot.times[-1] - shot.times[0]
        slopes[..., slopes.shape[2] // 2 :] /= size_v
        norms = np.sqrt(np.square(slopes).sum(axis=(1, 2)))
        worst = max(worst, 2 * np.log(norms.max() / (2 * norms[:half].max())))
    return worst


# --- which minimum --------------------------------------------------------------------------------


def misfit_gap(world, dataset, values):
    """Misfit at these constants minus that at the true ones, states fitted to each from the truth.

    Positive: these constants are no global minimum, whatever their distance from the truth.
    """
    return _misfit(world, dataset, np.asarray(values)) - _misfit(world, dataset, world.values)


def _misfit(world, dataset, values):
    from scipy.optimize import least_squares

    total = 0.0
    for shot, scene in zip(world.shots, dataset.scenes, strict=True):
        shape = shot.states.shape
        seen = scene.positions[:, : shape[1], : shape[2]]

        def left(flat, shot=shot, shape=shape, seen=seen):
            predicted = positions_of(world, shot, values, flat.reshape(shape))
            return ((predicted - seen) / shot.sigma).ravel()

        def slopes(flat, shot=shot, shape=shape):
            return jacobian(world, shot, values, flat.reshape(shape))[1]

        try:
            found = least_squares(
                left, shot.states.ravel(), jac=slopes, x_scale="jac", max_nfev=30
            )
        except ArithmeticError:  # such constants have no track at all
            return np.inf
        total += 2 * found.cost
    return total
