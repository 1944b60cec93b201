"""Which further measurement would tell explanations apart that fit the present data equally well.

One is taken for true and predicts a further recording without noise; the other is fitted to that,
its initial states free. What it leaves, in standard deviations of the noise, is by how much the
two could be told apart there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.errors import BspError
from bsp_gp.loop.seeing import Linearised
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.dynamics import rollout
from bsp_gp.physics.shooting import fit_rollout

__all__ = ["Member", "separating_text", "separations", "symmetry_text"]

TOLD = 5.0
"""Standard deviations at which two explanations count as told apart."""
LIKE_THESE = "one more recording like these"
BELIEVED = 0.05
"""An error of a scale or a clock that may well be: by it is told what a recording would show."""
TURNS = 30
"""Iterations from true to measured positions; corrections are near the identity."""


@dataclass(frozen=True, eq=False)
class Member:
    """One of several explanations that fit equally well.

    Attributes
    ----------
    name : str
    fit : Fit
    view : callable or None
        ``view(scene, track) -> Scene``: a measured scene as it was by this explanation; None:
        as measured.
    """

    name: str
    fit: object
    view: object = None

    def seen(self, scene, track=None):
        return scene if self.view is None else self.view(scene, track)


def separations(observation, one, other):
    """By how many standard deviations two explanations differ on further recordings.

    Parameters
    ----------
    observation : Observation
        As measured.
    one, other : Member

    Returns
    -------
    dict of str to float
        What would be recorded -> standard deviations; `LIKE_THESE` among them.
    """
    scene = max(observation.train, key=lambda s: len(s.times))
    out = {}
    for words, plan in _plans(observation, scene).items():
        try:
            size = _difference(observation, plan, one, other)
        except (BspError, np.linalg.LinAlgError):
            continue
        if np.isfinite(size):
            out[words] = size
    return out


def separating_text(observation, members):
    """In a few words, which further measurement would separate the members of a class.

    Parameters
    ----------
    observation : Observation
    members : sequence of Member
        At least two; the first one is compared with the others.

    Returns
    -------
    str
        "" where it cannot be said.
    """
    if observation.is_exact or len(members) < 2 or members[0].fit.whole is None:
        return ""
    one, *others = members
    found = [separations(observation, one, other) for other in others]
    common = set.intersection(*(set(f) for f in found))
    if not common:
        return ""
    least = {words: min(f[words] for f in found) for words in common}
    again = least.pop(LIKE_THESE, None)
    if not least:
        return ""
    best = max(least, key=lambda words: (least[words], words))
    if least[best] < TOLD:
        tried = ", ".join(sorted(least))
        return (
            f"none of the further recordings that were tried ({tried}): predictions differ by "
            f"{least[best]:.1g} sigma at most; a known length and a known time in the same "
            "recording, or a second camera"
        )
    text = f"{best}: predictions differ by {least[best]:.3g} sigma there"
    return text if again is None else f"{text} ({again:.2g} in {LIKE_THESE})"


def symmetry_text(observation, fit, corrections, column):
    """Which further recording would part errors of the measurement from another number.

    Parameters
    ----------
    observation : Observation
    fit : Fit
        Of the law under which they do the same to the present tracks.
    corrections : sequence of Correction
        Of one number each.
    column : callable
        ``column(linear)`` -> derivative of the residual by the number, see `Linearised`.

    Returns
    -------
    str
    """
    cure = "a known length and a known time in the same recording would tell them apart"
    if fit.whole is None:
        return cure
    scene = max(observation.train, key=lambda s: len(s.times))
    found = {}
    for words, plan in _plans(observation, scene).items():
        further = _predicted(observation, plan, Member("", fit))
        if further is None:
            continue
        start = _start_of(fit.whole, plan.source)
        start = plan.start(*start) if plan.start else start
        seen = replace(observation, train=(further,), segments=(further,), segment_rows=None)
        whole = fit_rollout(
            [further],
            fit.law,
            seen.sigma,
            integrator=seen.integrator,
            substeps=seen.substeps,
            up=seen.dataset.up,
            memory=seen.memory,
            states={further.name: start},
            max_iterations=0,
        )
        linear = Linearised(seen, replace(fit, whole=whole))
        number = column(linear)
        number = number / max(float(np.linalg.norm(number)), 1e-300)
        sizes = []
        for c in corrections:
            (change,), _ = linear.columns(c)
            sizes.append(BELIEVED * float(np.linalg.norm(change - (change @ number) * number)))
        found[words] = min(sizes)
    found.pop(LIKE_THESE, None)
    if not found:
        return cure
    best = max(found, key=lambda words: (found[words], words))
    if found[best] < TOLD:
        return (
            f"none of the further recordings that were tried would part them ({', '.join(found)}: "
            f"an error of {BELIEVED:.0%} shows by {found[best]:.1g} sigma at most); {cure}"
        )
    return (
        f"{best} would tell them apart: an error of {BELIEVED:.0%} shows by {found[best]:.3g} "
        "sigma there"
    )


@dataclass(frozen=True, eq=False)
class _Plan:
    """A further recording: a scene whose moving bodies are still to be filled in."""

    scene: object
    source: str
    start: object = None


def _plans(observation, scene):
    """Further recordings by what is other about them."""
    out = {LIKE_THESE: _Plan(scene, scene.name)}
    fixed = [k for k, e in enumerate(scene.entities) if e.is_static]
    if not _moves(scene, fixed):
        out["a track twice as long"] = _Plan(_longer(scene), scene.name)
    out["a start twice as fast"] = _Plan(scene, scene.name, lambda p, v: (p, 2 * v))
    out["a start in another direction"] = _Plan(
        scene, scene.name, lambda p, v: (p, np.concatenate([-v[..., 1:2], v[..., :1], v[..., 2:]],
                                                           axis=-1)),
    )  # fmt: skip
    up = observation.dataset.up
    if up is not None:
        higher = np.zeros(scene.n_dims)
        span = float(np.ptp(scene.positions[:, scene.dynamic, "xyz".index(up[-1])]))
        higher["xyz".index(up[-1])] = -span if up.startswith("-") else span
        if span > 0:
            out["a second height"] = _Plan(scene, scene.name, lambda p, v: (p + higher, v))
    if all(np.isfinite(scene.entities[k].mass) for k in scene.dynamic):
        out["bodies of twice the mass"] = _Plan(_heavier(scene), scene.name)
    if fixed and not _moves(scene, fixed):
        out["the fixed body elsewhere"] = _Plan(_elsewhere(scene, fixed), scene.name)
    return out


def _moves(scene, fixed):
    track = scene.positions[:, fixed]
    return bool(fixed) and not np.array_equal(track, np.broadcast_to(track[0], track.shape))


def _longer(scene):
    n = len(scene.times)
    step = np.median(np.diff(scene.times))
    times = np.concatenate([scene.times, scene.times[-1] + step * np.arange(1, n + 1)])
    positions = np.concatenate([scene.positions, np.repeat(scene.positions[-1:], n, axis=0)])
    sigma = None if scene.sigma is None else np.concatenate([scene.sigma, scene.sigma[::-1]])
    return replace(scene, times=times, positions=positions, velocities=None, sigma=sigma)


def _heavier(scene):
    entities = [
        e
        if e.is_static
        else replace(e, properties={**e.properties, "mass": 2 * e.properties["mass"]})
        for e in scene.entities
    ]
    return replace(scene, entities=tuple(entities))


def _elsewhere(scene, fixed):
    positions = np.array(scene.positions)
    reach = np.nanmax(np.ptp(positions[:, scene.dynamic], axis=0), axis=0)
    positions[:, fixed] += 0.5 * reach
    return replace(scene, positions=positions)


def _difference(observation, plan, one, other):
    """What the other leaves of what the one predicts, in standard deviations."""
    scene = _predicted(observation, plan, one)
    if scene is None:
        return np.nan
    seen = other.seen(scene, scene.positions[:, scene.dynamic])
    fit = fit_rollout(
        [seen], other.fit.law, observation.sigma, free=(), integrator=observation.integrator,
        substeps=observation.substeps, up=observation.dataset.up,
    )  # fmt: skip
    return float(np.sqrt(fit.chisqr))


def _predicted(observation, plan, member):
    """The scene as it would be measured if a member of the class were true."""
    start = _start_of(member.fit.whole, plan.source)
    if start is None:
        return None
    p, v = plan.start(*start) if plan.start else start
    scene = plan.scene
    dynamic = scene.dynamic
    positions = np.array(scene.positions)
    # Gaps are filled: a further recording has none.
    positions[:, dynamic] = p
    blank = replace(scene, positions=_apart(positions, dynamic), velocities=None)
    (batch,) = stack([member.seen(blank, blank.positions[:, dynamic])], observation.dataset.up)
    track = rollout(
        member.fit.law, batch, p[None], v[None], integrator=observation.integrator,
        substeps=observation.substeps,
    )[:, 0]  # fmt: skip
    if not np.isfinite(track).all():
        return None
    positions[:, dynamic] = track
    measured = replace(scene, positions=positions, velocities=None)
    for _ in range(TURNS if member.view is not None else 0):
        left = track - member.seen(measured, track).positions[:, dynamic][:, : track.shape[1]]
        positions = np.array(measured.positions)
        positions[:, dynamic] += left
        measured = replace(measured, positions=positions)
    return measured


def _apart(positions, dynamic):
    """Placeholders of the moving bodies that coincide with nothing."""
    out = np.array(positions)
    extent = np.nanmax(np.abs(out)) + 1.0
    out[:, dynamic] += extent * 1e-9 * (1 + np.arange(len(dynamic)))[:, None]
    return out


def _start_of(whole, name):
    for batch, p, v in zip(whole.batches, whole.positions, whole.velocities, strict=True):
        for s, scene in enumerate(batch.scenes):
            if scene.name == name or scene.name.startswith(f"{name}[0:"):
                return p[s], v[s]
    return None
