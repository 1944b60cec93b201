"""Which numbers are unknown, who shares them, and how drawn values get into scenes.

A latent belongs to one property of one or several entities. With ``share = "entity"`` every row of
``entities.csv`` has its own value: an entity listed without a scene is one body in all scenes.
"""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import DataError, SettingsError
from bsp_gp.inference.priors import Prior, prior_of
from bsp_gp.physics.force import key_of


@dataclass(frozen=True)
class Latent:
    """One unknown number.

    Attributes
    ----------
    name : str
        ``mass[scene:entity]``, ``mass[entity]`` if one body is in several scenes, ``mass`` if
        all share it.
    column : str
        The property.
    members : tuple of (str, str)
        Scene and entity names that have this value; "" for a scene is every one.
    truth : float
        A recorded value, nan if there is none; serves scoring only.
    """

    name: str
    column: str
    prior: Prior
    members: tuple
    truth: float = math.nan


@dataclass(frozen=True)
class Latents:
    """All unknowns of some scenes, in a fixed order."""

    items: tuple[Latent, ...] = ()
    names: tuple[str, ...] = field(init=False)

    def __post_init__(self):
        object.__setattr__(self, "items", tuple(self.items))
        object.__setattr__(self, "names", tuple(item.name for item in self.items))
        if len(set(self.names)) < len(self.names):
            raise SettingsError(f"two latents have one name: {self.names}")

    def __len__(self):
        return len(self.items)

    @property
    def columns(self):
        """Names of the properties that are unknown somewhere, sorted."""
        return tuple(sorted({item.column for item in self.items}))

    @property
    def truth(self):
        """Recorded values, shape (k,); nan where there is none."""
        return np.array([item.truth for item in self.items], dtype=float)

    @property
    def is_discrete(self):
        """Mask of the discrete ones, shape (k,)."""
        return np.array([item.prior.is_discrete for item in self.items], dtype=bool)

    def of_priors(self, name):
        """A number of every prior, shape (k,), or two, (k, 2): its spread, bounds or pull."""
        found = np.array([getattr(item.prior, name) for item in self.items], dtype=float)
        return found if len(found) or name == "spread" else found.reshape(0, 2)

    @property
    def medians(self):
        """Of the priors, shape (k,)."""
        return np.array([float(item.prior.ppf(0.5)) for item in self.items])

    def of_scenes(self, names):
        """The latents that occur in these scenes, with memberships cut to them.

        Returns
        -------
        latents : Latents
        index : ndarray of int
            Their places among all.
        """
        names = set(names)
        items, index = [], []
        for k, item in enumerate(self.items):
            members = tuple(m for m in item.members if m[0] in names)
            if members:
                items.append(replace(item, members=members))
                index.append(k)
        return Latents(tuple(items)), np.array(index, dtype=int)

    def blocks(self, scene_names):
        """Groups of scenes that share latents: their posteriors are independent given the law.

        Returns
        -------
        list of (tuple of scene names, ndarray of latent indices)
        """
        root = {name: name for name in scene_names}

        def find(name):
            while root[name] != name:
                name = root[name]
            return name

        for item in self.items:
            scenes = [s for s, _ in item.members if s in root]
            for other in scenes[1:]:
                root[find(other)] = find(scenes[0])
        groups = {}
        for name in scene_names:
            groups.setdefault(find(name), []).append(name)
        return [(tuple(group), self.of_scenes(group)[1]) for group in groups.values()]

    # --- prior -----------------------------------------------------------------------------------

    def sample(self, n_draws, *, rng):
        """Independent draws from the prior, shape (n_draws, k)."""
        columns = [item.prior.sample(n_draws, rng=rng) for item in self.items]
        return np.stack(columns, axis=1) if columns else np.zeros((n_draws, 0))

    def log_prior(self, values):
        """Log prior density of values (..., k), shape (...)."""
        values = np.asarray(values, dtype=float)
        total = np.zeros(values.shape[:-1])
        for prior, index in self._by_prior().items():
            total = total + prior.log_prob(values[..., index]).sum(axis=-1)
        return total

    def _by_prior(self):
        if "_groups" not in self.__dict__:
            groups = {}
            for k, item in enumerate(self.items):
                groups.setdefault(item.prior, []).append(k)
            object.__setattr__(self, "_groups", {p: np.array(i) for p, i in groups.items()})
        return self._groups

    def to_coordinate(self, values):
        """Values (..., k) -> coordinates of their priors."""
        out = np.array(values, dtype=float)
        for k, item in enumerate(self.items):
            if item.prior.is_logarithmic:
                out[..., k] = np.log(out[..., k])
        return out

    def from_coordinate(self, coordinates):
        """Coordinates (..., k) -> values."""
        out = np.array(coordinates, dtype=float)
        for k, item in enumerate(self.items):
            if item.prior.is_logarithmic:
                with np.errstate(over="ignore"):  # infinite: outside of every prior
                    out[..., k] = np.exp(out[..., k])
        return out

    def log_jacobian(self, coordinates):
        """Log |d value / d coordinate|, shape (...): density of coordinates = prior times this."""
        total = np.zeros(np.shape(coordinates)[:-1])
        for k, item in enumerate(self.items):
            if item.prior.is_logarithmic:
                total = total + np.asarray(coordinates)[..., k]
        return total

    # --- values into scenes ----------------------------------------------------------------------

    def filled(self, scenes, values):
        """The scenes with the unknown properties set to one draw, values (k,)."""
        changes = {}
        for item, value in zip(self.items, values, strict=True):
            for scene, entity in item.members:
                changes.setdefault((scene, entity), {})[item.column] = float(value)

        def changed(scene, entity):
            return with_properties(entity, changes.get(key_of((scene.name, entity.name), changes)))

        return tuple(
            replace(scene, entities=tuple(changed(scene, entity) for entity in scene.entities))
            for scene in scenes
        )


def with_properties(entity, changes):
    """The entity with some properties (or its radius) changed."""
    if not changes:
        return entity
    rest = {k: v for k, v in changes.items() if k != "radius"}
    radius = changes.get("radius", entity.radius)
    return replace(entity, radius=radius, properties={**entity.properties, **rest})


class PropertyTable:
    """Property columns of stacked scenes for many draws of the latents at once.

    Parameters
    ----------
    bodies : Bodies
        S stacked scenes with N entities.
    scene_names : sequence of str, length S
    """

    def __init__(self, bodies, scene_names, latents):
        self.bodies = bodies
        self.places = {}
        for k, item in enumerate(latents.items):
            for scene, entity in item.members:
                if scene in scene_names:
                    s = scene_names.index(scene)
                    n = bodies.names[s].index(entity)
                    self.places.setdefault(item.column, []).append((s, n, k))
        self.places = {c: np.array(p).T for c, p in self.places.items()}

    def columns(self, values):
        """Column -> array (W, S, N) for values (W, k)."""
        out = {}
        for column, (s, n, k) in self.places.items():
            base = self.bodies.column(column)
            full = np.repeat(base[None], len(values), axis=0)
            full[:, s, n] = values[:, k]
            out[column] = full
        return out

    def inputs(self, kind, values):
        """Lookup of property inputs for a law of this kind.

        Returns
        -------
        callable
            ``lookup(name)``: array (W or 1, S, R, J or 1), J sources for pair laws, 1 for fields.
        """
        from bsp_gp.language.inputs import property_of

        bodies = self.bodies
        changed = self.columns(values)

        def lookup(name):
            column, role = property_of(name)
            array = changed.get(column)
            array = bodies.column(column)[None] if array is None else array
            if role == "i":
                return array[:, :, bodies.receivers, None]
            if kind == "field":
                raise SettingsError("a field law acts on i alone and cannot name a source j")
            return array[:, :, bodies.others]

        return lookup


# --- making latents -------------------------------------------------------------------------------


def declared_latents(dataset, scenes=None):
    """Latents of a data set as its ``[latent.*]`` tables declare them.

    Parameters
    ----------
    dataset : Dataset
    scenes : sequence of Scene, optional
        By default all of them.

    Raises
    ------
    SettingsError
        If nothing is declared.
    """
    scenes = dataset.scenes if scenes is None else scenes
    if not dataset.latents:
        raise SettingsError(
            "nothing declares anything latent; write [latent.mass] with a prior in dataset.toml, "
            "or --prior on the command line"
        )
    items = []
    for declared in dataset.latents:
        items += latents_of(
            scenes, declared.name, prior_of(declared), entities=declared.entities or None,
            share=declared.share,
        ).items  # fmt: skip
    return Latents(tuple(items))


def latents_of_bodies(names, column, prior):
    """One number for each of some bodies, in whichever scenes they are."""
    return Latents(
        tuple(Latent(f"{column}[{name}]", column, prior, (("", name),)) for name in names)
    )


def latents_of(scenes, column, prior, *, entities=None, share="entity"):
    """Declare a property unknown in code.

    Parameters
    ----------
    scenes : sequence of Scene
    column : str
        Name of the property.
    prior : Prior
    entities : sequence of str, or callable, optional
        Names of the entities, or ``entities(scene, entity) -> bool``. By default those without a
        value, or, where all have one, all dynamic ones.
    share : str
        "entity": every row of ``entities.csv`` has a value of its own, in all scenes in which it
        occurs; "all": one value for all; a column: one value per value of that property.

    Returns
    -------
    Latents

    Raises
    ------
    DataError
        If no entity is meant.
    """
    chosen = _chosen(scenes, column, entities)
    if not chosen:
        raise DataError(f"latent {column!r} concerns no entity of these scenes")
    groups = {}
    for scene, entity in chosen:
        groups.setdefault(_group(entity, share, column), []).append((scene.name, entity))
    items = []
    for key, members in groups.items():
        names = tuple((s, e.name) for s, e in members)
        known = {_value(e, column) for _, e in members} - {None}
        items.append(
            Latent(
                _label(column, share, key, names),
                column,
                prior,
                names,
                known.pop() if len(known) == 1 else math.nan,
            )
        )
    return Latents(tuple(items))


def _chosen(scenes, column, entities):
    everyone = [(scene, entity) for scene in scenes for entity in scene.entities]
    if callable(entities):
        return [(s, e) for s, e in everyone if entities(s, e)]
    if entities:
        return [(s, e) for s, e in everyone if e.name in set(entities)]
    unknown = [
        (s, e)
        for s, e in everyone
        if _value(e, column) is None and (not e.is_static or column != "mass")
    ]
    return unknown or [(s, e) for s, e in everyone if not e.is_static]


def _value(entity, column):
    value = entity.radius if column == "radius" else entity.properties.get(column, math.nan)
    return float(value) if np.ndim(value) == 0 and math.isfinite(value) else None


def _group(entity, share, column):
    if share == "all":
        return ""
    if share == "entity":
        return id(entity)  # one object = one row of entities.csv
    value = entity.properties.get(share)
    if value is None or np.ndim(value) or not math.isfinite(value):
        raise DataError(
            f"latent {column!r} is shared by {share!r}, which entity {entity.name!r} has no value "
            "of",
            remedy=f"fill in the column {share}, or share by entity",
        )
    return float(value)


def _label(column, share, key, names):
    if share == "all":
        return column
    if share != "entity":
        return f"{column}[{share}={key:g}]"
    scene, entity = names[0]
    return f"{column}[{scene}:{entity}]" if len(names) == 1 else f"{column}[{entity}]"
