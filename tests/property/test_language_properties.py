import pickle

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bsp_gp.data.scene import PROPERTY_UNITS
from bsp_gp.errors import GrammarError
from bsp_gp.language.expression import derive, to_formula
from bsp_gp.language.formula import Call, evaluate, walk
from bsp_gp.language.grammar import load_grammar
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.language.primitives import from_tree, primitive_set, to_tree
from bsp_gp.language.render import to_latex, to_text
from tests.in_sympy import to_sympy

NEWTONIAN = load_grammar("newtonian")
PLANE = load_grammar("physics").masked(set(load_grammar("physics").inputs) - {"e_z"}, 2)[0]
SPACE = load_grammar("physics").masked(set(load_grammar("physics").inputs), 3)[0]
STARTS = [(g, start) for g in (NEWTONIAN, PLANE, SPACE) for start in g.start.values()]
UNIFORM = {id(g): Pcfg.uniform(g) for g in (NEWTONIAN, PLANE, SPACE)}
PRIMITIVES = {(id(g), s): primitive_set(g, k) for g in (NEWTONIAN, PLANE, SPACE)
              for k, s in g.start.items()}  # fmt: skip
TYPES = input_types(PROPERTY_UNITS, n_dims=3, up="y")
PROFILE = settings(max_examples=100, deadline=None)


@st.composite
def sampled(draw, starts=STARTS, most=14):
    """A grammar, its start symbol, a bound on levels and a derivation sampled under it."""
    grammar, start = draw(st.sampled_from(starts))
    bound = draw(st.integers(grammar.min_levels[start], most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    return grammar, start, bound, UNIFORM[id(grammar)].sample(rng, start, bound)


def type_of(expression, grammar):
    """Nonterminal at the root, after checking every rule's children."""
    rule = grammar.rules[expression.rule]
    assert tuple(type_of(child, grammar) for child in expression.children) == rule.children
    return rule.nonterminal


@PROFILE
@given(sampled())
def test_samples_are_well_typed_and_within_the_bound(sample):
    grammar, start, bound, expression = sample
    assert expression.levels <= bound
    assert type_of(expression, grammar) == start
    rules = list(expression.rules())
    assert expression.size == len(rules)
    formula = to_formula(expression, grammar)
    assert formula.type.shape == "vector"


@PROFILE
@given(sampled())
def test_log_prob_is_the_sum_over_rules(sample):
    grammar, _, _, expression = sample
    expected = 0.0
    stack = [expression]
    while stack:
        node = stack.pop()
        nonterminal = grammar.rules[node.rule].nonterminal
        expected -= np.log(len(grammar.rules_of[nonterminal]))
        stack.extend(node.children)
    found = UNIFORM[id(grammar)].log_prob(expression)
    assert found == pytest.approx(expected, rel=1e-12)


@PROFILE
@given(sampled())
def test_text_reads_back_as_the_same_formula(sample):
    grammar, _, _, expression = sample
    formula = to_formula(expression, grammar)
    again = parse_formula(
        to_text(formula), {**TYPES, **grammar.inputs}, operators=grammar.operators
    )
    assert again == formula
    assert hash(again) == hash(formula)


@PROFILE
@given(sampled(most=9))
def test_a_formula_has_a_derivation_again(sample):
    grammar, start, _, expression = sample
    formula = to_formula(expression, grammar)
    derived = derive(formula, grammar, start)
    assert type_of(derived, grammar) == start
    assert to_formula(derived, grammar) == formula
    assert derived.levels <= expression.levels  # the shortest one is found


@PROFILE
@given(sampled())
def test_deap_trees_are_expressions(sample):
    grammar, start, _, expression = sample
    pset = PRIMITIVES[id(grammar), start]
    tree = to_tree(expression, pset)
    assert from_tree(tree, grammar) == expression
    assert len(tree) == expression.size
    assert tree.height == expression.levels - 1
    for node in tree:
        rule = grammar.rules[int(node.name[1:])]
        assert node.ret.__name__ == rule.nonterminal
        arguments = tuple(a.__name__ for a in node.args) if node.arity else ()
        assert arguments == rule.children
    with pytest.raises(GrammarError):
        from_tree(tree[:-1], grammar)
    with pytest.raises(GrammarError):
        from_tree([*tree, tree[-1]], grammar)


@PROFILE
@given(sampled())
def test_pickles_round_trip(sample):
    grammar, _, _, expression = sample
    for thing in (expression, to_formula(expression, grammar)):
        assert pickle.loads(pickle.dumps(thing)) == thing


@PROFILE
@given(sampled())
def test_latex_has_balanced_brackets(sample):
    grammar, _, _, expression = sample
    text = to_latex(to_formula(expression, grammar), {"c1": -1.5e-11}, {"c1": "m^3/(kg s^2)"})
    assert text.count("{") == text.count("}") > 0
    assert text.count(r"\left") == text.count(r"\right")
    if "c1" in to_formula(expression, grammar).constants:
        assert r"\times 10^{-11}" in text


def guards(formula, inputs, constants):
    """Smallest guarded divisor; inf if there is none."""
    values = [
        np.min(evaluate(node.args[1], inputs, constants))
        for node in walk(formula)
        if isinstance(node, Call) and node.operator == "div_guarded"
    ]
    return min(values, default=np.inf)


@settings(max_examples=60, deadline=None)
@given(sampled(starts=STARTS[:3], most=9), st.integers(0, 2**32))
def test_sympy_computes_the_same(sample, seed):
    """On inputs where no guard acts: a guarded quotient is a plain one there.

    Both do the same few dozen operations on values of order one; SymPy may cancel common
    factors, which moves the result by rounding only: 1e-9 leaves room for condition numbers up
    to 1e6.
    """
    import sympy

    grammar, _, _, expression = sample
    formula = to_formula(expression, grammar)
    used = {node.operator for node in walk(formula) if isinstance(node, Call)}
    assume(not used & {"does_collide", "is_on"})
    rng = np.random.default_rng(seed)
    inputs, symbols = {}, {}
    for name in sorted(formula.inputs):
        if name in ("e_x", "e_y"):
            inputs[name] = np.eye(2)["xy".index(name[2])]
        elif formula_type(formula, name).shape in ("vector", "point"):
            inputs[name] = rng.uniform(-2, 2, 2)
            symbols |= {f"{name}_{axis}": inputs[name][k] for k, axis in enumerate("xy")}
        else:
            inputs[name] = symbols[name] = rng.uniform(0.5, 2)
    constants = {name: rng.uniform(0.5, 2) for name in formula.constants}
    assume(guards(formula, inputs, constants) > 1e-3)
    value = evaluate(formula, inputs, constants)
    assume(np.all(np.isfinite(value)))
    found = to_sympy(formula)
    names = sorted(found.free_symbols, key=str)
    function = sympy.lambdify(names, list(found), "numpy")
    at = [(symbols | constants)[str(name)] for name in names]
    np.testing.assert_allclose(function(*at), value, rtol=1e-9, atol=1e-9 * np.max(np.abs(value)))


def formula_type(formula, name):
    return next(n.type for n in walk(formula) if getattr(n, "name", None) == name)


def skewed(grammar, seed):
    """A PCFG with unequal probabilities."""
    counts = np.random.default_rng(seed).integers(1, 6, len(grammar.rules))
    return Pcfg.from_counts(grammar, counts)


@pytest.mark.parametrize("grammar", [NEWTONIAN, PLANE], ids=["newtonian", "physics"])
def test_sampling_frequencies_are_the_probabilities(grammar):
    """Chi-squared over all rules, with a bound on levels that is (almost) never met.

    Under the null it has mean f and variance 2f for f degrees of freedom; five standard
    deviations above are met once in some million seeds, and the seed is fixed.
    """
    pcfg = skewed(grammar, 5)
    rng = np.random.default_rng(6)
    start = grammar.start["pair"]
    samples = [pcfg.sample(rng, start, 60) for _ in range(4000)]
    counts = pcfg.counts(samples)
    chisqr, freedom = 0.0, 0
    for rules in grammar.rules_of.values():
        index = [rule.index for rule in rules]
        if not index or not counts[index].any():
            continue  # masked, or belongs to the other start symbol
        expected = counts[index].sum() * pcfg.probabilities[index]
        assert np.all(expected > 5), "too few visits for a chi-squared"
        chisqr += float(np.sum((counts[index] - expected) ** 2 / expected))
        freedom += len(index) - 1
    assert freedom > 25
    assert abs(chisqr - freedom) < 5 * np.sqrt(2 * freedom)
    # The sampler leaves no room: the shortest derivations only, where the bound is the least.
    least = grammar.min_levels[start]
    assert {pcfg.sample(rng, start, least).levels for _ in range(50)} == {least}
    with pytest.raises(GrammarError, match=f"at least {least} levels"):
        pcfg.sample(rng, start, least - 1)


def test_under_a_bound_the_rest_is_renormalised():
    """At the least bound Coeff has BasicCoeff and its two products, each with its share."""
    pcfg = skewed(NEWTONIAN, 7)
    rng = np.random.default_rng(8)
    rules = {r.index: r for r in NEWTONIAN.rules_of["Meter"]}
    at_least = [k for k, r in rules.items() if "UnitlessVec" not in r.children]
    assert at_least and len(at_least) < len(rules)
    drawn = {pcfg.sample(rng, "Meter", 2).rule for _ in range(200)}
    assert drawn == set(at_least)


def test_from_counts_is_maximum_likelihood():
    pcfg = skewed(NEWTONIAN, 9)
    rng = np.random.default_rng(10)
    samples = [pcfg.sample(rng, "Force", 40) for _ in range(3000)]
    counts = pcfg.counts(samples)
    fitted = Pcfg.from_counts(NEWTONIAN, counts)
    for rules in NEWTONIAN.rules_of.values():
        index = [rule.index for rule in rules]
        p, n = pcfg.probabilities[index], counts[index].sum()
        assert fitted.probabilities[index].sum() == pytest.approx(1, rel=1e-14)
        error = np.sqrt(p * (1 - p) / n)
        assert np.all(np.abs(fitted.probabilities[index] - p) <= 5 * error)
    total = sum(pcfg.log_prob(e) for e in samples)
    assert sum(fitted.log_prob(e) for e in samples) > total  # no PCFG is likelier


def test_from_counts_with_smoothing_masks_and_nothing():
    masked, _ = NEWTONIAN.masked(set(NEWTONIAN.inputs) - {"mu_j", "p_c"})
    counts = np.zeros(len(masked.rules))
    unitless = [r.index for r in masked.rules_of["Unitless"]]
    assert len(unitless) == 1  # mu_i alone
    kg = [r.index for r in masked.rules_of["Kg"]]
    counts[kg] = [3, 1, 0, 0]
    plain = Pcfg.from_counts(masked, counts)
    np.testing.assert_array_equal(plain.probabilities[kg], [0.75, 0.25, 0, 0])
    smooth = Pcfg.from_counts(masked, counts, smoothing=1.0)
    np.testing.assert_array_equal(smooth.probabilities[kg], [0.5, 0.25, 0.125, 0.125])
    assert plain.probabilities[unitless[0]] == 1
    off = [rule.index for rule in masked.rules if not masked.enabled[rule.index]]
    assert off and not np.any(smooth.probabilities[off])
    uniform = Pcfg.uniform(masked)
    mixed = plain.mixed(uniform, 0.5)
    np.testing.assert_array_equal(mixed.probabilities[kg], [0.5, 0.25, 0.125, 0.125])
    expression = derive(
        parse_formula("c1 * (mu_j * normalize(v_i))", dict(NEWTONIAN.inputs)), NEWTONIAN, "Force"
    )
    assert uniform.log_prob(expression) == -np.inf
    with pytest.raises(GrammarError, match="47 probabilities"):
        Pcfg(masked, [1.0])
