"""What has no finite value is a failed fit, a cause that fails is told, and nobody is warned."""

import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bsp_gp.loop.proposal as proposal
from bsp_gp.cli import main
from bsp_gp.errors import DataError, EvaluationError, FitError
from bsp_gp.fitting.law_fit import _correlation as correlation_of
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.loop.close import close_loop
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.report.folder import write_report
from bsp_gp.report.summary import summary_text
from tests.throws import DRAG, GRAVITY, throws, throws_folder

ROOT = Path(__file__).resolve().parents[2]
SHORT = {"max_rounds": 1, "max_levels": 2, "n_bootstrap": 0}


def rng():
    return np.random.default_rng(0)


@pytest.mark.slow
@pytest.mark.parametrize(
    "fault",
    [EvaluationError("no value"), FitError("no noise"), FloatingPointError("overflow"),
     np.linalg.LinAlgError("SVD did not converge")],
)  # fmt: skip
def test_a_cause_whose_fit_fails_is_told_and_ends_no_run(fault, monkeypatch):
    def fails(hypothesis, *args, **kwargs):
        if hypothesis.parts[-1].kind == "instrument":
            raise fault
        return fit(hypothesis, *args, **kwargs)

    fit = proposal.fit
    monkeypatch.setattr(proposal, "fit", fails)
    report = close_loop(throws(sigma=0.01), [GRAVITY], rng=rng(), **SHORT)
    rows = {h["code"]: h["status"] for h in report.rounds[0].hypotheses}
    assert rows["perspective"] == "nonfinite"
    assert report.verdict == "effect adopted"


def test_bugs_are_no_faults_of_a_cause(monkeypatch):
    def fails(hypothesis, *args, **kwargs):
        if hypothesis.parts[-1].kind == "instrument":
            raise ZeroDivisionError
        return fit(hypothesis, *args, **kwargs)

    fit = proposal.fit
    monkeypatch.setattr(proposal, "fit", fails)
    with pytest.raises(ZeroDivisionError):
        close_loop(throws(sigma=0.01), [GRAVITY], rng=rng(), **SHORT)


def test_a_matrix_that_cannot_be_decomposed_is_one_line(tmp_path, monkeypatch, capsys):
    data = str(throws_folder(tmp_path / "throws"))

    def fails(*args, **kwargs):
        return np.linalg.svd(np.full((3, 3), np.nan))

    monkeypatch.setattr("bsp_gp.fitting.law_fit.fit_law", fails)
    assert main(["fit", data, "--law", DRAG, "--quiet"]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    monkeypatch.setattr("bsp_gp.fitting.law_fit.fit_law", lambda *a, **k: int("x"))
    with pytest.raises(ValueError, match="invalid literal"):  # a bug shows
        main(["fit", data, "--law", DRAG, "--quiet"])


def test_correlation_with_an_undetermined_constant():
    covariance = np.array([[4.0, 0.0, 1.0], [0.0, np.inf, 0.0], [1.0, 0.0, 1.0]])
    expected = [[1, 0, 0.5], [0, 1, 0], [0.5, 0, 1]]
    np.testing.assert_allclose(correlation_of(covariance), expected)
    np.testing.assert_allclose(correlation_of(np.zeros((2, 2))), np.eye(2))


def test_accelerations_beyond_all_numbers_are_refused():
    scene = throws().scenes[0]
    for times, positions in (
        (scene.times * 1e-170, scene.positions), (scene.times * 1e-12, scene.positions * 1e300),
    ):  # fmt: skip
        with pytest.raises(DataError, match="'ball'"):
            build_regression([replace(scene, times=times, positions=positions)])


def test_a_patch_that_is_never_seen():
    from bsp_gp.vision.blobs import _gathered
    from bsp_gp.vision.track import NOWHERE

    lost = {k: (*NOWHERE, "not seen", np.nan) for k in range(4)}
    track = _gathered(SimpleNamespace(fps=25.0), "spot", lost)
    assert np.isnan(track.positions).all() and np.isnan(track.rms).all()


@pytest.mark.slow
@pytest.mark.parametrize("quiet", [True, False])
def test_quiet_shows_no_warning_and_keeps_errors(quiet, tmp_path, monkeypatch):
    def warns(*args, **kwargs):
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
        return fit_law(*args, **kwargs)

    data = str(throws_folder(tmp_path / "throws"))
    words = ["fit", data, "--law", DRAG, *["--quiet"][:quiet]]
    code = (
        "import sys, warnings, bsp_gp.fitting.law_fit as f; fit = f.fit_law\n"
        "def warns(*a, **k):\n    warnings.warn('overflow', RuntimeWarning)\n"
        "    return fit(*a, **k)\n"
        "f.fit_law = warns\nfrom bsp_gp.cli import main\nsys.exit(main(sys.argv[1:]))"
    )
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True,
                         cwd=ROOT)  # fmt: skip
    assert run.returncode == 0
    assert ("overflow" in run.stderr) is not quiet
    monkeypatch.setattr("bsp_gp.fitting.law_fit.fit_law", warns)
    with pytest.raises(RuntimeWarning):  # a test sees it all the same
        main(words)


def test_an_undetermined_constant_is_told_in_words():
    laws = ["-c * v_i", "a * m_i * down", "b * m_i * down"]
    fit = fit_law(throws(sigma=0.003), laws, rng=rng())
    assert [c.state for c in fit.constants] == ["", "undetermined", "undetermined"]
    variables = fit.text().split("[[Variables]]")[1].splitlines()[1:4]
    assert ["±" in line for line in variables] == [True, False, False]
    assert all("inf" not in line and "nan" not in line for line in variables)
    assert fit.to_dict()["constants"][1]["low"] is None


@pytest.mark.slow
def test_undetermined_constants_and_those_at_a_bound_in_a_report(tmp_path):
    laws = ["a * m_i * down", "b * m_i * down"]
    report = close_loop(throws(sigma=0.01), laws, rng=rng(), **SHORT)
    states = {c.name: c.state for c in report.constants}
    assert states["a"] == states["b"] == "undetermined"
    found = next(c for c in report.constants if c.name not in "ab")
    assert found.state == ""
    bound = replace(found, value=0.0, state="at_bound")
    own = tuple(replace(c, entity="ball") for c in report.constants)
    constants = (*report.constants, bound, *own)
    report = replace(report, constants=constants)
    folder = write_report(report, tmp_path / "report")
    texts = [summary_text(report), (folder / "law.txt").read_text(encoding="utf-8"),
             (folder / "law.tex").read_text(encoding="utf-8"),
             (folder / "report.html").read_text(encoding="utf-8")]  # fmt: skip
    for text in texts:
        assert "undetermined" in text and "at its bound" in text
        assert "± inf" not in text and "± nan" not in text
