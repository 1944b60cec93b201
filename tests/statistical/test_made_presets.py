"""``bsp-gp make PRESET --undeclared``, then ``close`` as a user would: the effect is named."""

import json

import pytest

from bsp_gp.cli import main

EXAMPLES = {
    "fall": ("quadratic_drag", 0.1, "drag, quadratic in speed"),
    "spring": ("drag", 0.05, "drag, "),
    "pucks": ("friction", 0.3, "friction of constant size"),
    "mat": ("quadratic_drag", 0.1, "drag, quadratic in speed"),
    "magnet": ("drag", 0.1, "drag, "),
    "nbody": ("drag", 0.1, "drag, "),
}
"""What is done to the worlds of each preset, and how it is told. BOUNCE declares no force."""


@pytest.mark.slow
@pytest.mark.parametrize("preset", EXAMPLES)
def test_the_effect_is_found(preset, tmp_path, monkeypatch, capsys):
    effect, size, told = EXAMPLES[preset]
    monkeypatch.chdir(tmp_path)
    words = ["--scenes", "4", "--seed", "1", "--effect", f"{effect}={size}", "--undeclared"]
    assert main(["make", preset, *words, "--out", "data", "--quiet"]) == 0
    assert main(["close", "data", "--model", "data-model.toml", "--quiet"]) == 0
    assert told in capsys.readouterr().out
    report = json.loads((tmp_path / "data-report" / "report.json").read_text("utf-8"))
    assert report["verdict"] == "effect adopted"
    (constant,) = report["law"]["constants"]
    margin = constant["high"] - constant["low"]
    assert abs(constant["value"] + size) < margin, "within twice the half of its interval"
