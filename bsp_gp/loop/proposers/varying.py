"""Constants that are not the same everywhere: a strength of its own for every body, or scene."""

import math
from dataclasses import replace

import numpy as np

from bsp_gp.fitting.tangent import as_pair
from bsp_gp.language.formula import Call, Constant, rename_constants
from bsp_gp.language.inputs import property_of
from bsp_gp.language.render import to_text
from bsp_gp.loop.proposal import Family, Proposal, with_term_at
from bsp_gp.physics.force import ForceLaw, Term, fresh_name, split_linear
from bsp_gp.physics.regression import checked

MOST = 40
"""Bodies or scenes that may have strengths of their own."""


class Varying:
    """Strengths by body and by scene as a proposer."""

    name = "varying"

    def propose(self, view):
        """The family of all terms, each by body and by scene."""
        proposals, even, best = [], np.zeros(view.moment_draws.shape[1]), 0.0
        by_whom = owners(view)
        law = view.fit.law
        for index, term in view.single_terms if by_whom else ():
            name, _ = split_linear(term.formula)
            is_own = any(n.endswith("]") for n in term.formula.constants)
            if is_own or (name and sum(name in t.formula.constants for t in law.terms) > 1):
                continue
            for by, ties in by_whom.items():
                known = {n: law.constants[n] for n in term.formula.constants}
                keys, columns = columns_by(view, term, known, by)
                score = view.score_forces(columns)
                if not score.rank:
                    continue
                even = np.maximum(even, as_pair(view.null_forces(columns), score.rank))
                gain = float(as_pair(score.statistic, score.rank))
                best = max(best, gain)
                proposals.append(_proposal(view, index, by, keys, score.amplitudes, gain, ties))
        proposals.sort(key=lambda p: -p.promise)
        return Family(self.name, tuple(proposals), best, 2, even, n_tried=len(proposals))


def owners(view, fewest=2):
    """By what strengths may differ, and by what else it would be the same on these data.

    Parameters
    ----------
    fewest : int
        Scenes, or bodies, that there have to be.

    Returns
    -------
    dict of str to tuple of str
        "body" or "scene".
    """
    pairs = {(scene.name, scene.names[k]) for scene in view.dataset.scenes for k in scene.dynamic}
    counts = {by: len({pair[k] for pair in pairs}) for k, by in enumerate(("scene", "body"))}
    if any(scene.part_of for scene in view.dataset.scenes):  # stretches have no own constants
        counts["scene"] = 0
    able = [by for by, count in counts.items() if fewest <= count <= MOST]
    if len(able) == 2 and len(pairs) == counts["scene"] == counts["body"]:
        return {"body": ("scene",)}  # each scene shows a body of its own
    return dict.fromkeys(able, ())


def columns_by(view, term, constants, by):
    """Names of bodies or scenes, and moments of the term as far as it acts there, (n, c).

    Parameters
    ----------
    constants : mapping of str to float
        Of the term.
    by : str
        "body" or "scene".
    """
    scenes = view.dataset.scenes
    bodies = [s.names[k] for s in scenes for k in s.dynamic]
    keys = list(dict.fromkeys(bodies if by == "body" else (s.name for s in scenes)))
    number = {key: k for k, key in enumerate(keys)}

    def owner(scene, body):
        return number[body if by == "body" else scene]

    return keys, _columns_of_owners(view, ForceLaw((term,), constants), owner, len(keys))


def _columns_of_owners(view, law, owner, count):
    """Moments (n, count) of a law as it acts on the bodies of each ``owner(scene, body)``."""
    parts = []
    for batch in view.response.regression.batches:
        value = checked(view.response.regression.predict(batch, law), batch)  # (n, S, R, d)
        apart = value[..., None, :] * np.eye(value.shape[2])[..., None]
        moments = batch.whiten(apart)[:, :, 0, :, 0]  # (m, S, R)
        out = np.zeros((*moments.shape[:2], count))
        names = zip(batch.scene_names, batch.bodies.receiver_names, strict=True)
        for s, (scene, bodies) in enumerate(names):
            for r, body in enumerate(bodies):
                out[:, s, owner(scene, body)] += moments[:, s, r]
        parts.append(out.reshape(-1, count))
    return np.concatenate(parts)


def _proposal(view, index, by, keys, changes, gain, ties):
    """The hypothesis with the strength of a term freed, as of relative changes."""
    law = view.fit.law
    term = law.terms[index]
    old, _ = split_linear(term.formula)
    name, value = (old, law.constants[old]) if old else (fresh_name(law, "s"), 1.0)
    name, formula = f"{name}[{by}]", term.formula
    if old:
        formula = rename_constants(formula, {old: name})
    else:
        formula = Call("mul", Constant(name), formula)
    least = -math.inf if old else 0.0  # what was typed with its number acts the other way nowhere
    table = {
        key: max(value * (1 + float(d)), least) for key, d in zip(keys, changes, strict=True)
    }
    return Proposal(
        f"constant_per_{by}", to_text(formula),
        with_term_at(view.hypothesis, index, formula, {name: table}),
        -view.criteria.cause_nats, gain, 2,
        ties=tuple(to_text(formula).replace(f"[{by}]", f"[{other}]") for other in ties),
        bounds={} if old else {name: (least, math.inf)},
    )  # fmt: skip


def beside_unknown(view, proposals):
    """Laws as proposed where properties are unknown: they may be others than without a new law.

    A law that feels a property of its receivers may pull on each body with a strength of its own.

    Parameters
    ----------
    proposals : list of Proposal
        Of one law each.
    """
    parts = [part for part in view.fit.law.frame if part.kind == "world"]
    places = [place for part in parts for place in part.places]
    return [_freed(view, p, places) for p in proposals] if places else proposals


def _freed(view, proposal, places):
    """A proposal with what it gains as properties change, `places` being those that are unknown."""
    (formula,) = proposal.formulas
    law = ForceLaw((Term(formula),), dict.fromkeys(formula.constants, 1.0))
    term = law.terms[0]
    felt = {property_of(name) for name in term.acceleration_formula.inputs}
    felt |= {("mass", "i")} if term.needs_mass else set()
    named = {at: name for column, at, name in places if (column, "i") in felt}
    number = {name: k for k, name in enumerate(dict.fromkeys(named.values()), 1)}
    if not number:
        return proposal
    columns = _columns_of_owners(
        view, law, lambda *at: number.get(named.get(at), 0), len(number) + 1
    )
    score = view.score_forces(columns[:, columns.any(axis=0)])
    price = max(score.rank - 1, 0) * np.log(max(view.n_left, 2))
    return replace(proposal, gain=max(proposal.gain, score.statistic - price))
