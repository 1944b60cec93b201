"""Constants as a fit sees them: a strength that stands beside a power is told at a typical base.

In ``k * norm(r)^n`` the strength k changes by the factor norm(r) when n changes by one: with metres
and the distances of planets by 1e11. The fit's own unknown is k * s^n with s the median of the base
over the data (DESIGN §1 point 3 of fits: "distances scaled by their median").
"""

import numpy as np

from bsp_gp.language.formula import Call, Constant, factors, walk


def powers_of(formula):
    """Powers with a fitted exponent in a term: (base, name of the exponent, sign).

    Exponents are a plain constant or its negative.
    """
    above, below = factors(formula)
    found = []
    for side, sign in ((above, 1.0), (below, -1.0)):
        for node in side:
            if isinstance(node, Call) and node.operator == "pow":
                base, exponent = node.args
                if isinstance(exponent, Constant):
                    found.append((base, exponent.name, sign))
                elif (
                    isinstance(exponent, Call)
                    and exponent.operator == "neg"
                    and isinstance(exponent.args[0], Constant)
                ):
                    found.append((base, exponent.args[0].name, -sign))
    return found


def strength_of(formula):
    """Name of the first constant that is a plain factor above and occurs nowhere else, or None."""
    above, _ = factors(formula)
    for node in above:
        if isinstance(node, Constant):
            count = sum(isinstance(n, Constant) and n.name == node.name for n in walk(formula))
            if count == 1:
                return node.name
    return None


class Coordinates:
    """Between the unknowns u of a fit and the constants of a law.

    `bases` has a typical value of every base of a fitted power, by formula.
    """

    def __init__(self, law, parameters, bases):
        names = [name for name, _ in parameters]
        self.n = len(names)
        self._rules = []
        for term in law.terms:
            strength = strength_of(term.formula)
            if strength is None or sum(strength in t.formula.constants for t in law.terms) > 1:
                continue
            powers = [
                (names.index(exponent), sign * np.log(bases[base]))
                for base, exponent, sign in powers_of(term.formula)
                if exponent in names and bases.get(base, 0.0) > 0
            ]
            rows = [k for k, name in enumerate(names) if name == strength]
            if powers and rows:
                self._rules.append((rows, powers))

    def constants(self, unknowns):
        """Constants, and their derivatives by the unknowns, shapes (k,) and (k, k)."""
        constants, slopes = np.array(unknowns, dtype=float), np.eye(self.n)
        for rows, powers in self._rules:
            with np.errstate(all="ignore"):  # what runs away is refused by the driver
                factor = np.exp(-sum(unknowns[k] * size for k, size in powers))
                for row in rows:
                    constants[row] = unknowns[row] * factor
                    slopes[row, row] = factor
                    for k, size in powers:
                        slopes[row, k] -= constants[row] * size
        return constants, slopes

    def unknowns(self, constants):
        unknowns = np.array(constants, dtype=float)
        for rows, powers in self._rules:
            with np.errstate(all="ignore"):
                factor = np.exp(sum(unknowns[k] * size for k, size in powers))
                unknowns[rows] = unknowns[rows] * factor
        return unknowns
