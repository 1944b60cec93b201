"""Bodies that must be integrated together, stacked: the chains of a law on some scenes.

Where no force passes between moving bodies, each body of each scene is a chain of its own, and its
unknown initial state touches no other; else the moving bodies of a scene are one chain. Chains of
like build are stacked with the points of their tracks on the last axis of every array.

The derivatives of a common state cost as the cube of its bodies. Fits lead each of many bodies by
where the others were seen: chains of one body, beside all others on curves through their rows. What
these curves err by is the noise of the rows, which a force at a distance hardly feels.
"""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.physics.bodies import stack
from bsp_gp.physics.engine.rails import rails_of
from bsp_gp.physics.geometry import DISC, MAT, WALL
from bsp_gp.physics.series import Series

MOST_TOGETHER = 10
"""Moving bodies that fits follow in one state where a force passes between them."""


@dataclass(frozen=True, eq=False)
class Chains:
    """S chains of R moving bodies each, beside D bodies that forces do not move.

    Attributes
    ----------
    scenes : tuple of str, length S
        Name of the scene of each chain.
    bodies, fixed : tuple of tuple of str, S x R and S x D
        Names of those that forces move, and of the others.
    times : ndarray, shape (T, S), s, padded with nan
    observed : ndarray, shape (T, S, R, d), m
        nan = not seen.
    sigma : ndarray, shape (T, S, R, d) or None
        Quoted errors, nan where a point quotes none.
    velocities : ndarray, shape (T, S, R, d) or None
        Measured ones only.
    driven_times : ndarray, shape (T, S), s
        As `times`, also where a chain is cut.
    driven : ndarray, shape (T, S, D, d)
        Measured places of the bodies that forces do not move.
    driven_velocities : ndarray, shape (T, S, D, d) or None
    properties : dict of str to ndarray
        Column -> (R + D, S) or (R + D, S, d); moving bodies first.
    code, radius, width, height : ndarray, shape (R + D, S)
    direction : callable
        ``direction(name)`` gives the unit vector of a lab axis.
    series : Series
        Measured inputs.
    begun, begun_errors : ndarray, shape (2, R, d, S), or None
        Known states of first rows and their errors; nan = unknown, an error of 0 = exact.
    """

    scenes: tuple
    bodies: tuple
    fixed: tuple
    times: np.ndarray
    observed: np.ndarray
    sigma: np.ndarray | None
    velocities: np.ndarray | None
    driven_times: np.ndarray
    driven: np.ndarray
    driven_velocities: np.ndarray | None
    properties: dict
    code: np.ndarray
    radius: np.ndarray
    width: np.ndarray
    height: np.ndarray
    direction: object
    series: Series
    begun: np.ndarray | None = None
    begun_errors: np.ndarray | None = None

    @property
    def n_chains(self):
        return self.times.shape[1]

    @property
    def n_moving(self):
        return self.observed.shape[2]

    @property
    def n_dims(self):
        return self.observed.shape[3]

    def members(self):
        """Scene and name of every body that forces move, its chain, and its number there."""
        for s, (scene, bodies) in enumerate(zip(self.scenes, self.bodies, strict=True)):
            for r, body in enumerate(bodies):
                yield scene, body, s, r

    @property
    def lengths(self):
        """Rows of each chain, shape (S,)."""
        return np.isfinite(self.times).sum(axis=0)

    def column(self, name):
        """A property as an array (N, S) or (N, S, d); nan where no body knows it."""
        if name in self.properties:
            return self.properties[name]
        return np.full((self.code.shape[0], self.n_chains), np.nan)

    def pieces(self, chain, first, stop):
        """Pieces of chains, rows ``first:stop`` of each `chain` (W,), as chains of their own."""
        whole = replace(
            self,
            scenes=tuple(self.scenes[k] for k in chain),
            bodies=tuple(self.bodies[k] for k in chain),
            fixed=tuple(self.fixed[k] for k in chain),
            properties={name: values[:, chain] for name, values in self.properties.items()},
            **{
                name: getattr(self, name)[:, chain]
                for name in ("code", "radius", "width", "height")
            },
        )
        tracks = ("times", "observed", "sigma", "velocities")
        driven = ("driven_times", "driven", "driven_velocities")
        if self.begun is not None:
            whole = replace(
                whole, begun=self.begun[..., chain], begun_errors=self.begun_errors[..., chain]
            )
        return whole._cut(chain, first, stop, (*tracks, *driven))

    def cut(self, first, stop):
        """The same chains, each cut to its rows ``first:stop``, (S,)."""
        chain = np.arange(self.n_chains)
        return self._cut(chain, first, stop, ("times", "observed", "sigma", "velocities"))

    def _cut(self, chain, first, stop, names):
        rows = first + np.arange(int((stop - first).max()))[:, None]
        inside = rows < stop
        rows = np.where(inside, rows, first)

        def taken(values):
            if values is None:
                return None
            kept = inside.reshape(*inside.shape, *(1,) * (values.ndim - 2))
            return np.where(kept, values[rows, chain], np.nan)

        begun = self.begun
        if begun is not None:  # of what begins later nothing is known
            begun = np.where(first == 0, begun, np.nan)
        return replace(self, begun=begun, **{name: taken(getattr(self, name)) for name in names})

    def contact_sizes(self, others):
        """What margins of contacts with sources (R, J) are measured with, arrays (R, J, S)."""
        own = slice(None, self.n_moving)
        radius = np.nan_to_num(self.radius)
        reach = radius[own, None] + radius[others]
        disc = (self.code[own] == DISC)[:, None]
        code, width, height = self.code[others], self.width[others], self.height[others]
        wall, mat = code == WALL, code == MAT
        half_width, half_height = np.nan_to_num(width) / 2, np.nan_to_num(height) / 2
        sizes = {
            "is_disc_pair": disc & (code == DISC), "is_disc_wall": disc & wall, "is_mat": mat,
            "disc_reach": reach, "wall_half_width": half_width + radius[own, None],
            "wall_half_height": half_height + radius[own, None],
            "mat_half_width": half_width, "mat_half_height": half_height,
            "wide_wall": wall & (width > height), "tall_wall": wall & ~(width > height),
        }  # fmt: skip
        return {name: np.asarray(value, dtype=float) for name, value in sizes.items()}


def is_coupled(law, batch):
    """Whether a force of the law passes between moving bodies of the batch."""
    passes = any(term.kind == "pair" for term in law.terms) or any(
        part.is_coupling for part in law.frame
    )
    return len(batch.bodies.receivers) > 1 and passes


def build_chains(law, scenes, up=None, velocity="ignore", *, coupled=None, may_lead=False):
    """Stack scenes into chains for a law, one Chains for every build of scenes.

    Parameters
    ----------
    velocity : str
        "measured" keeps the scenes' velocities.
    coupled : bool, optional
        Whether the moving bodies of a scene make one chain; by default where a force passes
        between them.
    may_lead : bool
        Whether each of more than `MOST_TOGETHER` bodies may be led by where the others were seen.
    """
    out = []
    for batch in stack(scenes, up, velocity):
        together = is_coupled(law, batch) if coupled is None else coupled
        led = may_lead and together and len(batch.bodies.receivers) > MOST_TOGETHER
        led = led and not any(part.is_coupling for part in law.frame)
        out.append(_chains(batch, together and not led, led, rails_of(law)))
    return out


def _chains(batch, coupled, led, rails=()):
    n_scenes, n_entities = batch.positions.shape[1:3]
    moving, everyone = batch.bodies.receivers, np.arange(n_entities)
    groups = [moving] if coupled else [np.array([k]) for k in moving]
    # Beside a body stand those that forces do not move, and all where it is led by them.
    beside = [np.setdiff1d(everyone, group if led else moving) for group in groups]
    # Chain number g * S + s is group g of scene s.
    order = np.array([np.concatenate(each) for each in zip(groups, beside, strict=True)])
    n_own = len(groups[0])

    def gathered(values):
        """(T, S, N, ...) -> (T, G * S, R + D, ...)."""
        if values is None:
            return None
        parts = [values[:, :, rows] for rows in order]
        return np.concatenate(parts, axis=1)

    def of_bodies(values):
        """(S, N, ...) -> (R + D, G * S, ...)."""
        return np.concatenate([np.swapaxes(values[:, rows], 0, 1) for rows in order], axis=1)

    positions, sigma = gathered(batch.positions), gathered(batch.sigma)
    velocities = gathered(batch.velocities)
    names = [batch.bodies.names[s] for _ in groups for s in range(n_scenes)]
    owners = [order[g][:n_own] for g in range(len(groups)) for _ in range(n_scenes)]
    others = [order[g][n_own:] for g in range(len(groups)) for _ in range(n_scenes)]
    shapes = batch.bodies.shapes
    times = np.concatenate([batch.times] * len(groups), axis=1)
    begun, begun_errors = _begun(batch.scenes, [rows[:n_own] for rows in order], rails)
    return Chains(
        scenes=tuple(scene.name for _ in groups for scene in batch.scenes),
        bodies=tuple(tuple(name[k] for k in own) for name, own in zip(names, owners, strict=True)),
        fixed=tuple(tuple(name[k] for k in rest) for name, rest in zip(names, others, strict=True)),
        times=times,
        observed=positions[:, :, :n_own],
        sigma=None if sigma is None else sigma[:, :, :n_own],
        velocities=None if velocities is None else velocities[:, :, :n_own],
        driven_times=times,
        driven=positions[:, :, n_own:],
        driven_velocities=None if velocities is None else velocities[:, :, n_own:],
        properties={k: of_bodies(v) for k, v in batch.bodies.properties.items()},
        code=of_bodies(shapes.code),
        radius=of_bodies(shapes.radius),
        width=of_bodies(shapes.width),
        height=of_bodies(shapes.height),
        direction=batch.bodies.direction,
        series=batch.bodies.series,
        begun=begun,
        begun_errors=begun_errors,
    )


def spread(values):
    """Largest less smallest along the first axis; 0 where there is none."""
    seen = np.isfinite(values)
    high = np.where(seen, values, -np.inf).max(axis=0)
    low = np.where(seen, values, np.inf).min(axis=0)
    return np.where(seen.any(axis=0), high - low, 0.0)


def _begun(scenes, owners, rails=()):
    """Known first states of chains and their errors, (2, R, d, G * S) each; None where none is.

    Along `rails` bodies are where they are seen, at rest.
    """
    if all(scene.first is None for scene in scenes) and not rails:
        return None, None
    values, errors = [], []
    for own in owners:
        for scene in scenes:
            known = np.full((2, len(own), scene.n_dims), np.nan)
            error = known.copy()
            if scene.first is not None:
                seen = np.isfinite(scene.positions[0, own])
                known[1] = np.where(seen, scene.first.velocity[own], np.nan)
                error[1] = scene.first.velocity_error[own]
                if scene.first.is_placed:
                    known[0], error[0] = scene.positions[0, own], 0.0
            for axis in rails:
                places = scene.positions[:, own, axis]
                row = np.isfinite(places).argmax(axis=0)
                known[:, :, axis] = places[row, np.arange(len(own))], np.zeros(len(own))
                error[:, :, axis] = 0.0
            values.append(known)
            errors.append(error)
    return np.stack(values, axis=-1), np.stack(errors, axis=-1)
