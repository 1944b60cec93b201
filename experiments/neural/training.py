"""Training of several runs of one network: compiled once, resumable, the same bits again.

`paper_training` is the paper's: raw inputs, Adam at a fixed rate, all scenes in every step, a fixed
number of steps. `tuned_training` is ours: inputs and outputs scaled by the training scenes,
logarithms of masses and distances, contacts relative to the body, minibatches, a rate that
decays, and, where it helps, the parameters kept that are best on held-out rows.
`longer_training` is ours with four times the steps.
"""

import time
import zlib
from dataclasses import dataclass, field, replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import optax

from bsp_gp.output.place import whole_file

from .models import Inputs, excess_of_row, init_model, normaliser
from .worlds import load_worlds, rows_of

CHUNK = 50
"""Steps between looks at the held-out scenes."""
SAVED = 4
"""Chunks between checkpoints."""


@dataclass(frozen=True)
class Training:
    """How a network is trained.

    Parameters
    ----------
    name : str
    n_steps : int
    rate : float
        Of Adam, at first.
    batch : int
        Rows of a step; 0: all.
    decays : bool
        The rate falls as a cosine to a hundredth.
    held_out : float
        Share of the training scenes (where that is no whole scene: of the rows of each) kept
        aside to choose the step whose parameters are kept; 0: the last ones are.
    is_scaled : bool
        Scale inputs and outputs by the training rows.
    inputs : Inputs
    is_squared : bool
        Steps follow the squared error in place of the paper's mean norm. Held-out scenes are
        judged by the norm all the same, as the test scenes are.
    """

    name: str
    n_steps: int
    rate: float
    batch: int = 0
    decays: bool = False
    held_out: float = 0.0
    is_scaled: bool = False
    inputs: Inputs = field(default_factory=Inputs)
    is_squared: bool = False


PAPER = {"OGN": (2000, 2e-3), "MLP (force)": (2000, 1e-3), "IN": (400, 1e-3),
         "MLP (position)": (400, 1e-3)}  # fmt: skip
"""Passes per scene (with all scenes in a step, that is the steps) and rates of its networks."""


def paper_training(model):
    """The paper's training of one of its four networks."""
    n_steps, rate = PAPER[model]
    return Training("paper", n_steps, rate, inputs=Inputs(has_dynamic=model == "IN"))


TUNED = {
    "nbody": {"OGN": (3e-2, "silu"), "HOGN": (3e-3, "silu"), "IN": (3e-3, "silu"),
              "MLP (force)": (3e-2, "silu"), "MLP (position)": (3e-2, "silu")},
    "mat": {"OGN": (1e-2, "relu"), "HOGN": (1e-2, "silu"), "IN": (3e-3, "silu"),
            "MLP (force)": (1e-2, "silu"), "MLP (position)": (1e-2, "relu")},
    "bounce": dict.fromkeys(("OGN", "HOGN", "IN", "MLP (force)", "MLP (position)"),
                            (3e-3, "silu")),
}  # fmt: skip
"""Rates and activations (HOGN has its own) of least error (docs/studies/neural_tuning.md)."""
HELD_OUT = {"nbody": 0.0, "mat": 0.0, "bounce": 0.2}
"""Likewise; on BOUNCE with and without are equal to 2e-4 of the error."""


def tuned_training(model, name):
    """Ours: the best of `neural_tuning.py` for a network and a scenario, on scenes 41 to 80.

    On BOUNCE OGN alone was tuned; the other networks take it over.
    """
    rate, activation = TUNED[name][model]
    inputs = Inputs(is_relative=True, is_excess=True, activation=activation)
    return Training("tuned", 2000, rate, batch=98, decays=True, held_out=HELD_OUT[name],
                    is_scaled=True, inputs=inputs)  # fmt: skip


def longer_training(model, name):
    """Ours with four times the steps."""
    tuned = tuned_training(model, name)
    return replace(tuned, name="longer", n_steps=4 * tuned.n_steps)


@dataclass(frozen=True)
class Trained:
    """Runs of a network: parameters with a leading axis for runs.

    Attributes
    ----------
    model : str
    inputs : Inputs
    params, norm : trees of arrays
    n_runs : int
    steps : ndarray of int, shape (n_runs,)
        Whose parameters are kept.
    seconds : float
        Processor time of all runs, compilation and earlier sittings included.
    """

    model: str
    inputs: Inputs
    params: object
    norm: object
    n_runs: int
    steps: np.ndarray
    seconds: float = 0.0

    def excess(self, worlds):
        """Predicted excess of all one-step predictions, shape (n_runs, B, R, 2), metres."""
        rows = rows_of(worlds)
        apply = partial(_apply, self.model, worlds.n_moving, worlds.dt, self.inputs)
        out = [apply(run_of(self.params, k), run_of(self.norm, k), rows.tree())
               for k in range(self.n_runs)]  # fmt: skip
        return np.asarray(out, np.float64)


def run_of(tree, k):
    """One run of a tree of arrays."""
    return jax.tree.map(lambda x: x[k], tree)


def _stacked(trees):
    return jax.tree.map(lambda *x: np.stack(x), *trees)


@partial(jax.jit, static_argnums=(0, 1, 2, 3))
def _apply(model, n_moving, dt, inputs, params, norm, rows):
    one = partial(excess_of_row, model, n_moving=n_moving, dt=dt, inputs=inputs)
    return jax.vmap(lambda row: one(params, norm, row))(rows)


def split(scenes, share, padded):
    """Rows to train on and rows held out (None if none are)."""
    if not share:
        return rows_of(load_worlds(scenes, *padded)), None
    n = int(share * len(scenes))
    if n:
        return tuple(rows_of(load_worlds(s, *padded)) for s in (scenes[:-n], scenes[-n:]))
    rows = rows_of(load_worlds(scenes, *padded))
    # Spread over a scene: its end alone may have no force in it.
    every = round(1 / share)
    held = np.arange(len(rows)) % every == every - 1
    return rows.some(~held), rows.some(held)


def train(model, training, draws, seeds, checkpoint=None, stop_after=None, progress=None):
    """Train a network once per draw of scenes.

    Parameters
    ----------
    model : str
        One of `models.MODELS`.
    training : Training
    draws : list of list of Scene
        As many scenes in each.
    seeds : list of int or tuple of int
        One per draw, of the first weights and of the minibatches.
    checkpoint : Path, optional
        File that the state is written to after every `SAVED` chunks of steps, and taken up from.
    stop_after : int, optional
        Steps after which to stop short, as an interruption would.
    progress : callable, optional
        ``progress(n_steps_done)``.

    Returns
    -------
    Trained
        None if stopped short.

    Raises
    ------
    ValueError
        If the checkpoint is of another training.
    """
    started = time.process_time()
    padded = (max(len(s.entities) for d in draws for s in d),
              max(sum(not e.is_static for e in s.entities) for d in draws for s in d))  # fmt: skip
    parts = [split(scenes, training.held_out, padded) for scenes in draws]
    rows, held = [p[0] for p in parts], [p[1] for p in parts]
    rngs = [np.random.default_rng(seed) for seed in seeds]
    norm = _stacked([normaliser(r, padded[1], training.inputs, training.is_scaled) for r in rows])
    first = [init_model(model, rng, *padded, training.inputs) for rng in rngs]
    keys = np.array([int(rng.integers(2**31)) for rng in rngs], np.uint32)
    data = jax.tree.map(jnp.asarray, _stacked([r.tree() for r in rows]))
    checked = None if held[0] is None else _stacked([r.tree() for r in held])
    loop = _Loop(model, training, padded[1], rows[0].dt, len(rows[0]))
    state = loop.start(_stacked(first))
    mark = fingerprint(model, training, draws, seeds)
    done, before, state = _taken_up(checkpoint, mark, state)
    while done < training.n_steps:
        if stop_after is not None and done >= stop_after:
            return None
        n = min(CHUNK, training.n_steps - done)
        state = loop.advance(state, data, checked, norm, keys, done, n)
        done += n
        if checkpoint is not None and done % (SAVED * CHUNK) == 0:
            jax.block_until_ready(state)
            _write(checkpoint, mark, done, before + time.process_time() - started, state)
        if progress is not None:
            progress(done)
    jax.block_until_ready(state)
    return Trained(model, training.inputs, state["best"], norm, len(draws),
                   np.asarray(state["best_step"]),
                   before + time.process_time() - started)  # fmt: skip


class _Loop:
    """Compiled chunks of training steps."""

    def __init__(self, model, training, n_moving, dt, n_rows):
        self.training = training
        self.n_rows = n_rows
        self.one = partial(excess_of_row, model, n_moving=n_moving, dt=dt, inputs=training.inputs)
        self.unit = dt**2
        rate = training.rate
        if training.decays:
            rate = optax.cosine_decay_schedule(rate, training.n_steps, 0.01)
        self.optimiser = optax.adam(rate)
        self.chunk = jax.jit(self._chunks)
        self.check = jax.jit(jax.vmap(self.loss))

    def loss(self, params, norm, rows, is_squared=False):
        """The paper's nRMSE, or the mean square; where outputs are scaled, in their unit."""
        predicted = jax.vmap(lambda row: self.one(params, norm, row))(rows)
        square = jnp.square(predicted - rows["excess"]).sum(-1)
        if is_squared:
            scale = self.unit * norm["acceleration"] if self.training.is_scaled else 1.0
            return (rows["weights"] * square / scale**2).sum()
        # Without the tiny number the gradient of a perfect prediction is not a number.
        error = (rows["weights"] * jnp.sqrt(square + 1e-24)).sum()
        return error / (self.unit * norm["acceleration"]) if self.training.is_scaled else error

    def start(self, params):
        n = len(jax.tree.leaves(params)[0])
        params = jax.tree.map(jnp.asarray, params)
        adam = jax.vmap(self.optimiser.init)(params)
        return {"params": params, "adam": adam, "best": params, "best_loss": jnp.full(n, jnp.inf),
                "best_step": jnp.zeros(n, jnp.int32)}  # fmt: skip

    def advance(self, state, data, held, norm, keys, done, n):
        """The state `n` steps further."""
        steps = jnp.arange(done, done + n)
        params, adam = self.chunk((state["params"], state["adam"]), data, norm, keys, steps)
        if held is None:
            best, step = params, jnp.full_like(state["best_step"], done + n)
            return {**state, "params": params, "adam": adam, "best": best, "best_step": step}
        loss = self.check(params, norm, held)
        better = loss < state["best_loss"]

        def choose(new, old):
            return jnp.where(better.reshape(-1, *[1] * (new.ndim - 1)), new, old)

        return {"params": params, "adam": adam,
                "best": jax.tree.map(choose, params, state["best"]),
                "best_loss": choose(loss, state["best_loss"]),
                "best_step": choose(jnp.full_like(state["best_step"], done + n),
                                    state["best_step"])}  # fmt: skip

    def _chunks(self, states, rows, norms, keys, steps):
        """One run after the other: side by side (vmap) their layers leave the cache."""
        return jax.lax.map(lambda run: self._chunk(*run, steps), (states, rows, norms, keys))

    def _chunk(self, state, rows, norm, key, steps):
        def step(state, k):
            params, adam = state
            batch = self._batch(rows, key, k)
            gradient = jax.grad(self.loss)(params, norm, batch, self.training.is_squared)
            update, adam = self.optimiser.update(gradient, adam, params)
            return (optax.apply_updates(params, update), adam), None

        return jax.lax.scan(step, state, steps)[0]

    def _batch(self, rows, key, k):
        """Some of the rows, told by the number of the step alone, so that a resumed run is one."""
        if not 0 < self.training.batch < self.n_rows:
            return rows
        key = jax.random.fold_in(jax.random.key(key), k)
        index = jax.random.randint(key, (self.training.batch,), 0, self.n_rows)
        rows = {name: value[index] for name, value in rows.items()}
        share = self.n_rows / self.training.batch
        return {**rows, "weights": rows["weights"] * share}


# --- checkpoints ------------------------------------------------------------------------------


def fingerprint(model, training, draws, seeds):
    """What tells a training from all others, as text."""
    scenes = [[(s.name, zlib.crc32(s.positions.tobytes())) for s in draw] for draw in draws]
    return repr((model, training, seeds, scenes))


def _write(path, mark, done, seconds, state):
    """Write the state, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    leaves = {f"leaf{k}": np.asarray(x) for k, x in enumerate(jax.tree.leaves(state))}
    with whole_file(path) as part:
        np.savez(part, mark=mark, done=done, seconds=seconds, **leaves)


def _taken_up(path, mark, state):
    """Steps done, the seconds they took, and the state, from the file if there is one."""
    if path is None or not path.exists():
        return 0, 0.0, state
    leaves, tree = jax.tree.flatten(state)
    with np.load(path, allow_pickle=False) as file:
        if "mark" not in file.files or str(file["mark"]) != mark:
            raise ValueError(f"{path} is of another training; remove it, or give another --out")
        read = [jnp.asarray(file[f"leaf{k}"]) for k in range(len(leaves))]
        return int(file["done"]), float(file["seconds"]), jax.tree.unflatten(tree, read)
