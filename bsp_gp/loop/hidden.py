"""An unseen source as a rival explanation of a residual: where it is, how it moves, how strong.

The pair law that holds between the visible bodies is taken to hold for one more, which stands at
rest, moves straight on, or moves as that law commands. Found by a global search, fitted by the
loop's own likelihood, weighed by BIC with its numbers counted, and tested against what the same
search finds in noise.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bsp_gp.loop.effects import CLASS_BIC
from bsp_gp.loop.explanation import HIDDEN_BODY, Explanation
from bsp_gp.loop.hidden_fit import in_pieces, is_lost, polish
from bsp_gp.loop.hidden_motion import REST, motions_of
from bsp_gp.loop.hidden_place import Stage, search, survey
from bsp_gp.loop.hidden_posterior import draw_posterior
from bsp_gp.loop.hidden_pull import pulls_of
from bsp_gp.loop.hidden_view import view_of
from bsp_gp.loop.outcome import ConstantEstimate
from bsp_gp.units import DIMENSIONLESS, Unit

__all__ = ["hidden_body"]

HOPELESS = 0.1
"""p-value above which the source is not fitted: noise would show one as strong."""
NEAR = 12.0
"""Candidates whose BIC on the view is within this of the best are fitted to the tracks."""
MOST_FITTED = 3
MOTION_BIC = 6.0
"""Motions whose BIC is higher by less than this are not ruled out."""
SAME_PLACE = 0.02
"""Distance, in sizes of the scene, within which two candidates are one."""
OPEN = 10.0
"""Factor between the ends of the interval of a strength beyond which it is not determined."""
WIDE = 30.0
"""Degrees; a direction that is known no better is not determined."""
SHOWN_ROWS = 60
NOT_TOLD = "cannot tell"
"""How a reason begins that is no refutation."""
LEAST_ROWS = 4
"""Independent rows of a track, however smooth its residual."""
WORTH = 0.5
"""Part of what the best law explains that a source must promise to be fitted."""
WELL_FITTED = 1.5
"""Chi-squared per degree of freedom above which what is left is misfit, and no noise."""


def hidden_body(observation, model, rng, *, workers=None, to_beat=None):
    """Explain what a model leaves by one source that no camera sees.

    Parameters
    ----------
    observation : Observation
    model : Model
        Fitted; its pair terms say how a source acts.
    rng : numpy.random.Generator
        Simulated noise, draws from the posterior.
    workers : concurrent.futures.Executor, optional
        Not used: the search is one of matrix products.
    to_beat : float, optional
        Chi-squared of the best law: a source that promises much less is not fitted.

    Returns
    -------
    Explanation or None
        None where no law says how a source would act, or where noise alone shows one as strong
        in more than a tenth of all cases. `details["p_value"]` is the chance of that.
    """
    search_rng, draw_rng = rng.spawn(2)
    pulls = pulls_of(observation, model.law)
    if not pulls:
        return None
    if _is_hopeless_beside(model.fit, to_beat):
        return None
    stages = in_pieces(observation, model.fit)
    alone = stages[-1][1]
    model = replace(model, law=alone.law, fit=alone)
    fits, p_values, promised = [], [], 0.0
    for pull, child in zip(pulls, search_rng.spawn(len(pulls)), strict=True):
        candidates, grid, stage = _candidates(observation, model, stages, pull, len(pulls), child)
        if len(stages) == 1 and to_beat is not None:
            promised = max([promised, *(c.gain for c in candidates)])
            needed = WORTH * (model.fit.chisqr - to_beat)
            candidates = [c for c in candidates if c.gain >= needed]
        done = [polish(stages, model.law, pull, c, stage) for c in candidates]
        done = [polished for polished in done if polished is not None and polished.found.strength]
        fits += [(polished, pull, stage) for polished in done]
        share = 0.0
        if len(stages) > 1 and done:
            # Along a track that is lost the view is rough: what the fit explains counts.
            share = 1 - min(polished.fit.chisqr for polished in done) / model.fit.chisqr
        p_values.append(grid.p_value(share))
    if not fits:
        return _beaten(observation, model.fit, promised) if promised else None
    n_effective = min(fits, key=lambda f: f[0].fit.chisqr)[0].fit.n_effective
    fits.sort(key=lambda f: f[0].bic(n_effective))
    # The choice among several properties is part of the search.
    p_value = min(len(pulls) * min(p_values), 1.0)
    # A source that has lost to a law is told of with rough numbers.
    has_lost = to_beat is not None and fits[0][0].fit.chisqr > to_beat + 2 * CLASS_BIC
    found = _explained(observation, fits, n_effective, p_value, draw_rng, has_lost)
    may_hold = not found.reason or found.is_open
    if may_hold and alone.bic(n_effective) <= found.bic(n_effective):
        reason = "the law alone explains as much, for fewer numbers"
        return replace(found, reason=reason, is_open=False)
    return found


def _beaten(observation, fit, promised):
    """The best source, not worth a fit beside a law that explains more."""
    share = promised / fit.chisqr
    return Explanation(
        HIDDEN_BODY, "an unseen body", "a body that is not seen", r"\text{a body that is not seen}",
        observation, fit, observation.dataset.n_dims + 1,
        reason=f"in its best place it would explain {100 * share:.2g} % of what is left, to first "
        "order; a law explains more than twice as much",
    )  # fmt: skip


def _is_hopeless_beside(fit, to_beat):
    """Whether tracks are lost without a law that leaves little: no source need be looked for."""
    if to_beat is None or not is_lost(fit):
        return False
    return to_beat <= WELL_FITTED * max(fit.whole.n_rows - fit.whole.n_free, 1)


def _candidates(observation, model, stages, pull, n_pulls, rng):
    """Candidates worth a fit; the grid on the whole tracks; the scales of the search."""
    view = view_of(observation, model.fit, pull)
    stage = Stage.of(observation, pull, view)
    motions = motions_of(observation, model, pull)
    grid_rng, rough_rng = rng.spawn(2)
    grid = survey(view, motions, stage, grid_rng)
    if len(stages) == 1 and n_pulls * grid.p_value() > HOPELESS:
        return [], grid, stage
    found = _nearest(view, search(view, grid, stage))
    if len(stages) > 1:
        rough, fit = stages[0]
        view = view_of(rough, fit, pull.under(fit.law))
        rough_grid = survey(view, motions, stage, rough_rng, n_null=1)
        known = list(found)
        found += [
            f
            for f in _nearest(view, search(view, rough_grid, stage))
            if not any(_is_same(f, g, stage) for g in known)
        ]
    return found, grid, stage


def _is_same(one, other, stage):
    """Whether two candidates lead to one optimum."""
    if one.motion.kind != other.motion.kind:
        return False
    n_dims = one.motion.n_dims
    gap = one.parameters[:n_dims] - other.parameters[:n_dims]
    return bool(np.linalg.norm(gap) < SAME_PLACE * stage.size)


def _nearest(view, found):
    """The best candidate at rest, and all whose evidence is not far from the best of all."""
    if not found:
        return []
    least = found[0].cost(view)
    near = [f for f in found if f.cost(view) < least + NEAR][:MOST_FITTED]
    rest = [f for f in found if f.motion.kind == REST][:1]
    return [*near, *(f for f in rest if f not in near)]


def _explained(observation, fits, n_effective, p_value, rng, is_rough=False):
    best, pull, stage = fits[0]
    draws = draw_posterior(best, pull, stage, rng, _inflation(best), may_walk=not is_rough)
    found = best.found
    units = observation.dataset.units
    unit = units.text(observation.dataset.property_units.get(pull.column, DIMENSIONLESS))
    estimates = _estimates(observation, best, pull, draws, unit)
    said = ", ".join(
        f"{c.value:.4g} ({c.low:.4g} to {c.high:.4g}) {c.unit}".strip()
        for c in estimates[: found.motion.n_dims]
    )
    strength = estimates[-1]
    when = f" at t = {found.motion.epoch:.6g} {units.text(Unit.of(s=1))}"
    text = (
        f"a body that is not seen, {found.motion.kind}, of {pull.column} {strength.value:.4g} "
        f"({strength.low:.4g} to {strength.high:.4g}) {strength.unit}".rstrip()
        + f", at {said}"
        + ("" if found.motion.kind == REST else when)
    )
    place = ",\\ ".join(f"{c.value:.4g}" for c in estimates[: found.motion.n_dims])
    symbol = {"mass": "m", "charge": "q"}.get(pull.column, rf"\mathrm{{{pull.column}}}")
    latex = (
        rf"{symbol}_\mathrm{{hidden}} = {strength.value:.4g},\quad "
        rf"\mathbf{{p}}_\mathrm{{hidden}} = ({place})"
    )
    others = dict.fromkeys(
        f"an unseen body {f.found.motion.kind}"
        for f, _, _ in fits[1:]
        if f.bic(n_effective) - best.bic(n_effective) < MOTION_BIC
        and f.found.motion.kind != found.motion.kind
    )
    spread = _spread(best, stage, draws)
    reason = _reason(observation, best, stage, draws, spread, pull)
    return Explanation(
        kind=HIDDEN_BODY,
        name=f"an unseen body {found.motion.kind}",
        text=text,
        latex=latex,
        observation=best.observation,
        fit=best.fit,
        n_free=found.n_free,
        constants=estimates,
        reason=reason,
        is_open=reason.startswith(NOT_TOLD),
        equivalents=tuple(others),
        separated_by=(
            "a look at the place where it must be; tracks that pass nearer to it"
            + ("; a longer recording" if others else "")
        ),
        details=_details(observation, best, pull, draws, spread, p_value, unit),
    )


def _inflation(polished):
    """Variance of the whitened residual, discounted for rows that are not independent."""
    fit, found = polished.fit, polished.found
    free = len(fit.values) + found.n_free
    if fit.whole is not None:
        misfit = max(fit.chisqr / max(fit.whole.n_rows - fit.whole.n_free - found.n_free, 1), 1.0)
        return misfit * (max(fit.n_rows / fit.n_effective, 1.0) if misfit > WELL_FITTED else 1.0)
    view = polished.view
    left = view.y - found.strength * view.response(found.motion, found.parameters)[0]
    start, tops, n_tracks = 0, 0.0, 0
    for part in view.parts:
        stop = start + part.positions.size
        rows = left[start:stop].reshape(len(part.times), -1)
        tops, start = tops + float((rows[1:] * rows[:-1]).sum()), stop
        n_tracks += part.positions.shape[1]
    power = float(left @ left)
    rho = max(tops / power, 0.0) if power > 0 else 0.0
    independent = max(len(left) * (1 - rho) / (1 + rho), LEAST_ROWS * n_tracks)
    return power / max(len(left) - free, 1) * len(left) / independent


def _estimates(observation, polished, pull, draws, unit):
    """Place, velocity and strength with 90 % intervals."""
    units, found = observation.dataset.units, polished.found
    n_dims = found.motion.n_dims
    values = np.append(found.parameters, found.strength)
    low, high = draws.quantile(0.05), draws.quantile(0.95)
    names = [f"{axis}_hidden" for axis in "xyz"[:n_dims]]
    texts = [units.text(Unit.of(m=1))] * n_dims
    if len(values) > n_dims + 1:
        names += [f"v{axis}_hidden" for axis in "xyz"[:n_dims]]
        texts += [units.text(Unit.of(m=1, s=-1))] * n_dims
    return tuple(
        ConstantEstimate(name, float(v), float(min(a, v)), float(max(b, v)), text)
        for name, v, a, b, text in zip(
            [*names, f"{pull.column}_hidden"], values, low, high, [*texts, unit], strict=True
        )
    )


def _spread(polished, stage, draws):
    """How well the place is known: 90 % radius, and 90 % angle as seen from the centre."""
    motion = polished.found.motion
    places = draws.values[:, : motion.n_dims]
    radius = np.linalg.norm(places - polished.found.parameters[: motion.n_dims], axis=1)
    centre = stage.middle
    if stage.centre is not None and motion.field is not None:
        centre = motion.field.place_of(stage.centre, motion.epoch)
    seen = places - centre
    best = polished.found.parameters[: motion.n_dims] - centre
    cosine = seen @ best / (np.linalg.norm(seen, axis=1) * np.linalg.norm(best))
    angles = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    return {
        "centre": centre,
        "radius_90": float(np.quantile(radius, 0.9)),
        "angle_90_deg": float(np.quantile(angles, 0.9)),
    }


def _reason(observation, polished, stage, draws, spread, pull):
    """Why it cannot hold, or cannot be told; "" if it can."""
    found = polished.found
    if pull.is_positive and found.strength <= 0:
        return f"its {pull.column} would be below zero, which no visible body has"
    inside = _inside(observation, found)
    if inside:
        return f"it would sit inside {inside!r}, which is seen"
    if spread["radius_90"] > 0.5 * stage.size and spread["angle_90_deg"] > WIDE:
        return f"{NOT_TOLD}: these data do not determine where it is"
    low, high = (draws.quantile(q)[-1] for q in (0.05, 0.95))
    if low <= 0 <= high or abs(high) > OPEN * abs(low):
        return f"{NOT_TOLD}: its {pull.column} is open by more than a factor of {OPEN:g}"
    return ""


def _inside(observation, found):
    """Name of a visible body within whose radius the source would come, or ""."""
    for scene in observation.train:
        places = found.motion(found.parameters, scene.times)[0][0]
        gap = np.linalg.norm(scene.positions - places[:, None], axis=-1)
        for k, entity in enumerate(scene.entities):
            if np.isfinite(entity.radius) and np.nanmin(gap[:, k]) < entity.radius:
                return entity.name
    return ""


def _details(observation, polished, pull, draws, spread, p_value, unit):
    """For the report and its map, JSON-able."""
    found = polished.found
    motion = found.motion
    scene = max(observation.train, key=lambda s: len(s.times))
    rows = np.unique(np.linspace(0, len(scene.times) - 1, SHOWN_ROWS).astype(int))
    own = motion(found.parameters, scene.times[rows])[0][0]
    names = [c.name for c in _estimates(observation, polished, pull, draws, unit)]
    return {
        "p_value": p_value,
        "motion": motion.kind,
        "epoch": motion.epoch,
        "property": pull.column,
        "unit": unit,
        "length_unit": observation.dataset.units.text(Unit.of(m=1)),
        "names": names,
        "best": np.append(found.parameters, found.strength).tolist(),
        "mean": draws.mean.tolist(),
        "sd": draws.sd.tolist(),
        "draws": draws.values.tolist(),
        "method": draws.method,
        "n_eff": draws.n_eff,
        "notes": list(draws.notes),
        "centre": np.asarray(spread["centre"]).tolist(),
        "radius_90": spread["radius_90"],
        "angle_90_deg": spread["angle_90_deg"],
        "track": own.tolist(),
        "visible": {
            name: [[None if np.isnan(x) else float(x) for x in p] for p in scene.positions[rows, k]]
            for k, name in enumerate(scene.names)
        },
    }
