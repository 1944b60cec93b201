"""One turn of the loop: what is missing, which term explains it, is it real, what did it buy."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.language.formula import Call, Constant, Number, factors, product
from bsp_gp.language.inputs import property_of
from bsp_gp.language.render import to_latex, to_text
from bsp_gp.loop.effects import COLLINEAR, describe, fresh_name, rename_constant, sign_bounds
from bsp_gp.loop.outcome import ConstantEstimate, Effect, Rival, Round
from bsp_gp.loop.residual import examine_residual
from bsp_gp.physics.force import ForceLaw, Term, constant_units, split_linear
from bsp_gp.search.subsets import best_subsets

__all__ = ["Attempt", "Model", "constant_estimates", "run_round"]

MIN_BIC_GAIN = 6.0
REVISION_SHARE = 0.5
"""A set takes the place of terms found one by one where it leaves at most this part."""
SAME_LOSS = 1.2
"""On exact data, sets whose losses differ by less than this factor fit practically equally."""
TIE_BIC = 2.0
MAX_BLUR = 10.0
"""Growth of the relative error of an adopted constant at which a further term is refused."""
MAX_RIVALS = 8
MOST_EQUALS = 24
"""Laws listed as not separable from an effect."""
FREES = " (frees a declared number)"
MAX_SET = 4
"""Largest set of found terms that is chosen as a whole."""
MIN_SHARE = 0.6
"""Part of the held-out error above the noise floor (squared) that a term must remove."""


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
        Found terms of the law before that it does without.
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

    def score(self, n_effective):
        """BIC plus twice the complexity (the prior of the grammar)."""
        return self.fit.bic(n_effective) + 2 * self.complexity


def evaluate(observation, law, fit=None):
    """Fit a law (unless fitted) and score it on the held-out scenes."""
    fit = fit or observation.fit(law)
    errors, rows = observation.errors(fit.law)
    return Model(fit.law, fit, errors, rows)


def run_round(number, observation, model, search, alpha, rng, progress, workers=None):
    """Run one round on a fitted model.

    Returns
    -------
    round : Round
    model : Model
        The one to go on with: the new one if a term was adopted.
    """
    started = time.perf_counter()
    search_rng, floor_rng, ratio_rng = rng.spawn(3)
    progress(f"round {number}: testing the residual against noise")
    missing = examine_residual(observation, model.fit, alpha)
    if not missing.is_missing:
        floor, _ = observation.floor(model.law, floor_rng)
        return _quiet_round(number, missing, model, floor, started), model
    progress(f"round {number}: searching for what is missing")
    proposals = search.propose(model.fit, search_rng)
    progress(f"round {number}: fitting {len(proposals.shortlist)} proposals jointly")
    attempts = _attempts(observation, model, proposals, workers)
    chosen = _choose(observation, model, search, attempts)
    if chosen is None:
        floor, _ = observation.floor(model.law, floor_rng)
        return _empty_round(number, missing, model, floor, proposals, attempts, started), model
    progress(f"round {number}: weighing {chosen.name} on held-out data")
    after = evaluate(observation, chosen.law, chosen.fit)
    floor, copies = observation.floor(after.law, floor_rng)
    ratio = observation.ratio(model.rows, after.rows, ratio_rng, copies, model.law, after.law)
    adopted, verdict, reason = _verdict(
        observation, model, after, chosen, attempts, floor, ratio, proposals.p_value, alpha
    )
    effect = _effect(observation, chosen, proposals.p_value)
    rivals = _rivals(observation, model, chosen, attempts)
    rivals += _freed_numbers(observation, model, chosen)
    done = Round(
        number=number,
        missing=missing,
        effect=effect,
        rivals=tuple(rivals),
        adopted=adopted,
        reason=reason,
        before=model.errors,
        after=after.errors,
        floor=floor,
        ratio=ratio,
        held_out=tuple(_held_out(model.rows, after.rows)),
        certificate="; ".join(proposals.certificates),
        seconds=time.perf_counter() - started,
        verdict=verdict,
    )
    return done, (after if adopted else model)


# --- proposals ------------------------------------------------------------------------------------


def _attempts(observation, model, proposals, workers):
    """Every proposal of the shortlist, fitted jointly with the rest of the law."""
    jobs = [(observation, model.fit.law, proposal) for proposal in proposals.shortlist]
    run = map if workers is None else workers.map
    return [attempt for attempt in run(_attempt, jobs) if attempt is not None]


def _attempt(job):
    observation, law, proposal = job
    name = fresh_name(law)
    formula = rename_constant(proposal.formula, proposal.constant, name)
    start = 0.0
    if proposal.per_entity:
        start = dict.fromkeys(observation.train_regression.receiver_names(), 0.0)
    new = law.plus(Term(formula, proposal.kind), {name: start})
    bounds = sign_bounds(observation, new)
    low, high = bounds.get(name, (-np.inf, np.inf))
    fit = observation.fit(new, bounds=bounds)
    reason = ""
    values = np.array(
        [v for (n, _), v in zip(fit.parameters, fit.values, strict=True) if n == name]
    )
    if observation.is_exact and not all(low <= v <= high for v in values):
        reason = "it would push forward along the velocity: the sign of another cause"
    elif not np.any(values):
        reason = "its sign would push forward: held at zero"
    if proposal.redoes_declared:
        reason = "it only changes the number of a declared term, which is declared as fixed"
    return Attempt(
        fit.law,
        fit,
        proposal.complexity,
        describe(formula, _typical(values)),
        to_text(formula),
        to_latex(formula),
        proposal.kind,
        proposal.share,
        tuple(to_text(rename_constant(t, proposal.constant, name)) for t in proposal.ties),
        reason,
        redoes_declared=proposal.redoes_declared,
    )


def _typical(values):
    return float(np.median(values)) if len(values) else None


def _choose(observation, model, search, attempts):
    """The attempt to adopt: best evidence and prior; then its nearest kin of the declared law."""
    able = [a for a in attempts if not a.reason]
    if not able:
        return None
    n_eff = min(attempts, key=lambda a: a.fit.chisqr).fit.n_effective
    best = min(able, key=lambda a: (a.score(n_eff), a.complexity))
    best = _like_declared(observation, model.law, best, n_eff)
    if observation.is_exact:
        best = _plan_ahead(observation, model.law, best, search)
    return best


def _declared_pair(law):
    """Property factors of the declared pair term, if there is exactly one such term."""
    terms = [t for t in law.terms if t.is_declared and t.kind == "pair"]
    if len(terms) != 1:
        return None
    above, below = factors(terms[0].formula)
    if any(_is_property(f) for f in below):
        return None
    return [f for f in above if _is_property(f)]


def _is_property(formula):
    return (
        bool(formula.inputs)
        and all(property_of(n) for n in formula.inputs)
        and not formula.constants
    )


def _with_properties(formula, properties):
    """The formula with its property factors replaced."""
    above, below = factors(formula)
    above = [f for f in above if not _is_property(f)]
    below = [f for f in below if not _is_property(f)]
    vectors = [f for f in above if f.type.shape == "vector"]
    scalars = [f for f in above if f.type.shape != "vector" and not isinstance(f, Constant)]
    head = [f for f in above if isinstance(f, Constant)]
    coefficient = product([*head, *properties, *scalars])
    if below:
        coefficient = Call("div", coefficient, product(below))
    return product([coefficient, *vectors])


def _like_declared(observation, law, best, n_eff):
    """Prefer the property factors of the declared pair law where the data cannot tell."""
    properties = _declared_pair(law)
    term = best.law.terms[-1]
    if not properties or term.kind != "pair":
        return best
    formula = _with_properties(term.formula, properties)
    if formula == term.formula:
        return best
    name = split_linear(formula)[0]
    new = law.plus(Term(formula, "pair"), {name: 0.0})
    fit = observation.fit(new, bounds=sign_bounds(observation, new))
    # On exact data what is left is misfit: a tenth of it more is no evidence.
    same = (
        fit.chisqr < 1.1 * best.fit.chisqr
        if observation.is_exact
        else fit.bic(n_eff) - best.fit.bic(n_eff) < TIE_BIC
    )
    if not same:
        return best
    value = float(fit.values[-1])
    return replace(
        best,
        law=fit.law,
        fit=fit,
        text=to_text(formula),
        latex=to_latex(formula),
        name=describe(formula, value),
        ties=(best.text, *best.ties),
    )


def _plan_ahead(observation, law, best, search):
    """Choose the found terms anew as part of the best set, on exact data.

    Added one at a time, a proxy (a cube of speed for an inverse cube of distance) may be taken
    first and never be parted with. So sets of terms are scored as wholes; where a larger set
    leaves far less, its strongest members are what is adopted now.
    """
    declared = [term for term in law.terms if term.is_declared]
    found = [term for term in best.law.terms if not term.is_declared]
    pool = _Pool(observation, declared, best, search)
    if not pool.laws:
        return best
    sets = pool.sets(min(len(found) + 2, MAX_SET))
    size = _worthwhile(sets, len(found), pool.floor)
    if not sets.get(size) or (size == len(found) == 1):
        return best
    chosen = pool.simplest(sets[size])
    order = pool.by_gain(chosen)[: len(found)]
    planned = pool.attempt(order, best)
    if size == len(found) and planned.fit.chisqr > REVISION_SHARE * best.fit.chisqr:
        planned = best
    same = pool.equals(size, sets[size][0][0], chosen) if size == len(found) else ()
    return replace(planned, equivalents=tuple(same))


def _worthwhile(sets, size, floor):
    """Grow the size of the set while that leaves a hundredth of the sum of squares or less."""
    while size + 1 in sets and sets[size + 1] and sets[size]:
        further = min(
            (max(sets[s][0][0], floor) for s in sets if s > size and sets[s]), default=np.inf
        )
        if further > 0.01 * max(sets[size][0][0], floor):
            break
        size += 1
    return size


class _Pool:
    """Columns of all laws with the declared (or best) property factors."""

    def __init__(self, observation, declared, best, search):
        self.observation = observation
        regression = observation.train_regression
        found = [term for term in best.law.terms if not term.is_declared]
        wanted = {_property_part(term.formula) for term in found}
        kinds = dict.fromkeys(term.kind for term in found)
        self.laws, columns = [], []
        for kind in kinds:
            laws, matrix = search.pool(kind, frozenset(wanted))
            self.laws += [(formula, complexity, kind) for formula, complexity in laws]
            columns.append(matrix)
        self.declared = ForceLaw(
            declared, {n: best.law.constants[n] for t in declared for n in t.formula.constants}
        )
        fit = observation.fit(self.declared)
        q = _orthonormal(fit.jacobian)
        matrix = np.concatenate(columns, axis=1)
        self.frozen = _parallel(matrix, _fixed_directions(regression, declared))
        self.matrix = matrix - q @ (q.T @ matrix)
        self.target = fit.residual - q @ (q.T @ fit.residual)
        self.floor = 0.5 * regression.n_rows

    def sets(self, size):
        """Best sets of each size up to `size` that leave the declared numbers alone."""
        free = np.flatnonzero(~self.frozen)
        found = best_subsets(self.matrix[:, free], self.target, size)
        return {
            count: [(loss, tuple(int(free[k]) for k in chosen)) for loss, chosen in members]
            for count, members in found.items()
        }

    def simplest(self, sets):
        """Of the sets that fit practically as well as the best, the least complex."""
        bar = max(sets[0][0], self.floor) * SAME_LOSS
        near = [chosen for loss, chosen in sets if max(loss, self.floor) <= bar]
        return min(near, key=lambda chosen: round(sum(self.laws[k][1] for k in chosen), 6))

    def by_gain(self, chosen):
        """Order a set so that each next member explains most of what is left."""
        order, left = [], list(chosen)
        while left:
            losses = []
            for k in left:
                columns = self.matrix[:, [*order, k]]
                columns = columns / np.linalg.norm(columns, axis=0)
                coefficients, *_ = np.linalg.lstsq(columns, self.target, rcond=None)
                losses.append(float(np.square(self.target - columns @ coefficients).sum()))
            order.append(left.pop(int(np.argmin(losses))))
        return order

    def attempt(self, order, best):
        """The declared law with these members, fitted."""
        law, complexity = self.declared, 0.0
        for k in order:
            formula, cost, kind = self.laws[k]
            name = fresh_name(law)
            law = law.plus(Term(Call("mul", Constant(name), formula), kind), {name: 0.0})
            complexity += cost
        fit = self.observation.fit(law)
        old = {
            to_text(split_linear(t.formula)[1]): t for t in best.law.terms[:-1] if not t.is_declared
        }
        terms = [t for t in fit.law.terms if not t.is_declared]
        texts = [to_text(split_linear(t.formula)[1]) for t in terms]
        new = [t for t, text in zip(terms, texts, strict=True) if text not in old]
        new = new or terms
        gone = [describe(t.formula) for text, t in old.items() if text not in texts]
        constants = fit.law.constants
        return Attempt(
            fit.law,
            fit,
            complexity,
            " and ".join(describe(t.formula, constants[split_linear(t.formula)[0]]) for t in new),
            " + ".join(to_text(t.formula) for t in new),
            " + ".join(to_latex(t.formula) for t in new),
            new[-1].kind,
            replaces=tuple(gone),
        )

    def equals(self, size, best_loss, chosen):
        """Texts of the sets that these data cannot tell from the chosen one, simplest first.

        Sets in which a declared number is freed are among them, and are marked.
        """
        bar = max(best_loss, self.floor) * SAME_LOSS
        found = best_subsets(self.matrix, self.target, size).get(size, ())
        near = [members for loss, members in found if max(loss, self.floor) <= bar]
        near.sort(key=lambda members: round(sum(self.laws[k][1] for k in members), 6))
        for members in near[:MOST_EQUALS]:
            if set(members) != set(chosen):
                text = " + ".join(
                    f"c{n} * {to_text(self.laws[k][0])}" for n, k in enumerate(members, 1)
                )
                yield text + (FREES if self.frozen[list(members)].any() else "")


def _property_part(formula):
    """Product of the property factors, as the left bank of the search writes it."""
    above, below = factors(formula)
    above = [f for f in above if _is_property(f)]
    below = [f for f in below if _is_property(f)]
    if not above and not below:
        return Number(1.0)
    top = product(above)
    return Call("div", top, product(below)) if below else top


def _orthonormal(columns):
    live = columns[:, np.any(columns, axis=0)] if columns.size else columns
    if not live.size:
        return np.zeros((len(columns), 0))
    return np.linalg.qr(live / np.linalg.norm(live, axis=0))[0]


def _fixed_directions(regression, declared):
    out = []
    for term in declared:
        if not term.formula.constants:
            column = regression.column(term)[0][:, 0]
            if np.any(column):
                out.append(column / np.linalg.norm(column))
    return out


def _parallel(matrix, fixed):
    """Which columns are parallel to a declared term of fixed number."""
    sizes = np.linalg.norm(matrix, axis=0)
    sizes = np.where(sizes > 0, sizes, 1.0)
    out = np.zeros(matrix.shape[1], dtype=bool)
    for direction in fixed:
        out |= 1 - (direction @ matrix / sizes) ** 2 < COLLINEAR
    return out


# --- verdict --------------------------------------------------------------------------------------


def _verdict(observation, model, after, chosen, attempts, floor, ratio, p_value, alpha):
    """Adopt, or say why not."""
    n_eff = chosen.fit.n_effective
    gain = model.fit.bic(n_eff) - chosen.fit.bic(n_eff)
    share = _explained(observation, model.errors, after.errors, floor)
    if p_value > alpha:
        return (
            False,
            "cannot tell",
            (
                "something is left, but no law of the grammar explains more of it than noise alone "
                f"would let the best of all laws explain (p = {p_value:.3g}, alpha = {alpha:g})"
            ),
        )
    if gain < MIN_BIC_GAIN:
        return (
            False,
            "seen, not adopted",
            (f"the evidence for it is weak: BIC falls by {gain:.1f}, less than {MIN_BIC_GAIN:g}"),
        )
    freed = [a.fit for a in attempts if a.redoes_declared and _is_better(a.fit, chosen.fit, n_eff)]
    if freed:
        return (
            False,
            "cannot tell",
            "a change of a declared number fits better than any new term; a wrong number, a wrong "
            "length scale and a wrong clock do the same, and these data cannot tell them apart",
        )
    if not share >= MIN_SHARE:
        rivals = [
            a
            for a in attempts
            if not a.reason
            and a.name != chosen.name
            and a.fit.bic(n_eff) - chosen.fit.bic(n_eff) < TIE_BIC
        ]
        verdict = "cannot tell" if rivals else "seen, not adopted"
        return (
            False,
            verdict,
            (
                f"the best term removes only {max(share, 0):.0%} of the held-out error above the "
                f"noise floor, less than {MIN_SHARE:.0%}: the cause is not among the laws tried"
            ),
        )
    blurred = _blurred(model.fit, after.fit)
    if blurred:
        return (
            False,
            "seen, not adopted",
            (f"beside it {blurred}: these data hardly tell the two terms apart"),
        )
    if not observation.is_exact and not ratio.high < 1:
        return (
            False,
            "seen, not adopted",
            (
                f"the held-out error does not fall for sure: ratio {ratio.value:.2f} "
                f"[{ratio.low:.2f}, {ratio.high:.2f}]"
            ),
        )
    extra = f"; it takes the place of {', '.join(chosen.replaces)}" if chosen.replaces else ""
    return (
        True,
        "effect adopted",
        (
            f"BIC falls by {gain:.1f}, p = {p_value:.3g} with the selection counted, and "
            f"{share:.0%} of the held-out error above the noise floor is gone{extra}"
        ),
    )


def _is_better(fit, other, n_eff):
    """Whether a fit is clearly better: by its BIC; on exact data by leaving next to nothing."""
    if fit.is_exact:
        return fit.chisqr < 0.01 * other.chisqr
    return fit.bic(n_eff) < other.bic(n_eff) - TIE_BIC


def _blurred(before, after):
    """Which constant loses its meaning when a term is added; "" if none does.

    A term that nearly repeats one of the law's inflates that one's error bar and may flip its
    sign; it explains nothing that can be named.
    """
    widths = {
        key: half / abs(value)
        for key, value, half in zip(before.parameters, before.values, before.intervals, strict=True)
        if value
    }
    for key, value, half in zip(after.parameters, after.values, after.intervals, strict=True):
        if key in widths and value:
            width = half / abs(value)
            if width > MAX_BLUR * widths[key] and width > 0.03:
                return f"the relative error of {key[0]} grows from {widths[key]:.1g} to {width:.1g}"
    return ""


def _explained(observation, before, after, floor):
    """Share of the squared held-out error above the floor that is gone."""
    if observation.is_exact:
        b, a, f = before.residual_acceleration, after.residual_acceleration, 0.0
    else:
        b, a, f = before.rollout_rmse, after.rollout_rmse, floor.rollout_rmse
    above = b**2 - f**2
    if not above > 0:
        return 0.0
    return float((b**2 - a**2) / above)


def _quiet_round(number, missing, model, floor, started):
    return Round(
        number,
        missing,
        None,
        (),
        False,
        "the residual is as large and as uncorrelated as the noise: nothing is missing that these "
        "data could show",
        model.errors,
        None,
        floor,
        None,
        (),
        "",
        time.perf_counter() - started,
        "nothing missing",
    )


def _empty_round(number, missing, model, floor, proposals, attempts, started):
    rivals = tuple(
        Rival(
            a.name,
            a.kind,
            a.text,
            a.latex,
            float("nan"),
            a.share,
            float("nan"),
            a.complexity,
            a.reason,
        )
        for a in attempts
    )
    return Round(
        number,
        missing,
        None,
        rivals,
        False,
        "something is left, but every law that was tried is ruled out by its sign or is only a "
        "change of a declared number",
        model.errors,
        None,
        floor,
        None,
        (),
        "; ".join(proposals.certificates),
        time.perf_counter() - started,
        "seen, not adopted",
    )


# --- telling --------------------------------------------------------------------------------------


def constant_estimates(observation, fit):
    """Constants of a fitted law with 90 % intervals and units."""
    units = {}
    for term in fit.law.terms:
        for name, unit in constant_units(term).items():
            units[name] = observation.dataset.units.text(unit)
    out = []
    for (name, entity), value, half in zip(fit.parameters, fit.values, fit.intervals, strict=True):
        unit = units.get(name, "")
        if entity and _mass_unknown(observation, entity) and unit:
            unit = f"{unit} per unit mass"
        out.append(
            ConstantEstimate(
                name, float(value), float(value - half), float(value + half), unit, entity
            )
        )
    return tuple(out)


def _mass_unknown(observation, entity):
    return any(
        e.name == entity and not np.isfinite(e.mass) for s in observation.train for e in s.entities
    )


def _effect(observation, chosen, p_value):
    names = {split_linear(t.formula)[0] for t in chosen.law.terms if not t.is_declared}
    estimates = tuple(c for c in constant_estimates(observation, chosen.fit) if c.name in names)
    entities = tuple(dict.fromkeys(e for e in observation.train_regression.receiver_names()))
    zero = {c.entity for c in estimates if c.entity and c.value == 0.0}
    equivalents = (*chosen.equivalents, *chosen.ties)
    return Effect(
        name=chosen.name,
        kind=chosen.kind,
        law=chosen.text,
        latex=chosen.latex,
        entities=tuple(e for e in entities if e not in zero),
        constants=estimates,
        p_value=p_value,
        equivalents=tuple(dict.fromkeys(equivalents))[:MOST_EQUALS],
        separated_by=_separated_by(chosen.text, equivalents),
    )


def _separated_by(text, equivalents):
    """Which further measurement would tell equal laws apart."""
    import re

    def words(law):
        found = set(re.findall(r"[A-Za-z_]\w*", law))
        return {w for w in found if property_of(w)}, {
            w for w in ("v_i", "v_j", "p_j") if w in found
        }

    own, motion = words(text)
    properties, motions = set(), set()
    for law in equivalents:
        p, m = words(law)
        properties |= p ^ own
        motions |= m ^ motion
    parts = []
    if properties:
        columns = sorted({property_of(p)[0] for p in properties})
        parts.append(f"bodies that differ in {' and '.join(columns)}")
    if motions or (equivalents and not properties):
        parts.append(
            "tracks on which speed and distance vary independently (another start, another orbit)"
        )
    return "; ".join(parts)


def _rivals(observation, model, chosen, attempts):
    """The other attempts, best first, each with why it lost."""
    n_eff = chosen.fit.n_effective
    out, seen = [], {chosen.text}
    for attempt in sorted(attempts, key=lambda a: a.score(n_eff)):
        if attempt.text in seen or len(out) >= MAX_RIVALS:
            continue
        seen.add(attempt.text)
        delta = attempt.fit.bic(n_eff) - chosen.fit.bic(n_eff)
        reason = attempt.reason
        if not reason and delta < TIE_BIC:
            reason = "fits as well" + (
                "; less simple" if attempt.complexity > chosen.complexity else ""
            )
        elif not reason:
            reason = f"fits worse: BIC higher by {delta:.1f}"
        out.append(
            Rival(
                attempt.name,
                attempt.kind,
                attempt.text,
                attempt.latex,
                float(delta),
                attempt.share,
                _ratio_of(observation, attempt.fit.law, model.errors),
                attempt.complexity,
                reason,
            )
        )
    return out


def _ratio_of(observation, law, before):
    """Held-out error of a law over that of the model entering the round."""
    bottom = before.residual_acceleration if observation.is_exact else before.rollout_rmse
    return observation.headline_error(law) / bottom if bottom else float("nan")


def _freed_numbers(observation, model, chosen):
    """What freeing each declared number would do, alone and beside the chosen effect."""
    out = []
    for base, label in (
        (model.law, "instead of the effect"),
        (chosen.fit.law, "beside the effect"),
    ):
        for index, term in enumerate(base.terms):
            if not term.is_declared or term.formula.constants:
                continue
            name = fresh_name(base, "s")
            scaled = Term(Call("mul", Constant(name), term.formula), term.kind, is_declared=True)
            terms = (*base.terms[:index], scaled, *base.terms[index + 1 :])
            law = ForceLaw(terms, {**base.constants, name: 1.0})
            fit = observation.fit(law, bounds=sign_bounds(observation, law))
            k = [n for n, _ in fit.parameters].index(name)
            delta = fit.bic(chosen.fit.n_effective) - chosen.fit.bic()
            factor, half = fit.values[k], fit.intervals[k]
            out.append(
                Rival(
                    f"declared number freed, {label}",
                    "declared_term_change",
                    to_text(scaled.formula),
                    to_latex(scaled.formula),
                    float(delta),
                    float(1 - (fit.chisqr / model.fit.chisqr)),
                    _ratio_of(observation, fit.law, model.errors),
                    0.0,
                    _freed_reason(factor, half, delta, _is_only_number(base)),
                )
            )
    return out


def _is_only_number(law):
    """Whether one term has a fixed number and no term knows a length of its own."""
    fixed = [term for term in law.terms if not term.formula.constants]
    own_lengths = {"s_i", "s_j", "p_c", "R_i", "R_j", "l_i", "l_j"}
    return len(fixed) == 1 and not any(term.formula.inputs & own_lengths for term in law.terms)


def _freed_reason(factor, half, delta, is_alone):
    """What freeing a declared number says; the same is said of the length scale and the clock."""
    size = f"{name_number(factor - 1)} ± {name_number(half)} of its value"
    text = f"the declared number would have to be off by {size}"
    if delta < -TIE_BIC:
        text += ", and that fits better"
    elif delta < TIE_BIC:
        text += ", and that fits as well"
    else:
        text += f"; BIC higher by {delta:.1f}"
    if is_alone:
        # The constants of the other terms take up any rescaling of length and time.
        text += (
            "; a length scale or a clock that is off looks exactly like a wrong number: these "
            "data cannot tell the three apart"
        )
    return text


def name_number(value):
    return f"{value:.2%}" if 1e-3 <= abs(value) < 10 else f"{value:.2g}"


def _held_out(before, after):
    for b, a in zip(before, after, strict=True):
        n = max(b["n"], 1)
        yield {
            "scene": b["scene"],
            "before": float(np.sqrt(b["sum_squares"] / n)),
            "after": float(np.sqrt(a["sum_squares"] / n)),
            "endpoint_before": float(np.mean(b["endpoints"])) if b["endpoints"] else None,
            "endpoint_after": float(np.mean(a["endpoints"])) if a["endpoints"] else None,
        }
