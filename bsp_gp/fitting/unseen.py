"""Bodies that no row shows and that forces move: their first states are constants of the law.

In the tracks of a fit such a body has nodes like any other, but its first one is no unknown of its
own. In scenes that a law was not fitted to it is a body that forces do not move, on the track on
which the fit has it.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.physics.engine.chains import build_chains
from bsp_gp.physics.engine.flow import Flow
from bsp_gp.physics.engine.motion import Motion

MARK = "unseen"
"""Property that is 1 of a body that no row shows, and 0 of others."""
STEP_ERROR = 0.02
"""Error of the integration from row to row, in standard deviations of a position."""
FAR = 1e30
"""Coordinate of a body that has run away, m."""


def without_unseen(law):
    """A law for people: without what its unseen bodies bring, which is told by itself."""
    marks = {f"{MARK}_i", f"{MARK}_j"}
    return replace(law, terms=tuple(t for t in law.terms if not marks & set(t.formula.inputs)))


def with_entity(scene, entity, track=None, values=()):
    """The scene with one more body.

    Parameters
    ----------
    track : ndarray, shape (2, T, d), optional
        Its places and velocities; by default no row shows it.
    values : mapping of str to float
        Properties that the other bodies get.
    """
    others = tuple(replace(e, properties={**e.properties, **dict(values)}) for e in scene.entities)
    blank = np.full((2, len(scene.times), scene.n_dims), np.nan)
    track = blank if track is None else track

    def more(values, own):
        return None if values is None else np.concatenate([values, own[:, None]], axis=1)

    return Scene(
        scene.name, scene.times, more(scene.positions, track[0]), (*others, entity),
        more(scene.velocities, track[1]), more(scene.sigma, blank[0]),
        {name: more(v, np.full_like(v[:, 0], np.nan)) for name, v in scene.inputs.items()},
        _one_more(scene.first),
    )  # fmt: skip


def _one_more(first):
    """First states of a scene with one more body, of which nothing is known."""
    if first is None:
        return None
    blank = np.full((1, first.velocity.shape[1]), np.nan)
    return replace(
        first, velocity=np.concatenate([first.velocity, blank]),
        velocity_error=np.concatenate([first.velocity_error, blank]),
    )  # fmt: skip


def tied(motion):
    """Which numbers of the state of chains are which constants at first, list of (int, int)."""
    chains, out = motion.chains, []
    names = [name for name, _ in motion.parameters]
    for body in motion.law.unseen:
        if chains.n_chains and body.entity in chains.bodies[0]:
            r = chains.bodies[0].index(body.entity)
            for k, name in enumerate(body.names):
                part, axis = divmod(k, chains.n_dims)
                if name in names:
                    state = (part * chains.n_moving + r) * chains.n_dims + axis
                    out.append((state, names.index(name)))
    return out


def carried(flow, nodes, constants):
    """Nodes (2, R, d, T, S) with bodies that no row shows on the tracks that the others make."""
    ties = tied(flow.motion)
    if not ties:
        return nodes
    chains, nodes = flow.chains, nodes.copy()
    flow.motion.set_constants(constants)
    flat = nodes.reshape(flow.n_state, *nodes.shape[3:])
    own = [state for state, _ in ties]
    flat[own, 0] = constants[[number for _, number in ties]][:, None]
    for row in range(len(chains.times) - 1):
        chain = flow.chain[flow.row == row]
        ends = flow.advance(
            nodes[..., row, chain], chain, chains.times[row, chain], chains.times[row + 1, chain]
        )
        flat[np.ix_(own, [row + 1], chain)] = ends.reshape(flow.n_state, 1, -1)[own]
    return np.nan_to_num(nodes)


def shown(found, scenes):
    """Scenes of a fitted scene's clock with the bodies that no row shows, on a fit's tracks."""
    for body in found.law.unseen:
        scenes = tuple(
            scene if body.entity in scene.names else _with_track(found, body, scene)
            for scene in scenes
        )
    return scenes


def as_driven(found, dataset):
    """A fit and its data with bodies that no row shows held to the tracks on which it has them."""
    names = [body.entity for body in found.law.unseen]
    if not names:
        return found, dataset
    (chains,), (whole,), (scene,) = found.groups, found.nodes, dataset.scenes
    places = np.array(scene.positions)
    for r, name in enumerate(chains.bodies[0]):
        if name in names:
            places[:, scene.names.index(name)] = whole[0, r, :, :, 0].T
    crew = tuple(replace(e, is_static=e.is_static or e.name in names) for e in scene.entities)
    scenes = (replace(scene, positions=places, entities=crew),)
    groups = build_chains(found.law, scenes, dataset.up, dataset.velocity, coupled=True)
    nodes = whole[:, [name not in names for name in chains.bodies[0]]]
    channels = found.channels
    kept = [channels.body_names[k] not in names for k in channels.body]
    channels = channels.only(np.array(kept))
    found = replace(found, groups=tuple(groups), nodes=(nodes,), channels=channels)
    return found, replace(dataset, scenes=scenes)


def _with_track(found, body, scene):
    """A scene with a body on the track that the motion of a fit gives it."""
    chains, nodes, s = next(
        (chains, nodes, members.index(True))
        for chains, nodes in zip(found.groups, found.nodes, strict=True)
        for members in [[body.entity in names for names in chains.bodies]]
        if True in members
    )
    r, (one,) = chains.bodies[s].index(body.entity), (np.array([s]),)
    own = chains.times[: chains.lengths[s], s]
    alone = chains.pieces(one, np.array([0]), chains.lengths[one])
    motion = Motion(found.law, _also_driven(alone, scene), ())
    motion.set_constants(np.zeros(0))
    flow = Flow(motion, np.array([STEP_ERROR * float(np.nanmin(found.noise.levels))]))
    row = np.abs(own - scene.times[0]).argmin()
    at, state = own[row], nodes[..., row, one]
    track = np.empty((2, len(scene.times), scene.n_dims))
    for k, time in enumerate(scene.times):
        if time != at:
            state = flow.advance(state, np.array([0]), np.array([at]), np.array([time]))
        at, track[:, k] = time, state[:, r, :, 0]
    unseen = Entity(body.entity, is_static=True, properties=_properties(alone, r))
    return with_entity(scene, unseen, np.where(np.isfinite(track), track, FAR), {MARK: 0.0})


def _also_driven(alone, scene):
    """One chain with the bodies that forces do not move where another scene has them as well."""
    driven = np.setdiff1d(np.arange(len(scene.entities)), scene.dynamic)
    times, rows = np.unique(np.append(alone.driven_times[:, 0], scene.times), return_index=True)
    places = np.concatenate([alone.driven[:, 0], scene.positions[:, driven]])[rows]
    return replace(
        alone, driven_times=times[:, None], driven=places[:, None], driven_velocities=None
    )


def _properties(chains, r):
    """Of one body of one chain."""
    columns = {name: values[r, 0] for name, values in chains.properties.items()}
    return {name: value for name, value in columns.items() if np.isfinite(value).all()}
