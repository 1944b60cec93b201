"""What the data cannot tell apart: combinations of latents and constants that they leave free.

The paper's appendix A.4 names the problem: only products such as c1 * mu enter the motion, so that
a larger constant with smaller properties fits as well. Found twice: by the Fisher information at
the joint optimum, in logarithms (a free direction is then a product of powers), and by the
correlations of the posterior.
"""

from dataclasses import dataclass

import numpy as np

FREE = 1.0
"""Information (in units of the prior's) below which the data add nothing to a direction."""
WEAK = 10.0
"""Information below which most of what is known of a direction is the prior."""
MEMBER = 0.15
"""Names whose share of a direction is below this part of the largest are not named."""
STRONG = 0.95
"""Correlation above which two names are reported as a pair."""
FLAT_PRIOR = 1.0
"""Width given to the logarithm of a constant, which has no prior: a factor of e."""


@dataclass(frozen=True, eq=False)
class FreeDirection:
    """A combination that the data leave open.

    Attributes
    ----------
    powers : tuple of float
        Multiply every name by t to its power: the fit does not change.
    information : float
        Of the data along the direction, in units of the prior's; below 1 they add nothing.
    """

    names: tuple[str, ...]
    powers: tuple[float, ...]
    information: float
    text: str
    remedy: str


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What is known, what is not, and what would help.

    Attributes
    ----------
    gain : ndarray
        1 - (posterior sd / prior sd)^2 of every latent: 0 nothing learnt, 1 all; nan for constants.
    directions : tuple of FreeDirection
        Least determined first.
    pairs : tuple of (str, str, float)
        Strongly correlated names of the posterior.
    """

    names: tuple[str, ...]
    gain: np.ndarray
    directions: tuple[FreeDirection, ...]
    pairs: tuple

    def text(self):
        """Sentences for a report; one that says so if everything is determined."""
        lines = [f"{direction.text}; {direction.remedy}" for direction in self.directions]
        for a, b, value in self.pairs:
            lines.append(f"{a} and {b} are correlated ({value:+.3f}): one fixes the other")
        return "\n".join(lines) or "every unknown is determined by the data beyond its prior"


def identifiability(profile, latents, posterior=None):
    """Find combinations of latents and constants that the data do not determine.

    Parameters
    ----------
    profile : Profile
        Joint optimum of latents and constants.
    latents : Latents
        In the order of the profile.
    posterior : Posterior, optional
        Of the latents, or of latents and constants, for correlations and gains.
    """
    k = len(latents)
    law = profile.law
    constants = [n for n in law.names if not hasattr(law.constants[n], "items")]
    names = (*latents.names, *constants[: len(profile.constants)])
    directions = _directions(profile, latents, names, k)
    gain = np.full(len(names), np.nan)
    pairs = ()
    if posterior is not None:
        place = {name: i for i, name in enumerate(posterior.names)}
        for i, item in enumerate(latents.items):
            if item.name in place:
                prior_sd = _prior_sd(item.prior)
                gain[i] = 1 - (posterior.sd[place[item.name]] / prior_sd) ** 2
        pairs = tuple(_pairs(posterior))
    return Identifiability(names, gain, tuple(directions), pairs)


def _directions(profile, latents, names, k):
    values = np.concatenate([profile.values, profile.constants])
    live = np.abs(values) > 0
    # d coordinate / d log value: 1 for a logarithmic coordinate, the value itself otherwise.
    slope = np.where(live, values, 1.0)
    for i, item in enumerate(latents.items):
        if item.prior.is_logarithmic:
            slope[i] = 1.0
    widths = np.concatenate([latents.of_priors("spread"), np.zeros(len(names) - k)])
    width = np.where(np.arange(len(names)) < k, np.minimum(widths / np.abs(slope), 3.0), FLAT_PRIOR)
    jacobian = profile.jacobian * slope * width
    information, vectors = np.linalg.eigh(jacobian.T @ jacobian)
    for value, vector in zip(information, vectors.T, strict=True):
        if value > WEAK:
            break
        powers = vector * width
        powers = powers / powers[np.argmax(np.abs(powers))]
        members = np.flatnonzero(np.abs(powers) > MEMBER)
        yield _direction(
            tuple(names[i] for i in members), tuple(float(powers[i]) for i in members),
            max(float(value), 0.0), members, k,
        )  # fmt: skip


def _direction(names, powers, information, members, k):
    strength = "the data do not determine" if information < FREE else "the data hardly determine"
    if len(names) == 1:
        return FreeDirection(
            names, powers, information, f"{strength} {names[0]}",
            "record a motion in which it matters: let the body meet others, closer or longer",
        )  # fmt: skip
    together = ", ".join(
        f"{name} by t" + ("" if abs(power - 1) < 0.05 else f"^{power:.2g}")
        for name, power in zip(names, powers, strict=True)
    )
    has_constant = any(i >= k for i in members)
    remedy = (
        "measure one of these properties (a reference body), or give the constant"
        if has_constant
        else "measure one of these properties, or add a body of known value to the scene"
    )
    return FreeDirection(
        names, powers, information,
        f"{strength} a common factor: multiplying {together} changes "
        f"{'nothing' if information < FREE else 'little'} that was measured",
        remedy,
    )  # fmt: skip


def _prior_sd(prior):
    if prior.is_discrete:
        return float(np.std(prior.values)) or 1.0
    return float(prior.distribution().std())


def _pairs(posterior):
    matrix = posterior.correlation()
    for a in range(len(matrix)):
        for b in range(a + 1, len(matrix)):
            if abs(matrix[a, b]) > STRONG:
                yield posterior.names[a], posterior.names[b], float(matrix[a, b])
