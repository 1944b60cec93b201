"""The exhaustive search against brute force over every derivation of small grammars."""

import itertools
import tomllib

import numpy as np
import pytest

import bsp_gp.search.exhaustive as exhaustive
import bsp_gp.search.scoring as scoring
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import GrammarError, SettingsError
from bsp_gp.language.expression import Expression, to_formula
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.language.pcfg import Pcfg
from bsp_gp.language.render import to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, split_linear
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.search.banks import Banks, Rows
from bsp_gp.search.exhaustive import Exhaustive, search_exhaustive
from bsp_gp.search.factoring import plan_of

MIXED = """
[grammar]
name = "mixed"
start = "Force"
kind = "pair"
[types]
Const = "scalar *"
Force = "vector *"
Coeff = "scalar *"
Factor = "scalar *"
Direction = "vector 1"
Gap = "vector m"
Condition = "bool 1"
[inputs]
m_i = "scalar kg"
m_j = "scalar kg"
p_i = "point m"
p_j = "point m"
v_i = "vector m/s"
s_i = "shape 1"
s_j = "shape 1"
[constants]
c1 = "scalar *"
[operators]
div = "div_guarded"
[rules]
Const = "c1"
Force = "mul(Const, mul(Coeff, Direction)) | mul(Const, mul(mul(Coeff, Direction), Condition))"
Coeff = "Factor | mul(Factor, Factor) | div(Factor, Factor)"
Factor = "m_i | m_j | add(m_i, m_j) | norm(Gap) | square(norm(Gap)) | norm(v_i)"
Gap = "sub(p_i, p_j)"
Direction = "normalize(Gap) | normalize(v_i)"
Condition = "does_collide(s_i, p_i, s_j, p_j)"
"""
SPLIT = """
[grammar]
name = "split"
start = ["Pair", "Field"]
kind = ["pair", "field"]
[types]
Const = "scalar *"
Pair = "vector *"
Coeff = "scalar *"
Property = "scalar *"
Motion = "scalar *"
Direction = "vector 1"
Field = "vector *"
Own = "scalar *"
Lab = "vector 1"
[inputs]
m_i = "scalar kg"
m_j = "scalar kg"
p_i = "point m"
p_j = "point m"
v_i = "vector m/s"
e_x = "vector 1"
e_y = "vector 1"
[constants]
c1 = "scalar *"
[rules]
Const = "c1"
Pair = "mul(Const, mul(Coeff, Direction))"
Coeff = "Property | Motion | mul(Property, Motion)"
Property = "m_i | m_j | mul(m_i, m_j)"
Motion = "norm(sub(p_i, p_j)) | inverse(square(norm(sub(p_i, p_j)))) | norm(v_i)"
Direction = "normalize(sub(p_i, p_j)) | normalize(v_i)"
Field = "mul(Const, Lab) | mul(Const, mul(Own, Lab))"
Own = "m_i | norm(v_i)"
Lab = "e_x | e_y | normalize(v_i)"
"""


def grammar_of(text):
    return read_grammar(tomllib.loads(text))


def regression_of(seed=0, n_times=14, method="one_step", n_scenes=2, **settings):
    """Three discs that sometimes touch: noise for accelerations, which is what laws must fit."""
    rng = np.random.default_rng(seed)
    scenes = []
    for k in range(n_scenes):
        crew = tuple(
            Entity(n, "disc", radius=r, properties={"mass": m})
            for n, r, m in zip("abc", rng.uniform(0.5, 1, 3), rng.uniform(0.5, 2, 3), strict=True)
        )
        positions = rng.uniform(-1, 1, (n_times, 3, 2))
        scenes.append(Scene(f"s{k}", np.cumsum(rng.uniform(0.1, 0.2, n_times)), positions, crew))
    return build_regression(scenes, method=method, sigma=[0.5, 2.0], **settings)


def derivations(grammar, nonterminal, levels):
    if levels == 0:
        return
    for rule in grammar.rules_of[nonterminal]:
        choices = [list(derivations(grammar, child, levels - 1)) for child in rule.children]
        for children in itertools.product(*choices):
            yield Expression(rule.index, children)


def brute_force(regression, grammar, kind, levels, nuisance=None, target=None, mask=None):
    """Loss and column of every derivation, by least squares with all columns at once."""
    y = regression.target() if target is None else target
    base = np.zeros((len(y), 0)) if nuisance is None else nuisance
    mask = np.ones(len(y), dtype=bool) if mask is None else mask
    out = {}
    for expression in derivations(grammar, grammar.start[kind], levels):
        formula = to_formula(expression, grammar)
        _, rest = split_linear(formula)
        column = regression.column(Term(rest, kind))[0][:, 0]
        if not np.any(column):
            continue
        design = np.column_stack([base, column])[mask]
        design = design / np.linalg.norm(design, axis=0)
        best = np.linalg.lstsq(design, y[mask], rcond=1e-10)[0]
        out[expression] = (0.5 * np.square(y[mask] - design @ best).sum(), column)
    return out


def distinct(columns):
    """Number of columns that are not proportional to one another."""
    kept = []
    for column in columns:
        column = column / np.linalg.norm(column)
        if all(abs(column @ other) < 1 - 1e-10 for other in kept):
            kept.append(column)
    return len(kept)


CASES = [(MIXED, "pair", "one_step", 4), (MIXED, "pair", "one_step", 5),
         (MIXED, "pair", "one_step", 6), (SPLIT, "pair", "one_step", 5),
         (SPLIT, "pair", "gls", 5), (MIXED, "pair", "gls", 4), (MIXED, "pair", "gls", 5),
         (SPLIT, "field", "one_step", 4),
         (SPLIT, "field", "gls", 4), (SPLIT, "pair", "weak", 5), (MIXED, "pair", "weak", 4),
         (SPLIT, "field", "one_step_weak", 4)]  # fmt: skip
IDS = [f"{'mixed' if c[0] is MIXED else 'split'}-{c[1]}-{c[2]}-{c[3]}" for c in CASES]


@pytest.mark.parametrize(("text", "kind", "method", "levels"), CASES, ids=IDS)
def test_nothing_is_missed(text, kind, method, levels):
    grammar = grammar_of(text)
    regression = regression_of(method=method)
    result = search_exhaustive(
        regression, grammar, kind=kind, max_levels=levels, top_k=10_000
    )
    truth = brute_force(regression, grammar, kind, levels)
    losses = np.array([loss for loss, _ in truth.values()])
    assert result.best.loss == pytest.approx(losses.min(), rel=1e-10)
    # Every derivation's loss is among the candidates', and no candidate is made up.
    found = np.array([c.loss for c in result.candidates])
    for loss in losses:
        assert np.min(np.abs(found - loss)) < 1e-9 * loss
    for loss in found:
        assert np.min(np.abs(losses - loss)) < 1e-9 * loss
    # Every distinct law is scored, and each is kept once.
    count = distinct([column for _, column in truth.values()])
    assert len(result.candidates) == count
    assert result.n_evaluated >= count
    assert result.certificate.n_derivations == len(list(
        derivations(grammar, grammar.start[kind], levels)
    ))
    assert list(found) == sorted(found)


def test_distinct_laws_are_scored_once_where_products_are_generic():
    """4 properties (m_i m_j among them) x 3 motions with a 1 on either side, 2 directions."""
    result = search_exhaustive(regression_of(), grammar_of(SPLIT), kind="pair")
    assert result.n_evaluated == (4 * 4 - 1) * 2
    result = search_exhaustive(regression_of(), grammar_of(SPLIT), kind="field")
    # m_i e_x is a plain acceleration of its own beside 1 e_x: 3 coefficients, 3 directions.
    assert result.n_evaluated == 3 * 3


def test_gains_constants_and_losses_belong_together():
    regression = regression_of()
    result = search_exhaustive(regression, grammar_of(MIXED), kind="pair", max_levels=6)
    y = regression.target()
    for candidate in result.candidates[:10]:
        name, rest = split_linear(candidate.formula)
        column = regression.column(Term(rest, "pair"))[0][:, 0]
        residual = y - candidate.constants[name] * column
        assert candidate.loss == pytest.approx(0.5 * residual @ residual, rel=1e-10)
        assert candidate.total == pytest.approx(y @ y, rel=1e-12)
        assert candidate.gain == pytest.approx(y @ y - residual @ residual, rel=1e-8)
        assert candidate.share == pytest.approx(candidate.gain / candidate.total)


def test_the_front_improves_with_complexity():
    front = search_exhaustive(regression_of(), grammar_of(MIXED), kind="pair").front
    assert len(front) > 1
    for simple, complex_ in itertools.pairwise(front):
        assert simple.complexity < complex_.complexity
        assert simple.loss > complex_.loss


def test_complexity_is_that_of_a_derivation():
    """-log p under the uniform grammar, by brute force over all derivations of the same law."""
    grammar = grammar_of(SPLIT)
    pcfg = Pcfg.uniform(grammar)
    regression = regression_of()
    result = search_exhaustive(regression, grammar, kind="pair", max_levels=5, top_k=1000)
    cheapest = {}
    for expression in derivations(grammar, "Pair", 5):
        text = to_text(to_formula(expression, grammar))
        cheapest[text] = min(cheapest.get(text, np.inf), -pcfg.log_prob(expression))
    for candidate in result.candidates:
        assert candidate.complexity == pytest.approx(cheapest[to_text(candidate.formula)], abs=1e-9)


@pytest.mark.parametrize(
    ("text", "method"),
    [(MIXED, "one_step"), (SPLIT, "one_step"), (SPLIT, "gls"), (SPLIT, "weak")],
)
def test_joint_refit_is_least_squares_with_all_columns(text, method):
    grammar = grammar_of(text)
    regression = regression_of(method=method)
    rng = np.random.default_rng(5)
    n = len(regression.target())
    nuisance = rng.normal(size=(n, 3)) * 10.0 ** np.array([-6, 0, 6])
    target = regression.target() + rng.normal(size=n)
    result = search_exhaustive(
        regression, grammar, kind="pair", max_levels=5, top_k=1000, nuisance=nuisance, target=target
    )
    truth = brute_force(regression, grammar, "pair", 5, nuisance, target)
    losses = np.array([loss for loss, _ in truth.values()])
    found = np.array([c.loss for c in result.candidates])
    assert found[0] == pytest.approx(losses.min(), rel=1e-9)
    for loss in losses:
        assert np.min(np.abs(found - loss)) < 1e-8 * loss


def test_what_the_law_already_says_is_no_candidate():
    """A candidate whose column is a free term's explains nothing beyond rounding."""
    grammar = grammar_of(SPLIT)
    regression = regression_of()
    first = search_exhaustive(regression, grammar, kind="pair").best
    _, rest = split_linear(first.formula)
    column = regression.column(Term(rest, "pair"))[0]
    again = search_exhaustive(regression, grammar, kind="pair", nuisance=column, top_k=1000)
    texts = [to_text(c.formula) for c in again.candidates if c.gain > 1e-9 * c.total]
    assert to_text(first.formula) not in texts
    assert again.best.loss < first.loss
    assert again.best.total == pytest.approx(2 * first.loss, rel=1e-10)


@pytest.mark.parametrize(
    ("text", "method"), [(MIXED, "one_step"), (SPLIT, "one_step"), (SPLIT, "gls")]
)
def test_rows_left_out_do_not_count(text, method):
    grammar, regression = grammar_of(text), regression_of(method=method)
    # Every third of the receivers' components.
    parts = [np.broadcast_to(np.arange(3)[:, None], b.target.shape) for b in regression.batches]
    seen = np.concatenate([part.ravel() for part in parts]) == 1
    result = search_exhaustive(
        regression, grammar, kind="pair", max_levels=5, top_k=1000, seen=seen
    )
    losses = [found[0] for found in brute_force(regression, grammar, "pair", 5, mask=seen).values()]
    assert result.best.loss == pytest.approx(min(losses), rel=1e-9)
    ((name, constant),) = result.best.constants.items()
    rest = split_linear(result.best.formula)[1]
    column, target = regression.column(Term(rest, "pair"))[0][seen, 0], regression.target()[seen]
    assert constant == pytest.approx(column @ target / (column @ column), rel=1e-9)


@pytest.mark.parametrize(
    ("text", "method"), [(MIXED, "one_step"), (SPLIT, "one_step"), (MIXED, "gls"), (SPLIT, "gls")]
)
def test_rows_left_out_do_not_weigh_in_the_ranking(text, method):
    """Sizes of laws were once summed over all rows, those left out too."""
    grammar = grammar_of(text)
    regression = regression_of(method=method)
    n = len(regression.target())
    mask = np.arange(n) % 5 == 0
    settings = {"kind": "pair", "max_levels": 5, "seen": mask}
    thorough = search_exhaustive(regression, grammar, top_k=1000, **settings).candidates
    single = search_exhaustive(regression, grammar, top_k=1, **settings)
    assert single.best.loss == pytest.approx(thorough[0].loss, rel=1e-9)
    # The best of every unit of complexity, as if all laws had been kept.
    losses = {}
    for candidate in thorough:
        level = int(candidate.complexity)
        losses[level] = min(candidate.loss, losses.get(level, np.inf))
    for candidate in single.candidates:
        assert candidate.loss == pytest.approx(losses[int(candidate.complexity)], rel=1e-9)


@pytest.mark.parametrize(("text", "method"), [(MIXED, "one_step"), (SPLIT, "gls"), (MIXED, "gls")])
def test_a_search_for_another_target_is_as_if_alone(text, method):
    """What is kept from one target to the next, sizes among it, changes no digit."""
    grammar, regression = grammar_of(text), regression_of(method=method)
    rng = np.random.default_rng(11)
    n = len(regression.target())
    several = Exhaustive(regression, grammar, "pair", max_levels=5, has_more=True)
    targets = [None, rng.normal(size=n), rng.normal(size=n)]
    beside = [None, rng.normal(size=(n, 2)), rng.normal(size=(n, 1))]
    rows = [None, None, np.arange(n) % 2 == 0]
    for target, nuisance, seen in zip(targets, beside, rows, strict=True):
        settings = {"target": target, "nuisance": nuisance, "seen": seen}
        alone = search_exhaustive(regression, grammar, kind="pair", max_levels=5, **settings)
        again = several.search(**settings)
        assert [(c.formula, c.loss, c.ties) for c in again.candidates] == [
            (c.formula, c.loss, c.ties) for c in alone.candidates
        ]
        assert again.certificate == alone.certificate
    assert several.sizes or (text, method) == (MIXED, "gls")  # there nothing can be kept


def test_what_is_kept_between_searches_is_bounded(monkeypatch):
    grammar, regression = grammar_of(MIXED), regression_of()
    whole = Exhaustive(regression, grammar, "pair", max_levels=5, has_more=True)
    whole.search()
    monkeypatch.setattr(exhaustive, "SIZES_BYTES", whole.bytes // 2)
    bounded = Exhaustive(regression, grammar, "pair", max_levels=5, has_more=True)
    first = bounded.search()
    assert 0 < sum(sizes.nbytes for sizes in bounded.sizes.values()) <= whole.bytes // 2
    assert bounded.search().candidates == first.candidates == whole.search().candidates
    alone = Exhaustive(regression, grammar, "pair", max_levels=5)
    alone.search()
    assert not alone.sizes


def test_gls_equals_direct_generalised_least_squares():
    """Group mode against (x' C^-1 y)^2 / (x' C^-1 x) with the covariance written out."""
    regression = regression_of(method="gls", n_scenes=1, n_times=12)
    (batch,) = regression.batches
    (scene,) = regression.scenes
    t = scene.times
    n = len(t) - 2
    rows = np.zeros((n, n + 2))
    for k in range(n):
        a, b = t[k + 1] - t[k], t[k + 2] - t[k + 1]
        rows[k, k : k + 3] = 2 / (a * (a + b)), -2 / (a * b), 2 / (b * (a + b))
    precision = np.linalg.inv(rows @ rows.T)
    result = search_exhaustive(regression, grammar_of(SPLIT), kind="pair", top_k=1000)
    assert len(result.candidates) == 30
    for candidate in result.candidates:
        name, rest = split_linear(candidate.formula)
        x = regression.predict(batch, ForceLaw([Term(rest, "pair")]))[:, 0]
        xx = xy = 0.0
        for axis, sigma in enumerate((0.5, 2.0)):
            for body in range(3):
                u, y = x[:, body, axis], batch.target[:, 0, body, axis]
                xx += u @ precision @ u / sigma**2
                xy += u @ precision @ y / sigma**2
        assert candidate.gain == pytest.approx(xy**2 / xx, rel=1e-6, abs=1e-9 * candidate.total)
        assert candidate.constants[name] == pytest.approx(xy / xx, rel=1e-6)


@pytest.mark.parametrize(("text", "method"), [(MIXED, "one_step"), (SPLIT, "gls"), (MIXED, "gls")])
def test_tiles_change_nothing(text, method, monkeypatch):
    grammar = grammar_of(text)
    regression = regression_of(method=method)
    settings = {"kind": "pair", "max_levels": 6, "top_k": 500}
    nuisance = np.random.default_rng(6).normal(size=(len(regression.target()), 2))
    whole = search_exhaustive(regression, grammar, nuisance=nuisance, **settings)
    monkeypatch.setattr(scoring, "TILE_BYTES", 1)  # one row, one factor at a time
    tiled = search_exhaustive(regression, grammar, nuisance=nuisance, **settings)
    assert tiled.n_evaluated == whole.n_evaluated
    assert [c.formula for c in tiled.candidates] == [c.formula for c in whole.candidates]
    # Sums over rows in another order: rounding only.
    np.testing.assert_allclose(
        [c.loss for c in tiled.candidates], [c.loss for c in whole.candidates], rtol=1e-11
    )


@pytest.mark.parametrize(("text", "method"), [(MIXED, "one_step"), (SPLIT, "gls"), (MIXED, "gls")])
def test_null_targets_are_searched_as_if_alone(text, method):
    grammar = grammar_of(text)
    regression = regression_of(method=method)
    rng = np.random.default_rng(7)
    n = len(regression.target())
    null, nuisance = rng.normal(size=(n, 4)), rng.normal(size=(n, 2))
    settings = {"kind": "pair", "max_levels": 5, "nuisance": nuisance}
    together = search_exhaustive(regression, grammar, null_targets=null, **settings)
    alone = [search_exhaustive(regression, grammar, target=y, **settings) for y in null.T]
    np.testing.assert_allclose(
        together.null_gains, [result.best.share for result in alone], rtol=1e-9
    )
    # They leave the search itself as it is.
    plain = search_exhaustive(regression, grammar, **settings)
    assert [c.formula for c in plain.candidates] == [c.formula for c in together.candidates]
    assert plain.null_gains == ()


@pytest.fixture(scope="module")
def alike():
    """Bodies of one mass, which nothing tells apart: result, loss by text of every law."""
    rng = np.random.default_rng(8)
    crew = tuple(Entity(n, "disc", radius=0.5, properties={"mass": 2.0}) for n in "abc")
    scene = Scene("s", 0.1 * np.arange(12), rng.uniform(-3, 3, (12, 3, 2)), crew)
    regression = build_regression([scene])
    grammar = grammar_of(SPLIT)
    result = search_exhaustive(regression, grammar, kind="pair", top_k=1000)
    truth = brute_force(regression, grammar, "pair", 8)
    losses = {to_text(to_formula(e, grammar)): loss for e, (loss, _) in truth.items()}
    return result, losses


def test_ties_are_equal_on_the_data_and_listed_once(alike):
    result, losses = alike
    listed = []
    for candidate in result.candidates:
        group = [to_text(f) for f in (candidate.formula, *candidate.ties)]
        for text in group:
            assert losses[text] == pytest.approx(candidate.loss, rel=1e-9)
        listed.extend(group)
    assert len(set(listed)) == len(listed)
    tied = next(c for c in result.candidates if "norm(v_i) * normalize(v_i)" in to_text(c.formula))
    assert to_text(tied.formula) == "c1 * (norm(v_i) * normalize(v_i))"  # the least complex leads
    assert "c1 * (m_i * norm(v_i) * normalize(v_i))" in [to_text(f) for f in tied.ties]


def test_nothing_is_missed_where_bodies_are_alike(alike):
    result, losses = alike
    found = np.array([c.loss for c in result.candidates])
    for text, loss in losses.items():
        assert np.min(np.abs(found - loss)) < 1e-9 * loss, text


def test_every_law_that_cannot_be_told_apart_is_listed(alike):
    result, losses = alike
    for candidate in result.candidates:
        group = {to_text(f) for f in (candidate.formula, *candidate.ties)}
        equal = {t for t, loss in losses.items() if abs(loss - candidate.loss) < 1e-9 * loss}
        assert group == equal


def test_banks_hold_every_distinct_value_once():
    grammar = grammar_of(MIXED)
    regression = regression_of()
    rows = Rows(regression, "pair")
    log_probs = np.log(Pcfg.uniform(grammar).probabilities)
    banks = Banks(grammar, rows, log_probs)
    bank = banks.bank("Coeff", 5)
    values = [entry.value for entry in bank]
    assert rows.n_rows == 2 * 12 * 3 * 2
    assert all(value.shape == (rows.n_rows,) for value in values)
    expected = []
    for expression in derivations(grammar, "Coeff", 5):
        formula = to_formula(expression, grammar)
        expected.append(_value_on(rows, formula))
    for value in expected:
        assert min(np.abs(value - other).max() for other in values) < 1e-9 * np.abs(value).max()
    for k, value in enumerate(values):
        for other in values[:k]:
            assert np.abs(value - other).max() > 1e-9 * np.abs(value).max()
    for entry in bank:
        assert entry.expression.levels == entry.levels <= 5
        assert to_formula(entry.expression, grammar) == entry.formula
        assert entry.complexity == pytest.approx(
            -sum(log_probs[r] for r in entry.expression.rules()), rel=1e-12
        )
        np.testing.assert_allclose(_value_on(rows, entry.formula), entry.value, rtol=1e-12)
    assert [e.levels for e in bank] == sorted(e.levels for e in bank)


def _value_on(rows, formula):
    from bsp_gp.language.formula import Input, evaluate, walk

    types = {n.name: n.type for n in walk(formula) if isinstance(n, Input)}
    return np.broadcast_to(
        evaluate(formula, rows.inputs_for(formula.inputs, types)), (rows.n_rows,)
    )


def test_values_that_are_not_finite_are_counted_and_left_out():
    end = "| norm(v_i)\"\nDirection"
    text = SPLIT.replace(end, "| inverse(sub(m_i, m_i)) " + end)
    assert text != SPLIT
    regression = regression_of()
    plain = search_exhaustive(regression, grammar_of(SPLIT), kind="pair")
    result = search_exhaustive(regression, grammar_of(text), kind="pair")
    assert result.n_failed == 1 and plain.n_failed == 0
    assert result.n_evaluated == plain.n_evaluated
    assert "1 sub-expressions without a finite value" in result.certificate.text()


def test_certificate():
    grammar, missing = load_grammar("physics").masked(
        {"m_i", "m_j", "p_i", "p_j", "v_i", "v_j"}, 2
    )
    result = search_exhaustive(
        regression_of(), grammar, kind="pair", max_levels=7, missing_inputs=missing
    )
    certificate = result.certificate
    assert (certificate.grammar, certificate.fingerprint) == ("physics", grammar.fingerprint)
    assert certificate.max_levels == 7
    assert certificate.n_derivations == grammar.count("PairForce", 7)
    assert certificate.n_scored == result.n_evaluated > len(result.candidates) > 0
    assert certificate.missing_inputs == missing and "q_j" in missing
    text = certificate.text()
    assert f"{certificate.n_scored:,} laws" in text
    assert f"{certificate.n_derivations:,} derivations" in text
    assert "for want of R_i" in text


def test_progress_ends_at_the_end():
    seen = []
    search_exhaustive(
        regression_of(), grammar_of(MIXED), kind="pair", progress=lambda k, n: seen.append((k, n))
    )
    # Two directions, free and under the condition.
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_plans_of_the_papers_grammar():
    plans = plan_of(load_grammar("newtonian"), "pair", 8)
    assert len(plans) == 2 * 3
    assert {plan.operator for plan in plans} == {"mul", "div_guarded"}
    assert sum(plan.condition is None for plan in plans) == 3
    assert {plan.constant for plan in plans} == {"c1"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("mul(Const, add(Direction, Direction)) |", "is none"),
        ("mul(Coeff, Direction) |", "is not"),
    ],
)
def test_grammars_that_are_no_products_are_named(change, message):
    grammar = grammar_of(MIXED.replace("mul(Const, mul(Coeff, Direction)) |", change))
    with pytest.raises(GrammarError, match=message):
        search_exhaustive(regression_of(), grammar, kind="pair")


def test_unknown_kinds_are_named():
    with pytest.raises(SettingsError, match="no field laws, only"):
        search_exhaustive(regression_of(), grammar_of(MIXED), kind="field")


def test_a_factor_alone_is_not_hidden_by_one_that_is_constant_here():
    """Every source has the mass 1: a law with one factor is as good as its product with m_j."""
    rng = np.random.default_rng(0)
    scenes = []
    for k in range(3):
        start, velocity = rng.normal(size=2), rng.normal(size=2)
        times = 0.1 * np.arange(12.0)
        track = start + velocity * times[:, None] - 0.3 * np.outer(times**2, velocity)
        ball = Entity("ball", properties={"mass": 1.0 + k, "friction": 0.0})
        post = Entity("post", is_static=True, properties={"mass": 1.0, "friction": 2.0 + k})
        positions = np.stack([track, np.full_like(track, 9.0)], axis=1)
        scenes.append(Scene(str(k), times, positions, [ball, post]))
    dataset = Dataset("posts", scenes)
    grammar, _ = load_grammar("newtonian").masked(dataset_types(dataset), 2)
    result = search_exhaustive(build_regression(scenes), grammar, kind="pair", top_k=400)
    laws = {to_text(c.formula): c.complexity for c in result.candidates}
    simplest = min((text for text in laws if "mu_j" in text), key=laws.get)
    assert simplest == "c1 * (mu_j * normalize(p_i - p_j))"
