"""Random kicks beside linear forces, where nothing is declared: see `bsp_gp.fitting.langevin`."""

import math
from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.data.extent import is_of_the_sky
from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.fitting.langevin import FARTHEST, Track, models_of
from bsp_gp.fitting.shooting import STATE_PRIOR
from bsp_gp.language.parse import parse_formula
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.physics.bodies import dataset_types
from bsp_gp.physics.force import ForceLaw, Term, fresh_names
from bsp_gp.units import DIMENSIONLESS, Unit

LEAST_ROWS = 100
"""Of a track: on fewer nobody tells kicks from a force that changes."""
FIRST_TRACKS, FIRST_ROWS, SURELY_ODD = 4, 800, 1e-6
"""Tracks and their rows, together, on which kicks are asked first where there are many, and the
chance of forecasts as odd, below which the others are not asked."""
MOST_ALONE = 2
"""Rows of a piece of a track that tell nothing of kicks."""
SMOOTH = 4.0
"""Rows until kicks show above the noise, beyond which they may be a force of any other form: beads
take one or two, and what nobody lists and pushes a body smoothly eight or more."""
LEAP, LONELY = 7.0, 3.0
"""Standard deviations of other steps, and times the two steps before and after it, from which a
step is a leap: of the tracker to another bead, or of the slide. No kick of many is so alone."""
TOGETHER = 0.5
"""Share of the variance of steps that bodies of a recording have in common, beyond which what
kicks them is what shows or carries them all: each is kicked by molecules of its own."""
SLACK = 0.5
"""Part of a track in which a trap would bring back what it holds, below which it is none."""
LENGTH, TIME = Unit.of(m=1), Unit.of(s=1)
UNITS = {
    "drag_rate": DIMENSIONLESS / TIME, "trap_rate": DIMENSIONLESS / TIME**2,
    "kick_power": LENGTH**2 / TIME**3, "diffusion": LENGTH**2 / TIME,
    "speed_variance": LENGTH**2 / TIME**2, "noise": LENGTH, "centre": LENGTH,
    "push": LENGTH / TIME**2, "exposure": TIME,
}  # fmt: skip
BOLTZMANN = 1.380649e-23
"""J/K."""


@dataclass(frozen=True, eq=False)
class Kicked(Proposal):
    """Kicks as a cause; states and kicks are taken out of its likelihood exactly.

    Attributes
    ----------
    log_evidence : float, nats
        In the terms of other fits.
    constants : tuple of dict
        Of kicks and forces, as a report has them.
    is_smooth : bool
        Whether so many rows are between kicks that show that any force which changes from place to
        place, or in time, moves the bodies as well.
    """

    log_evidence: float = -math.inf
    constants: tuple = ()
    is_smooth: bool = False

    def fitted(self, base, dataset, *, criteria, bounds=None, deadline=None):
        """The fit that it extends, with the evidence of kicks in the place of its own."""
        return replace(
            base, status="converged", chi2_red=1.0, noise=base.noise.plain(),
            log_likelihood=self.log_evidence - base.state_volume,
        )  # fmt: skip


class Kicks:
    """Kicks with drag, in a trap, under a push, as a proposer."""

    name = "kicks"

    def propose(self, view):
        """The family of kicks; empty where something is declared, or forces are told instead."""
        tracks = _asked(view.dataset, view.fit)
        if not tracks:
            return Family(self.name)
        best, models = _likeliest(tracks, view.fit, view.criteria, view.tick)
        n_tried = len(models)
        alone = next(m for m in models if not m.terms)
        gain = 2 * (best.log_likelihood - alone.log_likelihood)
        known = Family(self.name, (), gain, len(best.values), np.zeros(view.moment_draws.shape[1]),
                       n_tried=n_tried)  # fmt: skip
        # All that is left, if that is more: the level of the noise may be another beside a force.
        gain = max(gain, float(view.left @ view.left) - view.n_left)
        if best.terms == {"drag"}:
            return replace(known, proposals=(_slowed(view, best, gain),))
        if not _are_told(best, view.criteria):
            return known
        text = _text(best, sum(len(leaps(*own)) for own in _seen(view.dataset, _axes(view.fit))))
        proposal = Kicked(
            "kicks", text, view.hypothesis, -view.criteria.cause_nats, gain,
            len(best.values), kind="kicks", is_last=True,
            log_evidence=best.score - _wider(tracks), constants=_constants(best, view.dataset),
            is_smooth=best.settling > SMOOTH,
        )  # fmt: skip
        return replace(known, proposals=(proposal,))

    def details(self, view, proposal, fit, rng):
        """What kicks and forces are, as constants of a report."""
        return {"constants": proposal.constants} if isinstance(proposal, Kicked) else {}


def is_kicked(dataset, fit, criteria, tick=None):
    """Whether random kicks beside linear forces say all of tracks of which nothing is declared."""
    tracks = _asked(dataset, fit)
    return bool(tracks) and _are_told(_likeliest(tracks, fit, criteria, tick)[0], criteria)


def _asked(dataset, fit):
    """The tracks of which kicks are asked; none where something is declared.

    Stars are kicked by nothing, and what kicks do, which is anything, hides what orbits do.
    """
    if fit.law.terms or fit.law.frame or is_of_the_sky(dataset):
        return []
    axes = _axes(fit)
    if shared(dataset, axes) > TOGETHER:
        return []
    counts = [len(times) for times, _ in _seen(dataset, axes) if len(times) > MOST_ALONE]
    return _tracks(dataset, axes) if min(counts, default=0) >= LEAST_ROWS else []


def _axes(fit):
    """Axes along which anything moves, ndarray of int."""
    return np.flatnonzero(np.isfinite(fit.noise.levels))


def _likeliest(tracks, fit, criteria, tick=None):
    """The likeliest model whose forecasts err no more oddly than noise does, and all models."""
    free = fit.noise.is_free.any()
    noise = None if free else float(np.sqrt(np.nanmean(np.square(fit.noise.levels))))
    # What is so odd on a piece that no kicks are told stays so on the whole, which takes long.
    some = tracks[:: -(-len(tracks) // FIRST_TRACKS)]
    rows = max(FIRST_ROWS // len(some), LEAST_ROWS)
    pieces = [Track(t.times[:rows], t.places[:rows]) for t in some]
    if sum(len(t.times) for t in tracks) > 2 * sum(len(t.times) for t in pieces):
        models = models_of(pieces, noise, criteria.class_nats, tick)
        near = [m for m in models if models[0].score - m.score <= criteria.class_nats]
        if "kicks" in models[0].terms and all(m.oddity < SURELY_ODD for m in near):
            return models[0], models
    models = models_of(tracks, noise, criteria.class_nats, tick)
    near = [m for m in models if models[0].score - m.score <= criteria.class_nats]
    able = [m for m in near if m.oddity >= criteria.alpha]
    # What hardly comes back during a track is no more seen to be in a trap than to drift.
    span = max(float(np.ptp(t.times)) for t in tracks)
    if any("push" in m.terms for m in able):
        able = [m for m in able if not _is_slack(m, span)]
    # Of models that are about as likely the one that says least.
    alike = [m for m in able if able[0].score - m.score < criteria.tie_nats]
    return min(alike, key=lambda m: len(m.terms), default=models[0]), models


def _is_slack(model, span):
    """Whether a trap brings nothing back within so many seconds."""
    if "trap" not in model.terms:
        return False
    # With inertia as well, if drag brings bodies to rest sooner than the trap brings them back.
    drag = 1.0 if model.is_overdamped else model.values.get("drag_rate", (0.0,))[0]
    return drag > 0 and model.values["trap_rate"][0] * span < SLACK * drag


def _are_told(model, criteria):
    """Whether a model is one of kicks that stands."""
    return model.are_kicks and model.oddity >= criteria.alpha


def _slowed(view, model, gain):
    """Drag alone, which may have brought what it slows to rest long before the end."""
    masses = [e.mass for s in view.dataset.scenes for e in s.entities if not e.is_static]
    mass = float(np.mean(masses)) if np.isfinite(masses).all() else 1.0
    types = dataset_types(view.dataset)
    (name,) = fresh_names(view.fit.law, ("c",)).values()
    formula = parse_formula(f"{name} * (norm(v_i) * normalize(v_i))", types)
    starts = {name: -mass * model.values["drag_rate"][0]}
    part = Forces(ForceLaw((Term(formula),), starts))
    return Proposal(
        "law", to_text(formula), view.hypothesis + part, -view.criteria.cause_nats, gain,
        starts=starts, formulas=(formula,), n_dims=view.dataset.n_dims, is_afresh=True,
    )  # fmt: skip


def _constants(model, dataset):
    out = []
    for name, (value, low, high) in model.values.items():
        unit = UNITS[name if name in UNITS else name.rpartition("_")[0]]
        if model.is_overdamped and name in ("trap_rate", "push_x", "push_y", "push_z"):
            unit = unit * TIME
        text = dataset.units.text(unit)
        out.append({"name": name, "value": value, "low": low, "high": high, "unit": text})
    return (*out, *_of_mass(model, dataset))


def _of_mass(model, dataset):
    """Temperature and stiffness, where the mass of what is kicked is known in SI."""
    masses = {e.mass for s in dataset.scenes for e in s.entities if not e.is_static}
    is_si = dataset.units.is_calibrated(Unit.of(kg=1, m=1, s=1))
    if len(masses) != 1 or not is_si or not math.isfinite(next(iter(masses))):
        return []
    (mass,) = masses
    scales = {"speed_variance": ("temperature", mass / BOLTZMANN, "K")}
    if not model.is_overdamped:
        scales["trap_rate"] = ("stiffness", mass, "kg/s^2")
    return [
        {"name": name, "unit": unit,
         **dict(zip(("value", "low", "high"), (scale * x for x in model.values[of]), strict=True))}
        for of, (name, scale, unit) in scales.items() if of in model.values
    ]  # fmt: skip


def _tracks(dataset, axes):
    """Every body of every scene that forces move, up to each leap and from there on."""
    out = []
    for times, places in _seen(dataset, axes):
        at = leaps(times, places)
        pieces = zip(np.split(times, at), np.split(places, at), strict=True)
        out += [Track(*piece) for piece in pieces if len(piece[0]) > MOST_ALONE]
    return out


def shared(dataset, axes):
    """Share of the variance of steps that the bodies of a recording have in common."""
    both, alone = 0.0, 0.0
    for scene in dataset.scenes:
        steps = np.diff(scene.positions[:, scene.dynamic][..., axes], axis=0)
        is_seen = np.isfinite(steps)
        count = is_seen.all(axis=2).sum(axis=1)[:, None]
        mean = np.where(is_seen, steps, 0.0).sum(axis=0) / np.maximum(is_seen.sum(axis=0), 1)
        steps = np.where(is_seen, steps - mean, 0.0)  # a drift is no kick
        square = np.square(steps).sum(axis=1)
        both += float((np.square(steps.sum(axis=1)) - square).sum())
        alone += float(((count - 1).clip(0) * square).sum())
    return both / alone if alone > 0 else 0.0


def _seen(dataset, axes):
    """Times (T,) and places (T, a) of every body of every scene that forces move, without gaps."""
    for scene in dataset.scenes:
        for k in scene.dynamic:
            places = scene.positions[:, k][:, axes]
            is_seen = np.isfinite(places).all(axis=1)
            yield scene.times[is_seen], places[is_seen]


def leaps(times, places):
    """First rows after each leap of a track (T, d), ndarray of int."""
    if len(times) < LEAST_ROWS:
        return np.zeros(0, dtype=int)
    steps = np.diff(places, axis=0) / np.sqrt(np.diff(times))[:, None]
    scale = np.median(np.abs(steps), axis=0) / 0.6745
    if not scale.all():
        return np.zeros(0, dtype=int)
    size = np.linalg.norm(steps / scale, axis=1)
    around = np.lib.stride_tricks.sliding_window_view(np.pad(size, 2), 5)
    beside = np.delete(around, 2, axis=1).max(axis=1)
    return np.flatnonzero((size > LEAP) & (size > LONELY * beside)) + 1


def _wider(tracks):
    """Nats by which first states cost more under the priors of other fits."""
    total = 0.0
    for track in tracks:
        extent = float(np.ptp(track.places, axis=0).max())
        span = float(track.times[-1] - track.times[0])
        fastest = float(np.abs(np.diff(track.places, axis=0)
                               / np.diff(track.times)[:, None]).max())  # fmt: skip
        speed = math.log(max(STATE_PRIOR * extent / span / max(fastest, 1e-300), 1.0))
        total += track.places.shape[1] * (math.log(STATE_PRIOR / FARTHEST) + speed)
    return total


def _text(model, n_leaps=0):
    """What acts, in words."""
    forces = [word for name, word in (("drag", "drag"), ("trap", "a trap"), ("push", "a push"))
              if name in model.terms and not (name == "drag" and model.is_overdamped)]  # fmt: skip
    text = "random kicks" + (f" with {' and '.join(forces)}" if forces else "")
    text += ", shown as means over an exposure" if model.is_blurred else ""
    text += f", beside {n_leaps} leap{'s' * (n_leaps > 1)} of the track" if n_leaps > 0 else ""
    return text + (" (no inertia is seen)" if model.is_overdamped else "")
