"""Where a force is left and on what it depends: free forces along the tracks, as columns.

In every direction in which physics acts a push is tried whose strength is a smooth function of one
variable: cosines of its rank among all instants, or a number for each body or scene (LOOP §5.3).
Where masses differ the push is an acceleration or a force, whichever shows more.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bsp_gp.fitting.tangent import INDEPENDENT

COUNTS = (2, 4, 8)
"""Cosines beside a constant; that of the greatest evidence is told."""
MOST_GROUPS = 40
"""Bodies or scenes that are told apart, and other bodies by name, at the most."""
NODES = 11


@dataclass(frozen=True)
class Channel:
    """A direction, and a variable on which the strength of a push may depend.

    Attributes
    ----------
    direction : str
        "along" or "across" the velocity, "e_x", "line" to all other bodies, or "line:NAME".
    variable : str
        "", "time", "x", "y", "z", "speed", "distance", "body", "scene", or a column that was
        logged.
    statistic, p_value : float
        Of its score test alone.
    share : float
        Of the chi-squared above noise; shares of channels overlap.
    evidence : float, nats
        Half the statistic less what its numbers cost.
    """

    direction: str
    variable: str
    n_functions: int
    rank: int
    statistic: float
    p_value: float
    share: float
    evidence: float


@dataclass(frozen=True)
class Trace:
    """Where the residual force of a fit is.

    Attributes
    ----------
    channels : tuple of Channel
        The best first.
    at : tuple of float, or of str
        Values, SI, of the variable of the best, or names of bodies or scenes.
    values, errors : tuple of float, m/s^2
        The push there, of a body of median mass where it is a force.
    """

    channels: tuple[Channel, ...] = ()
    at: tuple = ()
    values: tuple = ()
    errors: tuple = ()


def trace(view):
    """The trace of a View."""
    batches = view.response.regression.batches
    fields = [_Field(batch, view.dataset.logged) for batch in batches]
    ways = [[None] * len(fields)]  # a push is an acceleration, or where masses differ a force
    masses = view.masses and np.concatenate([m.ravel() for m in view.masses])
    if masses is not None and np.ptp(masses) > 0:
        ways.append([np.median(masses) / m for m in view.masses])
    found = []
    for direction in dict.fromkeys(name for field in fields for name in field.directions):
        tried = [_channels(view, fields, direction, weights) for weights in ways]
        found += max(tried, key=lambda own: max(entry[0].evidence for entry in own))
    found = [entry for entry in found if entry[0].rank]
    found.sort(key=lambda entry: -entry[0].evidence)
    profile = _profile(*found[0][1]) if found else ()
    return Trace(tuple(channel for channel, _ in found), *map(tuple, profile))


def _channels(view, fields, direction, weights):
    """Channels of one direction, each with what its profile is made of."""
    size, n = float(view.left @ view.left), view.n_left
    out = []
    for basis in _bases(fields, direction):
        pushes = [f.pushes(direction, basis) for f in fields]
        pushes = [p if w is None else p * w[..., None, None]
                  for p, w in zip(pushes, weights, strict=True)]  # fmt: skip
        columns, tried = moments_of(view, pushes), []
        for count in basis.counts:
            score = view.score_forces(columns[:, :count])
            evidence = 0.5 * (score.statistic - score.rank * np.log(max(n, 2)))
            share = (score.statistic - score.rank) / (size - n) if size > n else np.nan
            channel = Channel(
                direction, basis.variable, count, score.rank, score.statistic,
                float(score.p_value), float(share), float(evidence),
            )  # fmt: skip
            tried.append((channel, (basis, count, score)))
        out.append(max(tried, key=lambda entry: entry[0].evidence))
    return out


def free_forces(view, count):
    """Pushes of one, in every direction, that vary smoothly with every variable.

    Parameters
    ----------
    count : int
        Cosines of its rank beside a constant.

    Yields
    ------
    str, str, ndarray, shape (n, F)
        Direction, variable, moments: of the constant and the cosines, or of every body or scene.
    """
    fields = [_Field(batch, view.dataset.logged) for batch in view.response.regression.batches]
    for direction in dict.fromkeys(name for field in fields for name in field.directions):
        for basis in _bases(fields, direction):
            columns = moments_of(view, [f.pushes(direction, basis) for f in fields])
            yield direction, basis.variable, columns if basis.is_named else columns[:, : 1 + count]


def smooth_variables(view, count=2, with_names=False):
    """Variables that vary along the tracks, with smooth functions of each.

    Parameters
    ----------
    count : int
        Cosines of its rank.
    with_names : bool
        Whether bodies and scenes are variables, too, each with a function of its own.

    Yields
    ------
    str, list of ndarray, shape (n, S, R, F)
        By batch of the response.
    """
    fields = [_Field(batch, view.dataset.logged) for batch in view.response.regression.batches]
    for basis in _bases(fields, "along"):
        if basis.variable and (with_names or not basis.is_named):
            made = [list(basis.functions(f.variables[basis.variable])) for f in fields]
            used = slice(None) if basis.is_named else slice(1, 1 + count)
            yield basis.variable, [np.concatenate(m[used], axis=3) for m in made]
    ways = [_unit(f.velocity) for f in fields]
    seen = np.concatenate([w[f.valid] for w, f in zip(ways, fields, strict=True)])
    if len(seen) and np.ptp(seen, axis=0).max() > INDEPENDENT:
        yield "direction", ways


def moments_of(view, pushes):
    """Moments (n, F) of accelerations (n, S, R, F, d) of each batch."""
    batches = view.response.regression.batches
    parts = [b.whiten(p) for b, p in zip(batches, pushes, strict=True)]  # (m, S, 1, F, 1)
    return np.concatenate([p.reshape(-1, p.shape[3]) for p in parts])


class _Field:
    """Directions and variables at the instants of a batch; arrays (n, S, R, J[, d])."""

    def __init__(self, batch, columns):
        self.batch, self.bodies, self.columns = batch, batch.bodies, tuple(columns)
        self.own = batch.positions[:, :, self.bodies.receivers]
        self.velocity = batch.velocities[:, :, self.bodies.receivers]
        self.valid = batch.valid.any(axis=-1)

    @cached_property
    def between(self):
        """From receivers to other bodies."""
        return self.batch.positions[:, :, self.bodies.others] - self.own[..., None, :]

    @cached_property
    def sources(self):
        """Names of the other bodies, (S, R, J)."""
        return np.array(self.bodies.names)[:, self.bodies.others]

    @cached_property
    def directions(self):
        """Unit vectors by name."""
        n_dims, along = self.own.shape[-1], _unit(self.velocity)
        axes = np.eye(n_dims)
        found = {"along": along}
        if n_dims == 2:
            found["across"] = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        for k, axis in enumerate(axes):
            found[f"e_{'xyz'[k]}"] = np.broadcast_to(axis, along.shape)
            if n_dims == 3:
                found[f"across_{'xyz'[k]}"] = np.cross(along, axis)
        found = {name: value[..., None, :] for name, value in found.items()}
        if self.between.shape[3]:
            line = found["line"] = _unit(self.between)
            names = np.unique(self.sources)
            if 2 < len(names) <= MOST_GROUPS:
                for name in names:
                    mine = (self.sources == name)[..., None]
                    found[f"line:{name}"] = np.where(mine, line, 0.0)
        return found

    @cached_property
    def variables(self):
        """Numbers, or names, by name."""
        shape = self.valid.shape
        places = {"xyz"[k]: self.own[..., k, None] for k in range(self.own.shape[-1])}
        scenes = np.array(self.batch.scene_names)[:, None]
        return {
            "time": np.broadcast_to(self.batch.times[:, :, None], shape)[..., None], **places,
            "speed": np.linalg.norm(self.velocity, axis=-1)[..., None],
            "distance": np.linalg.norm(self.between, axis=-1),
            "body": np.broadcast_to(np.array(self.bodies.receiver_names), shape)[..., None],
            "scene": np.broadcast_to(scenes, shape)[..., None],
            **{name: self._logged(name)[..., None] for name in self.columns},
        }  # fmt: skip

    def _logged(self, name):
        """Values of a measured input, (n, S, R)."""
        bodies = self.bodies
        return bodies.series.at(name, bodies.scenes, bodies.receiver_names, self.batch.times)

    def pushes(self, direction, basis):
        """Accelerations of every function of a basis, (n, S, R, F, d)."""
        nothing = np.zeros((*self.own.shape[:3], 1, self.own.shape[3]))
        vectors = np.nan_to_num(self.directions.get(direction, nothing))
        values = self.variables[basis.variable] if basis.variable else np.zeros((1, 1, 1, 1))
        if values.shape[3] == 1:  # the same for all other bodies
            vectors = vectors.sum(axis=3, keepdims=True)
        functions = (np.nan_to_num(f)[..., None] for f in basis.functions(values))
        one = [(vectors * f).sum(axis=3) for f in functions]
        return np.stack(one, axis=3)


@dataclass(frozen=True, eq=False)
class _Basis:
    """Functions of one variable: `known` are its quantiles, or all names."""

    variable: str
    known: np.ndarray
    counts: tuple

    @property
    def is_named(self):
        return self.variable in ("body", "scene")

    def functions(self, values):
        """The functions at values, one after the other."""
        if self.is_named:
            return (np.asarray(values == name, dtype=float) for name in self.known)
        rank = np.interp(values, self.known, np.linspace(0, 1, len(self.known)))
        return (np.cos(np.pi * k * rank) for k in range(max(self.counts)))

    @property
    def nodes(self):
        """Where the profile is told."""
        return self.known if self.is_named else np.quantile(self.known, np.linspace(0, 1, NODES))


def _bases(fields, direction):
    """A constant, and functions of every variable that varies."""
    yield _Basis("", np.zeros(2), (1,))
    for variable in fields[0].variables:
        if variable == "distance" and not direction.startswith("line"):
            continue
        pooled = np.concatenate([f.variables[variable][f.valid].ravel() for f in fields])
        if variable in ("body", "scene"):
            names = np.unique(pooled)
            if 1 < len(names) <= MOST_GROUPS:
                yield _Basis(variable, names, (len(names),))
            continue
        pooled = pooled[np.isfinite(pooled)]
        if len(pooled) and np.ptp(pooled) > INDEPENDENT * np.abs(pooled).max():
            known = np.quantile(pooled, np.linspace(0, 1, 257))
            yield _Basis(variable, known, tuple(1 + k for k in COUNTS))


def _profile(basis, count, score):
    """Where a push is told, and its value and error there."""
    at = np.stack(list(basis.functions(basis.nodes)), axis=1)[:, :count]
    errors = np.sqrt(np.einsum("ni,ij,nj->n", at, score.covariance, at))
    errors[(at != 0) @ np.isinf(score.errors)] = np.inf
    return basis.nodes.tolist(), (at @ score.amplitudes).tolist(), errors.tolist()


def _unit(vectors):
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(size > 0, size, 1.0)
