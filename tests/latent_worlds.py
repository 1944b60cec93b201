"""Small worlds made in Euler steps, whose properties tests take for unknown."""

import numpy as np

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.inference.latents import latents_of
from bsp_gp.inference.priors import Prior
from bsp_gp.language.parse import parse_formula
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.units import UnitSystem

SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
PULL = "c1 * (m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i))"
DRAG = "-c2 * (mu_i * v_i)"
MASSES = Prior("uniform", 0.2, 9.0)


def scene(name, seed, *, n_light=2, n_times=30, dt=0.05, noise=0.0, far=False, c1=20.0, c2=0.0):
    """A heavy body and light ones that pull each other (and are braked by their friction)."""
    rng = np.random.default_rng([42, seed])
    n = n_light + 1
    masses = np.array([200.0, *rng.uniform(0.5, 8.0, n_light)])
    friction = rng.uniform(0.5, 2.0, n)
    radii = np.linspace(6.0, 9.0, n_light)
    angles = np.linspace(0, 2, n_light) + rng.uniform(0, 0.5, n_light)
    p, v = np.zeros((n, 2)), np.zeros((n, 2))
    p[1:] = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    v[1:, 0] = -np.sin(angles) * np.sqrt(c1 * 200 / radii)
    v[1:, 1] = np.cos(angles) * np.sqrt(c1 * 200 / radii)
    if far:
        p[-1] = 1e7
        v[-1] = 0.0
    track = [p, p + dt * v]
    for _ in range(n_times - 2):
        p, v = track[-1], (track[-1] - track[-2]) / dt
        gap = p[None] - p[:, None]
        cube = (np.square(gap).sum(axis=-1) + np.eye(n)) ** 1.5
        a = c1 * np.einsum("j,ijd->id", masses, gap / cube[..., None])
        a -= c2 * (friction / masses)[:, None] * v
        track.append(p + dt * (v + dt * a))
    positions = np.array(track) + noise * rng.standard_normal((n_times, n, 2))
    entities = [
        Entity(f"b{k}", properties={"mass": masses[k], "friction": friction[k]}) for k in range(n)
    ]
    return Scene(name, dt * np.arange(n_times), positions, entities)


def scenes(n=2, **settings):
    return tuple(scene(f"s{k}", k, **settings) for k in range(n))


def dataset(n=2, latents=(), noise=None, **settings):
    return Dataset("pulls", scenes(n, **settings), units=SI, latents=latents, noise=noise)


def is_light(scene, entity):
    return entity.name != "b0"


def masses_of(some, prior=MASSES):
    return latents_of(some, "mass", prior, entities=is_light)


def law_of(*texts, **constants):
    types = dataset_types(dataset(1))
    law = ForceLaw(tuple(Term(parse_formula(text, types)) for text in texts))
    return law.with_constants({name: constants.get(name, 1.0) for name in law.names})


GRAMMAR = """
[grammar]
name = "pulls"
start = "Force"
kind = "pair"
[types]
Const = "scalar *"
Kg = "scalar kg"
KgSq = "scalar kg^2"
Meter = "scalar m"
MeterSq = "scalar m^2"
Direction = "vector 1"
BasicCoeff = "scalar *"
Coeff = "scalar *"
Force = "vector *"
[inputs]
m_i = "scalar kg"
m_j = "scalar kg"
p_i = "point m"
p_j = "point m"
v_i = "vector m/s"
[constants]
c1 = "scalar *"
[rules]
Const = "c1"
Kg = "m_i | m_j | add(m_i, m_j)"
KgSq = "mul(m_i, m_j) | square(Kg)"
Meter = "norm(sub(p_i, p_j))"
MeterSq = "square(Meter)"
Direction = "normalize(sub(p_i, p_j)) | normalize(v_i)"
BasicCoeff = "Kg | KgSq | Meter | MeterSq"
Coeff = "BasicCoeff | mul(BasicCoeff, BasicCoeff) | div(BasicCoeff, BasicCoeff)"
Force = "mul(Const, mul(Coeff, Direction))"
"""


def grammar_file(folder):
    """A small grammar that can say the pull, as a file."""
    path = folder / "pulls.toml"
    path.write_text(GRAMMAR, encoding="utf-8")
    return path
