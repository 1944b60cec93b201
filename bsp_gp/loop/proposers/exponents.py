"""Declared terms with a power of distance or speed that is not quite right, or another number."""

import re
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant, Number, factors, walk
from bsp_gp.language.inputs import property_of
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term_at
from bsp_gp.physics.force import ForceLaw, Term, fresh_name, fresh_names

MIN_SPREAD = 1e-3
"""Relative spread of a quantity below which its power cannot be seen."""
FEWEST_DIGITS = 3
"""Digits from which a number with a decimal point is taken for rounded."""
_MANTISSA = re.compile(r"-?(\d*\.\d+)")


class Declared:
    """Exponents and numbers of declared terms as a proposer."""

    name = "declared"

    def propose(self, view):
        """The family of changed exponents and numbers."""
        proposals, numbers, null = [], [], np.zeros(view.moment_draws.shape[1])
        for index, term in view.single_terms:
            if not term.is_declared:
                continue
            for base, typical in _powers(view, term):
                ratio = Call("div", base, Number(typical, base.type.unit))
                slope = Call("mul", Call("log", ratio), term.formula)
                score, chance = self._scored(view, Term(slope, term.kind))
                null = np.maximum(null, chance)
                if score.rank:
                    proposals.append(self._exponent(view, index, base, typical, score))
            if not term.formula.constants:
                numbers.append((index, term))
                score, chance = self._scored(view, term)
                null = np.maximum(null, chance)
                if score.rank:
                    proposals.append(self._number(view, index, score))
        if len(numbers) > 1:  # none of them need be better than it was while the others stay
            score, chance = self._scored(view, *(term for _, term in numbers))
            null = np.maximum(null, chance)
            if score.rank == len(numbers):
                proposals.append(self._numbers(view, [index for index, _ in numbers], score))
        proposals.sort(key=lambda p: -p.promise)
        best = max((as_pair(p.gain, p.rank) for p in proposals), default=0.0)
        return Family(
            self.name, tuple(proposals), float(best), 2, null, n_tried=len(proposals)
        )  # fmt: skip

    def _scored(self, view, *terms):
        """Score of terms with the constants of the law, and its gains on noise, as if of two."""
        law, columns = view.fit.law, []
        for term in terms:
            known = {name: law.constants[name] for name in term.formula.constants}
            columns.append(view.response.moments_of(ForceLaw((term,), known)))
        columns = np.stack(columns, axis=1)
        score = view.score_forces(columns)
        return score, as_pair(view.null_forces(columns), max(score.rank, 1))

    def _numbers(self, view, places, score):
        """All declared numbers at once, each a cause that is doubted."""
        law, hypothesis, starts = view.fit.law, view.hypothesis, {}
        names = fresh_names(law, places, "s")
        for index, amount in zip(places, score.amplitudes, strict=True):
            name = names[index]
            starts[name] = float(amount)
            formula = Call("mul", _changed(name), law.terms[index].formula)
            hypothesis = with_term_at(hypothesis, index, formula, {name: 0.0})
        text = "numbers of " + " and ".join(to_text(law.terms[k].formula) for k in places)
        return Proposal(
            "number", text, hypothesis, -len(places) * view.criteria.cause_nats, score.statistic,
            score.rank, starts=starts,
        )  # fmt: skip

    def _exponent(self, view, index, base, typical, score):
        law = view.fit.law
        term = law.terms[index]
        name = fresh_name(law, "n")
        unit = Number(typical, base.type.unit, f"{typical:.3g} [{base.type.unit}]")
        factor = Call("pow", Call("div", base, unit), Constant(name))
        text = f"exponent of {to_text(base)} in {to_text(term.formula)}"
        return _freed(view, index, "exponent", text, factor, name, score)

    def _number(self, view, index, score):
        law = view.fit.law
        name = fresh_name(law, "s")
        factor = _changed(name)
        text = f"number of {to_text(law.terms[index].formula)}"
        found = _freed(view, index, "number", text, factor, name, score)
        if abs(score.amplitudes[0]) <= rounding_of(law.terms[index].formula):
            # That a number was rounded as it was typed is no cause to be doubted.
            found = replace(found, log_prior=0.0, text=f"{text}, within its last digit")
        return found


def rounding_of(formula):
    """Part by which a term may be off since its numbers were rounded: half of each last digit.

    Numbers of few digits, and those without a decimal point, may be exact.
    """
    total = 0.0
    for node in walk(formula):
        found = _MANTISSA.match(node.text) if isinstance(node, Number) else None
        digits = found[1].replace(".", "").lstrip("0") if found else ""
        if len(digits) >= FEWEST_DIGITS:
            total += 0.5 / int(digits)
    return total


def _changed(name):
    """One and a number that is 0 where nothing changes."""
    return Call("add", Number(1.0), Constant(name))


def _freed(view, index, code, text, factor, name, score):
    """A term times a factor that is 1 where its number is 0, as a cause that may be missing."""
    formula = Call("mul", factor, view.fit.law.terms[index].formula)
    return Proposal(
        code, text, with_term_at(view.hypothesis, index, formula, {name: 0.0}),
        -view.criteria.cause_nats, score.statistic, starts={name: float(score.amplitudes[0])},
    )  # fmt: skip


def _powers(view, term):
    """Factors of a term that change with the motion, without powers: (base, typical value)."""
    bases = {}
    for part in (part for parts in factors(term.formula) for part in parts):
        base = base_of(part)
        is_scalar = part.type.shape == "scalar" and not part.constants
        if is_scalar and any(not property_of(name) for name in base.inputs):
            bases[base] = None
    for base in filter(is_size, bases):
        typical = typical_value(view, term, base)
        if typical is not None:
            yield base, typical


def is_size(base):
    """Whether a formula is a length, a speed or another size."""
    return isinstance(base, Call) and base.operator in ("norm", "abs")


def base_of(part):
    """What a factor is a power of."""
    return _split_power(part)[0]


def _split_power(part):
    power = 1.0
    while isinstance(part, Call):
        if part.operator == "pow" and isinstance(part.args[1], Number):
            power *= part.args[1].value
        elif part.operator in ("square", "inverse"):
            power *= 2.0 if part.operator == "square" else -1.0
        else:
            break
        part = part.args[0]
    return part, power


def power_of(base, formula):
    """The power of a quantity among the factors of a formula; 0 where it is none of them.

    A vector is its size times a direction.
    """
    total = 0.0
    vector = base.args[0] if isinstance(base, Call) and base.operator == "norm" else None
    for sign, side in zip((1, -1), factors(formula), strict=True):
        for part in side:
            found, power = _split_power(part)
            total += sign * power if found in (base, vector) else 0.0
    return total


def typical_value(view, term, base):
    """Typical value of a quantity where a term acts, to three digits; None if it hardly varies."""
    regression, constants = view.response.regression, view.fit.law.constants
    ratios = []
    with_base = Term(Call("mul", base, term.formula), term.kind, True)
    for batch in regression.batches:
        with np.errstate(all="ignore"):  # what runs away has no typical value
            plain, more = (
                np.linalg.norm(regression.predict(batch, ForceLaw((t,), constants)), axis=-1)
                for t in (term, with_base)
            )
            acts = (plain > 0) & batch.valid.any(axis=-1)
            ratios.append(more[acts] / plain[acts])
    ratios = np.concatenate(ratios)
    ratios = ratios[np.isfinite(ratios) & (ratios > 0)]
    if not len(ratios) or np.ptp(np.log(ratios)) < MIN_SPREAD:
        return None
    return float(f"{np.median(ratios):.3g}")
