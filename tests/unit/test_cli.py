import json
import subprocess
import sys
from pathlib import Path

import pytest

import bsp_gp
from bsp_gp import cli
from bsp_gp.cli import main
from bsp_gp.cli_options import build_parser, joined
from bsp_gp.data.tables import load_dataset
from tests.throws import DRAG, GRAVITY, throws_folder

HEAVY = {"numpy", "pandas", "scipy", "matplotlib", "sympy", "pint", "deap", "tqdm", "jinja2"}
COMMANDS = ("close", "fit", "infer", "simulate", "grammar", "demo")
FAST = ["--max-rounds", "1", "--max-levels", "2", "--quiet"]


EXTRAS = {"arviz_base", "av", "corner", "distributed", "h5py", "jax", "jplephem", "mujoco", "optax",
          "rebound"}  # fmt: skip


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    return str(throws_folder(tmp_path_factory.mktemp("data") / "throws", noise=(0.0,)))


@pytest.fixture(scope="module")
def closed(data, tmp_path_factory):
    """A report folder; tests read it only."""
    out = tmp_path_factory.mktemp("out") / "report"
    assert main(["close", data, "--declare", GRAVITY, "--out", str(out), *FAST]) == 0
    return out


@pytest.mark.slow
@pytest.mark.parametrize("command", ["close", "fit"])
def test_names_taken_as_constants_are_told(command, data, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = [command, data, "--declare", "g * m_i * down", "--declare=-drag * v_i"]
    words += FAST[:-1] if command == "close" else []
    assert "--quiet" == FAST[-1]
    assert main(words) == 0
    captured = capsys.readouterr()
    assert "Constants to fit: g, drag" in captured.err.splitlines()
    assert "Constants to fit" not in captured.out
    if command == "fit":
        assert main([*words, "--quiet"]) == 0
        assert "Constants to fit" not in capsys.readouterr().err


def tree(folder):
    return sorted(p.relative_to(folder).as_posix() for p in Path(folder).rglob("*"))


@pytest.mark.parametrize("words", [["--help"], ["close", "--help"], ["--version"], ["nonsense"]])
def test_answers_without_heavy_imports(words):
    code = (
        "import sys; from bsp_gp.cli import main; status = main(sys.argv[1:]); "
        f"print(sorted({HEAVY!r} & set(sys.modules)), status)"
    )
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert run.stdout.splitlines()[-1] == f"[] {2 if words == ['nonsense'] else 0}", run.stderr


@pytest.mark.slow
def test_no_extra_is_imported_by_a_command_that_does_not_need_it(data, tmp_path):
    code = (
        "import sys; from bsp_gp.cli import main; status = main(sys.argv[1:]); "
        f"print(sorted({EXTRAS!r} & set(sys.modules)), status)"
    )
    words = ["check", data, "--out", str(tmp_path / "out")]
    run = subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
    assert run.stdout.splitlines()[-1] == "[] 0", run.stderr


def test_import_of_the_package_is_cheap_and_its_names_are_there():
    code = f"import sys, bsp_gp; dir(bsp_gp); print(sorted({HEAVY!r} & set(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
    for name in bsp_gp.__all__:
        assert getattr(bsp_gp, name) is not None
    assert set(bsp_gp.__all__) <= set(dir(bsp_gp))
    with pytest.raises(AttributeError, match="nothing_such"):
        bsp_gp.nothing_such  # noqa: B018


@pytest.mark.parametrize("command", [(), *((c,) for c in COMMANDS), ("grammar", "count")])
def test_help(command, capsys):
    assert main([*command, "--help"]) == 0
    out = capsys.readouterr().out
    assert out.startswith(f"usage: {' '.join(('bsp-gp', *command))}")
    if not command:
        assert all(name in out for name in COMMANDS)


def test_module_is_the_command():
    run = subprocess.run([sys.executable, "-m", "bsp_gp", "--version"], capture_output=True,
                         text=True, check=True)
    assert run.stdout == f"bsp-gp {bsp_gp.__version__}\n"


@pytest.mark.slow
def test_close_writes_a_report_and_says_where(data, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["close", data, f"--declare={DRAG}", "--declare", GRAVITY, *FAST]) == 0
    captured = capsys.readouterr()
    assert captured.out.splitlines()[0].startswith("throws: ")
    assert captured.out.splitlines()[-1] == f"Report: {tmp_path / 'throws-report' / 'report.html'}"
    assert captured.err == ""
    assert tree(".")[0] == "throws-report"
    run = json.loads(Path("throws-report/run.json").read_text("utf-8"))
    assert run["argv"][:3] == ["bsp-gp", "close", data]
    assert run["settings"]["max_levels"] == 2


def test_default_folder_is_named_after_the_data(data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("lone.csv").write_text("t,x,y\n", encoding="utf-8")
    assert cli._data_name(["lone.csv"]) == "lone"
    assert cli._data_name([data]) == cli._data_name([f"{data}/"]) == "throws"
    monkeypatch.chdir(data)
    assert cli._data_name(["."]) == "throws"
    assert cli._data_name(["/"]) == "data"


@pytest.mark.slow
def test_close_tells_its_schema_its_settings_and_its_law(closed):
    told = json.loads((closed / "report.json").read_text())
    assert told["schema"] == "bsp_gp/report/2"
    assert json.loads((closed / "run.json").read_text())["settings"]["time_limit"] == 600
    assert (closed / "law.txt").read_text().startswith(told["law"]["text"])


@pytest.mark.slow
def test_an_interrupted_close_goes_on_to_the_same_report(data, tmp_path, monkeypatch, capsys):
    from bsp_gp.loop import close

    out = tmp_path / "report"
    command = ["close", data, "--declare", GRAVITY, "--out", str(out), "--quiet",
               "--max-levels", "5"]  # fmt: skip

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(close, "prune", interrupted)
        assert main(command) == 130
    kept = tmp_path / "report.rounds.json"
    assert kept.is_file()
    assert not out.exists()
    assert main([*command, "--resume", "--max-rounds", "4"]) == 2
    assert "other data or settings" in capsys.readouterr().err
    assert main([*command, "--resume"]) == 0
    assert not kept.exists()
    again = tmp_path / "again"
    assert main([*command[:4], "--out", str(again), *command[6:]]) == 0
    reports = [json.loads((place / "report.json").read_text()) for place in (out, again)]
    for told in reports:
        told.pop("wall_s")
        told.pop("n_fits")
        for done in told["rounds"]:
            done.pop("seconds")
    assert reports[0] == reports[1]
    assert (out / "residuals.csv").read_bytes() == (again / "residuals.csv").read_bytes()


def test_seed_and_settings_reach_the_report(closed):
    report = json.loads((closed / "report.json").read_text("utf-8"))
    assert (report["seed"], report["alpha"], len(report["rounds"])) == (0, 0.01, 1)
    assert report["declared"][0]["law"] == GRAVITY


@pytest.mark.slow
def test_json_is_the_report_and_nothing_else(data, tmp_path, capsys):
    out = tmp_path / "r"
    words = ["close", data, "--declare", GRAVITY, "--json", "--out", str(out), *FAST]
    assert main([*words, "--seed", "5", "--alpha", "0.02"]) == 0
    captured = capsys.readouterr()
    assert captured.out == (out / "report.json").read_text("utf-8")
    report = json.loads(captured.out)
    assert (report["seed"], report["alpha"]) == (5, 0.02)
    assert captured.err == f"Report: {out / 'report.html'}\n"


@pytest.mark.slow
def test_progress_is_on_stderr_one_line_a_stage(data, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("bsp_gp.cli_progress.QUIET_S", -1.0)
    words = ["close", data, "--declare", GRAVITY, "--out", str(tmp_path / "r"), *FAST[:-1]]
    assert main(words) == 0
    lines = capsys.readouterr().err.splitlines()
    assert "reading the data set" in lines[0]
    assert any("round 1" in line for line in lines)


def forbid_work(monkeypatch):
    def work(*args, **kwargs):
        raise AssertionError("work began before the output folder was checked")

    monkeypatch.setattr("bsp_gp.data.tables.load_dataset", work)


@pytest.mark.parametrize(
    "words",
    [
        ["close", "DATA", "--declare", GRAVITY],
        ["fit", "DATA"],
        ["fit", "DATA", "--law", GRAVITY],
        ["simulate", "DATA", "--law", GRAVITY],
        ["demo"],
    ],
)
def test_an_older_result_is_kept_before_any_work(words, data, tmp_path, monkeypatch, capsys):
    out = tmp_path / "mine"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work", encoding="utf-8")
    forbid_work(monkeypatch)
    words = [data if word == "DATA" else word for word in words]
    for extra in ([], ["--overwrite"]):
        assert main([*words, "--out", str(out), *extra]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"bsp-gp: error: {out}: holds")
        assert error.count("\n") == 1
    assert tree(tmp_path) == ["mine", "mine/thesis.txt"]


@pytest.mark.slow
def test_a_report_is_replaced_only_on_demand(closed, data, tmp_path, monkeypatch, capsys):
    out = tmp_path / "r"
    out.mkdir()
    (out / "report.json").write_bytes((closed / "report.json").read_bytes())
    words = ["close", data, "--declare", GRAVITY, "--out", str(out), *FAST]
    with monkeypatch.context() as patch:
        forbid_work(patch)
        assert main(words) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert tree(out) == ["report.json"]
    assert main([*words, "--overwrite"]) == 0
    assert (out / "report.html").is_file()


def test_model_file(data, tmp_path, capsys):
    model = tmp_path / "model.toml"
    model.write_text(f'declare = [\n  "{GRAVITY}",\n  "{DRAG}",\n]\n', encoding="utf-8")
    assert main(["fit", data, "--model", str(model), "--json"]) == 0
    fit = json.loads(capsys.readouterr().out)
    assert fit["law"]["text"] == f"{GRAVITY} - c1 * v_i"


@pytest.mark.parametrize(
    "words",
    [
        ["--law", "-c1 * v_i"],
        ["--law=-c1 * v_i"],
        ["--law", "-c1*v_i"],
        ["--law", "--c1*v_i"],
        ["--declare", "-h1*v_i"],
        ["--law", "-1*c1*v_i", "--quiet"],
        ["--law", "-(c1*v_i)", "--up", "-y"],
    ],
)
def test_a_law_may_begin_with_a_minus(words):
    args = build_parser().parse_args(joined(["fit", "data", *words]))
    assert args.declare == [words[1] if len(words) > 1 else words[0].removeprefix("--law=")]
    assert args.up == (words[3] if "--up" in words else None)


def test_options_after_laws_are_not_swallowed():
    words = ["fit", "data", "--law", "--quiet"]
    assert joined(words) == words
    assert joined(["close", "--", "--law", "-x"]) == ["close", "--", "--law", "-x"]


def test_fit_prints_and_writes(data, tmp_path, capsys):
    out = tmp_path / "fit"
    words = ["fit", data, "--law", GRAVITY, "--law", DRAG]
    assert main(words) == 0
    printed = capsys.readouterr().out
    assert "[[Variables]]" in printed
    assert tree(tmp_path) == []
    assert main([*words, "--out", str(out)]) == 0
    assert capsys.readouterr().out == f"{printed}Fit: {out}\n"
    assert tree(out) == [".bsp_gp", "fit.json", "fit.txt"]
    assert (out / "fit.txt").read_text("utf-8") == printed
    assert main([*words, "--out", str(out)]) == 2
    assert main([*words, "--out", str(out), "--overwrite", "--json"]) == 0
    captured = capsys.readouterr()
    assert captured.out == (out / "fit.json").read_text("utf-8")
    assert tree(tmp_path) == ["fit", "fit/.bsp_gp", "fit/fit.json", "fit/fit.txt"]


@pytest.mark.slow
def test_fit_without_a_law_searches_from_no_force(data, tmp_path, capsys):
    out = tmp_path / "r"
    assert main(["fit", data, "--out", str(out), *FAST]) == 0
    assert capsys.readouterr().out.endswith(f"Report: {out / 'report.html'}\n")
    assert json.loads((out / "report.json").read_text("utf-8"))["declared"] == []


def test_simulate_writes_a_data_set(data, tmp_path, capsys):
    out = tmp_path / "made"
    words = ["simulate", data, "--law", GRAVITY, "--law", DRAG, "--out", str(out)]
    assert main([*words, "--set", "c1=200 [g/s]"]) == 0
    assert capsys.readouterr().out == f"Data set: {out}\n"
    made, first = load_dataset(out), load_dataset(data)
    for a, b in zip(made.scenes, first.scenes, strict=True):
        assert abs(a.positions - b.positions).max() < 1e-8
    assert main([*words, "--set", "c1=0.3", "--overwrite", "--noise", "0.1", "--seed", "1"]) == 0
    assert load_dataset(out).noise == (0.1,)


def test_options_stand_in_for_the_toml(data, tmp_path, capsys):
    frames = load_dataset(data)
    lines = ["scene,frame,entity,X,y"]
    lines += [f"{s.name},{k},b,{100 * x},{100 * y}" for s in frames.scenes
              for k, (x, y) in enumerate(s.positions[:, 0])]
    table = tmp_path / "raw.csv"
    table.write_text("\n".join(lines) + "\n", encoding="utf-8")
    words = ["fit", str(table), "--law", "g * m_i * down", "--law", "-k1 * m_i * v_i", "--json",
             "--columns", "x=X", "--units", "length=cm,time=s", "mass=kg", "--up", "y",
             "--dt", "0.05", "--noise", "0.1", "--test", "s1", "s2"]
    assert main(words) == 0
    fit = json.loads(capsys.readouterr().out)
    g, k1 = fit["constants"]
    assert fit["noise"]["sigma"] == [0.001, 0.001]  # 0.1 cm
    assert g["value"] == pytest.approx(9.81, abs=0.02)  # Euler against the closed form
    assert k1["value"] == pytest.approx(0.4, abs=0.02)
    assert fit["split"] == "declared split: 2 scenes to train on, 2 held out"


def test_exclude_knows_every_spelling(data):
    from bsp_gp.cli_inputs import excluded_inputs
    from bsp_gp.language.grammar import load_grammar

    def excluded(*words):
        args = build_parser().parse_args(["close", data, "--declare", DRAG, *words])
        return excluded_inputs(args, load_grammar("physics"), load_dataset(data))

    assert excluded() == ("t",)
    assert excluded("--allow-time") == ()
    assert excluded("--exclude", "v_i", "mass_i") == ("t", "v_i", "m_i", "mass_i")


def test_grammar_counts_of_the_paper(capsys):
    assert main(["grammar", "count", "newtonian", "--levels", "6"]) == 0
    out = capsys.readouterr().out
    assert "75,816" in out.splitlines()[-2]
    assert "771,120" in out.splitlines()[-1]


def test_grammar_count_of_many_levels_is_quick(capsys):
    assert main(["grammar", "count", "newtonian", "--levels", "16"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 18


def test_count_text():
    assert cli._count_text(999) == "999"
    assert cli._count_text(10**18) == "1.0000e18"
    assert cli._count_text(123456 * 10**495) == "1.2345e500"
    assert cli._count_text(99999 * 10**5000) == "9.9999e5004"


def test_grammars_are_listed_and_checked(capsys):
    assert main(["grammar", "list"]) == 0
    assert "newtonian_sum: pair laws" in capsys.readouterr().out
    assert main(["grammar", "check", "newtonian_sum"]) == 0
    told = capsys.readouterr().out
    assert "--search exhaustive: no: exhaustive search needs products" in told
    assert "--search genetic: yes" in told
    assert told.count("\n  ") == 10
    assert main(["grammar", "check", "physics"]) == 0
    told = capsys.readouterr().out
    assert "--search exhaustive: yes" in told and "c1 [kg" in told


def test_grammar_show(data, capsys):
    assert main(["grammar", "show", "physics"]) == 0
    whole = capsys.readouterr().out
    for part in ("grammar physics, fingerprint ", "start symbol of field laws: FieldForce",
                 "mul(Const, mul(PairCoeff, PairDirection))", "q_i"):
        assert part in whole
    assert main(["grammar", "show", "physics", "--data", data]) == 0
    masked = capsys.readouterr().out
    assert len(masked) < len(whole)
    assert "for want of: R_j, e_z, k_i" in masked


def test_demo_is_handed_over(tmp_path, monkeypatch, capsys):
    calls = []

    class Demo:
        @staticmethod
        def run_demo(out, *, overwrite, seed, progress, workers, run_info):
            calls.append((out, overwrite, seed, workers, run_info["argv"]))
            progress("working")
            return "the report", out

    monkeypatch.setitem(sys.modules, "bsp_gp.demo", Demo)
    monkeypatch.setattr("bsp_gp.report.summary.summary_text", lambda report, width: report)
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--seed", "3"]) == 0
    out = tmp_path / "demo-report"
    assert calls == [(out, True, 3, None, ["bsp-gp", "demo", "--seed", "3"])]
    assert capsys.readouterr().out == f"the report\nReport: {out / 'report.html'}\n"


def test_a_closed_pipe_is_no_error(data):
    run = subprocess.run(
        f"'{sys.executable}' -m bsp_gp grammar show physics; echo $? >&2",
        shell=True, capture_output=True, check=False,
    )  # fmt: skip
    assert run.stderr == b"0\n"
    run = subprocess.run(
        f"('{sys.executable}' -m bsp_gp grammar show physics; echo $? >&2) | true",
        shell=True, capture_output=True, check=False,
    )  # fmt: skip
    assert run.stderr == b"0\n"


def test_a_bug_shows_its_traceback(data, monkeypatch):
    def broken(*args, **kwargs):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("bsp_gp.fitting.law_fit.fit_law", broken)
    with pytest.raises(ZeroDivisionError):
        main(["fit", data, "--law", GRAVITY])


def test_start_bounds_and_time_limit_of_a_fit(data, capsys):
    words = ["fit", data, "--law", GRAVITY, "--law=-c1 * norm(v_i)^n * normalize(v_i)", "--json",
             "--quiet", "--start", "n=1", "--start", "c1=200 [g/s]", "--bounds", "n=-4..2",
             "c1=0..", "--time-limit", "5m"]  # fmt: skip
    assert main(words) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["schema"] == "bsp_gp/fit/2"
    assert [c["name"] for c in found["constants"]] == ["c1", "n"]
    assert found["constants"][1]["value"] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--start", "c1"], "must be NAME=VALUE"),
        (["--start", "c1=x"], "--start c1=x: expected a number"),
        (["--start", "zz=1"], "start of zz: the law has no such constant; it has c1"),
        (["--bounds", "c1=3"], "expected LOW..HIGH"),
        (["--bounds", "c1=3..1"], "expected LOW..HIGH"),
        (["--bounds", "c1=a..b"], "expected LOW..HIGH"),
        (["--bounds", "zz=0..1"], "bound of zz: the law has no such constant; it has c1"),
        (["--bounds", "c1=0..1", "--start", "c1=2"], "must lie within its bounds 0..1"),
        (["--time-limit", "soon"], "must be a time such as 20s"),
        (["--time-limit", "0"], "must be a time such as 20s"),
    ],
)
def test_bad_settings_of_a_fit(data, words, message, capsys):
    assert main(["fit", data, "--law", GRAVITY, "--law", DRAG, *words]) == 2
    assert message in capsys.readouterr().err


def test_settings_of_a_fit_need_a_law(data, capsys):
    assert main(["fit", data, "--start", "c1=1"]) == 2
    assert "--start is for the fit of a --law" in capsys.readouterr().err


@pytest.mark.slow
def test_interrupt_is_130(data, tmp_path, monkeypatch, capsys):
    def interrupted(*args, **kwargs):
        raise KeyboardInterrupt

    out = tmp_path / "r"
    words = ["close", data, "--declare", GRAVITY, "--out", str(out), *FAST]
    with monkeypatch.context() as patch:
        patch.setattr("bsp_gp.loop.close.close_loop", interrupted)
        assert main(words) == 130
    assert capsys.readouterr().err == "bsp-gp: interrupted; nothing was written\n"
    assert not out.exists()
    monkeypatch.setattr("bsp_gp.report.summary.summary_text", interrupted)
    assert main(words) == 130
    assert capsys.readouterr().err == f"bsp-gp: interrupted; the result is in {out}\n"
    assert (out / "report.html").is_file()


def test_laws_behind_one_declare_are_told_to_take_one_each(capsys):
    assert main(["close", "x.csv", "--declare", "-k * x_i * e_x", "-c * v_i"]) == 2
    assert "each law takes a --declare of its own" in capsys.readouterr().err
    assert main(["close", "x.csv", "--declare", "nothing", "--foo"]) == 2
    assert "each law" not in capsys.readouterr().err
