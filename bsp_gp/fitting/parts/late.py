"""Logs that are late: what was logged at one instant acts, or was filmed, at another."""

from dataclasses import dataclass, replace

from bsp_gp.fitting.hypothesis import Parameter, Part
from bsp_gp.units import SECOND


@dataclass(frozen=True)
class Late(Part):
    """Measured inputs that act later than they were logged, all by one delay.

    Attributes
    ----------
    limit : float, s
        The largest delay that is believed; a negative one is that of the tracks.
    value : float, s
        Where a fit begins.
    """

    inputs: tuple
    limit: float
    value: float = 0.0
    kind = "log"

    @property
    def names(self):
        return ("_".join(("delay", *self.inputs)),)

    @property
    def parameters(self):
        return (Parameter(*self.names, "", SECOND, -self.limit, self.limit, self.value),)

    def at(self, values):
        """The part at another delay, mapping of name to number."""
        return replace(self, value=float(values[self.names[0]]))

    def describe(self):
        (name,) = self.names
        return ", ".join(f"{each} acts as logged at t - {name}" for each in self.inputs)
