"""Bodies that are led by where others were seen: led by where a fit has these, once there is one.

Of many bodies each is followed by itself. What was measured of the others has errors, and a force
of a body near by has them too, many times over; the track that the same law gives them has less.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.fitting.jumps import scatter

LEAST_ROWS = 6
NEAR = 2.0
"""Errors of a coordinate, as neighbouring rows tell them, within which a track is where a body was
seen, root mean square: what leads others must be."""
SETTLED = 0.02
"""Of such an error, by which tracks that lead may change, root mean square, and stay."""


def led_by(groups, found):
    """Groups of chains with bodies led by the tracks of a fit, where these are near what was seen.

    None where nothing changes.
    """
    seen = _seen(groups)
    if not any(are_led(chains, seen) for chains in groups):
        return None
    tracks = _tracks(found, seen)
    pairs = [_led(chains, tracks) for chains in groups]
    if not any(is_changed for _, is_changed in pairs):
        return None
    return tuple(chains for chains, _ in pairs)


def _seen(groups):
    """Times and measured places of the bodies that forces move, by scene and body."""
    return {
        (scene, body): (chains.times[:n, s], chains.observed[:n, s, r])
        for chains in groups for scene, body, s, r in chains.members()
        for n in [int(chains.lengths[s])]
    }  # fmt: skip


def are_led(chains, moving):
    """Whether bodies that forces move, by scene and name, stand beside chains."""
    beside = zip(chains.scenes, chains.fixed, strict=True)
    return any((scene, body) in moving for scene, fixed in beside for body in fixed)


def _tracks(found, seen):
    """States of bodies at the rows of their scenes, (2, T, d), and their errors, by both names.

    Of those alone that are near where the rows, by which others are to be led, have them.
    """
    out = {}
    for chains, nodes in zip(found.groups, found.nodes, strict=True):
        if nodes.shape[-2] != len(chains.times):  # it is known at other rows
            continue
        for scene, body, s, r in chains.members():
            n = int(chains.lengths[s])
            if n < np.isfinite(chains.driven_times[:, s]).sum():  # others are led for longer
                continue
            times, places = seen.get((scene, body), (None, None))
            states = np.moveaxis(nodes[:, r, :, :n, s], 1, 2)
            if times is None or not np.array_equal(times, chains.times[:n, s]):
                continue
            rows = np.isfinite(places).all(axis=1)
            moving = np.ptp(places[rows], axis=0) > 0 if rows.any() else np.zeros(1, dtype=bool)
            if rows.sum() < LEAST_ROWS or not moving.any() or not np.isfinite(states).all():
                continue
            error, off = scatter(places), (states[0] - places)[rows][:, moving]
            if np.sqrt(np.mean(np.square(off))) <= NEAR * error:
                out[scene, body] = states, error
    return out


def _led(chains, tracks):
    """Chains with the tracks that lead them, and whether any is another one than before."""
    places = chains.driven.copy()
    given = chains.driven_velocities
    speeds = np.full(places.shape, np.nan) if given is None else given.copy()
    is_changed = False
    for s, (scene, fixed) in enumerate(zip(chains.scenes, chains.fixed, strict=True)):
        for k, body in enumerate(fixed):
            if (scene, body) not in tracks:
                continue
            states, error = tracks[scene, body]
            n = min(len(states[0]), len(places))
            change = np.nan_to_num(places[:n, s, k] - states[0, :n], nan=np.inf)
            is_changed |= bool(np.sqrt(np.mean(np.square(change))) > SETTLED * error)
            places[:n, s, k], speeds[:n, s, k] = states[0, :n], states[1, :n]
    return replace(chains, driven=places, driven_velocities=speeds), is_changed
