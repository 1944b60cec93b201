"""Where a residual is and what it depends on: the answers to questions 2 and 3 of a round.

Everything is plain numbers and text, part of report.json. All ``low``/``high`` are 90 % intervals.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Carrier", "Channel", "Exponent", "Guidance", "Profile", "Segment", "Trace"]


@dataclass(frozen=True)
class Channel:
    """A direction in which the residual may act.

    Attributes
    ----------
    name : str
        In plain words: "along the velocity".
    kind : str
        axis | velocity | line | contact | region | point.
    share, low, high : float
        Part of the smooth residual's sum of squares, what noise would give taken off, that a
        free smooth push in this direction explains. Directions overlap, so shares may add up
        to more than one.
    freedom : int
        Constants of that push, all tracks together.
    evidence : float
        Gain in log-likelihood less the BIC penalty for these constants, nats.
    is_leading : bool
    inputs : tuple of str
        What a law in this direction names.
    place : tuple of float or None
        Of the unseen point, in the unit of length.
    """

    name: str
    kind: str
    share: float
    low: float
    high: float
    freedom: int
    evidence: float
    is_leading: bool = False
    inputs: tuple[str, ...] = ()
    place: tuple[float, ...] | None = None


@dataclass(frozen=True)
class Segment:
    """A part of the motion, and what a push that acts there alone explains.

    Attributes
    ----------
    name : str
        in contact | over a region | near another body | free flight.
    n_rows : int
    share, low, high : float
        As of a channel, any direction.
    """

    name: str
    n_rows: int
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Carrier:
    """An entity or a scene, and its part of the residual's sum of squares above noise."""

    name: str
    share: float
    low: float
    high: float


@dataclass(frozen=True)
class Profile:
    """Size of the residual acceleration along a channel against a quantity, free of any law.

    Attributes
    ----------
    x, y, error : tuple of float
        Nodes of a piecewise linear function, its values and standard errors.
    law_x, law_y : tuple of float
        The power law through it.
    """

    x: tuple[float, ...]
    y: tuple[float, ...]
    error: tuple[float, ...]
    law_x: tuple[float, ...]
    law_y: tuple[float, ...]


@dataclass(frozen=True)
class Exponent:
    """How the size of the residual in a channel scales with a quantity: c x^p.

    Attributes
    ----------
    channel : str
    variable : str
        speed, distance, time, or a property with its role: m_i, q_j.
    value, low, high : float
        nan where it is not determined.
    is_determined : bool
    reason : str
        Why it is not determined, or what to bear in mind; "".
    beside : tuple of str
        Quantities whose exponents were free as well.
    of_force : bool
        Whether it is that of a force (of an acceleration where masses are unknown).
    share : float
        Of the channel's own sum of squares that the power law explains.
    unit, size_unit : str
        Of the quantity, and of the acceleration.
    profile : Profile or None
    """

    channel: str
    variable: str
    value: float
    low: float
    high: float
    is_determined: bool
    reason: str = ""
    beside: tuple[str, ...] = ()
    of_force: bool = True
    share: float = float("nan")
    unit: str = ""
    size_unit: str = ""
    profile: Profile | None = None


@dataclass(frozen=True)
class Trace:
    """Where the residual of a round is, and what it depends on.

    Attributes
    ----------
    channels : tuple of Channel
        Best first.
    segments : tuple of Segment
    entities, scenes : tuple of Carrier
        Largest part first.
    exponents : tuple of Exponent
        Of the leading channels.
    method : str
        How intervals were found.
    snr : float
        Sum of squares of the smooth residual over its expectation under noise.
    notes : tuple of str
    """

    channels: tuple[Channel, ...]
    segments: tuple[Segment, ...]
    entities: tuple[Carrier, ...]
    scenes: tuple[Carrier, ...]
    exponents: tuple[Exponent, ...]
    method: str
    snr: float
    notes: tuple[str, ...] = ()

    @property
    def leading(self):
        """The leading channels."""
        return tuple(c for c in self.channels if c.is_leading)


@dataclass(frozen=True)
class Guidance:
    """How the trace was used in the search of its round.

    Attributes
    ----------
    used : str
        off | order | restrict.
    left_out : tuple of str
        Inputs that the leading channels do not speak of: not searched under "restrict", laws
        that name them after the others under "order".
    note : str
    """

    used: str
    left_out: tuple[str, ...] = ()
    note: str = ""
