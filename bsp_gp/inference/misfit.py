"""How far a law is from the data, for many draws of the latents and constants at once.

Where every term is a product of properties and motion, the motion is evaluated once and
compressed by a QR decomposition per receiver: the whitened residual of a receiver with J sources
becomes J numbers, whatever the number of instants, and its sum of squares is exact without
cancellation. Other laws are evaluated at all instants.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.errors import EvaluationError, LawError
from bsp_gp.inference.latents import PropertyTable
from bsp_gp.inference.separation import coefficient, separate
from bsp_gp.language.formula import evaluate
from bsp_gp.physics.bodies import Bodies, law_inputs
from bsp_gp.physics.regression import checked

CHUNK_NUMBERS = 1 << 17
"""Numbers of one work array: what stays in the cache of a processor."""


class _Misfit:
    """Base: constants by position, sums by scene."""

    reference = None
    """Where whole tracks were linearised (`bsp_gp.inference.track_reference.Reference`)."""
    notes = ()
    """What a reader must know of how the tracks were compared."""

    def __init__(self, law, latents, scene_names, row_scene, rest):
        self.law = law
        self.latents = latents
        self.constants = tuple(n for n in law.names if not hasattr(law.constants[n], "items"))
        self.scene_names = tuple(scene_names)
        self.row_scene = row_scene
        self.rest = rest
        self._starts = np.searchsorted(row_scene, np.arange(len(scene_names)))

    @property
    def start(self):
        """The law's own values of its free constants, shape (n_c,)."""
        return np.array([self.law.constants[n] for n in self.constants], dtype=float)

    def residual(self, values, constants=None):
        """Whitened residual (W, m), which may be compressed: with `rest`, its squares count."""
        values = np.atleast_2d(np.asarray(values, dtype=float))
        constants = self.start if constants is None else np.asarray(constants, dtype=float)
        return self._residual(
            values, np.broadcast_to(constants, (len(values), len(self.constants)))
        )

    def chisq(self, values, constants=None):
        """Whitened sum of squares of every scene, (W, S), for values (W, k)."""
        residual = self.residual(values, constants)
        return np.add.reduceat(np.square(residual), self._starts, axis=1) + self.rest

    def log_likelihood(self, values, constants=None):
        """-chi-squared / 2 over all scenes, (W,), nats up to a constant; -inf where not finite."""
        with np.errstate(all="ignore"):
            total = -0.5 * self.chisq(values, constants).sum(axis=1)
        return np.where(np.isfinite(total), total, -np.inf)


class MotionBank:
    """Whitened motion parts on a regression, kept between laws that share them.

    Parameters
    ----------
    is_smooth : bool
        Whether accelerations are averaged over three rows as Numerov's rule has it.
    """

    def __init__(self, regression, is_smooth=False):
        self.regression = regression
        self.is_smooth = is_smooth
        self._fields = {}
        self._factors = {}

    def field(self, kind, motion, index):
        """Whitened values of a motion formula on batch `index`, (n, S, R, J, d)."""
        key = (kind, motion, index)
        if key not in self._fields:
            batch = self.regression.batches[index]
            lookup = law_inputs(kind, batch.bodies, batch.positions, batch.velocities, batch.times)
            n, s, r, d = batch.target.shape
            sources = batch.bodies.others.shape[1] if kind == "pair" else 1
            value = evaluate(motion, lookup)
            if kind == "field":
                value = np.broadcast_to(value, (n, s, r, d))[:, :, :, None]
            value = np.broadcast_to(value, (n, s, r, sources, d))
            bad = ~np.isfinite(value).all(axis=3) & batch.valid
            if bad.any():
                raise EvaluationError(f"the law has no finite value at {int(bad.sum())} instants")
            if self.is_smooth:
                value = averaged(value, batch)
            self._fields[key] = batch.whiten(value)
        return self._fields[key]

    def direct(self, law, latents):
        """The misfit of a law that is no product, on the same terms."""
        return DirectMisfit(law, latents, self.regression, self.is_smooth)

    def factors(self, parts, index):
        """QR of the stacked motion parts of a batch.

        Parameters
        ----------
        parts : tuple of (kind, Formula)

        Returns
        -------
        triangle : ndarray, shape (S, R, q, P)
        target : ndarray, shape (S, R, q)
            The part of the data that the columns can reach.
        rest : ndarray, shape (S,)
            Sum of squares that they cannot.
        """
        key = (parts, index)
        if key not in self._factors:
            batch = self.regression.batches[index]
            columns = np.concatenate([self.field(k, m, index) for k, m in parts], axis=3)
            n, s, r, p, d = columns.shape
            columns = np.moveaxis(columns, (1, 2), (0, 1))  # S R n P d
            columns = np.moveaxis(columns, 3, 4).reshape(s, r, n * d, p)
            y = np.moveaxis(batch.whiten(batch.target), (1, 2), (0, 1)).reshape(s, r, n * d)
            q, triangle = np.linalg.qr(columns)
            target = np.einsum("srmq,srm->srq", q, y)
            left = y - np.einsum("srmq,srq->srm", q, target)
            self._factors[key] = (triangle, target, np.square(left).sum(axis=(1, 2)))
        return self._factors[key]


class ReducedMisfit(_Misfit):
    """Of a law whose terms are products of properties and motion."""

    def __init__(self, law, latents, bank, separated):
        self.separated = separated
        self.kinds = tuple(term.kind for term in law.terms)
        regression = bank.regression
        parts = tuple((t.kind, s.motion) for t, s in zip(law.terms, separated, strict=True))
        self.blocks = []
        names, row_scene, rest = [], [], []
        for index, batch in enumerate(regression.batches):
            triangle, target, left = bank.factors(parts, index)
            table = PropertyTable(batch.bodies, batch.scene_names, latents)
            self.blocks.append((table, triangle, target))
            size = int(np.prod(target.shape[1:]))
            row_scene.append(np.repeat(np.arange(target.shape[0]) + len(names), size))
            names += batch.scene_names
            rest.append(left)
        super().__init__(law, latents, names, np.concatenate(row_scene), np.concatenate(rest))
        self.n_rows = regression.n_rows
        self._place = [
            None if s.constant is None else self.constants.index(s.constant) for s in separated
        ]

    def _residual(self, values, constants):
        out = []
        for table, triangle, target in self.blocks:
            weights = self._weights(table, values, constants)
            if triangle.shape[1] < weights.shape[2]:  # all receivers together
                weights = weights.reshape(len(values), len(target), 1, -1)
            part = np.einsum("srqp,wsrp->wsrq", triangle, weights) - target
            out.append(part.reshape(len(values), -1))
        return np.concatenate(out, axis=1)

    def _weights(self, table, values, constants):
        s, r = table.bodies.n_scenes, len(table.bodies.receivers)
        lookups, parts = {}, []
        for kind, separated, place in zip(self.kinds, self.separated, self._place, strict=True):
            if kind not in lookups:
                lookups[kind] = table.inputs(kind, values)
            value = coefficient(separated, lookups[kind])
            if place is not None:
                value = value * constants[:, place, None, None, None]
            sources = table.bodies.others.shape[1] if kind == "pair" else 1
            parts.append(np.broadcast_to(value, (len(values), s, r, sources)))
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=-1)


class DirectMisfit(_Misfit):
    """Of any law: all instants are evaluated for every draw.

    Scenes are taken one by one, so that what a law makes of the motion alone is evaluated once
    for all draws.
    """

    def __init__(self, law, latents, regression, is_smooth=False):
        self.regression = regression
        self.is_smooth = is_smooth
        self.parts = []
        names, row_scene = [], []
        for batch in regression.batches:
            n, s, r, d = batch.target.shape
            for k in range(s):
                one = single(batch, k)
                table = PropertyTable(one.bodies, one.scene_names, latents)
                self.parts.append((one, table, one.whiten(one.target)))
            row_scene.append(np.repeat(np.arange(s) + len(names), n * r * d))
            names += batch.scene_names
        super().__init__(law, latents, names, np.concatenate(row_scene), np.zeros(len(names)))
        self.n_rows = regression.n_rows

    def _residual(self, values, constants):
        return np.concatenate([self._scene(*p, values, constants) for p in self.parts], axis=1)

    def _scene(self, batch, table, target, values, constants):
        """Whitened residual of one scene, (W, n * R * d)."""
        out = np.empty((len(values), *target.shape[:1], *target.shape[2:]))
        step = max(1, CHUNK_NUMBERS // max(target.size * batch.bodies.others.shape[1], 1))
        for first in range(0, len(values), step):
            some = slice(first, first + step)
            mine = constants[some]
            bodies = shared(batch.bodies, len(mine), table.columns(values[some]))
            given = constant_values(self.law, self.constants, mine, bodies)
            a = self.law.acceleration(
                bodies, batch.positions, batch.velocities, batch.times, given
            )  # (n, W, R, d)
            if not np.isfinite(a).all():
                a = np.where(batch.valid & ~np.isfinite(a), np.inf, a)
            a = np.moveaxis(a[:, None], 2, 3)  # (n, 1, R, W, d)
            if self.is_smooth:
                a = averaged(a, batch)
            with np.errstate(invalid="ignore"):
                part = target[:, :, :, None] - batch.whiten(a)
            out[some] = np.moveaxis(part[:, 0], 2, 0)
        return out.reshape(len(values), -1)


def single(batch, index):
    """One scene of a `RegressionBatch`."""
    one = slice(index, index + 1)
    bodies = batch.bodies
    properties = {name: value[one] for name, value in bodies.properties.items()}
    whitener = batch.whitener
    if whitener is not None and whitener.ndim > 2:
        whitener = whitener[one]
    states = ("times", "positions", "velocities", "target", "valid", "scale")
    return replace(
        batch,
        bodies=replace(
            bodies, names=bodies.names[one], properties=properties, shapes=bodies.shapes[one]
        ),
        whitener=whitener,
        scene_names=batch.scene_names[one],
        **{name: getattr(batch, name)[:, one] for name in states},
    )


def averaged(values, batch):
    """Accelerations averaged over three rows: what the second difference of a motion sees.

    Numerov's rule: p(t + h) - 2 p(t) + p(t - h) = h^2 (a(t + h) + 10 a(t) + a(t - h)) / 12, with
    an error of O(h^6), on even times; at the ends of a track the second difference of the
    accelerations is that of the next row, beside gaps 0.

    Parameters
    ----------
    values : ndarray, shape (n, S, R, ..., d)
    """
    if len(values) < 3:
        return values
    seen = batch.valid.any(axis=-1)
    inner = seen[:-2] & seen[1:-1] & seen[2:]
    steps = np.diff(batch.times, axis=0)
    with np.errstate(invalid="ignore"):
        even = np.abs(steps[1:] - steps[:-1]) <= 1e-3 * np.abs(steps[1:])
    inner &= even[..., None]
    mask = inner[(...,) + (None,) * (values.ndim - 3)]
    with np.errstate(invalid="ignore"):
        bend = np.where(mask, values[2:] - 2 * values[1:-1] + values[:-2], 0.0)
    return values + np.concatenate([bend[:1], bend, bend[-1:]]) / 12


def repeated(bodies, n_draws, columns):
    """Like-built scenes repeated for every draw: W * S scenes, draws outermost."""
    properties = {
        name: np.concatenate([value] * n_draws) for name, value in bodies.properties.items()
    }
    for name, value in columns.items():
        properties[name] = value.reshape(-1, value.shape[-1])
    tile = (n_draws, 1)
    s = bodies.shapes
    radius = properties["radius"] if "radius" in columns else np.tile(s.radius, tile)
    shapes = type(s)(np.tile(s.code, tile), radius, np.tile(s.width, tile), np.tile(s.height, tile))
    return Bodies(
        bodies.names * n_draws, bodies.receivers, properties, shapes, bodies.n_dims, bodies.up,
        bodies.scenes * n_draws,
    )  # fmt: skip


def shared(bodies, n_draws, columns):
    """One scene with its states shared by W draws of some columns.

    Columns that are known keep their one row; they broadcast.
    """
    s = bodies.shapes
    properties = {**bodies.properties, **{name: value[:, 0] for name, value in columns.items()}}
    radius = properties["radius"] if "radius" in columns else s.radius
    shapes = type(s)(s.code, radius, s.width, s.height)
    return replace(
        bodies, names=bodies.names * n_draws, properties=properties, shapes=shapes,
        scenes=bodies.scenes * n_draws,
    )  # fmt: skip


def constant_values(law, names, constants, bodies):
    """Constants (W, n_c) as `ForceLaw.acceleration` takes them for repeated scenes."""
    given = law.values(bodies)
    repeats = bodies.n_scenes // max(len(constants), 1)
    for k, name in enumerate(names):
        column = np.repeat(constants[:, k], repeats)
        given["field"][name] = column[:, None]
        given["pair"][name] = column[:, None, None]
    return given


def misfit_of(law, latents, bank):
    """The misfit of a law, compressed where its terms allow it.

    Parameters
    ----------
    law : ForceLaw
        Constants with one value per receiver stay as they are; the others are free.
    bank : MotionBank
        Of the regression; shares motion parts between laws.

    Raises
    ------
    EvaluationError
        If the law has no finite value on the data.
    """
    if not law.terms:
        raise LawError("a law without terms has no misfit to sample")
    is_plain = not any(law.is_per_entity(term) for term in law.terms)
    separated = [separate(t, latents.columns) if is_plain else None for t in law.terms]
    shared = [s.constant for s in separated if s is not None and s.constant is not None]
    if all(s is not None for s in separated) and len(set(shared)) == len(shared):
        return ReducedMisfit(law, latents, bank, tuple(separated))
    regression = bank.regression
    misfit = bank.direct(law, latents)
    for batch in regression.batches:
        if not latents.columns:
            checked(regression.predict(batch, law), batch)
    return misfit
