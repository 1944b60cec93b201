"""Scenes of stars, and of beads that are kicked: what goes with `close --declare nothing`."""

import math
from dataclasses import dataclass

import numpy as np

from bsp_gp.data.scene import Entity
from bsp_gp.simulate.forces import Drag, Kicks, PairForce
from bsp_gp.simulate.layouts import Layout, Range, polar, uniform
from bsp_gp.simulate.world import World

AU, SUN, NEWTON = 1.495978707e11, 1.98841e30, 6.6743e-11


@dataclass(frozen=True)
class Binary(Layout):
    """Two stars that go round each other.

    Parameters
    ----------
    mass : range, kg
        Of both together.
    share : range
        Of that, the first star's.
    half_axis : range, m
    eccentricity : range
    """

    mass: Range = (1 * SUN, 4 * SUN)
    share: Range = (0.5, 0.8)
    half_axis: Range = (4 * AU, 8 * AU)
    eccentricity: Range = (0.0, 0.5)
    positive = ("mass", "share", "half_axis")

    @property
    def forces(self):
        return (PairForce(NEWTON),)

    def draw(self, rng):
        mass, share = uniform(rng, self.mass), uniform(rng, self.share)
        half, e = uniform(rng, self.half_axis), uniform(rng, self.eccentricity)
        turn = uniform(rng, (0, 2 * math.pi))
        gap = polar(half * (1 + e), turn)
        speed = math.sqrt(NEWTON * mass / half * (1 - e) / (1 + e))
        moved = polar(speed, turn + math.pi / 2)
        parts = np.array([[share - 1.0], [share]])
        stars = [Entity(name, properties={"mass": mass * part})
                 for name, part in (("A", share), ("B", 1 - share))]  # fmt: skip
        return World(stars, parts * gap, parts * moved)


@dataclass(frozen=True)
class StarAboutUnseen(Binary):
    """A light star about a heavy one that nobody sees.

    Parameters
    ----------
    off : range, m
        How far the unseen star is from the origin.
    """

    share: Range = (1e-6, 1e-6)
    off: Range = (0.0, 4 * AU)
    is_declared = False

    def draw(self, rng):
        world = super().draw(rng)
        away = polar(uniform(rng, self.off), uniform(rng, (0, 2 * math.pi)))
        return World(world.entities, world.positions + away, world.velocities, frozenset({"B"}))


@dataclass(frozen=True)
class Beads(Layout):
    """Light beads in a gas, kicked by its molecules.

    Parameters
    ----------
    n_beads : int
    mass : float, kg
    drag_rate : float, 1/s
    temperature : float, K
    room : float, m
        Beads begin in a square of this side.
    """

    n_beads: int = 1
    mass: float = 1e-13
    drag_rate: float = 3.0
    temperature: float = 300.0
    room: float = 1e-3
    positive = ("n_beads", "mass", "drag_rate", "temperature", "room")
    is_declared = False

    @property
    def forces(self):
        drag = self.drag_rate * self.mass
        return Drag(drag), Kicks(self.temperature, drag)

    def draw(self, rng):
        speed = math.sqrt(Kicks.BOLTZMANN * self.temperature / self.mass)
        beads = [Entity(f"bead {k + 1}", properties={"mass": self.mass})
                 for k in range(self.n_beads)]  # fmt: skip
        places = self.room * (rng.random((self.n_beads, 2)) - 0.5)
        return World(beads, places, speed * rng.standard_normal((self.n_beads, 2)))
