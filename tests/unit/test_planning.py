"""Means, what an experiment tells of rivals, programs as apparatus, discovery."""

import json
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import bsp_gp
from bsp_gp.errors import DataError, SettingsError
from bsp_gp.fitting.hypothesis import read_law
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.masses import with_usable_masses
from bsp_gp.planning.apparatus import Command, Recording, recording_of
from bsp_gp.planning.discover import _is_series, _State, calm, discover
from bsp_gp.planning.means import Body, Experiment, Range, load_means, means_from, moved
from bsp_gp.planning.plan import foreseen, information, normals, plan, weights_of
from bsp_gp.planning.rivals import Rival, in_common, kin_of, of_whole_powers
from bsp_gp.planning.settings import Following
from tests.snippets import ROOT, blocks

MEANS = {
    "bodies": {
        "probe": {"x": "-4..4", "y": "1..4", "vx": "-1..1", "vy": 0, "mass": [1, 2]},
        "source": {"dynamic": 0, "x": 0, "y": 0, "charge": "0.1..10"},
    },
    "look": {"until": "1..5", "rows": 6, "noise": 0.02, "at_once": 2},
}


@pytest.fixture(scope="module")
def means():
    return means_from(MEANS)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def rival(means, text, probability=0.5, **constants):
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    law = read_law(dataset, text).with_constants(constants)
    return Rival(text, law, probability)


def pull(power):
    return f"-k * m_i * q_j * norm(p_i - p_j)^{power} * normalize(p_i - p_j)"


def test_means_are_drawn_within_their_ranges(means):
    drawn = [means.draw(np.random.default_rng(k)) for k in range(40)]
    probes, sources = zip(*(e.bodies for e in drawn), strict=True)
    assert all(-4 <= b.position[0] <= 4 and b.velocity[1] == 0 for b in probes)
    assert {b.properties["mass"] for b in probes} == {1.0, 2.0}
    assert all(b.is_static and 0.1 <= b.properties["charge"] <= 10 for b in sources)
    assert np.median([b.properties["charge"] for b in sources]) < 3  # even in the logarithm
    assert all(e.times[0] == 0 and len(e.times) == 6 and 1 <= e.times[-1] <= 5 for e in drawn)


GUN = {
    "settings": {"speed": "0.5..8", "angle": "0..1.5"},
    "bodies": {"ball": {"x": 0, "y": 0.5, "vx": "speed * cos(angle)", "vy": "-speed*sin(angle)"}},
    "look": {"until": 1.0, "rows": 6},
}


def test_numbers_of_bodies_follow_from_settings():
    means = means_from(GUN)
    assert means.n_choices == 2
    made = [means.draw(np.random.default_rng(k)) for k in range(20)]
    made += [moved(made[0], means, np.random.default_rng(1))]
    for experiment in made:
        speed, angle = experiment.settings["speed"], experiment.settings["angle"]
        assert 0.5 <= speed <= 8 and 0 <= angle <= 1.5
        expected = (speed * np.cos(angle), -speed * np.sin(angle))
        assert experiment.bodies[0].velocity == pytest.approx(expected)
        assert Experiment.from_dict(experiment.to_dict()) == experiment
    assert 0 < abs(made[-1].settings["angle"] - made[0].settings["angle"]) < 0.3


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("spead * 2", "'spead' in .* is neither a number nor a setting"),
        ("__import__('os')", "is neither a number nor a setting"),
        ("speed.real", "is neither"),
        ("sin(speed, 2)", "is neither"),
        ("True", "is neither"),
        ("speed +", "is no formula"),
        ("1+" * 200 + "1", "is longer than 200 letters"),
    ],
)
def test_what_is_no_formula_of_settings_is_refused(text, match):
    with pytest.raises(SettingsError, match=match):
        Following(text, ("speed",))


def test_formulas_of_settings_are_no_number_where_they_cannot_be():
    with pytest.raises(SettingsError, match="is no number where speed = -1"):
        Following("sqrt(speed)", ("speed",))({"speed": -1.0})
    with pytest.raises(SettingsError, match="no number where speed = 1000"):
        Following("10 ** speed", ("speed",))({"speed": 1000.0})
    with pytest.raises(SettingsError, match=r"\[settings\] 'pi' is no name"):
        means_from({**GUN, "settings": {"pi": 3}})
    with pytest.raises(SettingsError, match=r"\[bodies.ball\] vx: 'speed' in"):
        means_from({**GUN, "settings": {"angle": "0..1"}})


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"look": {"until": 5, "rows": 2}}, "rows must be a whole number of at least 4"),
        ({"look": {"rows": 6}}, "until is missing"),
        ({"look": {"until": "0..5"}}, "later than the begin"),
        ({"look": {"until": 5, "speed": 1}}, "'speed' is unknown"),
        ({"bodies": {"probe": {"x": "4..1"}}}, "LOW..HIGH"),
        ({"bodies": {"probe": {"x": "wide"}}}, "LOW..HIGH"),
        ({"bodies": {"probe": {"x": True}}}, "a number, a list"),
        ({"bodies": {"wall": {"x": 0, "dynamic": 0}}}, "no body moves"),
        ({"camera": {}}, "is unknown"),
    ],
)
def test_means_that_cannot_be_are_refused(change, match):
    with pytest.raises(SettingsError, match=match):
        means_from({**MEANS, **change})


def test_a_file_of_means_is_read_and_named_in_complaints(tmp_path):
    file = tmp_path / "means.toml"
    file.write_text('[bodies.probe]\nx = "-1..1"\n[look]\nuntil = 2\n')
    assert load_means(file).bodies["probe"]["x"] == Range(-1.0, 1.0)
    file.write_text("[look]\nuntil = 2\n")
    with pytest.raises(DataError, match="no body moves"):
        load_means(file)
    with pytest.raises(DataError, match="no means"):
        load_means(tmp_path / "none.toml")


def test_an_experiment_travels_as_json(means):
    experiment = means.draw(np.random.default_rng(3))
    assert Experiment.from_dict(json.loads(json.dumps(experiment.to_dict()))) == experiment


def test_information_of_rows_that_tell_all_or_nothing(rng):
    weights = np.array([0.5, 0.5])
    roots = np.repeat(np.eye(2)[None], 2, axis=0)
    far = np.array([[0.0, 0.0], [40.0, 0.0]])
    assert information(weights, far, roots, rng) == pytest.approx((1.0, 1.0))
    assert information(weights, 0 * far, roots, rng) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_information_is_that_of_the_integral(rng):
    # Two normals one standard deviation apart, by quadrature: 0.1527 bits at equal weights.
    x = np.linspace(-12, 13, 20001)
    a, b = (np.exp(-0.5 * (x - c) ** 2) / np.sqrt(2 * np.pi) for c in (0, 1))
    both = 0.5 * (a + b)
    bits = 0.5 * np.trapezoid(a * np.log2(a / both) + b * np.log2(b / both), x)
    found, _ = information(
        np.array([0.5, 0.5]), np.array([[0.0], [1.0]]), np.ones((2, 1, 1)), rng, 40000
    )
    assert found == pytest.approx(bits, abs=0.01)


def test_a_plan_tells_rivals_apart_where_they_differ(means):
    rivals = [rival(means, pull(-1), k=1.0), rival(means, pull(-2), k=2.5)]
    found = plan(rivals, means, rng=1, n_tried=24)
    assert [o.bits for o in found.options] == sorted((o.bits for o in found.options), reverse=True)
    assert found.options[0].bits > 0.8 and found.options[0].power > 0.8
    assert found.is_worth_it and not found.inseparable
    again = plan(rivals, means, rng=1, n_tried=24)
    assert again.options[0].experiment == found.options[0].experiment


def test_rivals_that_no_experiment_parts_are_told(means):
    # The place of the source never changes, so that this spring and a force to the origin are one.
    still = replace(means, bodies={**means.bodies, "source": {"x": 0.0, "y": 0.0}})
    rivals = [
        rival(still, "-k * m_i * (p_i - p_j)", k=1.0),
        rival(still, "-k * m_i * (p_i - origin)", k=1.0),
    ]
    found = plan(rivals, still, rng=0, n_tried=12)
    assert len(found.inseparable) == 1
    assert found.options[0].apart[0, 1] < 1e-6


def test_what_a_constant_may_be_is_asked(means):
    one = replace(rival(means, pull(-1), k=1.0), names=("k",), covariance=np.array([[0.04]]))
    found = plan([one], means, rng=0, about="k", n_tried=12)
    assert found.options[0].bits > 1
    with pytest.raises(SettingsError, match="no uncertain constant"):
        plan([one], means, rng=0, about="n")


def test_motion_that_could_lead_anywhere_tells_little(means):
    rows = np.zeros((2, 5, 3))
    rows[:, 1:, 2] = [[1e9, -1e12, 3.0, 1e15], [0, 1.0, 2.0, 1e9]]
    centres, roots = normals(rows, np.ones(3), np.full(3, 1e-3))
    assert np.isfinite(roots).all() and centres.shape == (3, 3)
    bits, _ = information(np.full(3, 1 / 3), centres, roots, np.random.default_rng(0))
    assert 0 <= bits < np.log2(3) + 1e-6


def test_rows_behind_a_close_pass_are_not_counted(means):
    """There draws of a constant lead to anywhere, and laws seem apart that no fit tells apart."""
    bodies = (
        Body("probe", (1.0, 1.0), (0.0, 0.0), {"mass": 1.0}),
        Body("source", (0.0, 0.0), (0.0, 0.0), {"charge": 2.0}, is_static=True),
    )
    experiment = Experiment(bodies, (0.0, 0.2, 0.5, 3.0, 4.0, 5.0))
    vague = replace(rival(means, pull(-2), k=1.0), names=("k",), covariance=np.array([[0.01]]))
    other = rival(means, pull(-1), k=1.0)
    rng = np.random.default_rng(0)
    draws = [vague.draws(rng, 6), other.draws(rng, 6)]
    ((rows, free, sigma),) = foreseen([vague, other], draws, [experiment], means, rng)
    assert np.isfinite(rows).all() and (sigma > 0).all()
    early, late = rows[:, :, :4], rows[:, :, 4:]
    assert np.abs(early[0] - early[1]).max() > 0 and not late.any() and not free[4:].any()


def test_a_fitted_power_has_kin(means):
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    law = "-k1 * m_i * q_j * norm(p_i - p_j)^n1 * normalize(p_i - p_j)"
    kin = kin_of(rival(means, law, k1=1.5, n1=-1.3), dataset)
    assert [r.law.names for r in kin] == [("k1", "L1"), ("k1", "n1", "L1"), ("k1", "k2")]
    screened, faded, two = (r.text for r in kin)
    assert "bessel_k1(norm(p_i - p_j) / L1)" in screened
    assert "^-2 " in two and "^-1 " in two and "exp(-norm(p_i - p_j) / L1)" in faded
    assert all(np.isfinite(list(r.law.constants.values())).all() for r in kin)
    faded = law.replace(" * normalize", " * exp(-norm(p_i - p_j) / L1) * normalize")
    (screened,) = kin_of(rival(means, faded, k1=1.5, n1=-1.3, L1=2.0), dataset)
    assert "bessel_k1" in screened.text and "exp" not in screened.text
    (free,) = kin_of(screened, dataset)
    assert free.law.names == ("k1", "n1") and "bessel" not in free.text


def test_powers_that_are_nearly_whole_are_tried_as_such(means):
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    law = "-k1 * m_i * m_j * (m_i + m_j)^a1 * norm(p_i - p_j)^n1 * normalize(p_i - p_j)"
    (whole,) = of_whole_powers(rival(means, law, k1=1.5, a1=-9e-5, n1=-1.001), dataset)
    assert whole.law.names == ("k1",) and whole.law.constants["k1"] == 1.5
    assert "m_i + m_j" not in whole.text and "^-1 " in whole.text
    (half,) = of_whole_powers(rival(means, law, k1=1.5, a1=-0.7, n1=-1.49), dataset)
    assert half.law.names == ("k1", "a1") and "norm(p_i - p_j)^-1.5" in half.text
    vague = rival(means, law, k1=1.5, a1=-0.7, n1=-1.4)
    assert not of_whole_powers(vague, dataset)
    vague = replace(vague, names=("n1",), covariance=np.array([[0.06**2]]))
    (half,) = of_whole_powers(vague, dataset)
    assert "norm(p_i - p_j)^-1.5" in half.text


def test_a_whole_power_has_a_fitted_one_and_a_screened_force_as_kin(means):
    """An inverse square stood where a force screened in two dimensions acts: over few lengths no
    experiment of 24 told them apart, and the other was not asked."""
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    for text in (pull(-2), "-k * m_i * q_j * inverse(norm(p_i - p_j)^2) * normalize(p_i - p_j)"):
        screened, fitted = kin_of(rival(means, text, k=1.0), dataset)
        assert screened.law.names == ("k", "L1") and fitted.law.names == ("k", "n1")
        assert fitted.law.constants["n1"] == -2.0
    known = "-2 * m_i * q_j * norm(p_i - p_j)^-2 * normalize(p_i - p_j)"
    assert not kin_of(rival(means, known), dataset)  # the number is declared, and has no rival
    fading = pull(-2).replace(" * normalize", " * exp(-norm(p_i - p_j) / 3 [m]) * normalize")
    assert not kin_of(rival(means, fading, k=1.0), dataset)


@pytest.mark.parametrize(
    "form",
    [
        "exp(-norm(p_i - p_j) / L1) * normalize(p_i - p_j)",
        "exp(-(norm(p_i - p_j) / L1)^2) * (p_i - p_j)",
        "(norm(p_i - p_j)^2 + L1^2)^-1.5 * (p_i - p_j)",
    ],
)
def test_what_falls_beyond_a_length_has_a_power_as_kin(means, form):
    """Of four calm recordings of a ring three such forms were told and no power: the force went as
    distance to the -1.5, and ten rounds of experiments never asked for it."""
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    law = rival(means, f"-k1 * m_i * q_j * {form}", k1=1.5, L1=2.0)
    (free,) = kin_of(law, dataset)
    assert free.law.names == ("k1", "n1") and "norm(p_i - p_j)^n1" in free.text
    p, v = np.array([[[3.0, 0.0], [0.0, 0.0]]]), np.zeros((1, 2, 2))
    (batch,) = stack((means.draw(np.random.default_rng(0)).scene("a"),))
    a, b = (r.law.acceleration(batch.bodies, p, v, np.zeros(1)) for r in (law, free))
    assert 0.1 < np.linalg.norm(a[0, 0]) / np.linalg.norm(b[0, 0]) < 10  # about as strong


def test_kin_of_a_law_of_unit_masses_are_read():
    bodies = {"a": {"x": "-4..4", "vx": 0}, "b": {"x": "5..9"}}
    means = means_from({"bodies": bodies, "look": {"until": 1, "noise": 0.1}})
    state = _State(means, (), {}, lambda text: None, None)
    experiment = means.draw(np.random.default_rng(0))
    scene = experiment.scene("a")
    state.add(experiment, Recording(scene.times, scene.positions[..., :1]))
    seen = with_usable_masses(state.dataset)
    law = read_law(seen, "k1 * m_i * m_j * norm(p_i - p_j)^-2 * normalize(p_i - p_j)")
    final = law.with_constants({"k1": 1.0})
    report = SimpleNamespace(
        rounds=[SimpleNamespace(adopted=None, hypotheses=())], dataset=seen, law=final,
        fit=SimpleNamespace(law=final, uncertain=((), np.zeros((0, 0)))),
    )  # fmt: skip
    state._take(report)
    assert len(state.rivals) == 3


def test_none_of_these_has_a_probability(means):
    weights = weights_of([rival(means, pull(-1), k=1.0), rival(means, pull(-2), k=1.0)])
    assert weights.sum() == pytest.approx(1) and 0 < weights[-1] < 0.2


def test_a_scene_is_calm_until_forces_have_led_bodies_off(means):
    experiment = means.draw(np.random.default_rng(0))
    p, v = (np.array([getattr(b, n) for b in experiment.bodies]) for n in ("position", "velocity"))
    t = np.array(experiment.times)[:, None, None]
    free = p + v * t
    assert calm(experiment.scene("a", free)).times.tolist() == list(experiment.times)
    led = np.array(free)
    led[4:, 0] += 50.0
    assert len(calm(experiment.scene("a", led)).times) == 4


def test_calm_rows_are_foreseeable_however_vague_a_constant_is(means):
    experiment = Experiment(
        (Body("probe", (4.0, 0.0), (0.0, 0.0), {"mass": 1.0}),
         Body("source", (0.0, 0.0), (0.0, 0.0), {"charge": 1.0}, is_static=True)),
        (0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
    )  # fmt: skip
    positions = np.repeat([[[4.0, 0.0], [0.0, 0.0]]], 6, axis=0)
    positions[:, 0, 0] -= 0.02 * np.array(experiment.times) ** 2
    scene = experiment.scene("a", positions)
    state = _State(means, (), {}, print, None)
    vague = replace(rival(means, pull(-2), k=1.0), names=("k",), covariance=np.array([[0.03]]))
    state.rivals = (vague,)
    (kept,) = state._foreseeable([scene], np.random.default_rng(0)).scenes
    assert len(kept.times) == len(calm(scene).times) == 6


def test_a_held_body_is_where_it_is_held_whatever_was_measured_of_it():
    bodies = (Body("ball", (1.0, 0.0), (0.0, 1.0)), Body("post", (0.0, 0.0), (0.0, 0.0), {}, True))
    seen = np.random.default_rng(0).standard_normal((3, 2, 2))
    scene = Experiment(bodies, (0.0, 1.0, 2.0)).scene("a", seen)
    np.testing.assert_array_equal(scene.positions[:, 1], np.zeros((3, 2)))
    np.testing.assert_array_equal(scene.positions[1:, 0], seen[1:, 0])


def test_a_motion_is_foretold_from_where_an_experiment_begins(means):
    experiment = means.draw(np.random.default_rng(0))
    scene = experiment.scene("a")  # nothing is seen yet
    law = rival(means, pull(-2), k=0.0).law
    ahead = law.simulate(scene).positions[-1, 0]
    probe = experiment.bodies[0]
    free = np.array(probe.position) + experiment.times[-1] * np.array(probe.velocity)
    np.testing.assert_allclose(ahead, free)


APPARATUS = """
import json, sys
for line in sys.stdin:
    asked = json.loads(line)
    probe = asked["entities"][0]
    rows = [["probe", t, *(x + v * t for x, v in zip(probe["position"], probe["velocity"]))]
            for t in asked["times"]]
    print(json.dumps({"id": asked["id"], ANSWER}), flush=True)
"""


def program(path, answer='"rows": rows'):
    path.write_text(APPARATUS.replace("ANSWER", answer))
    return f"{sys.executable} {path}"


def test_a_program_is_an_apparatus(tmp_path, means):
    with Command(program(tmp_path / "a.py")) as run:
        for k in range(2):
            experiment = means.draw(np.random.default_rng(k))
            seen = recording_of(run(experiment), experiment)
            assert seen.times == pytest.approx(np.array(experiment.times))
            begin = np.array([b.position for b in experiment.bodies])
            assert seen.positions[0] == pytest.approx(begin)


@pytest.mark.parametrize(
    ("answer", "match"),
    [
        ('"error": "the laser is off"', "the laser is off"),
        ('"row": rows', "must have rows"),
        ('"rows": rows[:2]', "at least 3 times"),
        ('"rows": [["nobody", 0, 1, 2]] + rows', "one of probe, source"),
        ('"id": 7', "must answer the id 1"),
    ],
)
def test_what_an_apparatus_says_wrong_is_told(tmp_path, means, answer, match):
    experiment = means.draw(np.random.default_rng(0))
    with Command(program(tmp_path / "a.py", answer)) as run, pytest.raises(DataError, match=match):
        run(experiment)


def test_an_apparatus_that_ends_is_told(tmp_path, means):
    with Command(f"{sys.executable} -c pass") as run, pytest.raises(DataError, match="answer"):
        run(means.draw(np.random.default_rng(0)))
    with pytest.raises(SettingsError, match="cannot be run"):
        Command(str(tmp_path / "none"))


class World:
    """A probe about a source that stands still, moved by small steps of its own."""

    def __init__(self, pull, seed=0):
        self.pull, self.rng, self.count = pull, np.random.default_rng(seed), 0

    def __call__(self, experiment):
        self.count += 1
        probe, source = experiment.bodies
        p, v = np.array(probe.position), np.array(probe.velocity)
        rows, t = [], 0.0
        for end in experiment.times:
            n = max(int((end - t) / 2e-3), 1) if end > t else 0
            for _ in range(n):
                h = (end - t) / n
                p = p + 0.5 * h * v
                v = v + h * self.pull(p, v, source)
                p = p + 0.5 * h * v
            t = end
            rows.append(["probe", t, *(p + 0.005 * self.rng.standard_normal(2)).tolist()])
        return {"rows": rows}


SEARCH = {
    "bodies": {
        "probe": {"x": "-5..5", "y": "-5..5", "vx": "-2..2", "vy": "-2..2"},
        "source": {"dynamic": 0, "x": 0, "y": 0, "charge": "0.3..3"},
    },
    "look": {"until": "0.5..6", "rows": 10, "noise": 0.005, "at_once": 10},
}


@pytest.mark.slow
def test_a_law_is_discovered_and_kept(tmp_path):
    world = World(lambda p, v, source: -3 * source.properties["charge"] * p / (p @ p))
    found = discover(world, means_from(SEARCH), 3, rng=0, out=tmp_path)
    assert "inverse(norm(p_i - p_j)) * normalize(p_i - p_j)" in found.law.text()
    ahead = found.law.simulate(found.dataset.scenes[0])
    assert np.isfinite(ahead.positions).all()
    kept = json.loads((tmp_path / "discovery.json").read_text())
    assert kept["round"] == found.rounds and len(kept["experiments"]) == world.count
    again = discover(world, means_from(SEARCH), found.rounds, rng=0, out=tmp_path)
    assert again.law.text() == found.law.text() and again.rounds == found.rounds


PAGE = {block.note or block.kind: block.text
        for block in blocks((ROOT / "docs" / "planning.md").read_text("utf-8"))}  # fmt: skip
"""Blocks of the page, those that it does not run among them."""


def test_the_exchange_of_the_page_is_the_one_there_is(means):
    lines = PAGE["an exchange of lines; tests/unit/test_planning.py has it"]
    asked, answer, failure = map(
        json.loads, lines.replace(",\n ", ", ").replace(", ...]", "]").splitlines()
    )

    def shape(of):
        bodies = of["entities"]
        return sorted(set(of) - {"id"}), [sorted(b) for b in bodies], type(bodies[0]["properties"])

    experiment = replace(means.draw(np.random.default_rng(0)), times=(0.0, 0.1, 0.2))
    told = experiment.to_dict()
    assert shape({**told, "entities": told["entities"][:1]}) == shape(asked)
    ((name, _, *place),) = answer["rows"]
    rows = [[name, t, *place] for t in experiment.times]
    seen = recording_of({**answer, "rows": rows}, experiment)
    assert seen.positions[0, 0] == pytest.approx(place) and (seen.sigma == 0.02).all()
    assert failure == {"id": 1, "error": "the laser is off"}  # told above as such


@pytest.mark.slow
def test_the_python_of_the_page_finds_a_law(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "means.toml").write_text(PAGE["means.toml"], "utf-8")
    text = PAGE["run is your apparatus; tests/unit/test_planning.py has one that is made up"]
    pull = World(lambda p, v, source: -3 * source.properties["charge"] * p / (p @ p))
    names = {"bsp_gp": bsp_gp, "run": pull}
    exec(text.replace("rounds=16", "rounds=2"), names)  # sixteen take minutes
    assert names["found"].law.terms and (tmp_path / "discovery" / "discovery.json").is_file()


@pytest.mark.slow
def test_a_law_that_is_discovered_stands(tmp_path):
    world = World(lambda p, v, source: -3 * source.properties["charge"] * p / (p @ p))
    found = discover(world, means_from(SEARCH), 3, rng=0, out=tmp_path)
    (term,) = found.law.terms
    assert found.stands and not found.open


def test_an_interrupted_discovery_goes_on_with_the_same_experiments(tmp_path, means):
    def still(experiment):
        return {"rows": [["probe", t, *experiment.bodies[0].position] for t in experiment.times]}

    seen = []

    def breaks(experiment):
        seen.append(experiment)
        if len(seen) == 3:
            raise KeyboardInterrupt
        return still(experiment)

    few = replace(means, bodies={**means.bodies}, at_once=2)
    with pytest.raises(KeyboardInterrupt):
        discover(breaks, few, 2, rng=5, out=tmp_path / "a")
    kept = json.loads((tmp_path / "a" / "discovery.json").read_text())
    assert kept["round"] == 1 and len(kept["experiments"]) == 2
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "discovery.json").write_text("[]")
    with pytest.raises(DataError, match="no discovery to go on from"):
        discover(still, few, 2, rng=5, out=tmp_path / "b")


def test_misfits_without_a_law_end_in_what_is_declared(means):
    """Round after round no law was found; there was none to be declared, and an IndexError."""
    from bsp_gp.loop.criteria import Criteria
    from bsp_gp.planning import discover as module

    settings = {"criteria": Criteria(), "n_bootstrap": 0, "max_rounds": 1}
    state = module._State(means, ("nothing",), settings, lambda text: None, None)
    rng = np.random.default_rng(0)
    for _ in range(3):
        experiment = means.draw(rng)
        body = experiment.bodies[0]
        rows = [["probe", t, *(np.array(body.position) + t * np.array(body.velocity))]
                for t in experiment.times]  # fmt: skip
        state.add(experiment, module.recording_of({"rows": rows}, experiment))
    state.is_misfit, state.n_misfits = True, module.PATIENCE
    state.learn(rng, is_last=True)
    assert state.rivals == () and state.left[0] == "no_law" and not state.stands


def test_the_share_of_a_constant_that_stays_at_zero_is_a_number(means):
    from types import SimpleNamespace

    from bsp_gp.loop.criteria import Criteria
    from bsp_gp.loop.evidence import _log_share

    law = rival(means, pull(-1), k=0.0).law
    found = SimpleNamespace(
        law=law, values=np.zeros(1), jacobian=np.array([[2.0]]), covariance=np.full((1, 1), np.inf)
    )
    number = SimpleNamespace(name="k", prior=None)
    share = _log_share(found, SimpleNamespace(parameters=(number,)), Criteria())
    assert np.isfinite(share)


def test_a_law_with_a_constant_of_each_scene_foretells_with_their_median(means):
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    law = read_law(dataset, ["c1[scene] * m_i * e_x", "-c2 * v_i"])
    law = law.with_constants({"c1[scene]": {"a": 1.0, "b": 2.0, "c": 9.0}, "c2": 0.5})
    found = in_common(law)
    assert set(found.names) == {"c1", "c2"}
    assert dict(found.constants) == {"c1": 2.0, "c2": 0.5}
    assert in_common(found) is found
    Rival("", found, 1.0)
    with pytest.raises(SettingsError, match="no value for a new experiment"):
        Rival("", law, 1.0)


def test_a_factor_to_the_power_of_nothing_is_left_out_wherever_it_stands(means):
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    law = "-k1 * (m_i^a1 * q_j * norm(p_i - p_j)^n1 * normalize(p_i - p_j))"
    (whole,) = of_whole_powers(rival(means, law, k1=1.5, a1=9e-5, n1=-1.001), dataset)
    assert "m_i" not in whole.text and "^-1 " in whole.text


def test_where_no_law_is_found_experiments_get_shorter(means):
    """Something unseen may lead bodies off: nothing tells that such rows are not calm."""
    state = _State(means, (), {}, lambda text: None, None)
    scenes = [means.draw(np.random.default_rng(k)).scene(f"s{k}") for k in range(6)]
    led = [replace(s, positions=s.positions + s.times[:, None, None] ** 2 * [1.0, 0.0])
           for s in scenes]  # fmt: skip
    state._choose_part(led, led)
    assert state.part == 1.0
    state.n_lost = 1
    state._choose_part(led, led)
    assert state.part == 0.5
    assert max(state._short(s).times[-1] for s in led) <= 2.5 + 1e-9


@pytest.mark.parametrize(("count", "is_series"), [(2, False), (3, True)])
def test_many_terms_along_one_line_stand_for_any_form(means, count, is_series):
    texts = [f"-k{n} * q_j * norm(p_i - p_j)^-{n} * normalize(p_i - p_j)" for n in (1, 2, 3)]
    dataset = means.dataset([means.draw(np.random.default_rng(0)).scene("a")])
    assert _is_series(read_law(dataset, [*texts[:count], "-c * v_i"])) is is_series
