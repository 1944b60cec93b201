"""The networks: each predicts the excess of one step (see `worlds`) of every moving body.

OGN, the Interaction Network and the two MLPs are those of the paper's section 4.1, with the layers
and inputs of its code (github.com/xukai92/bsp): 100 hidden units, embeddings of 50. OGN and MLP
(force) give an acceleration to a symplectic Euler step; IN and MLP (position) give a displacement.
HOGN is after Sanchez-Gonzalez et al. (2019): a network gives an energy of every pair, with OGN's
layers, and forces are its gradients, so that action equals reaction. Theirs gives the energy of
all bodies in their positions and momenta, and moves by Hamilton's equations.

Three deviations from the paper, meant not to harm the networks: the Interaction Network's last
network is applied to every body with its own mass, friction and velocity, as by Battaglia et al.
(2016), where the paper's takes the effects on all bodies at once; bodies that cannot move are not
asked to be predicted; and IN and MLP (position) do not put out velocities, which a loss of one
step's positions leaves untrained.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

HIDDEN, EMBEDDED = 100, 50
TINY = 1e-12


@dataclass(frozen=True)
class Inputs:
    """What the networks are told.

    Parameters
    ----------
    is_relative : bool
        Contact points relative to the receiver, and logarithms of masses and distances;
        otherwise as the paper has them.
    is_excess : bool
        IN and MLP (position) predict the excess of a step, otherwise the whole displacement.
    activation : str
    has_dynamic : bool
        Pair networks are told which bodies can move, as the paper tells its Interaction Network.
    """

    is_relative: bool = False
    is_excess: bool = False
    activation: str = "relu"
    has_dynamic: bool = False

    @property
    def n_pair(self):
        """Features of one end of a pair."""
        return 12 + self.is_relative + self.has_dynamic


def others(n_moving, n_bodies):
    """Index of the other bodies of every moving one, shape (R, N - 1)."""
    index = [[j for j in range(n_bodies) if j != i] for i in range(n_moving)]
    return np.array(index).reshape(n_moving, n_bodies - 1)


def pair_features(row, p, n_moving, inputs):
    """What a pair network sees of receiver and source: two arrays (R, N - 1, `n_pair`)."""
    r = n_moving
    j = others(r, p.shape[0])
    p_i, p_j = p[:r, None], p[j]
    v_i, v_j = row["v"][:r, None], row["v"][j]
    wall, wide = row["is_wall"][j][..., None], row["is_wide"][j][..., None]
    foot = jnp.where(wide > 0, _mixed(p_i, p_j), _mixed(p_j, p_i))
    contact = jnp.where(wall > 0, foot, jnp.broadcast_to(p_j, foot.shape))
    half, half_v = (p_i - p_j) / 2, (v_i - v_j) / 2  # relative to the mean of the two
    mass_i, mass_j = row["mass"][:r, None], row["mass"][j]
    extra = ()
    if inputs.is_relative:
        contact = contact - p_i
        mass_i, mass_j = jnp.log(mass_i), jnp.log(mass_j)
        extra = (0.5 * jnp.log(jnp.sum(contact**2, -1, keepdims=True) + 1e-6),)

    def of(mass, friction, shape, moves, sign):
        dynamic = (moves[..., None],) if inputs.has_dynamic else ()
        columns = (mass[..., None], friction[..., None], shape, contact, sign * half,
                   sign * half_v, *extra, *dynamic)  # fmt: skip
        lead = half.shape[:-1]
        return jnp.concatenate([jnp.broadcast_to(c, (*lead, c.shape[-1])) for c in columns], -1)

    f_i = of(mass_i, *(row[name][:r, None] for name in ("friction", "shape", "moves")), 1.0)
    return f_i, of(mass_j, *(row[name][j] for name in ("friction", "shape", "moves")), -1.0)


def _mixed(p_x, p_y):
    """The x of one point and the y of another."""
    x, y = jnp.broadcast_arrays(p_x[..., 0], p_y[..., 1])
    return jnp.stack([x, y], -1)


def own_features(row, n_moving, inputs):
    """What the Interaction Network sees of a body itself, shape (R, 4)."""
    mass = row["mass"][:n_moving]
    mass = jnp.log(mass) if inputs.is_relative else mass
    return jnp.concatenate(
        [mass[:, None], row["friction"][:n_moving, None], row["v"][:n_moving]], -1
    )


def all_features(row, inputs):
    """What MLP (position) sees: everything at once, shape (11 N,)."""
    mass = jnp.log(row["mass"]) if inputs.is_relative else row["mass"]
    columns = (row["moves"][:, None], mass[:, None], row["friction"][:, None], row["shape"],
               row["p"], row["v"])  # fmt: skip
    return jnp.concatenate(columns, -1).reshape(-1)


# --- layers -----------------------------------------------------------------------------------


def init_layers(rng, sizes):
    """Weights uniform after Glorot, biases zero."""
    layers = []
    for n_in, n_out in zip(sizes[:-1], sizes[1:], strict=True):
        bound = np.sqrt(6 / (n_in + n_out))
        weights = rng.uniform(-bound, bound, (n_in, n_out)).astype(np.float32)
        layers.append({"w": weights, "b": np.zeros(n_out, np.float32)})
    return layers


def apply_layers(layers, x, activation, is_last_linear=True):
    """A multi-layer perceptron."""
    for k, layer in enumerate(layers):
        x = x @ layer["w"] + layer["b"]
        if k < len(layers) - 1 or not is_last_linear:
            x = getattr(jax.nn, activation)(x)
    return x


def _scaled(x, norm, name):
    return (x - norm[name]["mean"]) / norm[name]["std"]


def _embedded_pairs(params, norm, row, p, n_moving, inputs, activation):
    """Both ends of every pair through the node network, joined: (R, N - 1, 100)."""
    ends = [
        apply_layers(params["node"], _scaled(f, norm, "pair"), activation, False)
        for f in pair_features(row, p, n_moving, inputs)
    ]
    return jnp.concatenate(ends, -1)


def _summed(row, n_moving, values):
    """Sum over the sources that exist."""
    j = others(n_moving, row["mass"].shape[0])
    return (values * row["exists"][j][..., None]).sum(axis=1)


# --- models: init(rng, n_bodies, n_moving, width), excess(params, norm, row, ...) -----------------


def _init_ogn(rng, n_bodies, n_moving, width):
    return {"node": init_layers(rng, [width, HIDDEN, EMBEDDED]),
            "edge": init_layers(rng, [2 * EMBEDDED, *3 * [HIDDEN], 2])}  # fmt: skip


def _ogn(params, norm, row, n_moving, dt, inputs):
    pairs = _embedded_pairs(params, norm, row, row["p"], n_moving, inputs, inputs.activation)
    force = apply_layers(params["edge"], pairs, inputs.activation)
    return dt**2 * norm["acceleration"] * _summed(row, n_moving, force)


def _init_mlp_force(rng, n_bodies, n_moving, width):
    return {"net": init_layers(rng, [2 * width, *3 * [HIDDEN], 2])}


def _mlp_force(params, norm, row, n_moving, dt, inputs):
    ends = [_scaled(f, norm, "pair") for f in pair_features(row, row["p"], n_moving, inputs)]
    force = apply_layers(params["net"], jnp.concatenate(ends, -1), inputs.activation)
    return dt**2 * norm["acceleration"] * _summed(row, n_moving, force)


def _init_in(rng, n_bodies, n_moving, width):
    return {"node": init_layers(rng, [width, HIDDEN, EMBEDDED]),
            "edge": init_layers(rng, [2 * EMBEDDED, *3 * [HIDDEN], EMBEDDED]),
            "body": init_layers(rng, [EMBEDDED + 4, *3 * [HIDDEN], 2])}  # fmt: skip


def _in(params, norm, row, n_moving, dt, inputs):
    pairs = _embedded_pairs(params, norm, row, row["p"], n_moving, inputs, inputs.activation)
    effects = apply_layers(params["edge"], pairs, inputs.activation)
    own = _scaled(own_features(row, n_moving, inputs), norm, "own")
    body = jnp.concatenate([_summed(row, n_moving, effects), own], -1)
    moved = apply_layers(params["body"], body, inputs.activation)
    return _excess_of(moved, norm, row, n_moving, dt, inputs)


def _init_mlp_position(rng, n_bodies, n_moving, width):
    return {"net": init_layers(rng, [11 * n_bodies, *3 * [HIDDEN], 2 * n_moving])}


def _mlp_position(params, norm, row, n_moving, dt, inputs):
    x = _scaled(all_features(row, inputs), norm, "all")
    moved = apply_layers(params["net"], x, inputs.activation).reshape(n_moving, 2)
    return _excess_of(moved, norm, row, n_moving, dt, inputs)


def _excess_of(moved, norm, row, n_moving, dt, inputs):
    """The excess, where the network gives it or the whole displacement."""
    if inputs.is_excess:
        return dt**2 * norm["acceleration"] * moved
    return moved - dt * row["v"][:n_moving]


def _hogn(params, norm, row, n_moving, dt, inputs):
    """Minus the gradient of a sum of pair energies, each in units of the reduced mass."""
    r = n_moving
    j = others(r, row["mass"].shape[0])
    m_i, m_j = row["mass"][:r, None], row["mass"][j]
    share = m_i * m_j / (m_i + m_j) * row["exists"][j] * row["moves"][:r, None]

    def energy(p):
        # relu has no second derivative to learn from; the authors of HOGN take softplus too.
        pairs = _embedded_pairs(params, norm, row, p, r, inputs, "softplus")
        return (share * apply_layers(params["edge"], pairs, "softplus")[..., 0]).sum()

    force = -jax.grad(energy)(row["p"])[:r]
    return dt**2 * norm["acceleration"] * norm["length"] * force / row["mass"][:r, None]


def _init_hogn(rng, n_bodies, n_moving, width):
    return {"node": init_layers(rng, [width, HIDDEN, EMBEDDED]),
            "edge": init_layers(rng, [2 * EMBEDDED, *3 * [HIDDEN], 1])}  # fmt: skip


MODELS = {
    "OGN": (_init_ogn, _ogn),
    "IN": (_init_in, _in),
    "MLP (force)": (_init_mlp_force, _mlp_force),
    "MLP (position)": (_init_mlp_position, _mlp_position),
    "HOGN": (_init_hogn, _hogn),
}
FIXED_NUMBER = ("MLP (position)",)
"""Models that cannot be asked about another number of bodies than they were trained on."""


def init_model(name, rng, n_bodies, n_moving, inputs):
    """Parameters of a network, drawn from a numpy generator."""
    return MODELS[name][0](rng, n_bodies, n_moving, inputs.n_pair)


def excess_of_row(name, params, norm, row, n_moving, dt, inputs):
    """Predicted excess at one instant, shape (R, 2), metres."""
    return MODELS[name][1](params, norm, row, n_moving, dt, inputs)


def normaliser(rows, n_moving, inputs, is_on):
    """Mean and standard deviation of the features, and the scale of what is predicted.

    Parameters
    ----------
    rows : Rows
        Of training.
    is_on : bool
        False: nothing is scaled.

    Returns
    -------
    dict
    """
    tree = rows.tree()
    f_i, f_j = jax.vmap(lambda row: pair_features(row, row["p"], n_moving, inputs))(tree)
    real = np.stack([others(n_moving, tree["p"].shape[1])] * len(rows))
    moves = np.asarray(rows.bodies.moves)[:, :n_moving, None] > 0
    real = moves & (np.take_along_axis(rows.bodies.exists[:, None], real, axis=2) > 0)
    pair = np.concatenate([np.asarray(f_i)[real], np.asarray(f_j)[real]])
    own = jax.vmap(lambda row: own_features(row, n_moving, inputs))(tree)
    own = np.asarray(own)[moves[..., 0]]
    whole = np.asarray(jax.vmap(lambda row: all_features(row, inputs))(tree))
    norm = {"pair": _moments(pair, is_on)}
    # One scene's velocities may hardly vary beside their mean: in units of their deviation those
    # of other scenes would be far out of the range learned from. Of pairs the deviation does
    # better (NBODY, tuning scenes).
    norm["own"] = _moments(own, is_on, of_size=True)
    norm["all"] = _moments(whole, is_on, of_size=True)
    size = np.linalg.norm(rows.excess, axis=-1)[rows.weights > 0] / rows.dt**2
    gap = np.linalg.norm(rows.p[:, :n_moving, None] - rows.p[:, None], axis=-1)
    gap = gap[np.broadcast_to(moves & (rows.bodies.exists[:, None] > 0), gap.shape)]
    norm["acceleration"] = np.float32(np.sqrt(np.mean(size**2)) + TINY if is_on else 1.0)
    norm["length"] = np.float32(np.sqrt(np.mean(gap**2)) if is_on else 1.0)
    return norm


def _moments(x, is_on, of_size=False):
    """Mean and deviation, or root mean square; 1 for columns that do not vary."""
    width = x.shape[1]
    if not is_on:
        return {"mean": np.zeros(width, np.float32), "std": np.ones(width, np.float32)}
    mean, std = x.mean(axis=0, dtype=float), x.std(axis=0, dtype=float)
    if of_size:
        std = np.sqrt(np.mean(np.square(x, dtype=float), axis=0))
    std = np.where(std > 1e-4 * (np.abs(mean) + 1e-2), std, 1.0)
    return {"mean": mean.astype(np.float32), "std": std.astype(np.float32)}
