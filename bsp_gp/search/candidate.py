"""What a search returns: candidates, and a result with its front, ties and certificate."""

from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.language.render import to_text


@dataclass(frozen=True)
class Candidate:
    """One law with its best constant.

    Attributes
    ----------
    formula : Formula
        With its free constant(s).
    kind : str
        "pair" or "field".
    constants : dict of str to float, or to a dict of entity name to float
    loss : float
        Half the whitened residual sum of squares after a joint refit: the negative
        log-likelihood up to a constant, in nats.
    complexity : float
        -log p under the uniform PCFG of the grammar, in nats.
    gain : float
        Whitened sum of squares that the term explains, of `total`.
    total : float
        Whitened sum of squares before the term.
    expression : Expression or None
    ties : tuple of Formula
        Other laws equal on these data, simplest first.
    """

    formula: object
    kind: str
    constants: dict
    loss: float
    complexity: float
    gain: float
    total: float
    expression: object = None
    ties: tuple = ()

    @property
    def share(self):
        """Part of the sum of squares that the term explains, 0 to 1."""
        return self.gain / self.total if self.total else 0.0


@dataclass(frozen=True)
class Certificate:
    """What an exhaustive search guarantees.

    Attributes
    ----------
    n_derivations : int
        Derivations within the bound, masked rules excluded.
    n_scored : int
        Laws that differ on these data, all scored with their best constants.
    n_failed : int
        Sub-expressions without a finite value on these data.
    missing_inputs : tuple of str
        Inputs of the grammar that the data lack; rules with them are left out.
    parts : tuple of str
        Sizes of the factor banks, for the curious.
    guarantee : str
        What holds for sums of terms, which are not searched through.
    """

    grammar: str
    fingerprint: str
    max_levels: int
    n_derivations: int
    n_scored: int
    n_failed: int
    missing_inputs: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    guarantee: str = ""

    def text(self):
        """The guarantee in one sentence."""
        missing = (
            f"; not sayable on these data for want of {', '.join(self.missing_inputs)}"
            if self.missing_inputs
            else ""
        )
        if self.guarantee:
            missing += f"; {self.guarantee}"
        return (
            f"grammar {self.grammar} ({self.fingerprint[:12]}), derivations of at most "
            f"{self.max_levels} levels: {self.n_derivations:,} derivations, {self.n_scored:,} laws "
            f"that differ on these data, all scored with their best constants "
            f"({self.n_failed} sub-expressions without a finite value){missing}"
        )


@dataclass(frozen=True)
class SearchResult:
    """Outcome of a search.

    Attributes
    ----------
    best : Candidate or None
        Lowest loss; of ties the least complex.
    candidates : tuple of Candidate
        The best laws, lowest loss first, equal laws merged.
    front : tuple of Candidate
        Best per complexity, each better than every simpler one.
    null_gains : tuple of float
        Greatest gain of any law on each simulated target, as a share of its total.
    """

    best: Candidate | None
    candidates: tuple[Candidate, ...]
    front: tuple[Candidate, ...]
    n_evaluated: int
    n_failed: int
    seconds: float
    certificate: Certificate | None = None
    null_gains: tuple[float, ...] = field(default=(), repr=False)


def merge_equal(rescored):
    """Sort by loss, and merge laws whose fitted accelerations are equal on the data.

    Parameters
    ----------
    rescored : list of (Candidate, ndarray)
        Laws with exact losses, and their fitted whitened accelerations.

    Returns
    -------
    list of Candidate
        Of equal laws the least complex, the others among its ties.
    """
    if not rescored:
        return []
    total = max(candidate.total for candidate, _ in rescored)
    floor = 1e-20 * total
    order = sorted(rescored, key=lambda item: (item[0].loss, item[0].complexity))
    merged = []
    for candidate, fitted in order:
        same = None
        for k in range(len(merged) - 1, -1, -1):
            other, other_fitted = merged[k]
            if candidate.loss - other.loss > 1e-9 * (candidate.loss + other.loss) + floor:
                break  # in order of their losses: no further one is close
            apart = np.square(fitted - other_fitted).sum()
            if apart <= 1e-16 * np.square(fitted).sum() + floor:
                same = k
                break
        if same is None:
            merged.append((candidate, fitted))
        else:
            merged[same] = (_absorb(merged[same][0], candidate), merged[same][1])
    return sorted((c for c, _ in merged), key=lambda c: c.loss)


def _absorb(kept, other):
    """Of two equal laws the least complex leads, the other becomes a tie."""
    # Of equally complex ones the text decides: the order of the losses is rounding.
    lead, tail = sorted((kept, other), key=lambda c: (round(c.complexity, 9), to_text(c.formula)))
    names = dict.fromkeys((*kept.ties, *other.ties, tail.formula))
    names.pop(lead.formula, None)
    return replace(lead, ties=tuple(names))


def front_of(laws, score=lambda law: law):
    """Best per complexity, simplest first: each better than every simpler law.

    ``score(law)`` has its complexity and its loss.
    """
    front = []
    for law in sorted(laws, key=lambda one: (score(one).complexity, score(one).loss)):
        if not front or score(law).loss < score(front[-1]).loss:
            front.append(law)
    return tuple(front)
