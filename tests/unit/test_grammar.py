import copy
import itertools
import pickle
import tomllib

import numpy as np
import pytest

from bsp_gp.errors import GrammarError
from bsp_gp.language.expression import derive
from bsp_gp.language.grammar import grammar_directory, load_grammar, read_grammar
from bsp_gp.language.operators import Type
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.units import Unit

FILES = sorted(path.stem for path in grammar_directory().glob("*.toml"))
SMALL = """
[grammar]
name = "small"
start = "Force"
kind = "pair"
[types]
Force = "vector *"
Coeff = "scalar *"
Direction = "vector 1"
[inputs]
m_i = "scalar kg"
m_j = "scalar kg"
q_j = "scalar A s"
p_i = "point m"
p_j = "point m"
[constants]
c1 = "scalar *"
[rules]
Force = "mul(c1, mul(Coeff, Direction))"
Coeff = "m_i | m_j | q_j | mul(Coeff, Coeff)"
Direction = "normalize(sub(p_i, p_j))"
"""


def small(**changes):
    """The small grammar's tables with some entries changed: table__key = value, None = removed."""
    source = tomllib.loads(SMALL)
    for place, value in changes.items():
        table, _, key = place.partition("__")
        if not key:
            source[table] = value
        elif value is None:
            del source[table][key]
        else:
            source[table][key] = value
    return source


@pytest.fixture(scope="module")
def newtonian():
    return load_grammar("newtonian")


@pytest.mark.parametrize("name", FILES)
def test_every_grammar_file_loads(name):
    grammar = load_grammar(name)
    assert grammar.name == name
    assert all(np.isfinite(least) for least in grammar.min_levels.values())
    assert [rule.index for rule in grammar.rules] == list(range(len(grammar.rules)))


def test_the_papers_grammar(newtonian):
    """Counts of the paper (EXHAUSTIVE.md, STYLE.md)."""
    assert len(newtonian.rules) == 47
    assert len(newtonian.types) == 17
    assert newtonian.min_levels["Force"] == 5  # height 4, a terminal rule having height 0
    assert newtonian.count("Force", 4) == 0
    assert newtonian.count("Force", 5) == 75_816
    assert newtonian.count("Force", 6) == 771_120
    assert dict(newtonian.start) == {"pair": "Force"}
    assert newtonian.constants == ("c1", "c2", "c3")


def derivations(grammar, nonterminal, levels):
    """Every derivation by brute force, as nested tuples."""
    if levels == 0:
        return []
    out = []
    for rule in grammar.rules_of[nonterminal]:
        choices = [derivations(grammar, child, levels - 1) for child in rule.children]
        out.extend((rule.index, *children) for children in itertools.product(*choices))
    return out


@pytest.mark.parametrize(
    ("name", "nonterminal", "levels"),
    [("newtonian", "Force", 5), ("newtonian", "UnitlessVec", 5), ("newtonian", "Coeff", 4),
     ("physics", "PairDirection", 5), ("physics", "Motion", 4), ("physics", "FieldForce", 4)],
)  # fmt: skip
def test_counts_are_those_of_brute_force(name, nonterminal, levels):
    grammar = load_grammar(name)
    listed = derivations(grammar, nonterminal, levels)
    assert len(set(listed)) == len(listed) == grammar.count(nonterminal, levels) > 0


def test_counts_stay_exact_beyond_floats(newtonian):
    count = newtonian.count("Force", 30)
    assert isinstance(count, int) and count > 2**53
    assert count == newtonian.count("BasicForce", 29)


def test_physics_in_the_plane():
    grammar = load_grammar("physics")
    assert dict(grammar.start) == {"pair": "PairForce", "field": "FieldForce"}
    available = {"m_i", "m_j", "p_i", "p_j", "v_i", "v_j", "e_x", "e_y"}
    plane, missing = grammar.masked(available, 2)
    assert missing == (
        "R_i", "R_j", "e_z", "k_i", "k_j", "l_i", "l_j", "mu_i", "mu_j", "p_c", "q_i", "q_j",
        "s_i", "s_j", "t",
    )  # fmt: skip
    # Extensions need l or R, conditions shapes: gone with all that needs them.
    gone = {"Extension", "PairCondition", "Time"}
    assert {name for name, rules in plane.rules_of.items() if not rules} == gone
    assert not any(r.operators & {"cross"} for rules in plane.rules_of.values() for r in rules)
    # FieldForce with a bare direction: v^ and v_perp, one level deeper e_x and e_y.
    assert len(derivations(plane, "FieldForce", 2)) == plane.count("FieldForce", 2) == 2
    bare = [d for d in derivations(plane, "FieldForce", 3) if len(d) == 3]
    assert len(bare) == 4
    # By hand: 5 properties (reduced mass and sum included), 4 powers of each; 20 + 20^2 parts.
    assert plane.count("PropertyPart", 12) == 20 + 20**2
    # Distance: 8 powers; 2 speeds with 4; radial: one separation, 2 ways, 2 powers.
    motion = 8 + 8 + 4 + 8 * 8 + 8 * 4 + 8 * 4 + 8 * 8 * 4
    assert plane.count("Motion", 12) == motion
    directions = 2 * (1 + 2)
    coefficients = 420 + motion + 420 * motion
    assert plane.count("PairForce", 12) == coefficients * directions
    own_motion = 4
    own = 4 + 16
    assert plane.count("FieldForce", 12) == 4 * (1 + own + own_motion + own * own_motion)


def test_physics_in_space_has_cross_products_and_no_perpendiculars():
    grammar = load_grammar("physics")
    space, missing = grammar.masked(set(grammar.inputs), 3)
    assert missing == ()
    used = set().union(*(r.operators for rules in space.rules_of.values() for r in rules))
    assert "cross" in used and "perp" not in used


def test_masking_removes_rules_that_cannot_be_finished():
    grammar = read_grammar(small())
    masked, missing = grammar.masked({"m_i", "p_i", "p_j"})
    assert missing == ("m_j", "q_j")
    assert [r.text for r in masked.rules_of["Coeff"]] == ["m_i", "mul(Coeff, Coeff)"]
    nothing, _ = grammar.masked({"p_i", "p_j"})
    assert not nothing.rules_of["Coeff"] and not nothing.rules_of["Force"]
    assert nothing.count("Force", 20) == 0
    # Rule numbers keep their meaning.
    assert masked.fingerprint == grammar.fingerprint and len(masked.rules) == len(grammar.rules)
    assert Pcfg.uniform(masked).probabilities[grammar.rules_of["Coeff"][2].index] == 0


def test_masking_twice_is_masking_both():
    grammar = load_grammar("physics")
    both = grammar.without_inputs({"q_i", "q_j", "t"})
    twice = grammar.without_inputs({"q_i", "q_j"}).without_inputs({"t"})
    assert both.enabled == twice.enabled


def test_fingerprint_is_of_the_meaning():
    path = grammar_directory() / "newtonian.toml"
    text = path.read_text(encoding="utf-8")
    original = read_grammar(tomllib.loads(text)).fingerprint
    spaced = text.replace("| ", "   |  ").replace("mul(m_i, m_j)", "mul(m_i,  m_j)")
    commented = text.replace("# reduced mass", "# another remark").replace(
        '[rules]', '# a remark\n[rules]'
    )
    for same in (commented, spaced.replace("mul(m_i,  m_j)", "mul(m_i, m_j)")):
        assert same != text
        assert read_grammar(tomllib.loads(same)).fingerprint == original
    for other in (
        text.replace("mul(m_i, m_j) | square(Kg)", "square(Kg) | mul(m_i, m_j)"),  # renumbered
        text.replace("add(mu_i, mu_j)", "add(mu_j, mu_i)"),
        text.replace('project = "project_abs"', 'project = "dot"'),
        text.replace('"scalar m"\ns_i', '"scalar m"\nq_i = "scalar A s"\ns_i'),
    ):
        assert other != text
        assert read_grammar(tomllib.loads(other)).fingerprint != original


def test_grammars_travel_to_other_processes(newtonian):
    masked, _ = newtonian.masked(set(newtonian.inputs) - {"l_j"})
    again = pickle.loads(pickle.dumps(masked))
    assert (again.fingerprint, again.enabled) == (masked.fingerprint, masked.enabled)
    assert again.count("Force", 7) == masked.count("Force", 7) < newtonian.count("Force", 7)


def test_each_property_rules_are_repeated_for_new_columns():
    physics = load_grammar("physics")
    mass, spin = (Type("scalar", unit) for unit in (Unit.of(kg=1), Unit.of(s=-1)))
    more = physics.for_properties({"mass": mass, "spin": spin})
    assert len(more.rules) == len(physics.rules) + 4 + 1
    assert more.inputs["spin_i"].unit == Unit.of(s=-1)
    assert more.fingerprint != physics.fingerprint
    law = "c1 * ((spin_i - spin_j) * normalize(p_i - p_j))"
    formula = parse_formula(law, dict(more.inputs))
    assert derive(formula, more, "PairForce") is not None
    assert derive(formula, physics, "PairForce") is None
    assert physics.for_properties({"mass": mass}) is physics
    # The paper's grammar has no such rules and stays what it is.
    newtonian = load_grammar("newtonian")
    assert newtonian.for_properties({"mass": mass, "spin": spin}) is newtonian


def test_vectors_have_rules_of_their_own_and_velocities_more():
    physics = load_grammar("physics")
    spin, wind = (Type("vector", unit) for unit in (Unit.of(s=-1), Unit.of(m=1, s=-1)))
    more = physics.for_properties({"spin": spin, "wind": wind})
    types = dict(more.inputs)
    for law in (
        "c1 * (norm(spin_i) * norm(v_i) * cross(normalize(spin_i), normalize(v_i)))",
        "c1 * (norm(v_i - wind_i) * normalize(v_i - wind_i))",
    ):
        formula = parse_formula(law, types)
        assert derive(formula, more, "FieldForce") is not None


@pytest.mark.parametrize(
    ("changes", "parts"),
    [
        ({"types__Coeff": "scalar kg"}, ("Coeff -> q_j", "scalar s A", "scalar kg")),
        ({"rules__Direction": "sub(p_i, p_j)"}, ("vector m", "vector 1")),
        ({"rules__Direction": "norm(sub(p_i, p_j))"}, ("scalar m", "vector 1")),
        ({"rules__Coeff": "add(m_i, q_j)"}, ("rule Coeff -> add(m_i, q_j)", "adds", "s A", "kg")),
        ({"rules__Coeff": "exp(m_i)"}, ("dimensionless", "kg")),
        ({"rules__Coeff": "m_k"}, ("rule Coeff -> m_k", "unknown name 'm_k'")),
        ({"rules__Coeff": "frob(m_i)"}, ("unknown operator 'frob'",)),
        ({"rules__Coeff": "mul(m_i)"}, ("mul takes 2 argument(s), got 1",)),
        ({"rules__Coeff": "square(m_i, m_j)"}, ("square takes 1 argument(s), got 2",)),
        ({"rules__Coeff": "m_i * m_j"}, ("only calls, names and numbers",)),
        ({"rules__Coeff": "m_i.mass"}, ("only calls, names and numbers",)),
        ({"rules__Coeff": "square(x=m_i)"}, ("only calls, names and numbers",)),
        ({"rules__Coeff": "__import__('os')"}, ("unknown operator '__import__'",)),
        ({"rules__Coeff": "mul(m_i"}, ("not a call, a name or a number",)),
        ({"rules__Coeff": "mul(Coeff, Coeff)"}, ("['Force', 'Coeff'] have no finite derivation",)),
        ({"rules__Coeff": None}, ("['Force', 'Coeff'] have no finite derivation",)),
        ({"rules__Mass": "m_i"}, ("rule for 'Mass', which has no type",)),
        ({"types__Mass": "scalar kg", "rules__Mass": "m_i"}, ("['Mass'] cannot be reached",)),
        ({"types__Coeff": "number kg"}, ("type of Coeff", "got 'number'")),
        ({"types__Coeff": "scalar zorkmid"}, ("type of Coeff", "unknown unit")),
        ({"inputs__m_i": "scalar g"}, ("type of m_i", "must be SI", "'g'", "write 'kg'")),
        ({"operators": {"mul": "times"}}, ("[operators] mul = 'times'",)),
        ({"grammar__kind": "triple"}, ("kind must be one of", "'triple'")),
        ({"grammar__kind": ["pair", "field"]}, ("one kind",)),
        ({"grammar__start": "Froce"}, ("start symbol 'Froce' has no type",)),
        ({"grammar__start": None}, ("[grammar] needs",)),
        ({"weights": {"Coeff": [1.0]}}, ("unknown table(s) ['weights']", "rules")),
    ],
)  # fmt: skip
def test_grammars_that_contradict_themselves(changes, parts):
    with pytest.raises(GrammarError) as caught:
        read_grammar(small(**changes))
    message = str(caught.value)
    assert all(part in message for part in parts), message
    assert "\n" not in message


@pytest.mark.parametrize("table", ["grammar", "types", "inputs", "rules"])
def test_a_table_is_missing(table):
    source = small()
    del source[table]
    with pytest.raises(GrammarError, match=rf"\[{table}\] is missing"):
        read_grammar(source)


def test_reading_leaves_its_source_alone():
    source = small()
    before = copy.deepcopy(source)
    read_grammar(source).for_properties({"spin": Type("scalar")})
    assert source == before


def test_files_name_themselves_in_errors(tmp_path):
    bad = tmp_path / "mine.toml"
    bad.write_text(SMALL.replace("m_i | m_j", "m_i | m_k"), encoding="utf-8")
    with pytest.raises(GrammarError, match="mine.toml: rule Coeff -> m_k"):
        load_grammar(bad)
    bad.write_text("[grammar\n", encoding="utf-8")
    with pytest.raises(GrammarError, match="mine.toml: not readable as TOML"):
        load_grammar(bad)
    bad.write_bytes(b"\xff\xfe")
    with pytest.raises(GrammarError, match="mine.toml: not readable as TOML"):
        load_grammar(bad)
    with pytest.raises(GrammarError, match="known are newtonian"):
        load_grammar("newtonain")
    bad.write_text(SMALL, encoding="utf-8")
    assert load_grammar(bad).name == "small"


def test_a_measured_column_may_be_called_like_a_constant_of_the_grammar():
    physics = load_grammar("physics")
    more = physics.for_properties({}, {"u": Type("scalar")})
    assert "u" in more.inputs
    assert "u" not in more.inside["ranges"]
    assert "u_own" in more.inside["ranges"]
    assert "u_own" in more.beyond.source["rules"]["Powered"]  # was: adds m/s and 1
