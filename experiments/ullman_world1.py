"""World 1 as a closed loop: the paper's friction is declared, and what is really there is found.

World 1 has friction alone. As in the paper its attributes are given (masses of the discs,
roughness of the mats), so that the *form* of the friction can be found; the movies of World 1
are then scored with forms and constants from the other worlds. Free flights between contacts are
the scenes; discs act on a mat while they touch it (the region found by `ullman_forms`, centre
only being refuted there).
"""

import json

import numpy as np
from common import reference_data
from ullman_model import contacts_of

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.loop.close import close_loop

DECLARED = "c0 * (mu_j * m_i * normalize(v_i) * is_on(s_i, p_i, s_j, p_j))"
LEAST = 24  # frames of a flight
SLOWEST = 0.6  # px a frame: slower motion is all rounding


def flights(movie, masses, roughness, reach):
    """Contact-free pieces of every track as scenes of one disc and the mats; px and seconds."""
    contacts = contacts_of(movie)
    touching = contacts.walls.any(axis=2)
    for t, pairs in enumerate(contacts.pairs):
        for i, j, _ in pairs:
            touching[t, [i, j]] = True
    mats = [
        (
            Entity(f"mat{k}", "rect_mat", width=r - l + 2 * reach, height=b - t + 2 * reach,
                   is_static=True, properties={"friction": roughness[c], "mass": 1.0}),
            ((l + r) / 2, (t + b) / 2),
        )
        for k, (c, l, t, r, b, _) in enumerate(movie.mats)
    ]  # fmt: skip
    scenes = []
    for k, colour in enumerate(movie.colours):
        free = ~touching[:, k] & np.isfinite(movie.positions[:, k, 0])
        cuts = np.flatnonzero(np.diff(np.concatenate([[0], free, [0]])))
        for start, stop in zip(cuts[::2], cuts[1::2], strict=True):
            x = movie.positions[start:stop, k]
            if len(x) < LEAST:
                continue
            on = [
                np.all(np.abs(x - place) < (entity.width / 2, entity.height / 2), axis=1)
                for entity, place in mats
            ]
            inside = np.any(on, axis=0)
            if np.sum(on, axis=0).max() > 1:
                continue  # on two mats at once only one acts, which a sum over mats cannot say
            speed = np.linalg.norm(x[8:] - x[:-8], axis=1) / 8
            slow = np.flatnonzero(speed < SLOWEST)
            stop_row = int(slow[0]) if len(slow) else len(x)
            if inside[:stop_row].sum() < 12 or stop_row < LEAST:
                continue
            x = x[:stop_row] * (1.0, -1.0)
            disc = Entity(colour, "disc", radius=reach, properties={"mass": masses[colour]})
            places = [np.broadcast_to((p[0], -p[1]), x.shape) for _, p in mats]
            scenes.append(
                Scene(f"{movie.name}_{colour}{k}_{start}", np.arange(len(x)) / movie.fps,
                      np.stack([x, *places], axis=1), (disc, *(e for e, _ in mats)))
            )  # fmt: skip
    return scenes


def world_one(movies, reach=40.0):
    """Data set of World 1: flights of movies 1-4 for training, of 5 and 6 held out."""
    truth = json.loads((reference_data("ullman") / "worlds.json").read_text())["worlds"]["world1"]
    masses = {c: float(v) for c, v in truth["mass_value"].items()}
    roughness = {c: float(v) for c, v in truth["friction_value"].items()}
    scenes = [s for m in movies for s in flights(m, masses, roughness, reach)]
    train = tuple(s.name for s in scenes if int(s.name.split("_")[1]) <= 4)
    test = tuple(s.name for s in scenes if int(s.name.split("_")[1]) > 4)
    return Dataset("world1", tuple(scenes), train=train, test=test, noise=(0.3, 0.3))


def close_world_one(movies, seed, declared=(DECLARED,), grammar="ullman"):
    """The loop's report: the declared friction against what the flights say."""
    return close_loop(
        world_one(movies), declared, rng=np.random.default_rng(seed), seed=seed,
        grammar=grammar, max_rounds=3, exclude=(),
    )  # fmt: skip


def table(report, fps=80.0):
    """Rounds as rows: effect, law, before and after in px on held-out flights."""
    rows = []
    for k, round_ in enumerate(report.rounds, 1):
        rows.append(
            {"round": k, "effect": round_.effect.name if round_.effect else "",
             "law": round_.effect.law if round_.effect else "", "adopted": round_.adopted,
             "reason": round_.reason, "before_px": _rmse(round_.before),
             "after_px": _rmse(round_.after)}
        )  # fmt: skip
    return rows


def _rmse(measures):
    value = getattr(measures, "rollout_rmse", None) if measures is not None else None
    return float("nan") if value is None else float(value)
