"""Which form do the forces of the movies have? Evidence of rival forms, movie by movie.

The declared forms are the paper's: a friction of constant size along the velocity, acting while
the centre of a disc is on a mat. Rivals change one thing at a time; the coefficients of every
form are free in every movie and no label is used. For a movie of world w the form is chosen on
the other nine worlds.
"""

from dataclasses import asdict, replace

import numpy as np
import pandas as pd
from common import write_table
from ullman_model import (
    Form,
    contacts_of,
    features_of,
    free_fit,
    mass_hypotheses,
    mat_orders,
    motion_evidence,
)

DECLARED = Form(drag_power=0.0, pair_power=1.0, overlap="all", region="centre")
CHOICES = {
    "region": ("centre", "touch"),
    "drag_power": (0.0, 1.0, 2.0),
    "pair_power": (0.0, 1.0, 2.0, 3.0),
    "overlap": ("all", "first"),
}
CLIP = 100.0  # nats: no single movie may decide
NEAR = 0.15  # step of the exponents in the interval


def form_evidence(movie, form):
    """Log evidence of a form in one movie, coefficients free, best mass ratio and mat order."""
    masses, _ = mass_hypotheses(movie)
    values = []
    for order in mat_orders(movie, form):
        features, names = features_of(movie, form, order)
        evidence = motion_evidence(
            movie.positions, features, contacts_of(movie), masses, form.noise
        )
        values.append(free_fit(evidence, names)[3].max())
    return max(values)


class FormTable:
    """Evidence of forms in movies, computed once and kept in ``forms.csv``."""

    def __init__(self, movies, path):
        self.movies, self.path = movies, path
        self.rows = {}
        if path.is_file():
            for row in pd.read_csv(path, keep_default_na=False).to_dict("records"):
                self.rows[(row["scene"], row["form"])] = float(row["evidence"])

    @staticmethod
    def key(form):
        return " ".join(f"{k}={v}" for k, v in asdict(form).items() if k != "noise")

    def values(self, form):
        """Evidence in every movie, shape (n_movies,)."""
        new = False
        for movie in self.movies:
            place = (movie.name, self.key(form))
            if place not in self.rows:
                self.rows[place] = form_evidence(movie, form)
                new = True
        if new:
            write_table(
                [{"scene": s, "form": f, "evidence": v} for (s, f), v in self.rows.items()],
                self.path,
            )
        return np.array([self.rows[(m.name, self.key(form))] for m in self.movies])


def gain(table, form, rival, use):
    """Clipped sum over the movies `use` of the evidence that `rival` has over `form`."""
    change = table.values(rival) - table.values(form)
    return float(np.clip(change, -CLIP, CLIP)[use].sum())


def choose(table, use, sweeps=2):
    """Coordinate ascent from the declared form on the movies `use`; returns form and steps."""
    form, steps = DECLARED, []
    for _ in range(sweeps):
        before = form
        for name, values in CHOICES.items():
            rivals = [replace(form, **{name: v}) for v in values]
            gains = [gain(table, form, r, use) for r in rivals]
            best = int(np.argmax(gains))
            if gains[best] > 0:
                steps.append((name, getattr(form, name), values[best], gains[best]))
                form = rivals[best]
        if form == before:
            break
    return form, steps


def exponents(table, form):
    """Continuous exponents of distance and speed: parabola through three forms, by worlds.

    Returns
    -------
    dict name -> (value, low, high)
        Median over worlds of each world's own best exponent, with a 90 % interval from the
        scatter between worlds (t distribution).
    """
    from scipy import stats

    worlds = np.array([m.world for m in table.movies])
    result = {}
    for name in ("drag_power", "pair_power"):
        centre = getattr(form, name)
        values = [
            table.values(replace(form, **{name: centre + step})) for step in (-NEAR, 0.0, NEAR)
        ]
        low, mid, high = (np.array([v[worlds == w].sum() for w in np.unique(worlds)])
                          for v in values)  # fmt: skip
        bend = low - 2 * mid + high
        informative = bend < -20.0  # a world without that force has a flat evidence
        best = centre + NEAR * 0.5 * (low - high)[informative] / bend[informative]
        n = len(best)
        half = stats.t.ppf(0.95, n - 1) * best.std(ddof=1) / np.sqrt(n) if n > 1 else np.nan
        result[name] = (float(best.mean()), float(best.mean() - half), float(best.mean() + half), n)
    return result
