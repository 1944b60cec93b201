"""Kicks in plain words."""

from types import SimpleNamespace

import numpy as np

from bsp_gp import load_dataset
from bsp_gp.loop.close import close_loop
from bsp_gp.report.kicks import kick
from bsp_gp.report.summary import summary_text


def effect_of(*kicks):
    """Of kicks (body, scene, instant, velocity along x), whose instants are known to 1 ms."""
    name, constants = [], []
    for k, (body, scene, time, gain) in enumerate(kicks, 1):
        name.append(f"{body}[{scene}, {time} s]")
        constants += [
            SimpleNamespace(name=f"w_x{k}", value=gain, unit="m/s", low=gain, high=gain),
            SimpleNamespace(name=f"t{k}", value=time, unit="s", low=time - 1e-3, high=time + 1e-3),
        ]  # fmt: skip
    return SimpleNamespace(code="contact", name="kick " + ", ".join(name), constants=constants)


def test_a_kick_is_told_with_its_body_size_instant_and_scene():
    values = {"w_x1": (0.6, "m/s"), "t1": (0.433, "s"), "w_y1": (-0.8, "m/s")}
    constants = [
        SimpleNamespace(name=n, value=v, unit=u, low=v - 1e-3, high=v + 1e-3)
        for n, (v, u) in values.items()
    ]
    effect = SimpleNamespace(
        code="contact", name="kick red, 2[throw 1, 0.43 s]", constants=constants
    )
    told = "a kick: the velocity of red, 2 jumps by 1.0 m/s at 0.433 s in scene throw 1"
    assert kick(effect) == told


def test_a_kick_at_a_date_is_told_to_the_day():
    """A kick in the sky was told "at 2.13 x 10^11 s": of some years."""
    effect = effect_of(("a", "1", 212601234567.0, 0.1))
    instant = effect.constants[1]
    instant.low, instant.high = instant.value - 86400.0, instant.value + 86400.0
    assert "at 2.1260123 × 10¹¹ s" in kick(effect)


def test_a_kick_is_told_in_the_units_of_the_data(tmp_path):
    rng = np.random.default_rng(4)
    times = np.arange(30.0)
    places = 0.4 * times + 1.5 * np.maximum(times - 12.5, 0.0) + rng.normal(0, 0.02, 30)
    rows = [f"{t},{x:.4f},{0.7 * t + 0.02 * rng.normal():.4f}"
            for t, x in zip(times, places, strict=True)]  # fmt: skip
    file = tmp_path / "buoy.csv"
    file.write_text("\n".join(["t (day),x (km),y (km)", *rows]) + "\n", encoding="utf-8")
    report = close_loop(load_dataset(file), "nothing", rng=rng, n_bootstrap=0)
    text = " ".join(summary_text(report).split())
    assert "jumps by 1.5 km/day at 12.5 day" in text


def test_two_bodies_that_are_kicked_at_once_against_each_other_collide():
    told = kick(effect_of(("red", "1", 1.8682, -0.193), ("blue", "1", 1.8674, 0.0963)))
    assert told == (
        "a collision of red and blue at 1.87 s in scene 1: velocities jump by 0.19 m/s and "
        "0.096 m/s, against each other, as where blue has 2.00 times the mass of red"
    )
    for other in (("blue", "1", 1.9, 0.0963), ("blue", "1", 1.8674, -0.0963),
                  ("blue", "2", 1.8674, 0.0963), ("red", "1", 1.8674, 0.0963)):  # fmt: skip
        told = kick(effect_of(("red", "1", 1.8682, -0.193), other))
        assert told.startswith("2 kicks: the velocity of red jumps by 0.19 m/s at 1.87 s")


def test_a_soft_contact_lasts():
    effect = effect_of(("red", "1", 1.8682, -0.193), ("blue", "1", 1.9, 0.0963))
    assert kick(effect).startswith("2 kicks")
    effect.code = "collision"
    assert kick(effect).startswith("a collision of red and blue at 1.87 s")


def test_many_kicks_are_told_together():
    told = kick(effect_of(*(("puck", "1", 0.1 * k, 0.5 + k) for k in range(1, 6))))
    assert told == "5 kicks of puck in scene 1: by 1.5 m/s to 5.5 m/s, from 0.100 s to 0.500 s"
