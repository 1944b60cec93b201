"""Made-up worlds: settings and a random generator in, a data set and its truth out.

`preset` has the paper's NBODY, BOUNCE and MAT, and MAGNET, FALL, SPRING and PUCKS; every number of
them can be set. Motion is pymunk's (or another engine's), never that of our own integrator.
"""

from dataclasses import dataclass, fields, replace
from itertools import combinations

import numpy as np

from bsp_gp.data.scene import Dataset, Scene
from bsp_gp.errors import SettingsError
from bsp_gp.simulate.effects import Effect
from bsp_gp.simulate.engine import Contacts, Motion, run_pymunk
from bsp_gp.simulate.forces import AnchorSpring, ContactDamping, Force, PairForce, SoftContact
from bsp_gp.simulate.layouts import Bounce, Fall, Layout, Magnet, Mat, NBody, Pucks, Spring
from bsp_gp.simulate.machines import MACHINES
from bsp_gp.simulate.observation import Observation
from bsp_gp.simulate.skies import Beads, Binary, StarAboutUnseen
from bsp_gp.simulate.truth import Truth
from bsp_gp.simulate.world import States
from bsp_gp.units import UnitSystem

_DRAWS = 100
_SI = {"length": "m", "time": "s", "mass": "kg"}


@dataclass(frozen=True)
class Settings:
    """Everything that a made-up data set depends on, besides the random generator.

    Parameters
    ----------
    name : str
    layout : Layout
        Draws scenes.
    n_scenes : int
    n_frames, dt, substeps
        As in `Motion`.
    contacts : Contacts
        As the declared model has them.
    forces : tuple of Force, optional
        Of the declared model; by default those of the layout.
    effects : tuple of Effect
        What differs from that; undeclared ones are in the truth only.
    up : str or None
        Axis that points up, as the data set declares it.
    train_share : float
        The first so many scenes are declared for training, if there are at least five.
    is_followed : bool
        Where bodies have no contacts: scenes in which discs overlap, or a velocity changes by more
        than its usual size between two frames, are drawn again. No law can be read off those.
    """

    name: str
    layout: Layout
    n_scenes: int = 1
    n_frames: int = 51
    dt: float = 0.02
    substeps: int = 20
    contacts: Contacts = Contacts()
    forces: tuple[Force, ...] | None = None
    effects: tuple[Effect, ...] = ()
    observation: Observation = Observation()
    up: str | None = None
    train_share: float = 0.8
    is_followed: bool = False

    def __post_init__(self):
        if self.n_scenes < 1:
            raise SettingsError(f"n_scenes must be at least 1, got {self.n_scenes}")
        if not 0 < self.train_share < 1:
            raise SettingsError(f"train_share must lie between 0 and 1, got {self.train_share}")
        if self.forces is None:
            object.__setattr__(self, "forces", self.layout.forces)
        if self.up not in (None, "x", "y", "-x", "-y"):
            raise SettingsError(f"up must be x, y, -x, -y or none, got {self.up!r}")
        forces = self.motion().forces
        self._require_hidden_to_act(forces)
        self._require_discs_to_meet(forces)

    def _require_hidden_to_act(self, forces):
        sources = {force.column for force in forces if isinstance(force, PairForce)}
        sources |= {"stiffness"} if any(isinstance(f, AnchorSpring) for f in forces) else set()
        for effect in self.effects:
            body = effect.body
            if body is None or not body.is_hidden or body.entity.shape != "point":
                continue
            if not sources & set(body.entity.properties):
                raise SettingsError(
                    f"a hidden body acts by its {' and '.join(body.entity.properties)}, and no "
                    f"force of {self.name} does; add one, such as the effect "
                    f"pair=1,column={next(iter(body.entity.properties))}"
                )

    def _require_discs_to_meet(self, forces):
        is_soft = any(isinstance(force, SoftContact) for force in forces)
        if any(isinstance(force, ContactDamping) for force in forces) and not is_soft:
            raise SettingsError(
                f"a dashpot acts while discs overlap, and those of {self.name} do not; take the "
                "preset pucks, or the effect inelastic"
            )
        for effect in self.effects:
            if effect.restitution is not None and not self.contacts.has_contacts:
                raise SettingsError(
                    f"effect {effect.name!r} changes contacts, and {self.name} has none; "
                    + ("the effect dashpot damps its soft discs" if is_soft
                       else "set has_contacts=yes (in a fall has_table=yes as well)")
                )
            body = effect.body
            if is_soft and body and not body.is_hidden and not body.entity.radius > 0:
                raise SettingsError(
                    f"effect {effect.name!r} adds a body without a radius, of which the law of "
                    f"the soft discs of {self.name} cannot speak; hide it (hidden=1)"
                )

    def motion(self, effects=None):
        """What moves the worlds, with all effects or those given."""
        forces, contacts = self.forces, self.contacts
        for effect in self.effects if effects is None else effects:
            forces = (*_with_power(forces, effect), *effect.forces)
            if effect.restitution is not None:
                contacts = replace(contacts, restitution=effect.restitution)
        return Motion(forces, self.n_frames, self.dt, self.substeps, contacts)

    def laws(self, effects=None):
        """Laws of the forces with all effects or those given, as typed on the command line."""
        return tuple(law for force in self.motion(effects).forces for law in force.laws)

    @property
    def declared(self):
        """Laws of the model that goes with the data."""
        laws = self.laws([effect for effect in self.effects if effect.is_declared])
        return laws if self.layout.is_declared else laws[len(self.laws([])) :]


def _with_power(forces, effect):
    if effect.power is None:
        return forces
    for k, force in enumerate(forces):
        if isinstance(force, PairForce):
            return (*forces[:k], replace(force, power=effect.power), *forces[k + 1 :])
    raise SettingsError(
        f"effect {effect.name!r} changes the exponent of a pair force, and there is none"
    )


YEAR = 31557600.0
UNTOUCHED = Contacts(has_contacts=False)
PRESETS = {
    "nbody": Settings("nbody", NBody(), substeps=1),
    "bounce": Settings("bounce", Bounce(), substeps=1),
    "mat": Settings("mat", Mat(), substeps=1),
    "magnet": Settings("magnet", Magnet(), dt=0.04),
    "fall": Settings("fall", Fall(), dt=1 / 50, contacts=Contacts(restitution=0.5), up="y"),
    "spring": Settings("spring", Spring(), dt=1 / 25, up="y"),
    "pucks": Settings("pucks", Pucks(), dt=1 / 25, contacts=Contacts(has_contacts=False)),
    "binary": Settings(
        "binary", Binary(), n_frames=40, dt=YEAR / 2, substeps=200, contacts=UNTOUCHED,
    ),
    "star_about_unseen": Settings(
        "star_about_unseen", StarAboutUnseen(), n_frames=40, dt=YEAR / 2, substeps=200,
        contacts=UNTOUCHED,
    ),
    "beads": Settings("beads", Beads(), n_frames=500, contacts=UNTOUCHED),
}  # fmt: skip
"""The paper's scenes, with its one step of 0.02 per frame, and seven more."""

RECORDED = {
    "nbody": {"has_contacts": False, "is_followed": True, "substeps": 50, "noise": 0.05},
    "bounce": {"noise": 0.05},
    "mat": {"has_contacts": False, "noise": 0.05},
    "magnet": {"has_contacts": False, "is_followed": True, "noise": 0.01},
    "fall": {"has_contacts": False, "has_table": False, "noise": 0.005},
    "spring": {"noise": 0.003},
    "pucks": {"noise": 0.01},
    "binary": {"noise": 3e10}, "star_about_unseen": {"noise": 3e10}, "beads": {"noise": 1e-6},
}
"""Numbers with which a preset is a recording: a camera's noise, and motion that follows the laws
of its declared model, which know of no hard contacts."""


def preset(name, effects=(), **numbers):
    """Settings of a preset, with numbers of it changed.

    There are those in `PRESETS`; numbers are as for `configured`.

    Examples
    --------
    >>> preset("bounce", n_scenes=3, restitution=0.9, speed=(20, 30)).contacts.restitution
    0.9
    """
    if name not in PRESETS:
        known = ", ".join((*PRESETS, *MACHINES))
        raise SettingsError(f"preset must be one of {known}, got {name!r}")
    return replace(configured(PRESETS[name], **numbers), effects=tuple(effects))


def configured(settings, **numbers):
    """Settings with numbers changed by name, wherever they belong.

    Parameters
    ----------
    **numbers
        Fields of the layout, `Settings`, `Contacts` or `Observation`; ranges are (low, high).

    Raises
    ------
    SettingsError
        If there is no such number, or it is not allowed.
    """
    parts = {"layout": {}, "contacts": {}, "observation": {}}
    own = {}
    for name, value in numbers.items():
        for part, changes in parts.items():
            if name in _names(getattr(settings, part)):
                changes[name] = value
                break
        else:
            if name not in _names(settings) or name in (*parts, "name", "effects"):
                raise SettingsError(
                    f"there is no number {name!r}; those of {settings.name} are "
                    f"{', '.join(numbers_of(settings))}"
                )
            own[name] = value
    try:
        changed = {part: replace(getattr(settings, part), **c) for part, c in parts.items() if c}
    except TypeError as error:
        raise SettingsError(f"a number has the wrong type: {error}") from error
    if "layout" in changed and "forces" not in own and settings.forces == settings.layout.forces:
        own["forces"] = None
    return replace(settings, **changed, **own)


def _names(part):
    return [item.name for item in fields(part)]


def numbers_of(settings):
    """Names of all numbers that `configured` can change, and their values."""
    parts = (settings.layout, settings, settings.contacts, settings.observation)
    skipped = ("name", "layout", "contacts", "observation", "forces", "effects", "world")
    return {n: getattr(p, n) for p in parts for n in _names(p) if n not in skipped}


def read_numbers(settings, texts):
    """Numbers for `configured` from texts: ``{"mass": "0.1..2", "n_bodies": "5"}``.

    A text is a number; ``a..b`` for a range; yes or no; ``none`` where that is a value.
    """
    known = numbers_of(settings)
    numbers = {}
    for name, text in texts.items():
        if name not in known:
            configured(settings, **{name: text})  # complains, and says which there are
        numbers[name] = _value(name, text.strip(), known[name])
    return numbers


def _value(name, text, now):
    try:
        if isinstance(now, bool):
            return {"yes": True, "no": False, "1": True, "0": False}[text.lower()]
        if isinstance(now, tuple):
            low, dots, high = text.partition("..")
            return (float(low), float(high if dots else low))
        if now is None or isinstance(now, str):
            return None if text.lower() == "none" else text
        return int(text) if isinstance(now, int) else float(text)
    except (ValueError, KeyError):
        allowed = {bool: "yes or no", tuple: "a number or a range a..b", int: "a whole number"}
        what = allowed.get(type(now), "a number")
        raise SettingsError(f"{name} must be {what}, got {text[:40]!r}") from None


def make(settings, rng, engine=run_pymunk):
    """Make a data set.

    Parameters
    ----------
    rng : numpy.random.Generator
        Every scene has streams of its own for its layout, its effects and its noise, so that
        scene k does not depend on how many there are, nor its start on the effects.
    engine : callable
        ``engine(worlds, motion) -> States``; `run_pymunk` or another one.

    Returns
    -------
    dataset : Dataset
        What was measured. Scenes are named "1", "2", ...
    truth : Truth
        What really happened.
    """
    settings = _seeded(settings, rng)
    streams = [child.spawn(2 + len(settings.effects)) for child in rng.spawn(settings.n_scenes)]
    noise_rngs = [stream.pop(1) for stream in streams]
    worlds = [_drawn(settings, stream) for stream in streams]
    states = engine(worlds, settings.motion())
    if settings.is_followed and not settings.contacts.has_contacts:
        worlds, states = _followed(settings, streams, worlds, states, engine)
    names = tuple(str(k + 1) for k in range(settings.n_scenes))
    scenes = [
        _observed(name, world, states, k, settings.observation, noise_rng)
        for k, (name, world, noise_rng) in enumerate(zip(names, worlds, noise_rngs, strict=True))
    ]
    truth = Truth(
        settings.name, settings.declared, settings.laws(), settings.effects, _unsaid(settings),
        tuple(worlds), names, states, settings,
    )  # fmt: skip
    return _dataset(settings, scenes, names), truth


def _seeded(settings, rng):
    """Settings whose random forces have seeds; those without any take nothing of the generator."""
    if not any(force.is_random for force in settings.forces):
        return settings
    return replace(settings, forces=tuple(
        replace(f, seed=int(rng.integers(2**31))) if f.is_random else f for f in settings.forces
    ))  # fmt: skip


def _drawn(settings, stream):
    """One world, of the generators of its layout and of every effect."""
    layout_rng, *effect_rngs = stream
    world = settings.layout.draw(layout_rng)
    for effect, effect_rng in zip(settings.effects, effect_rngs, strict=True):
        for part in (effect.new_property, effect.body):
            world = world if part is None else part.added_to(world, effect_rng)
    return world


def _followed(settings, streams, worlds, states, engine):
    """Worlds and states in which those whose frames do not tell the motion are drawn again."""
    motion = settings.motion()
    can_overlap = any(isinstance(force, SoftContact) for force in motion.forces)
    for _ in range(_DRAWS):
        lost = [k for k, world in enumerate(worlds) if _is_lost(world, states, k, can_overlap)]
        if not lost:
            return worlds, states
        for k in lost:
            worlds[k] = _drawn(settings, streams[k])
        again = engine([worlds[k] for k in lost], motion)
        for name in ("positions", "velocities", "touched"):
            getattr(states, name)[lost] = getattr(again, name)
    raise SettingsError(
        f"scene {lost[0] + 1}: bodies met, or turned too fast for the frames, in all {_DRAWS} "
        "draws; more frames a second help, more room, or is_followed=no"
    )


def _is_lost(world, states, k, can_overlap):
    """Whether discs overlap between frames, or a velocity changes by more than its usual size."""
    moving = [i for i, entity in enumerate(world.entities) if not entity.is_static]
    p, v = states.positions[k][:, moving], states.velocities[k][:, moving]
    usual = np.sqrt((v**2).sum(axis=-1).mean(axis=0))
    if (np.linalg.norm(np.diff(v, axis=0), axis=-1) > usual).any():
        return True
    if can_overlap:
        return False
    radii = np.array([world.entities[i].radius or 0.0 for i in moving])
    for i, j in combinations(range(len(moving)), 2):
        apart = p[:, i] - p[:, j]
        step = np.diff(apart, axis=0)  # straight between frames
        along = -(apart[:-1] * step).sum(axis=-1) / np.maximum((step**2).sum(axis=-1), 1e-300)
        nearest = apart[:-1] + np.clip(along, 0, 1)[:, None] * step
        if (np.linalg.norm(nearest, axis=-1) < radii[i] + radii[j]).any():
            return True
    return False


def _observed(name, world, states: States, k, observation, rng):
    """What is seen of one world."""
    positions = states.positions[k].copy()
    moving = [i for i in world.seen if not world.entities[i].is_static]
    shape = (len(states.times), len(moving), 2)
    if observation.noise:
        positions[:, moving] += observation.errors(shape, rng)
    seen = world.seen
    return Scene(name, states.times, positions[:, seen], tuple(world.entities[i] for i in seen))


def _unsaid(settings):
    unsaid = [e.name for e in settings.effects if not all(f.laws for f in e.forces)]
    unsaid += [e.name for e in settings.effects if e.body is not None and e.body.is_hidden]
    if settings.contacts.has_contacts:
        unsaid.append("contacts")
    return tuple(dict.fromkeys(unsaid))


def _dataset(settings, scenes, names):
    n_train = int(np.ceil(settings.train_share * len(names))) if len(names) >= 5 else 0
    n_train = min(n_train, len(names) - 1)
    observation = settings.observation
    has_charge = any("charge" in e.properties for scene in scenes for e in scene.entities)
    made = f"{len(names)} scenes of {settings.name}, moved by a physics engine"
    return Dataset(
        settings.name, scenes, train=names[:n_train], test=names[n_train:] if n_train else (),
        units=UnitSystem.from_declared(_SI | ({"charge": "C"} if has_charge else {})),
        up=settings.up, noise=(observation.noise,) if observation.is_declared else None,
        provenance={"source": "made up", "description": made},
    )  # fmt: skip
