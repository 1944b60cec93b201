"""A lowered law computes what the operators compute, and its slopes are the operators' own."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bsp_gp.language.expression import to_formula
from bsp_gp.language.formula import Call, Constant, Input, evaluate, evaluate_with_gradient, walk
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.operators import OPERATORS, Type
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.physics.engine.graph import Graph, Tape
from bsp_gp.physics.engine.lowering import MOVING, Lowering
from bsp_gp.physics.geometry import CODES, Shapes, contact_point

NEWTONIAN = load_grammar("newtonian")
PHYSICS = load_grammar("physics")
PLANE = PHYSICS.masked(set(PHYSICS.inputs) - {"e_z"}, 2)[0]
SPACE = PHYSICS.masked(set(PHYSICS.inputs), 3)[0]
STARTS = [(g, start) for g in (NEWTONIAN, PLANE, SPACE) for start in g.start.values()]
UNIFORM = {id(g): Pcfg.uniform(g) for g in (NEWTONIAN, PLANE, SPACE)}
PROFILE = settings(max_examples=100, deadline=None, derandomize=True)
STATE = ("p_i", "p_j", "v_i", "v_j")
CONDITIONS = ("does_collide", "is_on", "sign")
MARGIN = 1e-3
"""Conditions nearer than this to their change are left out: they have no derivative there."""

TYPES = {name: Type(type_.shape, None) for name, type_ in STATE_INPUTS.items()}
TYPES |= dict.fromkeys(("a_i", "b_j"), Type("scalar", None))
"""All units open, and two properties of bodies."""
FURTHER = {  # what no grammar says
    "pow": ["norm(v_i)^c1", "(a_i * norm(p_i - p_j))^(-c1)", "c1^norm(v_j)", "norm(v_i)^3",
            "norm(v_i)^0", "norm(v_j)^0.5", "a_i^norm(v_i)"],
    "exp": ["exp(-norm(p_i - p_j) * c1)"],
    "log": ["log(c1 * norm(p_i - p_j))"],
    "sin": ["sin(c1 * t + c2)", "sin(norm(v_i) * c1)"],
    "cos": ["cos(c1 * norm(p_i - p_j)^2)"],
    "tanh": ["tanh(c1 * dot(v_i, e_x))"],
    "sign": ["sign(dot(v_i, v_j) - c1) * norm(v_i)", "sign(a_i) * c1"],
    "sqrt": ["sqrt(c1 + norm(v_i))"],
    "abs": ["abs(dot(v_i, p_i - p_j)) * c1", "abs(-c1)"],
    "square": ["square(c1 - norm(v_j))"],
    "inverse": ["inverse(c1 + norm(p_i - p_j))"],
    "along": ["along(v_i, p_i - p_j)", "along(c1 * v_i, v_j)"],
    "project_abs": ["project_abs(v_i, c1 * v_j)"],
    "div_guarded": ["div_guarded(c1, norm(v_i) - b_j)", "div_guarded(a_i, c1 * b_j)"],
    "neg": ["-(-norm(v_i) * c1)"], "sub": ["c1 - norm(v_i) - c1"],
}  # fmt: skip


@st.composite
def grammatical(draw):
    """A formula of a grammar and the number of dimensions that it is meant for."""
    grammar, start = draw(st.sampled_from(STARTS))
    bound = draw(st.integers(grammar.min_levels[start], 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    formula = to_formula(UNIFORM[id(grammar)].sample(rng, start, bound), grammar)
    return formula, 3 if grammar is SPACE else 2


def parsed(text):
    return parse_formula(text, TYPES)


@st.composite
def typed(draw):
    """Products and sums of the further formulas, on a direction."""
    texts = [t for group in FURTHER.values() for t in group]
    one, two = (draw(st.sampled_from(texts)) for _ in range(2))
    glue = draw(st.sampled_from(["({}) * ({}) * v_i", "({}) * v_j - ({}) * (p_i - p_j)",
                                 "(({}) + c3 * ({})) * normalize(p_j - p_i)"]))  # fmt: skip
    return glue.format(one, two), draw(st.sampled_from([2, 3]))


def shapes_of(rng):
    """Receiver and other: two discs, a disc and a wall, a disc on a mat, points."""
    pair = [("disc", "disc"), ("disc", "rect_wall"), ("disc", "rect_mat"), ("point", "disc")]
    own, other = pair[rng.integers(len(pair))]
    sizes = rng.uniform(0.5, 4.0, (3, 2))
    crew = [(own, sizes[:, 0]), (other, sizes[:, 1])]
    return [Shapes(np.array(CODES[s]), *(np.array(x) for x in size)) for s, size in crew]


def inputs_of(formula, n_dims, rng):
    """Values of every input that a formula may ask for."""
    found = {name: rng.uniform(-2.0, 2.0, n_dims) for name in STATE}
    found |= {"t": np.float64(rng.uniform(0, 3))}
    found["s_i"], found["s_j"] = shapes_of(rng)
    found["p_c"] = contact_point(found["p_i"], found["s_j"], found["p_j"])
    found |= {f"e_{'xyz'[k]}": np.eye(n_dims)[k] for k in range(n_dims)}
    for name in formula.inputs - set(found):
        is_vector = next(
            n.type.shape == "vector" for n in walk(formula) if getattr(n, "name", "") == name
        )
        found[name] = rng.uniform(-2.0, 2.0, n_dims) if is_vector else rng.uniform(0.5, 2.0)
    return found


def sizes_of(inputs):
    """What margins of contacts are measured with, of one pair."""
    own, other = inputs["s_i"], inputs["s_j"]
    disc, wall = own.code == CODES["disc"], other.code == CODES["rect_wall"]
    half = np.array([other.width, other.height]) / 2
    return {
        "is_disc_pair": disc & (other.code == CODES["disc"]), "is_disc_wall": disc & wall,
        "is_mat": other.code == CODES["rect_mat"], "disc_reach": own.radius + other.radius,
        "wall_half_width": half[0] + own.radius, "wall_half_height": half[1] + own.radius,
        "mat_half_width": half[0], "mat_half_height": half[1],
        "wide_wall": wall & (half[0] > half[1]), "tall_wall": wall & ~(half[0] > half[1]),
    }  # fmt: skip


class Lowered:
    """A formula as a tape, with what it is evaluated on."""

    def __init__(self, formula, n_dims, seed):
        rng = np.random.default_rng(seed)
        self.formula, self.n_dims = formula, n_dims
        self.inputs = inputs_of(formula, n_dims, rng)
        self.constants = {name: rng.uniform(0.5, 2.0) for name in formula.constants}
        self.sizes = sizes_of(self.inputs)
        self.graph = Graph()
        vectors = [n for n, v in self.inputs.items() if np.ndim(v) == 1]
        self.lowering = Lowering(self.graph, n_dims, self.inputs.get, vectors)
        lowered = self.lowering.lower(formula)
        self.nodes = lowered if isinstance(lowered, tuple) else (lowered,)
        margins = [mode.margin for mode in self.lowering.modes]
        self.modes = []  # margins may hang on modes of conditions inside of them
        for k in range(len(margins)):
            self.modes = [*self.modes, *[0.0] * (len(margins) - len(self.modes))]
            margin = self.run(margins)[k]
            mode = self.lowering.modes[k]
            self.modes[k] = mode.on if margin > 0 else mode.off
        self.margins = self.run(margins)

    def value(self, name, axis):
        if name == "mode":
            return np.float64(self.modes[axis])
        found = self.sizes[name] if name in self.sizes else self.inputs[name]
        return np.float64(found if axis is None else found[axis])

    def run(self, nodes):
        tape = Tape(self.graph, nodes, MOVING)
        constants = {name: np.float64(x) for name, x in self.constants.items()}
        return tape.run(tape.prepare(self.value, constants), self.value)

    def slopes(self, leaf):
        slopes = self.run([self.graph.slope(node, leaf) for node in self.nodes])
        return np.array(slopes, dtype=float)

    @property
    def is_tame(self):
        """Whether values are no rounding errors of huge or tiny parts, and no condition is near."""
        parts = [
            evaluate(node, self.inputs, self.constants)
            for node in walk(self.formula)
            if isinstance(node, Call) and node.type.shape != "point"
        ]
        size = [np.abs(part) for part in parts]
        finite = all(np.isfinite(part).all() for part in parts)
        near = any(abs(m) < MARGIN for m in self.margins)
        fair = all(np.all((s == 0) | ((s > 1e-6) & (s < 1e6))) for s in size)
        return finite and fair and not near


def directional(node, lowered, name, axis):
    """Value and derivative by one component of an input, operator by operator."""
    if isinstance(node, Constant):
        return np.float64(lowered.constants[node.name]), None
    if not isinstance(node, Call):
        value = evaluate(node, lowered.inputs, lowered.constants)
        if isinstance(node, Input) and node.name == name:
            return value, np.eye(lowered.n_dims)[axis]
        if isinstance(node, Input) and node.name == "p_c":
            return value, by_contact_point(lowered, name, axis)
        return value, None
    pairs = [directional(arg, lowered, name, axis) for arg in node.args]
    values, tangents = zip(*pairs, strict=True)
    operator, types = OPERATORS[node.operator], tuple(arg.type for arg in node.args)
    value = operator.evaluate(types, *values)
    if operator.derivative is None or all(t is None for t in tangents):
        return value, None
    return value, operator.derivative(types, values, list(tangents))


def by_contact_point(lowered, name, axis):
    """Slope of the contact point by differences; it is linear in both places."""
    if name[0] != "p":
        return None
    found = []
    for sign in (0.5, -0.5):
        inputs = dict(lowered.inputs)
        inputs[name] = inputs[name] + sign * np.eye(lowered.n_dims)[axis]
        found.append(contact_point(inputs["p_i"], inputs["s_j"], inputs["p_j"]))
    return np.round(found[0] - found[1])


def check(formula, n_dims, seed):
    """Compare values and all slopes of a lowered formula; False if the sample is no fair one."""
    lowered = Lowered(formula, n_dims, seed)
    if not lowered.is_tame:
        return False
    expected = np.atleast_1d(evaluate(formula, lowered.inputs, lowered.constants))
    found = np.broadcast_to(lowered.run(lowered.nodes), expected.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    g = lowered.graph
    _, gradient = evaluate_with_gradient(
        formula, lowered.inputs, lowered.constants, formula.constants
    )
    pairs = [(g.constant(name), slope) for name, slope in gradient.items()]
    with np.errstate(all="ignore"):
        pairs += [
            (g.input(name, axis), directional(formula, lowered, name, axis)[1])
            for name in STATE for axis in range(n_dims)
        ]  # fmt: skip
    for leaf, slope in pairs:
        slope = np.zeros(len(lowered.nodes)) if slope is None else np.asarray(slope, dtype=float)
        if not (np.isfinite(slope).all() and np.abs(slope).max() < 1e8):
            return False
        found = lowered.slopes(leaf)
        atol = 1e-8 * max(np.abs(slope).max(), np.abs(expected).max())
        np.testing.assert_allclose(found, np.broadcast_to(slope, found.shape), rtol=1e-8, atol=atol)
    return True


@PROFILE
@given(grammatical(), st.integers(0, 2**32))
def test_formulas_of_the_grammars(sample, seed):
    assume(check(*sample, seed))


@PROFILE
@given(typed(), st.integers(0, 2**32))
def test_formulas_that_no_grammar_says(sample, seed):
    text, n_dims = sample
    assume(check(parsed(text), n_dims, seed))


ARGUMENTS = {
    "scalar": ["c1 * norm(v_i) + c3", "c2 * norm(p_i - p_j) + a_i"],
    "vector": ["c1 * v_i", "c2 * (p_i - p_j)"],
}
OF_VECTORS = ("norm", "normalize", "dot", "along", "project_abs", "perp", "cross")


@pytest.mark.parametrize("name", OPERATORS)
def test_every_operator_is_lowered(name):
    """With arguments that depend on places, velocities and constants; a new operator fails here."""
    n_dims = 3 if name == "cross" else 2
    operator = OPERATORS[name]
    if name in ("does_collide", "is_on"):
        call = Call(name, *(Input(n, STATE_INPUTS[n]) for n in ("s_i", "p_i", "s_j", "p_j")))
        call = Call("mul", call, parsed("c1 * v_i"))
    else:
        kind = "vector" if name in OF_VECTORS else "scalar"
        texts = ARGUMENTS[kind][: operator.arity]
        call = Call(name, *(parsed(text) for text in texts))
    assert sum(check(call, n_dims, seed) for seed in range(8)) >= 6


@pytest.mark.parametrize("name", ["does_collide", "is_on"])
def test_margins_of_contacts_are_positive_where_they_hold(name):
    call = Call(name, *(Input(n, STATE_INPUTS[n]) for n in ("s_i", "p_i", "s_j", "p_j")))
    held = []
    for seed in range(200):
        lowered = Lowered(call, 2, seed)
        held.append(bool(evaluate(call, lowered.inputs)))
        assert (lowered.margins[0] > 0) == held[-1]
    assert 10 < sum(held) < 190  # both happen


def test_a_vector_at_zero_has_no_direction_and_no_slope():
    lowered = Lowered(parsed("c1 * normalize(v_i) + norm(v_i) * v_j"), 2, 0)
    lowered.inputs["v_i"] = np.zeros(2)
    np.testing.assert_array_equal(lowered.run(lowered.nodes), 0.0)
    for axis in range(2):
        assert np.all(lowered.slopes(lowered.graph.input("v_i", axis)) == 0.0)


def test_equal_parts_are_one_node():
    g = Graph()
    lowering = Lowering(g, 2, dict(e_x=(1.0, 0.0)).get)
    one = lowering.lower(parsed("c1 * norm(p_i - p_j)"))
    count = len(g.nodes)
    assert lowering.lower(parsed("norm(p_i - p_j) * c1")) == one
    assert len(g.nodes) == count


def test_what_belongs_to_bodies_alone_is_computed_once():
    formula = parsed("exp(a_i) * c1 * v_i")
    g = Graph()
    nodes = Lowering(g, 2, {}.get).lower(formula)
    tape = Tape(g, nodes, MOVING)
    calls = SimpleNamespace(names=[])

    def inputs(name, axis):
        calls.names.append(name)
        return np.float64(0.5)

    prepared = tape.prepare(inputs, {"c1": np.float64(2.0)})
    assert calls.names == ["a_i"]
    calls.names.clear()
    found = tape.run(prepared, inputs)
    assert calls.names == ["v_i", "v_i"]
    np.testing.assert_allclose(found, np.exp(0.5))
    assert len(tape.line) == 2  # one product for each component
