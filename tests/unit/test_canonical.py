"""Laws that are equal up to algebra have one key."""

import pytest

from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.units import Unit

TYPES = input_types({"mass": Unit.of(kg=1), "charge": None, "radius": Unit.of(m=1)})


def law(text):
    return parse_formula(text, TYPES)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("c1 * v_i", "c1 * (norm(v_i) * normalize(v_i))"),
        ("c1 * v_i", "c2 * (m_i * inverse(m_i) * norm(v_i) * normalize(v_i))"),
        ("c1 * v_i", "c1 * (norm(v_i) * normalize(v_i) * m_i^2 * inverse(m_i^2))"),
        ("k * (p_i - p_j)", "-k * (p_j - p_i)"),
        ("k * (p_i - p_j)", "k * norm(p_j - p_i) * normalize(p_i - p_j)"),
        ("c * m_i * m_j / (m_i + m_j) * v_i", "c * v_i / (1/m_i + 1/m_j)"),
        ("c * mass_i * v_i", "c * m_i * v_i"),
        ("a * norm(v_i)^n * v_i", "b * v_i * norm(v_i)^e"),
        ("c * normalize(v_i) * does_collide(s_i, p_i, s_j, p_j)",
         "c * does_collide(s_i, p_i, s_j, p_j) * v_i / norm(v_i)"),
    ],
)  # fmt: skip
def test_rewritings_are_one_law(one, other):
    assert canonical_key(law(one)) == canonical_key(law(other))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("c1 * v_i", "c1 * m_i * v_i"),
        ("c1 * v_i", "c1 * norm(v_i) * v_i"),
        ("k * (p_i - p_j)", "k * normalize(p_i - p_j)"),
        ("k * (p_i - p_j)", "k * (p_i - p_j) * does_collide(s_i, p_i, s_j, p_j)"),
        ("c * perp(v_i)", "c * v_i"),
    ],
)
def test_other_laws_are_others(one, other):
    assert canonical_key(law(one)) != canonical_key(law(other))


def test_laws_in_space_have_keys_of_their_own():
    types = input_types({}, n_dims=3)
    texts = ("c * e_z", "c * cross(e_z, v_i)", "c * v_i", "c * e_x")
    keys = [canonical_key(parse_formula(text, types), 3) for text in texts]
    assert len(set(keys)) == len(texts)
    turned = parse_formula("-c * cross(v_i, e_z)", types)
    assert canonical_key(turned, 3) == keys[1]


def test_keys_have_one_length():
    texts = ("c * v_i", "0 [N] * e_x", "g * e_y")
    assert len({len(canonical_key(law(text))) for text in texts}) == 1
