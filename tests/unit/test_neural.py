"""The neural baselines of the experiments (extra `neural`)."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.metrics import one_step_nrmse
from bsp_gp.simulate.synth import make, preset

jax = pytest.importorskip("jax", reason="pip install 'bsp_gp[neural]'")
pytest.importorskip("optax", reason="pip install 'bsp_gp[neural]'")
from experiments.neural import training as T  # noqa: E402
from experiments.neural.models import FIXED_NUMBER, MODELS, Inputs, init_model, normaliser  # noqa: E402
from experiments.neural.scores import can_be_asked, one_step, rollouts, share_predicted  # noqa: E402
from experiments.neural.worlds import load_worlds, rows_of  # noqa: E402

TUNING = (Path(__file__).parents[2] / "docs" / "studies" / "neural_tuning.md").read_text("utf-8")
NUMBER_FREE = [name for name in MODELS if name not in FIXED_NUMBER]
TUNED = T.tuned_training("MLP (force)", "bounce")
KINDS = {"raw": Inputs(has_dynamic=True), "relative": Inputs(True, True, "silu")}


def scenes(name="bounce", n=2, **numbers):
    settings = preset(name, n_scenes=n, n_frames=12, **numbers)
    return list(make(settings, np.random.default_rng(3))[0].scenes)


def untrained(model, worlds, inputs=KINDS["relative"]):
    """A network with its first weights, as one run."""
    n_bodies = worlds.positions.shape[2]
    norm = normaliser(rows_of(worlds), worlds.n_moving, inputs, inputs.is_relative)
    params = init_model(model, np.random.default_rng(1), n_bodies, worlds.n_moving, inputs)
    params, norm = (jax.tree.map(lambda x: np.asarray(x)[None], t) for t in (params, norm))
    return T.Trained(model, inputs, params, norm, 1, np.zeros(1))


def silent(trained):
    """The network with all weights zero: no force, or no displacement."""
    return replace(trained, params=jax.tree.map(np.zeros_like, trained.params))


@pytest.mark.parametrize("inputs", KINDS.values(), ids=KINDS)
@pytest.mark.parametrize("model", NUMBER_FREE)
def test_the_order_of_bodies_does_not_matter(model, inputs):
    plain = scenes()
    order = [2, 0, 3, 1, 6, 4, 7, 5]
    turned = [
        replace(s, entities=tuple(s.entities[k] for k in order), positions=s.positions[:, order],
                velocities=None)
        for s in plain
    ]  # fmt: skip
    trained = untrained(model, load_worlds(plain), inputs)
    expected = trained.excess(load_worlds(plain))[0][:, order[:4]]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(trained.excess(load_worlds(turned))[0], expected, atol=1e-5 * scale)


@pytest.mark.parametrize("model", NUMBER_FREE)
def test_padding_does_not_matter(model):
    plain = scenes()
    worlds, padded = load_worlds(plain), load_worlds(plain, n_bodies=11, n_moving=6)
    trained = untrained(model, worlds)
    expected = trained.excess(worlds)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(trained.excess(padded)[:, :, :4], expected, atol=1e-5 * scale)
    np.testing.assert_allclose(one_step(trained, padded), one_step(trained, worlds), rtol=1e-4)
    np.testing.assert_allclose(rollouts(trained, padded), rollouts(trained, worlds), rtol=1e-3)


@pytest.mark.parametrize("name", ["nbody", "bounce", "mat"])
def test_without_force_the_error_is_that_of_no_law(name):
    made = scenes(name, 3)
    worlds = load_worlds(made)
    still = silent(untrained("OGN", worlds))
    mine = one_step(still, worlds).mean()
    assert mine == pytest.approx(one_step_nrmse(made, ForceLaw(())), rel=1e-6)
    assert share_predicted(still, worlds) == [0.0]


def test_a_displacement_network_that_stays_errs_by_the_displacement():
    worlds = load_worlds(scenes("nbody"))
    moved = np.linalg.norm(np.diff(worlds.positions[:, 1:], axis=1), axis=-1).mean(axis=(1, 2))
    still = silent(untrained("IN", worlds, KINDS["raw"]))
    np.testing.assert_allclose(one_step(still, worlds)[0], moved, rtol=1e-5)


def test_the_first_step_of_a_rollout_is_the_one_step_prediction():
    made = [replace(s, times=s.times[:3], positions=s.positions[:3], velocities=None)
            for s in scenes("nbody")]  # fmt: skip
    worlds = load_worlds(made)
    trained = untrained("OGN", worlds)
    np.testing.assert_allclose(rollouts(trained, worlds), one_step(trained, worlds), rtol=1e-3)


def test_only_networks_without_a_fixed_number_can_be_asked_about_more_bodies():
    more = load_worlds(scenes("nbody", n_bodies=5))
    assert can_be_asked("OGN", more, n_bodies=4)
    assert not can_be_asked("MLP (position)", more, n_bodies=4)


def trained(model, training, **kwargs):
    # Contacts would make the loss jump.
    numbers = {"distance": (40, 90), "jitter": (0, 1), "has_contacts": False}
    made = scenes("nbody", 6, **numbers)
    return T.train(model, training, [made[:3], made[3:]], seeds=[1, 2], **kwargs), made


@pytest.mark.parametrize(
    ("model", "version"),
    [
        ("MLP (force)", "paper"),
        pytest.param("OGN", "tuned", marks=pytest.mark.slow),
        pytest.param("IN", "tuned", marks=pytest.mark.slow),
        pytest.param("MLP (position)", "tuned", marks=pytest.mark.slow),
        pytest.param("HOGN", "tuned", marks=pytest.mark.slow),
    ],
)
def test_training_reduces_the_error_on_its_own_scenes(model, version):
    tuned = T.tuned_training(model, "nbody")
    training = tuned if version == "tuned" else T.paper_training(model)
    training = replace(training, n_steps=20, batch=0, held_out=0.0, decays=False)
    after, made = trained(model, training)
    worlds = load_worlds(made[:3])
    first, _ = trained(model, replace(training, n_steps=0))
    assert one_step(after, worlds)[0].mean() < one_step(first, worlds)[0].mean()


def test_a_resumed_training_gives_the_same_bits(tmp_path, monkeypatch):
    monkeypatch.setattr(T, "CHUNK", 2)
    training = replace(TUNED, n_steps=15 * T.CHUNK, batch=8)
    whole, _ = trained("MLP (force)", training)
    file = tmp_path / "state.npz"
    stop = 2 * T.SAVED * T.CHUNK
    assert trained("MLP (force)", training, checkpoint=file, stop_after=stop)[0] is None
    with np.load(file) as saved:
        before = float(saved["seconds"])
    seen = []
    resumed, _ = trained("MLP (force)", training, checkpoint=file, progress=seen.append)
    assert seen[0] == stop + T.CHUNK
    assert resumed.seconds > before > 0  # of both sittings
    for a, b in zip(jax.tree.leaves(whole.params), jax.tree.leaves(resumed.params), strict=True):
        np.testing.assert_array_equal(np.asarray(a), np.asarray(b))
    np.testing.assert_array_equal(whole.steps, resumed.steps)


def test_a_run_does_not_depend_on_the_runs_beside_it():
    training = replace(TUNED, n_steps=20, batch=8)
    both, made = trained("MLP (force)", training)
    alone = T.train("MLP (force)", training, [made[3:]], seeds=[2])
    for a, b in zip(jax.tree.leaves(both.params), jax.tree.leaves(alone.params), strict=True):
        np.testing.assert_array_equal(np.asarray(a)[1], np.asarray(b)[0])


def test_a_checkpoint_of_another_training_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(T, "CHUNK", 2)
    file = tmp_path / "state.npz"
    training = replace(TUNED, n_steps=T.SAVED * T.CHUNK, batch=8)
    _, made = trained("MLP (force)", training, checkpoint=file)
    draws = [made[:3], made[3:]]
    others = [
        ("OGN", training, draws, [1, 2]),
        ("MLP (force)", replace(training, rate=1e-4), draws, [1, 2]),
        ("MLP (force)", training, draws, [1, 3]),
        ("MLP (force)", training, draws[::-1], [1, 2]),
    ]
    for other in others:
        with pytest.raises(ValueError, match="another training"):
            T.train(*other, checkpoint=file)


def test_the_paper_s_shortest_training_has_a_checkpoint():
    steps = [T.paper_training(model).n_steps for model in T.PAPER]
    assert T.SAVED * T.CHUNK < min(steps)


@pytest.mark.parametrize(
    ("model", "n_steps", "rate", "width"),
    [("OGN", 2000, 2e-3, 12), ("MLP (force)", 2000, 1e-3, 12), ("IN", 400, 1e-3, 13),
     ("MLP (position)", 400, 1e-3, 11)],
)  # fmt: skip
def test_layers_rates_and_passes_are_the_paper_s(model, n_steps, rate, width):
    """100 hidden units, embeddings of 50; the inputs as in its code."""
    training = T.paper_training(model)
    assert (training.n_steps, training.rate) == (n_steps, rate)
    assert training.inputs.activation == "relu"
    n_bodies, n_moving = 4, 3
    params = init_model(model, np.random.default_rng(0), n_bodies, n_moving, training.inputs)
    sizes = {name: [layers[0]["w"].shape[0], *(layer["w"].shape[1] for layer in layers)]
             for name, layers in params.items()}  # fmt: skip
    hidden = [100, 100, 100]
    assert sizes == {
        "OGN": {"node": [width, 100, 50], "edge": [100, *hidden, 2]},
        "IN": {"node": [width, 100, 50], "edge": [100, *hidden, 50], "body": [54, *hidden, 2]},
        "MLP (force)": {"net": [2 * width, *hidden, 2]},
        "MLP (position)": {"net": [width * n_bodies, *hidden, 2 * n_moving]},
    }[model]


def test_the_step_that_is_kept_is_that_of_least_held_out_error(monkeypatch):
    monkeypatch.setattr(T, "CHUNK", 1)
    advance, met = T._Loop.advance, []

    def watched(*args):
        state = advance(*args)
        met.append(state["params"])
        return state

    monkeypatch.setattr(T._Loop, "advance", watched)
    # At this rate the steps are too long to end at the best.
    training = replace(TUNED, n_steps=6, rate=3.0, decays=False)
    found, made = trained("MLP (force)", training)
    for run, draw in enumerate((made[:3], made[3:])):
        held = T.split(draw, training.held_out, (4, 3))[1]
        errors = [held_error(replace(found, params=params), held)[run] for params in met]
        assert found.steps[run] == 1 + np.argmin(errors)
    assert min(found.steps) < training.n_steps


def held_error(network, held):
    apply = partial(T._apply, network.model, held.excess.shape[1], held.dt, network.inputs)
    predicted = [apply(T.run_of(network.params, k), T.run_of(network.norm, k), held.tree())
                 for k in range(network.n_runs)]  # fmt: skip
    return [(np.linalg.norm(p - held.excess, axis=-1) * held.weights).sum() for p in predicted]


def test_hogn_s_forces_on_two_bodies_are_opposite():
    made = scenes("nbody", n_bodies=2)
    # Both may move, so that both forces are predicted.
    made = [replace(s, entities=tuple(replace(e, is_static=False) for e in s.entities))
            for s in made]  # fmt: skip
    worlds = load_worlds(made)
    excess = untrained("HOGN", worlds).excess(worlds)[0]
    momentum = excess * rows_of(worlds).bodies.mass[..., None]
    size = np.abs(momentum).max()
    assert size > 0
    np.testing.assert_allclose(momentum.sum(axis=1), 0.0, atol=1e-5 * size)


@pytest.mark.parametrize("name", T.TUNED)
@pytest.mark.parametrize("model", MODELS)
def test_the_longer_training_is_ours_but_for_its_steps(model, name):
    tuned, longer = T.tuned_training(model, name), T.longer_training(model, name)
    assert longer.n_steps == 4 * tuned.n_steps
    assert replace(longer, n_steps=tuned.n_steps, name=tuned.name) == tuned


@pytest.mark.parametrize("name", T.TUNED)
@pytest.mark.parametrize("model", MODELS)
def test_tuned_trainings_are_the_best_of_the_tuning_as_run(model, name):
    title = f"## {name.upper()}, {model}\n"
    if title not in TUNING:
        assert (name, T.TUNED[name][model]) == ("bounce", T.TUNED[name]["OGN"])
        return
    lines = TUNING.split(title)[1].split("\n##")[0].strip().splitlines()[2:]
    ratios = {}
    for line in lines:
        rate, activation, loss, held_out, steps, *_, ratio, _ = line.strip("| ").split(" | ")
        if steps == "2000":
            activation = "silu" if model == "HOGN" else activation  # its own is no choice
            ratios[float(rate), activation, loss, float(held_out)] = float(ratio)
    chosen = (*T.TUNED[name][model], "norm", T.HELD_OUT[name])
    assert ratios[chosen] <= 1.01 * min(ratios.values())


def test_squared_errors_are_another_training():
    squared = replace(TUNED, n_steps=10, batch=0, is_squared=True)
    after, made = trained("MLP (force)", squared)
    norm, _ = trained("MLP (force)", replace(squared, is_squared=False))
    worlds = load_worlds(made[:3])
    assert not np.array_equal(after.excess(worlds), norm.excess(worlds))


def test_held_out_rows_are_not_trained_on():
    made = scenes("nbody", 5)
    rows, held = T.split(made, 0.2, (4, 4))
    assert (len(rows), len(held)) == (40, 10)  # a whole scene
    rows, held = T.split(made[:2], 0.2, (4, 4))
    assert (len(rows), len(held)) == (16, 4)  # every fifth row
    np.testing.assert_array_equal(held.p, rows_of(load_worlds(made[:2], 4, 4)).p[4::5])
    assert not set(map(tuple, rows.p[:, 1])) & set(map(tuple, held.p[:, 1]))
    assert rows.weights.sum() == pytest.approx(1.0)


def test_columns_that_hardly_vary_are_not_blown_up():
    worlds = load_worlds(scenes("mat", 1))
    rows = rows_of(worlds)
    rows.v[..., 0] = 40 + 0.01 * np.arange(rows.v[..., 0].size).reshape(rows.v[..., 0].shape)
    norm = normaliser(rows, worlds.n_moving, KINDS["relative"], True)
    column = np.argmin(np.abs(norm["own"]["mean"] - 40))
    assert norm["own"]["std"][column] == pytest.approx(40, abs=1)
