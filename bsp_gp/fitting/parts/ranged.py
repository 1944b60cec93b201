"""Forces with constants inside, each with the range in which the data can show it."""

from dataclasses import dataclass, replace

from bsp_gp.fitting.hypothesis import Forces


@dataclass(frozen=True)
class RangedForces(Forces):
    """Forces some of whose constants have bounds and priors, `ranges`, by name."""

    ranges: tuple = ()

    @property
    def parameters(self):
        """The constants of the law, within their ranges."""
        known = {p.name: p for p in self.ranges}
        return tuple(
            replace(p, low=known[p.name].low, high=known[p.name].high, prior=known[p.name].prior)
            if p.name in known else p
            for p in super().parameters
        )  # fmt: skip
