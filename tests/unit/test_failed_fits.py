"""What has no finite value is a failed fit, a rival that fails is dropped, and nobody is warned."""

import math
import subprocess
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bsp_gp.loop.bootstrap as bootstrap
import bsp_gp.loop.measurement as measurement
import bsp_gp.loop.rivals as rivals
from bsp_gp.cli import main
from bsp_gp.errors import BspError, DataError, EvaluationError, ResourceError
from bsp_gp.fitting.law_fit import _correlation as correlation_of
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop import seeing
from bsp_gp.loop.attempts import attempt_of, evaluate
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.corrections import corrections_of
from bsp_gp.loop.dropping import NOT_FITTED, dropped_rivals, or_fault
from bsp_gp.loop.effects import Proposal
from bsp_gp.loop.hidden_place import Grid
from bsp_gp.loop.observation import Observation
from bsp_gp.loop.preparing import observe
from bsp_gp.loop.residual import examine_residual
from bsp_gp.loop.rivals import explanations
from bsp_gp.loop.significance import p_value
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.report.folder import write_report
from bsp_gp.report.summary import summary_text
from tests.throws import DRAG, GRAVITY, throws, throws_folder

ROOT = Path(__file__).resolve().parents[2]
SHORT = {"max_rounds": 1, "max_levels": 2, "n_bootstrap": 0, "ask_held_out": False}


def observed(sigma, noise=None):
    data = throws(sigma=sigma, n_times=20, noise=noise)
    law = declared_law(data, [GRAVITY])
    observation = observe(data, law, np.random.default_rng(0), sources=False)
    return observation, evaluate(observation, law)


@pytest.fixture(scope="module")
def exact():
    return observed(0.0, noise=(0.0,))


@pytest.fixture(scope="module")
def noisy():
    return observed(0.01)


def rng():
    return np.random.default_rng(0)


# --- what is not finite ---------------------------------------------------------------------------


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_failed_fit_is_not_noise(value, exact, noisy):
    observation, model = noisy
    whole = replace(model.fit.whole, chisqr=value)
    missing = examine_residual(observation, replace(model.fit, whole=whole), 0.01)
    assert missing.is_failed and not missing.is_missing and not missing.is_noise
    observation, model = exact
    residual = model.fit.residual.copy()
    residual[3] = value
    fit = replace(model.fit, residual=residual, whole=None)
    missing = examine_residual(observation, fit, 0.01)
    assert missing.is_failed and not missing.is_noise and math.isnan(missing.p_value)


def test_slopes_that_run_away_are_a_failed_fit(noisy, monkeypatch):
    observation, model = noisy

    def blocks(self, whole):
        made = original(self, whole)
        return [(flat, jc, np.full_like(js, np.nan)) for flat, jc, js in made]

    original = Observation.track_blocks
    assert not examine_residual(observation, model.fit, 0.01).is_failed
    monkeypatch.setattr(Observation, "track_blocks", blocks)
    assert examine_residual(observation, model.fit, 0.01).is_failed


def test_a_declared_model_that_cannot_be_fitted_is_no_finding(monkeypatch, tmp_path):
    def failed(observation, fit, alpha):
        found = examine_residual(observation, fit, alpha)
        return replace(found, p_value=math.nan, statistic=math.nan, is_missing=False)

    monkeypatch.setattr("bsp_gp.loop.rounds.examine_residual", failed)
    report = close_loop(throws(sigma=0.01), [GRAVITY], rng=rng(), **SHORT)
    assert report.verdict == "cannot tell"
    assert not any(r.adopted for r in report.rounds)
    assert report.to_dict()["rounds"][0]["missing"]["p_value"] is None
    assert "cannot tell" in summary_text(report)
    write_report(report, tmp_path / "report")


def test_what_is_not_a_number_is_never_significant():
    null = np.linspace(0.0, 1.0, 99)
    assert p_value([2.0], [null]) == 0.01
    assert p_value([math.nan], [null]) == p_value([2.0, math.nan], [null, null]) == 1
    assert p_value([2.0], [np.full(99, math.nan)]) == 1
    assert Grid([], 2.0, null).p_value() == 0.01
    assert Grid([], math.nan, null).p_value(2.0) == Grid([], 2.0, null).p_value(math.nan) == 1


@pytest.mark.parametrize("observed, strength", [(math.nan, 1.0), (2.0, math.nan), (2.0, None)])
def test_a_bootstrap_of_failures_is_never_significant(observed, strength, monkeypatch):
    monkeypatch.setattr(bootstrap, "_Source", lambda *_: lambda rng: strength)
    found = bootstrap.bootstrap(None, None, observed, rng(), alpha=0.01, n_max=99)
    assert found.p_value == 1


# --- a rival that fails ---------------------------------------------------------------------------


@pytest.mark.parametrize("fault", [
    DataError("quoted errors must not be negative"), EvaluationError("no value"),
    np.linalg.LinAlgError("SVD did not converge"), FloatingPointError("overflow"),
])  # fmt: skip
@pytest.mark.parametrize("where", ["screen", "fit", "hidden body", "defect"])
def test_a_rival_that_fails_is_dropped_and_listed(fault, where, noisy, monkeypatch):
    def fails(*args, **kwargs):
        raise fault

    observation, model = noisy
    whole = explanations(observation, model, rng())
    if where == "screen":
        monkeypatch.setattr(measurement, "_screen", fails)
    elif where == "fit":
        monkeypatch.setattr(measurement, "_fitted", fails)
    elif where == "hidden body":
        monkeypatch.setattr(rivals, "hidden_body", fails)
    else:
        monkeypatch.setattr("bsp_gp.loop.defects._bad", fails)
    found = explanations(observation, model, rng())
    dropped = [e for e in found if e.reason.startswith(NOT_FITTED)]
    assert dropped and all(str(fault) in e.reason for e in dropped)
    assert {e.name for e in whole} <= {e.name for e in found} | {"a frame that is off"}
    ranked, ruled_out = rivals.rival_rows(model, model.fit, found)
    assert not {r.name for r in ranked} & {e.name for e in dropped}
    done = SimpleNamespace(number=1, rivals=(*ranked, *ruled_out))
    notes = dropped_rivals([done])
    assert len(notes) == len({(e.name, e.reason) for e in dropped})
    assert all(any(e.name in note for note in notes) for e in dropped)


def test_a_rival_that_fails_ends_no_run_and_stands_in_the_notes(monkeypatch):
    plain = close_loop(throws(sigma=0.01), [GRAVITY], rng=rng(), **SHORT)
    ruled_out = [r.name for r in plain.rounds[0].rivals if r.kind == "measurement"]
    ruled_out = [name for name in ruled_out if name not in plain.rounds[0].undecided]
    screen = measurement._screen

    def fails(linear, correction):
        if correction.name == ruled_out[-1]:
            raise DataError("quoted errors must not be negative")
        return screen(linear, correction)

    monkeypatch.setattr(measurement, "_screen", fails)
    report = close_loop(throws(sigma=0.01), [GRAVITY], rng=rng(), **SHORT)
    assert (report.verdict, report.law_text) == (plain.verdict, plain.law_text)
    assert [ruled_out[-1] in note for note in report.notes if NOT_FITTED in note] == [True]
    assert not any(NOT_FITTED in note for note in plain.notes)


def test_nothing_is_adopted_where_every_error_of_the_measurement_fails(monkeypatch):
    def fails(*args):
        raise DataError("quoted errors must not be negative")

    assert close_loop(throws(sigma=0.01), [GRAVITY], rng=rng(), **SHORT).rounds[0].adopted
    monkeypatch.setattr(measurement, "_screen", fails)
    report = close_loop(throws(sigma=0.01), [GRAVITY], rng=rng(), **SHORT)
    assert report.verdict == "seen, not adopted" and not report.rounds[0].adopted
    assert report.rounds[0].reason == rivals.UNOPPOSED
    assert report.rounds[0].effect is not None


@pytest.mark.parametrize("slant", [-5.0, 0.1, 5.0])
def test_a_slanted_camera_leaves_errors_a_size(slant, noisy):
    observation, _ = noisy
    scene = observation.train[0]
    scene = replace(scene, sigma=np.full(scene.positions.shape, 0.01))
    slants = [c for c in corrections_of(observation) if c.numbers[0].name == "slant"]
    assert slants
    for correction in slants:
        sigma = correction.undo(scene, np.array([slant])).sigma
        assert (sigma >= 0).all() and not np.array_equal(sigma, scene.sigma)


def test_a_law_that_fails_is_dropped(noisy, monkeypatch):
    observation, model = noisy
    formula = parse_formula("c1 * v_i", dataset_types(observation.dataset))
    proposal = Proposal(formula, "field", "c1", False, 1.0, math.nan, math.nan)
    job = (observation, model.fit, proposal)
    assert attempt_of(job) is not None
    for fault in (np.linalg.LinAlgError("singular"), DataError("x"), FloatingPointError("y")):
        with monkeypatch.context() as patch:
            patch.setattr(Observation, "fit_beyond", lambda *_, f=fault: or_raise(f))
            assert attempt_of(job) is None


def or_raise(error):
    raise error


def test_bugs_and_want_of_memory_are_no_faults_of_a_rival():
    for error in (ResourceError("memory"), MemoryError(), ZeroDivisionError(), KeyboardInterrupt()):
        with pytest.raises(type(error)):
            or_fault(or_raise, error)
    assert or_fault(or_raise, BspError("x")) == (None, f"{NOT_FITTED}x")
    assert or_fault(abs, -3) == (3, "")


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


# --- no warnings (they are errors here) -----------------------------------------------------------


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


@pytest.mark.parametrize("huge", [1e200, np.inf])
def test_corrections_of_tracks_that_run_away(huge, noisy, monkeypatch):
    observation, model = noisy
    linear = seeing.Linearised(observation, model.fit)
    correction = corrections_of(observation)[0]
    residual = linear._residual_of
    monkeypatch.setattr(
        linear, "_residual_of", lambda *a: [np.full_like(part, huge) for part in residual(*a)]
    )
    columns, whole = linear.columns(correction)
    assert np.isfinite(columns).all() and not columns.any()
    assert measurement._screen(linear, correction) is None
    assert len(whole) == len(correction)


def test_effects_along_tracks_that_run_away(noisy, monkeypatch):
    observation, model = noisy
    n_own = len(model.fit.whole.parameters)

    def blocks(self, whole):
        made = original(self, whole)
        for _, by_constant, _ in made:
            by_constant[:, n_own:][:, :1] = 1e200
        return made

    original = Observation.track_blocks
    plain = {d.name for d in examine_residual(observation, model.fit, 0.01).directions}
    monkeypatch.setattr(Observation, "track_blocks", blocks)
    seen = {d.name for d in examine_residual(observation, model.fit, 0.01).directions}
    assert seen < plain and len(plain - seen) == 1


@pytest.mark.parametrize("huge", [1e200, np.nan])
def test_rows_that_count_of_a_failed_fit(huge, exact):
    fit = SimpleNamespace(whitened=[np.full((9, 2, 2), huge)], n_rows=36)
    observation, model = exact
    assert np.isfinite(observation._effective_positions(fit))
    residual = np.full_like(model.fit.residual, huge)
    assert np.isfinite(observation._effective(observation.train_regression, residual))


def test_a_patch_that_is_never_seen():
    from bsp_gp.vision.blobs import _gathered

    lost = {k: (None, None, None) for k in range(4)}
    track = _gathered(SimpleNamespace(fps=25.0), "spot", lost)
    assert np.isnan(track.positions).all() and np.isnan(track.rms).all()


@pytest.mark.parametrize("law", [
    "3 [kg s^3/m^4] * norm(v_i)^4 * v_i", "3 [kg s^5/m^6] * norm(v_i)^6 * v_i",
    "1e140 [kg/s] * v_i",
])  # fmt: skip
def test_a_declared_law_that_runs_away_is_no_finding(law):
    report = close_loop(throws(sigma=0.01), [law], rng=rng(), **SHORT)
    assert report.verdict == "cannot tell" and "could not be fitted" in report.rounds[0].reason
    assert not report.rounds[0].adopted and not math.isfinite(report.rounds[0].floor.rollout_rmse)
    assert "nan" not in summary_text(report)


@pytest.mark.parametrize("law", ["1e200 [N] * e_x", "1e300 [kg/s] * v_i"])
def test_forces_beyond_all_numbers_are_told(law):
    with pytest.raises(EvaluationError, match="range of numbers"):
        close_loop(throws(sigma=0.01), [law], rng=rng(), **SHORT)


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


# --- constants in words ---------------------------------------------------------------------------


def test_an_undetermined_constant_is_told_in_words():
    laws = ["-c * v_i", "a * m_i * down", "b * m_i * down"]
    fit = fit_law(throws(sigma=0.003), laws, rng=rng())
    assert [c.state for c in fit.constants] == ["", "undetermined", "undetermined"]
    variables = fit.text().split("[[Variables]]")[1].splitlines()[1:4]
    assert ["±" in line for line in variables] == [True, False, False]
    assert all("inf" not in line and "nan" not in line for line in variables)
    assert fit.to_dict()["constants"][1]["low"] is None


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
