"""Properties of bodies that are unknown: masses, charges, frictions, fitted with their priors."""

from dataclasses import dataclass, replace

from bsp_gp.fitting.hypothesis import Parameter, Valued
from bsp_gp.physics.force import key_of


@dataclass(frozen=True)
class About:
    """A normal prior, where little is seen: what is likeliest is then near what is expected."""

    mean: float
    spread: float
    is_logarithmic = False

    @property
    def pull(self):
        return self.mean, self.spread


@dataclass(frozen=True)
class Properties(Valued):
    """Unknown properties.

    Attributes
    ----------
    latents : Latents
        Of `bsp_gp.inference.latents`: which bodies of which scenes, and with which priors.
    units : tuple of (str, Unit or None)
        Of every column.
    values : tuple of float
        Where a fit begins; none = at the medians of the priors.
    others : Latents or None
        Of bodies that the fitted scenes do not show.
    is_little_seen : bool
        Whether priors pull as normal ones do.
    is_absolute : bool
        Whether the numbers are of SI, though the data do not say in what theirs are.
    """

    latents: object
    units: tuple
    values: tuple = ()
    others: object = None
    is_little_seen: bool = False
    is_absolute: bool = False
    kind = "world"

    @property
    def names(self):
        return self.latents.names

    @property
    def columns(self):
        return self.latents.columns

    @property
    def places(self):
        """Which bodies have which number: (column, (scene, entity), name) each."""
        return [(i.column, member, i.name) for i in self.latents.items for member in i.members]

    @property
    def starts(self):
        return self.values or tuple(float(item.prior.ppf(0.5)) for item in self.latents.items)

    @property
    def parameters(self):
        units, out = dict(self.units), []
        for item, start in zip(self.latents.items, self.starts, strict=True):
            prior, ends = item.prior, (float(item.prior.low), float(item.prior.high))
            if self.is_little_seen:
                prior = About(start, Parameter("", prior=prior).width(start))
            out.append(Parameter(item.name, "", units[item.column], *ends, start, prior))
        return tuple(out)

    def off_bounds(self):
        """The part with what stands at a bound back at the middle of its prior.

        A law that lacks something bends properties to hide it.
        """
        values = tuple(
            value if item.prior.low < value < item.prior.high else float(item.prior.ppf(0.5))
            for item, value in zip(self.latents.items, self.starts, strict=True)
        )
        return replace(self, values=values)

    def filled(self, scenes):
        """The scenes with the properties where a fit begins."""
        return self.latents.filled(scenes, self.starts)

    def seen(self, dataset):
        return replace(dataset, scenes=self.filled(dataset.scenes))

    def describe(self):
        return "unknown " + ", ".join(self.names)


def unknown_properties(dataset, latents, scenes):
    """The unknowns of bodies that some scenes of a data set show, for all its scenes."""
    mine = set(latents.of_scenes([scene.name for scene in scenes])[1].tolist())
    shown = tuple(item for k, item in enumerate(latents.items) if k in mine)
    others = tuple(item for k, item in enumerate(latents.items) if k not in mine)
    units = tuple((column, dataset.property_units.get(column)) for column in latents.columns)
    return Properties(replace(latents, items=shown), units, (), replace(latents, items=others))


def unknown_beyond(law, scenes):
    """The unknowns of scenes that a law was not fitted to, of copies one by one; () or one part."""
    parts = []
    for part in law.frame:
        if part.kind != "world" or part.others is None:
            continue
        found, names = {}, {scene for item in part.others.items for scene, _ in item.members}
        for scene in scenes:
            known = key_of(scene.name, names)
            for item in part.others.items:
                members = [(scene.name, body) for own, body in item.members if own == known]
                if members:
                    found.setdefault((item, scene.name[len(known) :]), []).extend(members)
        items = tuple(
            replace(item, name=item.name + copy, members=tuple(members))
            for (item, copy), members in found.items()
        )
        if items:
            latents = replace(part.latents, items=items)
            parts.append(Properties(latents, part.units, is_little_seen=True))
    return tuple(parts)


def filled(law, scenes):
    """Scenes with the properties that a law was fitted with."""
    for part in law.frame:
        if part.kind == "world":
            scenes = part.at(law.constants).filled(scenes)
    return tuple(scenes)
