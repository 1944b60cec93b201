"""Contacts that nobody declared: the velocity of a body jumps at one instant."""

from dataclasses import dataclass, replace

from bsp_gp.fitting.hypothesis import Forces
from bsp_gp.language.formula import Call, Constant, Input, Number
from bsp_gp.language.impulse import impulse
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.operators import Type
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.units import KILOGRAM, SECOND


@dataclass(frozen=True)
class Kick(Forces):
    """A velocity that one body gains at one instant of one scene.

    A push of constant strength and very short duration about that instant, so that derivatives by
    the instant follow from the jumps of the forces like those of any threshold.

    Attributes
    ----------
    mark : str
        Property that is 1 of this body in this scene, and that no other has.
    span : tuple of float, s
        Within which it lies.
    """

    scene: str = ""
    entity: str = ""
    mark: str = ""
    instant: str = ""
    span: tuple = ()

    @classmethod
    def of(cls, scene, entity, mark, gains, instant, values, span, duration):
        """The kick with its terms.

        Parameters
        ----------
        gains : mapping of str to str
            Axis -> name of the component of the velocity that is gained.
        values : mapping of str to float
            Where a fit begins, by name.
        duration : float, s
        """
        time = Input("t", STATE_INPUTS["t"])
        since = Call("sub", time, Constant(instant))
        rate = impulse(since, Number(float(f"{duration:.3g}"), SECOND))
        mass = Input("m_i", Type("scalar", KILOGRAM))
        own = Call("mul", mass, Input(f"{mark}_i", Type("scalar")))
        terms = []
        for axis, name in gains.items():
            size = Call("mul", Constant(name), Call("mul", own, rate))
            terms.append(Term(Call("mul", size, Input(f"e_{axis}", Type("vector"))), "field"))
        law = ForceLaw(tuple(terms), values)
        return cls(law, None, scene, entity, mark, instant, tuple(map(float, span)))

    @property
    def parameters(self):
        """The instant, within the scene, and the velocity."""
        low, high = self.span
        about = {"low": low, "high": high, "prior": ((low + high) / 2, (high - low) / 2)}
        return tuple(
            replace(p, unit=SECOND, **about) if p.name == self.instant else p
            for p in super().parameters
        )

    def seen(self, dataset):
        """The rows, with the mark on the body."""
        scenes = tuple(
            replace(s, entities=tuple(map(self._marked, s.entities))) if s.name == self.scene else s
            for s in dataset.scenes
        )
        return replace(dataset, scenes=scenes)

    def _marked(self, entity):
        if entity.name != self.entity:
            return entity
        return replace(entity, properties={**entity.properties, self.mark: 1.0})


def kicks_text(kicks):
    """Kicks as the text of a cause, of body, scene and instant each."""
    where = ", ".join(f"{body}[{scene}, {time:.4g} s]" for body, scene, time in kicks)
    return f"kick {where}"
