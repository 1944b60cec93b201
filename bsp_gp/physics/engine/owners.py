"""Whose constant is whose: one for all, one of every body or scene, or a property of some bodies.

A property that is fitted (`bsp_gp.fitting.parts.latents`) is a constant named after its input,
``mass_i`` or ``mass_j``; its values and parameters are those of its bodies, here put in rows.
"""

import numpy as np

from bsp_gp.language.inputs import property_of
from bsp_gp.physics.force import entry, key_of


def fitted_properties(law):
    """Columns of properties that are fitted, tuple of str."""
    parts = [part for part in law.frame if part.kind == "world"]
    return tuple(dict.fromkeys(column for part in parts for column in part.columns))


class Owners:
    """Constants of a law in rows of receivers and sources, `others` (R, J), of some chains."""

    def __init__(self, law, chains, parameters, others):
        self.chains, self.others = chains, others
        self._number = {pair: k for k, pair in enumerate(parameters)}
        self._members = {column: self._members_of(law, column) for column in fitted_properties(law)}

    def _members_of(self, law, column):
        """Names of the numbers that bodies have as a property, (N, S); "" = it is known."""
        chains = self.chains
        found = {}
        for part in law.frame:
            if part.kind == "world":
                found |= {at: name for own, at, name in part.places if own == column}
        return np.array([
            [found.get(key_of((scene, name), found), "") for name in (*own, *driven)]
            for scene, own, driven in zip(chains.scenes, chains.bodies, chains.fixed, strict=True)
        ], dtype=object).T  # fmt: skip

    def values(self, name, known, kind):
        """Values of a constant, a number or an array (R, S), of pairs (R, J or 1, S)."""
        column, role = property_of(name) or ("", "")
        if column in self._members:
            members, table = self._members[column], np.array(self.chains.column(column))
            for number in set(members.ravel()) - {""}:
                table[members == number] = known[number]
            return self._shaped(np.where(np.isnan(table), 1.0, table), role, kind)
        value = known[name]
        if not hasattr(value, "items"):
            return np.asarray(value, dtype=float)[()]
        table = [[entry(name, value, body, scene) for body in own] for scene, own in self._rows]
        return self._shaped(np.array(table, dtype=float).T, "i", kind)

    def parameter(self, name, kind):
        """Which parameter it is, a number, or an array as of `values`; -1 = none."""
        column, role = property_of(name) or ("", "")
        if column in self._members:
            members = self._members[column]
            table = np.vectorize(lambda n: self._number.get((n, ""), -1), otypes=[int])(members)
            return self._shaped(table, role, kind)
        if (name, "") in self._number:
            return self._number[name, ""]
        mine = {entity: k for (own, entity), k in self._number.items() if own == name}
        table = [[_place(name, mine, body, scene) for body in own] for scene, own in self._rows]
        return self._shaped(np.array(table, dtype=int).T, "i", kind) if mine else -1

    @property
    def _rows(self):
        return zip(self.chains.scenes, self.chains.bodies, strict=True)

    def _shaped(self, table, role, kind):
        """Rows of bodies (N or R, S) as a law of some kind has them."""
        if role == "j":
            return table[self.others]
        own = table[: self.chains.n_moving]
        return own if kind == "field" else own[:, None]


def _place(name, mine, body, scene):
    """The parameter of a body or scene."""
    return mine.get(key_of(scene if name.endswith("[scene]") else body, mine), -1)
