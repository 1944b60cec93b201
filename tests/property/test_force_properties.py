"""Symmetries that every law of a grammar must have, and Newton's third where it applies.

Positions and velocities are multiples of 2^-20 below 8, so that shifts and boosts by such
numbers are exact in floating point and symmetric laws must agree bit for bit.
"""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bsp_gp.data.scene import PROPERTY_UNITS, Entity, Scene
from bsp_gp.language.expression import to_formula
from bsp_gp.language.formula import Call, Input, walk
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.force import ForceLaw, Term

NEWTONIAN = load_grammar("newtonian")
PHYSICS = load_grammar("physics")
LAB = ("e_x", "e_y", "e_z")
PLANE = PHYSICS.masked(set(PHYSICS.inputs) - {"e_z"}, 2)[0]
SPACE = PHYSICS.masked(set(PHYSICS.inputs), 3)[0]
ISOTROPIC = {2: PLANE.without_inputs(LAB), 3: SPACE.without_inputs(LAB)}
PROFILE = settings(max_examples=60, deadline=None)
SEEDS = st.integers(0, 2**32)
TYPES = input_types(PROPERTY_UNITS, up="y")


def dyadic(rng, low, high, shape):
    return np.round(rng.uniform(low, high, shape) * 2**20) / 2**20


def world(rng, n_dims=2, with_walls=False, masses=None):
    """One instant of three discs (and a wall and a mat), some of them touching."""
    crew = []
    for k in range(3):
        properties = {
            name: rng.uniform(0.5, 2)
            for name in ("mass", "friction", "charge", "stiffness", "rest_length")
        }
        if masses is not None:
            properties["mass"] = masses[k]
        crew.append(Entity(f"d{k}", "disc", radius=rng.uniform(0.5, 2), properties=properties))
    if with_walls:
        properties = {name: 0.3 for name in ("friction", "charge", "stiffness", "rest_length")}
        properties["mass"] = 3.0
        crew += [
            Entity("w", "rect_wall", width=3.0, height=1.0, is_static=True, properties=properties),
            Entity("m", "rect_mat", width=4.0, height=4.0, is_static=True, properties=properties),
        ]
    positions = dyadic(rng, -3, 3, (len(crew), n_dims))
    velocities = dyadic(rng, -2, 2, (len(crew), n_dims))
    return tuple(crew), positions, velocities


def acceleration(law, crew, positions, velocities, t=0.7):
    times = np.arange(3.0)
    frames = np.broadcast_to(positions, (3, *positions.shape))
    (batch,) = stack([Scene("s", times, frames, crew)], up="y")
    with np.errstate(all="ignore"):
        return law.acceleration(
            batch.bodies, positions[None, None], velocities[None, None], np.array([[t]])
        )[0, 0]


def sampled(seed, grammar, kind, levels=12, banned_rules=()):
    """A law drawn from a grammar, with the generator that drew it."""
    rng = np.random.default_rng(seed)
    probabilities = np.array(Pcfg.uniform(grammar).probabilities)
    probabilities[list(banned_rules)] = 0.0
    expression = Pcfg(grammar, probabilities).sample(rng, grammar.start[kind], levels)
    formula = to_formula(expression, grammar)
    constants = {name: rng.uniform(0.5, 2) for name in formula.constants}
    return ForceLaw([Term(formula, kind)], constants), rng


CASES = [(NEWTONIAN, "pair", 2), (PLANE, "pair", 2), (PLANE, "field", 2), (SPACE, "pair", 3),
         (SPACE, "field", 3)]  # fmt: skip


@PROFILE
@given(SEEDS, st.sampled_from(CASES))
def test_force_is_independent_of_translation(seed, case):
    grammar, kind, n_dims = case
    law, rng = sampled(seed, grammar, kind)
    crew, positions, velocities = world(rng, n_dims, with_walls=n_dims == 2)
    shift = dyadic(rng, -100, 100, n_dims)
    here = acceleration(law, crew, positions, velocities)
    there = acceleration(law, crew, positions + shift, velocities)
    np.testing.assert_array_equal(there, here)


def random_rotation(rng, n_dims):
    q, r = np.linalg.qr(rng.normal(size=(n_dims, n_dims)))
    q = q * np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return q


def nearly_touching(crew, positions):
    gap = np.linalg.norm(positions[:, None] - positions, axis=-1)
    radii = np.array([e.radius for e in crew])
    edge = np.abs(gap - radii[:, None] - radii)
    return np.min(edge[~np.eye(len(crew), dtype=bool)]) < 1e-9


ROTATIONS = [(NEWTONIAN, "pair", 2), (ISOTROPIC[2], "pair", 2), (ISOTROPIC[2], "field", 2),
             (ISOTROPIC[3], "pair", 3)]  # fmt: skip


@PROFILE
@given(SEEDS, st.sampled_from(ROTATIONS))
def test_force_turns_with_the_world(seed, case):
    """Covariance under rotations.

    Rounding in the turned positions is 1e-15; laws are products of at most a dozen factors, and
    the only ones that magnify it are differences near zero (r - l, radial speed): 1e-8 allows
    for a factor of 1e6, met by chance once in a million.
    """
    grammar, kind, n_dims = case
    project = [r.index for r in grammar.rules if "project_abs" in r.operators]
    mats = [r.index for r in grammar.rules if "is_on" in r.operators]
    law, rng = sampled(seed, grammar, kind, banned_rules=project + mats)
    crew, positions, velocities = world(rng, n_dims)
    assume(not nearly_touching(crew, positions))
    turn = random_rotation(rng, n_dims)
    here = acceleration(law, crew, positions, velocities)
    assume(np.all(np.isfinite(here)))
    there = acceleration(law, crew, positions @ turn.T, velocities @ turn.T)
    np.testing.assert_allclose(there, here @ turn.T, rtol=0, atol=1e-8 * np.max(np.abs(here)))


def test_the_papers_project_does_not_turn_with_the_world():
    """Why `newtonian` laws with project are left out above, and `physics` has none."""
    formula = parse_formula(
        "project(v_i, v_j) * normalize(p_j - p_i)", TYPES, operators=NEWTONIAN.operators
    )
    law = ForceLaw([Term(formula)])
    rng = np.random.default_rng(3)
    crew, positions, velocities = world(rng)
    turn = random_rotation(rng, 2)
    here = acceleration(law, crew, positions, velocities)
    there = acceleration(law, crew, positions @ turn.T, velocities @ turn.T)
    assert np.max(np.abs(there - here @ turn.T)) > 0.01 * np.max(np.abs(here))
    assert not any("project_abs" in rule.operators for rule in PHYSICS.rules)


def has_bare_velocity(formula):
    """Whether v_i or v_j occurs outside of a difference of the two."""
    stack_ = [formula]
    while stack_:
        node = stack_.pop()
        if isinstance(node, Input) and node.name in ("v_i", "v_j"):
            return True
        if isinstance(node, Call):
            names = [getattr(arg, "name", "") for arg in node.args]
            if not (node.operator == "sub" and sorted(names) == ["v_i", "v_j"]):
                stack_.extend(node.args)
    return False


@PROFILE
@given(SEEDS, st.sampled_from([(NEWTONIAN, 2), (PLANE, 2), (SPACE, 3)]))
def test_relative_velocities_make_galilean_laws(seed, case):
    grammar, n_dims = case
    bare = [r.index for r in grammar.rules if r.text in ("v_i", "v_j")]
    assert bare
    law, rng = sampled(seed, grammar, "pair", banned_rules=bare)
    assert not has_bare_velocity(law.terms[0].formula)
    crew, positions, velocities = world(rng, n_dims, with_walls=n_dims == 2)
    boost = dyadic(rng, -50, 50, n_dims)
    here = acceleration(law, crew, positions, velocities)
    np.testing.assert_array_equal(
        acceleration(law, crew, positions, velocities + boost), here
    )


def test_drag_against_the_lab_is_not_galilean():
    crew, positions, velocities = world(np.random.default_rng(4))
    law = ForceLaw([Term(parse_formula("c1 * v_i", TYPES))], {"c1": -0.5})
    here = acceleration(law, crew, positions, velocities)
    there = acceleration(law, crew, positions, velocities + 1.0)
    masses = np.array([e.mass for e in crew])[:, None]
    np.testing.assert_allclose(there - here, np.broadcast_to(-0.5 / masses, here.shape), rtol=1e-14)


SYMMETRIC = [
    "c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)",
    "-c1 * q_i * q_j / norm(p_i - p_j)^3 * (p_j - p_i)",
    "c1 * (norm(p_i - p_j) - R_i - R_j) * normalize(p_j - p_i)",
    "c1 * m_i * m_j / (m_i + m_j) * along(v_i - v_j, p_i - p_j) * normalize(p_i - p_j)",
    "c1 * does_collide(s_i, p_i, s_j, p_j) * normalize(p_i - p_j)",
    "c1 * (v_j - v_i) * exp(-norm(p_i - p_j) / 1 [m])",
    "c1 * norm(v_i - v_j) * perp(normalize(p_i - p_j))",
]


@pytest.mark.parametrize("text", SYMMETRIC)
@pytest.mark.parametrize("seed", range(5))
def test_symmetric_pair_laws_obey_newtons_third(text, seed):
    """Forces sum to zero: rounding of a few operations on each of six forces."""
    rng = np.random.default_rng(seed)
    crew, positions, velocities = world(rng)
    positions = positions / 4  # near enough for some of the discs to touch
    law = ForceLaw([Term(parse_formula(text, TYPES))], {"c1": 1.3})
    masses = np.array([e.mass for e in crew])[:, None]
    forces = masses * acceleration(law, crew, positions, velocities)
    scale = np.abs(forces).sum()
    assert scale > 0
    assert np.all(np.abs(forces.sum(axis=0)) <= 32 * np.finfo(float).eps * scale)


def test_a_lopsided_law_does_not_obey_newtons_third():
    crew, positions, velocities = world(np.random.default_rng(5))
    law = ForceLaw([Term(parse_formula("m_i * m_j^2 * (p_j - p_i)", TYPES))])
    masses = np.array([e.mass for e in crew])[:, None]
    forces = masses * acceleration(law, crew, positions, velocities)
    assert np.abs(forces.sum(axis=0)).max() > 0.01 * np.abs(forces).sum()


@pytest.mark.parametrize(
    ("text", "feels"),
    [
        ("9.81 [m/s^2] * m_i * down", True),
        ("mass_i * v_i", True),
        ("-m_i * norm(v_i) * v_i / 2", True),
        ("m_i * q_j * (p_j - p_i)", True),
        ("c1 * v_i", False),
        ("c1 * m_i^2 * v_i", False),
        ("m_i * m_i * v_i", False),
        ("m_i * v_i / m_i", False),
        ("c1 * q_i * (p_j - p_i)", False),
        ("m_i / (m_i + 1 [kg]) * v_i", False),
        ("(m_i + m_i) * v_i", False),
    ],
)
def test_only_laws_per_unit_mass_move_a_body_of_unknown_mass(text, feels):
    """And the bodies of known mass feel what they would feel beside a known one."""
    formula = parse_formula(text, TYPES)
    law = ForceLaw([Term(formula)], {"c1": 0.7} if "c1" in formula.constants else {})
    found = {}
    for mass in (1.7, np.nan):
        crew, positions, velocities = world(np.random.default_rng(6), masses=(mass, 2.0, 3.0))
        found[mass] = acceleration(law, crew, positions, velocities)
    known, unknown = found.values()
    np.testing.assert_array_equal(unknown[1:], known[1:])
    assert np.any(known[0] != 0)
    np.testing.assert_array_equal(unknown[0], known[0] if feels else 0)


def test_an_unknown_charge_feels_no_electric_force_but_its_weight():
    crew, positions, velocities = world(np.random.default_rng(7))
    crew = (Entity("d0", "disc", radius=1.0, properties={"mass": 2.0}), *crew[1:])
    law = ForceLaw(
        [Term(parse_formula(t, TYPES)) for t in ("q_i * e_x", "9.81 [m/s^2] * m_i * down")]
    )
    found = acceleration(law, crew, positions, velocities)
    np.testing.assert_array_equal(found[0], [0, -9.81])
    assert np.all(found[1:, 0] > 0)


def test_terms_add_up_and_sources_are_summed():
    crew, positions, velocities = world(np.random.default_rng(8), with_walls=True)
    pair = Term(parse_formula("m_i * m_j * (p_j - p_i)", TYPES))
    field = Term(parse_formula("c1 * m_i * e_x", TYPES))
    both = ForceLaw([pair, field], {"c1": 0.25})
    found = acceleration(both, crew, positions, velocities)
    for i in range(3):
        expected = np.array([0.25, 0.0])
        for j in range(5):  # static bodies are sources too
            if j != i:
                expected = expected + crew[j].mass * (positions[j] - positions[i])
        np.testing.assert_allclose(found[i], expected, rtol=1e-13)
    assert (pair.kind, field.kind) == ("pair", "field")
    # A law without j that is declared a pair law acts once per source.
    as_pair = ForceLaw([Term(field.formula, "pair")], {"c1": 0.25})
    np.testing.assert_array_equal(
        acceleration(as_pair, crew, positions, velocities), np.tile([1.0, 0.0], (3, 1))
    )


def test_walks_meet_every_operator_of_a_law():
    """The filters above look at whole formulas."""
    formula = parse_formula("c1 * norm(v_i - v_j) * v_i", TYPES)
    assert has_bare_velocity(formula)
    assert {n.operator for n in walk(formula) if isinstance(n, Call)} == {"mul", "norm", "sub"}
