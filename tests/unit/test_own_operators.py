"""Operators of a user's own: tested before any law may name them, then used like all others."""

import os
import subprocess
import sys
import tomllib

import numpy as np
import pytest

from bsp_gp.errors import SettingsError, UnitError
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.language import operators
from bsp_gp.language.canonical import canonical_key
from bsp_gp.language.grammar import load_grammar, read_grammar
from bsp_gp.language.operators import OPERATORS, Type
from bsp_gp.language.own_operators import register_operator
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.units import Unit
from tests.loop_views import throws
from tests.snippets import ROOT, blocks


def saturated(a):
    return a / (1 + a)


def slope(a):
    return 1 / np.square(1 + a)


@pytest.fixture(autouse=True)
def _forgotten():
    """Operators that a test registers are gone after it."""
    known = dict(OPERATORS)
    yield
    for name in set(OPERATORS) - set(known):
        dict.pop(OPERATORS, name)


@pytest.fixture(scope="module")
def data():
    return throws(np.random.default_rng(1), n_scenes=3)


def test_a_law_with_an_operator_of_ones_own_is_read_fitted_and_typeset(data):
    register_operator("saturated", saturated, slope)
    text = "-c * saturated(norm(v_i) / u) * v_i"
    formula = parse_formula(text, dataset_types(data), units=data.units)
    assert "saturated(norm(v_i) / u)" in to_text(formula)
    assert r"\operatorname{saturated}" in to_latex(formula)
    plain = parse_formula("-c * (norm(v_i) / u) / (1 + norm(v_i) / u) * v_i", dataset_types(data))
    assert canonical_key(formula) == canonical_key(plain)
    starts = {"c": 0.01, "u": 2.0}
    laws = ["g * m_i * e_y", text]
    own = fit(Hypothesis.from_laws(data, laws), data, starts=starts)
    laws[1] = "-c * (norm(v_i) / u) / (1 + norm(v_i) / u) * v_i"
    usual = fit(Hypothesis.from_laws(data, laws), data, starts=starts)
    assert own.chisqr == pytest.approx(usual.chisqr, rel=1e-6)
    assert own.law.constants["c"] == pytest.approx(usual.law.constants["c"], rel=1e-3, abs=1e-6)


def test_two_arguments_and_units():
    register_operator(
        "smaller", np.minimum, (lambda a, b: 1.0 * (a < b), lambda a, b: 1.0 * (a >= b)), "same"
    )
    metre, second = (Type("scalar", Unit.of(**{name: 1})) for name in ("m", "s"))
    with pytest.raises(UnitError, match="different units"):
        OPERATORS["smaller"].infer(metre, second)
    assert OPERATORS["smaller"].infer(metre, metre) == metre


def test_a_grammar_may_use_it(data):
    register_operator("saturated", saturated, slope)
    source = {
        "grammar": {"name": "own", "start": "F", "kind": "field"},
        "types": {"F": "vector *", "C": "scalar *", "S": "scalar *", "D": "vector 1"},
        "inputs": {"v_i": "vector m/s", "e_x": "vector 1"},
        "constants": {"c1": "scalar *"},
        "rules": {
            "F": "mul(C, mul(S, D))", "C": "c1", "D": "normalize(v_i)",
            "S": "saturated(norm(normalize(v_i)))",
        },
    }  # fmt: skip
    assert read_grammar(source).count("F", 3) == 1
    assert load_grammar("physics").name == "physics"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"derivative": lambda a: -slope(a)}, r"derivative by argument 1 is -0\.\d+ at"),
        ({"function": lambda a: a - np.mean(a)}, "element by element"),
        ({"function": lambda a: a.nothing}, "does not take arrays"),
        ({"function": lambda a: np.log(-a)}, "no finite value at"),
        ({"name": "norm"}, "something else"),
        ({"name": "m_i"}, "something else"),
        ({"name": "a b"}, "needs a name"),
        ({"units": "m"}, 'must be "1", "same"'),
        ({"units": lambda u: 3}, "not a Unit"),
        ({"units": lambda u: u.nothing}, "rule of units fails"),
        ({"domain": (3.0, 1.0)}, "domain must be"),
        ({"derivative": ()}, "one or two numbers"),
        ({"latex": "{0} {3}"}, "must be a template"),
    ],
)
def test_one_that_contradicts_itself_is_refused(changes, said):
    given = {"name": "saturated", "function": saturated, "derivative": slope, **changes}
    with pytest.raises(SettingsError, match=said):
        register_operator(**given)
    assert "saturated" not in OPERATORS


def test_the_package_of_the_page_brings_its_operator_to_the_command_line(tmp_path):
    page = (ROOT / "docs" / "grammars.md").read_text("utf-8")
    files = {block.note: block.text for block in blocks(page) if block.mark == "file"}
    info = tmp_path / "flow_operators-0.1.dist-info"  # what pip makes of the two files
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: flow-operators\nVersion: 0.1\n")
    offered = tomllib.loads(files["flow/pyproject.toml"])["project"]["entry-points"]
    (info / "entry_points.txt").write_text("".join(
        f"[{group}]\n" + "".join(f"{name} = {where}\n" for name, where in points.items())
        for group, points in offered.items()
    ))  # fmt: skip
    (tmp_path / "flow_operators.py").write_text(files["flow/flow_operators.py"], "utf-8")
    grammar = files["air.toml"].replace('square(Speed))"', 'square(Speed)) | between(Speed)"')
    (tmp_path / "flow.toml").write_text(grammar, "utf-8")
    command = [sys.executable, "-m", "bsp_gp", "grammar", "check", "flow.toml"]
    for path, status in ((f"{ROOT}{os.pathsep}{tmp_path}", 0), (str(ROOT), 2)):
        done = subprocess.run(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": path,
                              "PYTHONSAFEPATH": "1"}, capture_output=True, text=True)  # fmt: skip
        assert done.returncode == status, done.stderr
    assert "unknown operator" in done.stderr


def test_those_of_installed_packages_are_found_by_name(monkeypatch):
    class Point:
        def load(self):
            return lambda: register_operator("offered", saturated, slope)

    monkeypatch.setattr(operators, "_offered", lambda: offered)
    offered = {"offered": Point()}
    assert "offered" in OPERATORS and "unheard_of" not in OPERATORS
    assert OPERATORS["offered"].arity == 1
