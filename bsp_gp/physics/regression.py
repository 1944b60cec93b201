"""The interface between data and searches: what laws must explain, whitened.

Whatever a likelihood makes of the tracks (`bsp_gp.physics.likelihood`), searches, constants and
the loop see it as a `Regression`: columns, targets, residuals and gradients as plain vectors with
independent errors of size one.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import EvaluationError, SettingsError
from bsp_gp.language.formula import evaluate
from bsp_gp.physics.bodies import law_inputs
from bsp_gp.physics.evaluation import Settling
from bsp_gp.physics.force import term_gradient


@dataclass(frozen=True, eq=False)
class RegressionBatch:
    """Instants of like-built scenes.

    Attributes
    ----------
    times : ndarray, shape (n, S), s
    positions, velocities : ndarray, shape (n, S, N, d)
        The state at which a law is evaluated.
    target : ndarray, shape (n, S, R, d), m/s^2
        Observed accelerations; 0 where not valid.
    valid : ndarray of bool, shape (n, S, R, d)
    scale : ndarray, shape (n, S, R, d)
        1 / standard deviation of independent errors; 0 where not valid.
    scene_names : tuple of str, length S
    whitener : ndarray or None
        Applied along time before `scale`; None = identity. ``(k, n)`` shared, ``(S, R, k, n)`` or
        ``(S, R, d, k, n)``; where k < n, the last n - k whitened rows are 0.
    observed : ndarray, shape (n, S, R, d), or None
        What the whitened law is to explain, before `scale`; None: the whitened `target`.
    kept : ndarray of bool, shape (n, S, R, d)
        Whitened rows that count; by default the valid ones. In the weak form these are test
        functions, and no instants.
    """

    bodies: object
    times: np.ndarray
    positions: np.ndarray
    velocities: np.ndarray
    target: np.ndarray
    valid: np.ndarray
    scale: np.ndarray
    scene_names: tuple[str, ...] = ()
    whitener: np.ndarray | None = None
    observed: np.ndarray | None = None
    kept: np.ndarray | None = None

    def __post_init__(self):
        if self.kept is None:
            object.__setattr__(self, "kept", self.valid)

    def whiten(self, values):
        """Whiten accelerations, shape (n, S, R, ..., d); rows that are not kept become 0.

        What is beyond the range of numbers is not finite afterwards.
        """
        extra = values.ndim - 4
        index = (slice(None),) * 3 + (None,) * extra
        values = np.where(self.valid[index], values, 0.0)
        with np.errstate(over="ignore", invalid="ignore"):
            if self.whitener is not None:
                values = _along_time(self.whitener, values)
            return values * self.scale[index]

    def whitened_target(self):
        """What the whitened law is to explain, shape (n, S, R, d)."""
        return self.whiten(self.target) if self.observed is None else self.observed * self.scale

    def whitened_residual(self, predicted):
        """Whitened observed minus predicted accelerations, shape (n, S, R, d)."""
        if self.observed is None:
            return self.whiten(self.target - predicted)
        return self.observed * self.scale - self.whiten(predicted)


def _along_time(whitener, values):
    """Apply a whitener to the first axis of values (n, S, R, ..., d); 0 beyond its rows."""
    if whitener.ndim == 2:
        out = np.tensordot(whitener, values, axes=(1, 0))
    elif whitener.ndim == 4:
        out = np.einsum("srtu,usr...->tsr...", whitener, values, optimize=True)
    else:
        out = np.einsum("srdtu,usr...d->tsr...d", whitener, values, optimize=True)
    if len(out) == len(values):
        return out
    return np.concatenate([out, np.zeros((len(values) - len(out), *out.shape[1:]))])


@dataclass(frozen=True, eq=False)
class Regression:
    """All instants of some scenes, ready for laws.

    Attributes
    ----------
    sigma : ndarray, shape (d,)
        Standard deviation used: of positions, metres, or of accelerations (``derivative``).
    widths : Widths or None
        Of the test functions (``weak``).
    n_rows : int
        Rows that count: instants and axes, or independent test functions.
    """

    batches: tuple[RegressionBatch, ...]
    method: str
    sigma: np.ndarray
    scenes: tuple
    widths: object = None
    n_rows: int = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "n_rows", int(sum(batch.kept.sum() for batch in self.batches)))

    def target(self):
        """Whitened observed accelerations, one vector."""
        return self._flat(batch.whitened_target() for batch in self.batches)

    def residual(self, law):
        """Whitened observed minus predicted accelerations, one vector.

        Raises
        ------
        EvaluationError
            If the law has no finite value at a valid instant.
        """
        return self._flat(
            batch.whitened_residual(checked(self.predict(batch, law), batch))
            for batch in self.batches
        )

    def predict(self, batch, law):
        """Accelerations of a law at the instants of a batch, shape (n, S, R, d)."""
        return law.acceleration(batch.bodies, batch.positions, batch.velocities, batch.times)

    def column(self, term, per_entity=False, cache=None):
        """Whitened acceleration of a constant-free term: one vector, or a column per receiver.

        Parameters
        ----------
        cache : list of dict, one per batch, optional
            Values of sub-formulas, kept between calls for terms of one kind.

        Returns
        -------
        columns : ndarray, shape (n_flat, k)
        names : tuple of str
            Receiver names for ``per_entity``, else ``("",)``.
        """
        values = self._accelerations(term, per_entity, cache)
        parts = [b.whiten(value) for b, value in zip(self.batches, values, strict=True)]
        if not per_entity:
            return self._flat(parts)[:, None], ("",)
        columns = [self._flat(own) for own in self._by_receiver(parts)]
        return np.stack(columns, axis=1), self.receiver_names()

    def _accelerations(self, term, per_entity, cache=None):
        """Accelerations by a constant-free term, batch by batch."""
        for batch, known in zip(self.batches, cache or [None] * len(self.batches), strict=True):
            lookup = law_inputs(
                term.kind, batch.bodies, batch.positions, batch.velocities, batch.times
            )
            force = evaluate(term.acceleration_formula, lookup, cache=known)
            value = Settling(term, batch.bodies, per_entity)(force, batch.target.shape)
            yield checked(value, batch)

    def _by_receiver(self, parts):
        """Arrays (n, S, R, d) of all batches, zero but for one receiver, a list for each."""
        for name in self.receiver_names():
            own = [np.array(b.bodies.receiver_names) == name for b in self.batches]
            yield [part * mine[..., None] for part, mine in zip(parts, own, strict=True)]

    def gradient(self, law, term):
        """Whitened derivatives of one term by its constants, dict of vectors."""
        out = {}
        for batch in self.batches:
            _, slopes = term_gradient(
                law, term, batch.bodies, batch.positions, batch.velocities, batch.times
            )
            for name, slope in slopes.items():
                out.setdefault(name, []).append(batch.whiten(checked(slope, batch)))
        return {name: self._flat(parts) for name, parts in out.items()}

    def receiver_names(self):
        """Names of all receivers, in order of first appearance."""
        return tuple(
            dict.fromkeys(
                name
                for batch in self.batches
                for row in batch.bodies.receiver_names
                for name in row
            )
        )

    def raw_residuals(self, law):
        """Observed minus predicted accelerations, m/s^2, one list entry per batch; nan = no row."""
        return [
            np.where(batch.valid, batch.target - self.predict(batch, law), np.nan)
            for batch in self.batches
        ]

    def _flat(self, parts):
        return np.concatenate([np.ravel(part) for part in parts]) if self.batches else np.zeros(0)


def stack_draws(regressions, weights):
    """One regression for an expectation over draws of latent properties.

    Least squares on it minimises the weighted mean of the draws' losses, constants shared.

    Parameters
    ----------
    regressions : sequence of Regression
        The same scenes, each with the properties of one draw.
    weights : sequence of float
        Not negative; normalised to sum to one.

    Raises
    ------
    SettingsError
        If weights and draws do not match.
    """
    weights = np.asarray(weights, dtype=float)
    if weights.shape != (len(regressions),) or not weights.sum() > 0 or np.any(weights < 0):
        raise SettingsError(
            f"weights must be {len(regressions)} numbers that are not negative and not all 0, "
            f"got {weights!r:.80}"
        )
    batches = tuple(
        replace(batch, scale=batch.scale * np.sqrt(weight))
        for regression, weight in zip(regressions, weights / weights.sum(), strict=True)
        for batch in regression.batches
    )
    first = regressions[0]
    return Regression(batches, first.method, first.sigma, first.scenes, first.widths)


def checked(values, batch):
    """Return values (n, S, R, d), or raise EvaluationError where a valid row is not finite."""
    bad = ~np.isfinite(values) & batch.valid
    if bad.any():
        raise EvaluationError(f"the law has no finite value at {int(bad.sum())} instants")
    return np.where(batch.valid, values, 0.0)
