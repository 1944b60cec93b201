"""Measured double arms: friction left out, viscous and dry, and the authors' own model beside.

All models are held against the same pieces of the swing that no fit has seen, each from states that
are found in the same way.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

import bsp_gp
from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.held_out import held_out_errors
from bsp_gp.fitting.hypothesis import Hypothesis

SWING = ("k[body] * m_i * sin(theta_i)", "linked(phi1, phi2)")
MODELS = {
    "none": (),
    "viscous": ("-c[body] * m_i * omega_i",),
    "viscous, joints": ("-c[body] * m_i * omega_i", "-d[body] * m_i * (omega_i - omega_j)"),
    "dry": ("-c[body] * m_i * sign(omega_i)",),
}
THEIRS = {
    "m1": 0.0938440, "m2": 0.137596, "a1": 0.108565, "a2": 0.116779, "l1": 0.172719,
    "i1": 4.37529e-4, "i2": 1.26883e-3, "k1": 2.37143e-4, "k2": 1.0e-5, "g": 9.80858,
}  # fmt: skip
"""Kaheman et al. 2022, arXiv 2205.06231."""


def theirs():
    """Their model: properties of both arms and the couplings between them."""
    p = THEIRS
    first = p["i1"] + p["m1"] * p["a1"] ** 2 + p["m2"] * p["l1"] ** 2
    second = p["i2"] + p["m2"] * p["a2"] ** 2
    both = p["m2"] * p["l1"] * p["a2"]
    pull = p["g"] * np.array([p["m1"] * p["a1"] + p["m2"] * p["l1"], p["m2"] * p["a2"]])
    inertia = np.array([first, second])
    arms = pd.DataFrame({
        "entity": ["phi1", "phi2"], "pull": pull / inertia,
        "hinge": np.array([p["k1"], 0]) / inertia, "joint": p["k2"] / inertia,
    })  # fmt: skip
    return arms, {"coupling_phi1": both / first, "coupling_phi2": both / second}


def tables(path, step, n_train):
    """Rows of every `step`-th, of `n_train` pieces to learn from and of all that are held out."""
    frame = pd.read_csv(path)[["scene", "t", "phi1", "phi2"]]
    frame = frame.groupby("scene").nth(slice(None, None, step)).reset_index(drop=True)
    names = frame["scene"].unique()
    train = [name for name in names if name.startswith("train")]
    kept = [train[k] for k in np.linspace(0, len(train) - 1, n_train).astype(int)]
    test = [name for name in names if name.startswith("test")]
    return frame[frame["scene"].isin([*kept, *test])], kept, test


def run(path, step=4, n_train=7, models=tuple(MODELS)):
    """A tidy table of held-out errors in mrad, model by model and piece by piece."""
    frame, train, test = tables(path, step, n_train)
    arms, couplings = theirs()
    units = {"phi1": "rad", "phi2": "rad", "t": "s"}
    units |= {"pull": "1/s^2", "hinge": "1/s", "joint": "1/s"}
    data = bsp_gp.Dataset.from_frames(frame, arms, units=units)
    rows = []
    for name in ("theirs", *models):
        laws, bounds = (*SWING, *MODELS.get(name, ())), {}
        if name == "theirs":
            laws = ("pull_i * m_i * sin(theta_i)", "-hinge_i * m_i * omega_i",
                    "-joint_i * m_i * (omega_i - omega_j)", SWING[1])  # fmt: skip
            bounds = {key: (value * (1 - 1e-9), value) for key, value in couplings.items()}
        began = time.process_time()
        part = replace(data, scenes=data.select(train), train=(), test=())
        starts = {key: (low + high) / 2 for key, (low, high) in bounds.items()}
        found = fit(Hypothesis.from_laws(part, list(laws)), part, starts=starts, bounds=bounds)
        names = (" ".join(pair).strip() for pair in found.parameters)
        numbers = dict(zip(names, found.values, strict=True))
        for piece in test:
            error = held_out_errors(found, data, (data.scene(piece),))
            rows.append({
                "model": name, "piece": piece, "mrad": 1e3 * error.rollout_rmse,
                "status": found.status, "seconds": time.process_time() - began, **numbers,
            })  # fmt: skip
            print(rows[-1], flush=True)
    return pd.DataFrame(rows)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path, help="double.csv of the measured arms")
    parser.add_argument("--step", type=int, default=4, help="every so manieth row")
    parser.add_argument("--pieces", type=int, default=7, help="to learn from")
    parser.add_argument("--models", nargs="+", default=list(MODELS), choices=MODELS)
    args = parser.parse_args()
    table = run(args.path, args.step, args.pieces, args.models)
    print(table.pivot(index="model", columns="piece", values="mrad").round(2).to_string())
