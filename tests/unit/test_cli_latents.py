import json
import shutil

import pandas as pd
import pytest

from bsp_gp.cli import main
from bsp_gp.cli_latents import read_priors
from bsp_gp.data.scene import LatentDeclaration
from bsp_gp.data.tables import save_dataset
from bsp_gp.errors import SettingsError
from bsp_gp.inference.priors import Prior
from tests.latent_worlds import dataset, grammar_file, masses_of

LAW = "c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
DECLARED = LatentDeclaration("mass", low=0.2, high=9.0, entities=("b1", "b2"))
FAST = ["--n-eff", "60", "--max-steps", "400", "--quiet"]


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("latents") / "pulls"
    return str(save_dataset(dataset(4, (DECLARED,), noise=(0.0,)), folder))


@pytest.mark.slow
def test_infer_prints_a_posterior_and_writes_its_folder(data, tmp_path, capsys):
    out = tmp_path / "posterior"
    words = ["infer", data, "--law", LAW, "--train", "s0", "s1", "--noise", "0.01"]
    words += ["--likelihood", "one-step", "--out", str(out), *FAST]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "mass[s0:b1]" in text and "U(0.2, 9)" in text and "c1" in text
    names = {path.name for path in out.iterdir()}
    assert {"infer.json", "posterior.csv", "draws.csv", "trace.png", "corner.png"} <= names
    content = json.loads((out / "infer.json").read_text())
    assert content["likelihood"] == "one_step"
    assert content["posterior"]["latents"][0]["name"] == "mass[s0:b1]"
    assert main(words) == 2  # not overwritten without being asked
    assert "exists already" in capsys.readouterr().err


def test_infer_keeps_noise_that_is_declared_and_tells_the_notes(data, tmp_path, capsys):
    """Far below what counts as exact, where an error of one part in 10,000 was assumed."""
    folder = tmp_path / "pulls"
    shutil.copytree(data, folder)
    toml = (folder / "dataset.toml").read_text()
    (folder / "dataset.toml").write_text(toml.replace("noise = 0.0", "noise = 1e-9"))
    table = pd.read_csv(folder / "trajectories.csv")
    table.assign(colour=1).to_csv(folder / "trajectories.csv", index=False)
    words = ["infer", str(folder), "--law", LAW.replace("c1", "20 [m^3/(kg s^2)]"), "--train"]
    assert main([*words, "s0", "--e-step", "laplace", "--json", *FAST]) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any(note.startswith("noise 1e-09 m (declared)") for note in notes)
    assert any(note.startswith("not used: colour") for note in notes)


@pytest.mark.slow
def test_fit_with_latents_learns_the_law(data, tmp_path, capsys):
    out = tmp_path / "learnt"
    words = ["fit", data, "--latent", "mass", "--grammar", str(grammar_file(tmp_path))]
    words += ["--train", "s0", "s1", "--noise", "0.002", "--likelihood", "one-step"]
    words += ["--starts", "1", "--json"]
    assert main([*words, "--out", str(out), *FAST]) == 0
    result = json.loads(capsys.readouterr().out)
    assert "m_i * m_j / norm(p_i - p_j)^2" in result["law"]
    assert result["one_step_nrmse"]["found"] < result["one_step_nrmse"]["zero force"]
    assert (out / "laws.csv").is_file() and (out / "trace.csv").is_file()


@pytest.mark.slow
@pytest.mark.parametrize("command", ["infer", "fit"])
def test_discrete_unknowns_end_at_their_values(command, data, tmp_path, capsys):
    true = masses_of(dataset(2).scenes).truth.tolist()
    values = ",".join(f"{v:.17g}" for v in (*true, 0.7, 9.5))
    words = [command, data, "--prior", f"mass=values:{values}", "--train", "s0", "s1"]
    words += ["--noise", "0.002", "--likelihood", "one-step", "--json"]
    if command == "infer":
        words += ["--law", LAW]
    else:
        words += ["--latent", "mass", "--grammar", str(grammar_file(tmp_path)), "--starts", "1"]
    assert main([*words, "--out", str(tmp_path / "out"), *FAST]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [item["mean"] for item in result["posterior"]["latents"]] == pytest.approx(
        true, rel=0.03
    )
    assert (tmp_path / "out" / "corner.png").is_file()
    note = any("stand at their joint optimum" in text for text in result["notes"])
    assert note == (command == "infer")


def test_priors_are_read_in_the_units_of_the_data(data):
    some = dataset(1)
    pairs = [("mass", "uniform:0.1:2"), ("charge", "values:-1,0,1"), ("x", "normal:5:2:0:9")]
    priors = read_priors(pairs[:2], some)
    assert priors["mass"] == Prior("uniform", 0.1, 2.0)
    assert priors["charge"].values == (-1.0, 0.0, 1.0)
    assert read_priors([("friction", "normal:5:2:0:9")], some)["friction"].mean == 5.0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("uniform:1", "cannot be read"),
        ("uniform:2:1", "low must be below high"),
        ("values:", "cannot be read"),
        ("gamma:1:2", "prior must be one of"),
    ],
)
def test_bad_priors_are_one_clear_error(text, message):
    with pytest.raises(SettingsError, match=message):
        read_priors([("mass", text)], dataset(1))


def test_an_unknown_without_a_prior_is_refused(data, capsys):
    assert main(["infer", data, "--law", LAW, "--latent", "charge", *FAST]) == 2
    assert "--prior charge" in capsys.readouterr().err
