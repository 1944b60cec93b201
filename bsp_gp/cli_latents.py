"""The commands with unknown properties: ``infer`` and ``fit --latent``."""

import json
from io import BytesIO

from bsp_gp.data.declaration import PRIOR_FORMS, split_prior
from bsp_gp.errors import SettingsError

MOST_TOGETHER = 30
"""Unknowns up to this number are sampled together with the constants of a law."""
PRIOR_HELP = (
    ", ".join(f"mass={form}" for form in PRIOR_FORMS)
    + "; numbers in the data's unit of the property"
)


def read_priors(pairs, dataset):
    """Priors of ``--prior NAME=KIND:...``, SI.

    Raises
    ------
    SettingsError
        If one cannot be read.
    """
    from bsp_gp.data.conversion import Conversion
    from bsp_gp.inference.priors import Prior

    out = {}
    declared = dict(dataset.units.declared)
    for name, text in pairs or ():
        scale = Conversion(declared, {*declared, name}).property(name)[0]
        try:
            said = split_prior(text)
            kind, values = said.pop("prior"), said.pop("values", ())
            numbers = {key: value * scale for key, value in said.items()}
            out[name] = Prior(kind, **numbers, values=[value * scale for value in values])
        except (ValueError, IndexError):
            raise SettingsError(
                f"--prior {name}={text}: cannot be read; write {PRIOR_HELP}"
            ) from None
        except SettingsError as error:
            raise SettingsError(f"--prior {name}={text}: {error}") from None
    return out


def with_declared_latents(args, dataset):
    """The data set with the unknowns of the options in the place of, or beside, its own."""
    from dataclasses import replace

    from bsp_gp.data.scene import LatentDeclaration

    declared = {d.name: d for d in dataset.latents}
    priors = read_priors(args.prior, dataset)
    for name, prior in priors.items():
        old = declared.get(name, LatentDeclaration(name))
        ends = {} if prior.is_discrete else {"low": prior.low, "high": prior.high}
        declared[name] = replace(
            old, prior=prior.kind, values=prior.values, mean=prior.mean, sd=prior.sd, **ends
        )
    for option, key in (("entities", "entities"), ("share", "share")):
        for name, text in getattr(args, option) or ():
            value = tuple(text.split(",")) if key == "entities" else text
            declared[name] = replace(declared.get(name, LatentDeclaration(name)), **{key: value})
    chosen = args.latent or list(declared)
    missing = [name for name in chosen if name not in declared]
    if missing:
        raise SettingsError(
            f"--latent {missing[0]}: it has no prior; give --prior {missing[0]}=uniform:LOW:HIGH "
            f"or [latent.{missing[0]}] in dataset.toml"
        )
    return replace(dataset, latents=tuple(declared[name] for name in chosen))


def _problem(args, dataset, rng, **settings):
    from dataclasses import replace

    from bsp_gp.inference.problem import latent_problem

    tracks = args.likelihood in ("auto", "track")
    problem = latent_problem(
        with_declared_latents(args, dataset), rng=rng,
        kind="auto" if tracks else args.likelihood.replace("-", "_"),
        noise=dataset.noise if args.noise is not None else None, **settings,
    )  # fmt: skip
    return replace(problem, likelihood=replace(problem.likelihood, reads_tracks=tracks))


def _e_step(args):
    from bsp_gp.inference.e_step import EStep

    return EStep(args.e_step, n_eff=args.n_eff, max_steps=args.max_steps, keep_chain=True)


def run_infer(args, dataset, laws, progress):
    """Posterior of the unknowns (and named constants) under a given law.

    Returns
    -------
    text : str
    data : dict
    files : dict of str to str or bytes
    """
    from dataclasses import replace

    import numpy as np

    from bsp_gp.fitting.hypothesis import declared_law
    from bsp_gp.inference.e_step import infer, refine
    from bsp_gp.inference.identifiability import identifiability
    from bsp_gp.inference.profile import fit_profile

    rng = np.random.default_rng(args.seed)
    split_rng, start_rng, sample_rng, draw_rng = rng.spawn(4)
    problem = _problem(args, dataset, split_rng, everything=not args.train, test=False)
    if problem.likelihood.reads_tracks:
        problem = replace(problem, likelihood=problem.likelihood.for_posterior)
    law = declared_law(problem.dataset, laws)
    settings = _e_step(args)
    misfit = problem.likelihood.misfit(law, problem.latents, problem.train)
    is_discrete = bool(problem.latents.is_discrete.any())
    known = None
    if law.names or not is_discrete:
        progress("joint optimum of unknowns and constants")
        starts = problem.latents.sample(settings.n_starts, rng=start_rng)
        profile = misfit.reference.profile if misfit.reference else fit_profile(misfit, starts)
        law = profile.law
    progress("sampling the posterior")
    together = bool(law.names) and len(problem.latents) <= MOST_TOGETHER and not is_discrete
    extra = []
    if law.names and not together:
        why = (
            "discrete unknowns are not sampled"
            if is_discrete
            else f"{len(problem.latents)} unknowns are too many to sample"
        )
        extra.append(
            f"{why} together with the constants: these stand at their joint optimum, and "
            "intervals leave their errors out"
        )
    if together:
        posterior = refine(
            profile, problem.train, problem.latents, problem.likelihood, rng=sample_rng,
            settings=settings, misfit=misfit,
        )  # fmt: skip
    else:
        posterior = infer(
            law, problem.train, problem.latents, problem.likelihood, rng=sample_rng,
            settings=settings,
        )  # fmt: skip
    if not is_discrete:
        known = identifiability(profile, problem.latents, posterior)
    notes = [*dataset.notes, *problem.notes, *extra, *posterior.notes]
    data = {
        "schema": "bsp_gp/infer/1", "dataset": dataset.name, "law": law.text(), "seed": args.seed,
        "likelihood": problem.likelihood.kind, "posterior": posterior.to_dict(),
        "not_determined": known.text().splitlines() if known else [], "notes": notes,
    }  # fmt: skip
    text = "\n".join(
        [f"law: F_i = {law.text()}", "", _table(posterior), ""]
        + ([f"Identifiability: {line}" for line in known.text().splitlines()] if known else [])
        + [f"Note: {note}" for note in notes]
    )
    files = _posterior_files(posterior) if args.out else {}
    if args.out:
        progress("figures")
        files |= _figures(law, problem, posterior, draw_rng, args)
        files |= {"infer.json": _json(data), "infer.txt": f"{text}\n"}
    return text, data, files


def run_learn(args, dataset, laws, progress):
    """EM: a law and the unknowns together.

    Returns
    -------
    text, data, files
        As `run_infer`.
    """
    import numpy as np

    from bsp_gp.cli_inputs import masked_grammar
    from bsp_gp.fitting.hypothesis import declared_law
    from bsp_gp.inference.e_step import EStep, infer
    from bsp_gp.inference.em import EmSettings, fit_em
    from bsp_gp.inference.identifiability import identifiability
    from bsp_gp.inference.m_step import Exhaustive
    from bsp_gp.inference.prediction import posterior_nrmse
    from bsp_gp.language.grammar import load_grammar
    from bsp_gp.physics.force import ForceLaw

    rng = np.random.default_rng(args.seed)
    split_rng, em_rng, test_rng, draw_rng = rng.spawn(4)
    problem = _problem(args, dataset, split_rng)
    grammar, _ = masked_grammar(load_grammar(args.grammar), problem.dataset)
    base = declared_law(problem.dataset, laws) if laws else ForceLaw()
    kinds = [k for k in grammar.start if k != "pair" or problem.likelihood.sources]
    settings = EmSettings.for_noise(problem.likelihood, n_starts=args.starts, final=_e_step(args))
    em = fit_em(
        problem.train, problem.latents, grammar, problem.likelihood, rng=em_rng, settings=settings,
        m_step=Exhaustive(max_levels=args.max_levels), base=base, kinds=kinds, progress=progress,
    )  # fmt: skip
    known = "" if problem.latents.is_discrete.any() else identifiability(
        em.best.profile, problem.latents, em.joint or em.posterior
    ).text()  # fmt: skip
    scores = {}
    if problem.test:
        progress("held-out scenes")
        likelihood = problem.likelihood.for_posterior
        held = infer(
            em.law, problem.test, problem.test_latents, likelihood, rng=test_rng,
            settings=EStep("laplace" if not problem.test_latents.is_discrete.any() else "auto"),
        )  # fmt: skip
        draws = held.draw(100, rng=draw_rng)
        for label, law in (("found", em.law), ("zero force", ForceLaw())):
            errors = posterior_nrmse(law, problem.test, problem.test_latents, draws, up=dataset.up)
            scores[label] = float(errors.mean())
    members = em.equivalents()
    notes = [*dataset.notes, *problem.notes, *em.notes]
    data = {
        "schema": "bsp_gp/learn/1", "dataset": dataset.name, "grammar": grammar.name,
        "seed": args.seed, "law": em.law.text(), "latex": em.law.latex(), "loss": em.best.loss,
        "not_separable": [c.law.text() for c in members if c is not em.best]
        + [repr(t)[1:-1] for t in em.best.ties],
        "posterior": em.posterior.to_dict(),
        "joint": em.joint.to_dict() if em.joint is not None else None,
        "not_determined": known.splitlines(), "one_step_nrmse": scores,
        "trace": [
            {"start": s.start, "iteration": s.iteration, "law": s.law_text, "loss": _number(s.loss),
             "expected_log_joint": _number(s.expected_log_joint), "n_scored": s.n_scored}
            for s in em.trace
        ],
        "n_scored": em.n_scored, "notes": notes,
    }  # fmt: skip
    lines = [em.text(), *(f"Identifiability: {line}" for line in known.splitlines())]
    lines += [f"one-step nRMSE on held-out scenes, {k}: {v:.4g}" for k, v in scores.items()]
    text = "\n".join(lines + [f"Note: {note}" for note in (*dataset.notes, *problem.notes)])
    files = {}
    if args.out:
        progress("figures")
        best = em.joint if em.joint is not None else em.posterior
        files = _posterior_files(best) | _figures(em.law, problem, best, draw_rng, args)
        files |= {
            "learn.json": _json(data), "learn.txt": f"{text}\n",
            "trace.csv": _csv(data["trace"]),
            "laws.csv": _csv([
                {"law": c.law.text(), "loss": c.loss, "complexity": c.complexity,
                 "has_latent": c.has_latent} for c in em.contenders
            ]),
        }  # fmt: skip
    return text, data, files


def _number(value):
    return value if value == value and abs(value) != float("inf") else None


def _table(posterior):
    table = posterior.summary().drop(columns="truth")
    return table.to_string(float_format=lambda value: f"{value:.4g}")


def _json(data):
    return json.dumps(data, indent=1, ensure_ascii=False) + "\n"


def _csv(rows):
    import pandas as pd

    from bsp_gp.data.cells import safe_table

    return safe_table(pd.DataFrame(rows)).to_csv(index=False)


def _posterior_files(posterior):
    import pandas as pd

    from bsp_gp.data.cells import safe_table

    draws = pd.DataFrame(posterior.draws, columns=list(posterior.names))
    draws["weight"] = posterior.weights
    draws["log_prob"] = posterior.log_prob
    return {
        "posterior.csv": safe_table(posterior.summary()).to_csv(),
        "draws.csv": safe_table(draws).to_csv(index=False),
    }


def _figures(law, problem, posterior, rng, args):
    from bsp_gp.inference.prediction import predictive_bands
    from bsp_gp.report.posterior import corner_figure, rollout_figure, trace_figure

    euler = not problem.likelihood.is_gls or problem.likelihood.velocities == "backward"
    bands = predictive_bands(
        law, problem.train[0], problem.latents, posterior, rng=rng, up=problem.dataset.up,
        integrator="euler" if euler else "rk4",
    )  # fmt: skip
    return {
        "trace.png": _png(trace_figure, posterior), "corner.png": _png(corner_figure, posterior),
        "rollout.png": _png(rollout_figure, bands),
    }  # fmt: skip


def _png(draw, what):
    out = BytesIO()
    draw(what, out)
    return out.getvalue()
