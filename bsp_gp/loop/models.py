"""Fitted laws: the model that a round starts from, and attempts at a better one."""

from __future__ import annotations

from dataclasses import dataclass, field

from bsp_gp.language.inputs import property_of
from bsp_gp.physics.force import ForceLaw

__all__ = ["Attempt", "Model", "is_property"]


@dataclass(frozen=True, eq=False)
class Model:
    """A law fitted to the training data with its errors on held-out data."""

    law: ForceLaw
    fit: object
    errors: object
    rows: list


@dataclass(frozen=True, eq=False)
class Attempt:
    """A proposal fitted jointly with the rest of the law.

    Attributes
    ----------
    law : ForceLaw
    fit : Fit
    complexity : float
    name, text : str
    ties : tuple of str
    share : float
    kind : str
    reason : str
        Why it cannot be adopted; "" if it can.
    replaces : tuple of str
        Terms of the law before that it does without.
    equivalents : tuple of str
        Sets of terms that these data cannot tell from it.
    redoes_declared : bool
        Whether it only changes the number of a declared term.
    freed : tuple of str
        Further constants that belong to it: not linear ones, and those added to a declared term.
    p_value : float
        With its own selection counted, where it is no law of the search; else nan.
    n_effects : int
        Common effects that it says are there at once.
    """

    law: ForceLaw
    fit: object
    complexity: float
    name: str
    text: str
    latex: str
    kind: str
    share: float = float("nan")
    ties: tuple = ()
    reason: str = ""
    replaces: tuple = ()
    equivalents: tuple = field(default=())
    redoes_declared: bool = False
    freed: tuple = ()
    p_value: float = float("nan")
    n_effects: int = 1

    def score(self, n_effective):
        """BIC plus twice the complexity (the prior of the grammar)."""
        return self.fit.bic(n_effective) + 2 * self.complexity


def is_property(formula):
    """Whether a factor depends on properties of bodies only."""
    return (
        bool(formula.inputs)
        and all(property_of(n) for n in formula.inputs)
        and not formula.constants
    )
