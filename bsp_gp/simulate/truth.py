"""What a made-up data set really contains, kept apart from it: nothing that reads data reads this.

The folder of a truth stands beside the data set's, not in it, so that a loop cannot peek and a
test can score its verdict.
"""

import json
from dataclasses import dataclass, fields, is_dataclass

import numpy as np

from bsp_gp.data.cells import safe_table
from bsp_gp.data.scene import Scene
from bsp_gp.simulate.engine import acceleration
from bsp_gp.simulate.world import Ensemble, States, World

TRUTH, STATES, PIXELS = "truth.json", "states.csv", "pixels.csv"
KIND = "truth"
_INSTANT = 1e-12


@dataclass(frozen=True, eq=False)
class Truth:
    """The answer to a made-up data set.

    Attributes
    ----------
    declared : tuple of str
        Laws of the model that goes with the data, as typed on the command line.
    acting : tuple of str
        Laws of all forces that act, as far as the language can say them.
    effects : tuple of Effect
    unsaid : tuple of str
        Names of what acts and no law says: contacts, and effects without words.
    worlds : tuple of World
        As they started, hidden entities included.
    scenes : tuple of str
        Their names in the data set.
    states : States
        Exact places and velocities, without noise.
    settings : Settings
    """

    name: str
    declared: tuple[str, ...]
    acting: tuple[str, ...]
    effects: tuple
    unsaid: tuple[str, ...]
    worlds: tuple[World, ...]
    scenes: tuple[str, ...]
    states: States
    settings: object

    @property
    def undeclared(self):
        """Effects that the declared model lacks."""
        return tuple(effect for effect in self.effects if not effect.is_declared)

    def scene(self, k):
        """Scene k (from 0) as it really was, with exact velocities; nothing hidden is shown."""
        world, states = self.worlds[k], self.states
        seen = world.seen
        return Scene(
            self.scenes[k], states.times, states.positions[k][:, seen],
            [world.entities[i] for i in seen], states.velocities[k][:, seen],
        )  # fmt: skip

    def accelerations(self, of_declared=False):
        """Accelerations along the true motion, contacts left out.

        The difference of the two is what a loop has to find.

        Parameters
        ----------
        of_declared : bool
            Those of the declared model, which knows no hidden bodies, in place of all that act.

        Returns
        -------
        ndarray, shape (S, T, N, 2), m/s^2
            Of the entities that the data show.
        """
        effects = [e for e in self.effects if e.is_declared] if of_declared else None
        forces = self.settings.motion(effects).forces
        seen = self.worlds[0].seen
        kept = seen if of_declared else np.arange(len(self.worlds[0].entities))
        bodies = Ensemble([world.only(kept) for world in self.worlds])
        p, v = (a[:, :, kept] for a in (self.states.positions, self.states.velocities))
        out = np.empty_like(p)
        for k, t in enumerate(self.states.times):
            out[:, k] = acceleration(forces, bodies, p[:, k], v[:, k], t, _INSTANT)
        return out if of_declared else out[:, :, seen]

    def to_dict(self):
        """What ``truth.json`` holds."""
        touched = self.states.touched.any(axis=2)
        effects = [
            _record(effect) | {"parameters": dict(effect.parameters),
                               "laws": [law for force in effect.forces for law in force.laws]}
            for effect in self.effects
        ]  # fmt: skip
        scenes = [
            {"name": name, "hidden": sorted(world.hidden),
             "frames_with_contact": (np.flatnonzero(hit) + 1).tolist()}
            for name, world, hit in zip(self.scenes, self.worlds, touched, strict=True)
        ]  # fmt: skip
        return {
            "schema": 1, "name": self.name, "declared": list(self.declared),
            "acting": list(self.acting), "unsaid": list(self.unsaid), "effects": effects,
            "settings": _record(self.settings), "scenes": scenes,
        }  # fmt: skip


def _record(value):
    """Settings as JSON can say them; a dataclass with its type."""
    if isinstance(value, World):
        return {"type": "World", "entities": [e.name for e in value.entities]}
    if is_dataclass(value):
        items = {f.name: _record(getattr(value, f.name)) for f in fields(value)}
        return {"type": type(value).__name__, **items}
    if isinstance(value, tuple | list):
        return [_record(item) for item in value]
    if hasattr(value, "items"):
        return {key: _record(item) for key, item in value.items()}
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def fill_truth(truth, folder, pixels=None, seed=None):
    """Write ``truth.json`` and ``states.csv`` (exact states, with contacts) into an empty folder.

    `pixels` (a DataFrame), where bodies are in the frames of films, goes into ``pixels.csv``; the
    seed of the generator is for the record.
    """
    text = json.dumps(
        {"seed": seed, **truth.to_dict()}, indent=1, ensure_ascii=False, allow_nan=False
    )
    (folder / TRUTH).write_text(f"{text}\n", encoding="utf-8")
    safe_table(_states_table(truth)).to_csv(folder / STATES, index=False, lineterminator="\n")
    if pixels is not None:
        safe_table(pixels).to_csv(folder / PIXELS, index=False, lineterminator="\n")


def _states_table(truth):
    import pandas as pd

    states = truth.states
    shape = states.positions.shape[:3]  # scenes, times, entities
    names = np.array([[entity.name for entity in world.entities] for world in truth.worlds], object)
    touched = np.zeros(shape, dtype=int)
    touched[:, 1:] = states.touched
    columns = {
        "scene": np.array(truth.scenes, dtype=object)[:, None, None],
        "t": states.times[:, None], "entity": names[:, None],
        "x": states.positions[..., 0], "y": states.positions[..., 1],
        "vx": states.velocities[..., 0], "vy": states.velocities[..., 1], "touched": touched,
    }  # fmt: skip
    return pd.DataFrame({k: np.broadcast_to(v, shape).ravel() for k, v in columns.items()})
