"""Measured motion in; a force law in symbols, with units and error bars, out.

Examples
--------
>>> import bsp_gp
>>> bsp_gp.load_grammar("newtonian").count("Force", 5)
75816
"""

import importlib

_HOMES = {
    "BspError": "bsp_gp.errors",
    "Dataset": "bsp_gp.data.scene",
    "EStep": "bsp_gp.inference.e_step",
    "EmSettings": "bsp_gp.inference.em",
    "Entity": "bsp_gp.data.scene",
    "ForceLaw": "bsp_gp.physics.force",
    "LawFit": "bsp_gp.fitting.law_fit",
    "LawRegressor": "bsp_gp.loop.estimator",
    "Likelihood": "bsp_gp.inference.likelihood",
    "LoopReport": "bsp_gp.loop.outcome",
    "Means": "bsp_gp.planning.means",
    "Posterior": "bsp_gp.inference.posterior",
    "Prior": "bsp_gp.inference.priors",
    "Scene": "bsp_gp.data.scene",
    "Term": "bsp_gp.physics.force",
    "close_loop": "bsp_gp.loop.close",
    "declared_latents": "bsp_gp.inference.latents",
    "declared_law": "bsp_gp.fitting.hypothesis",
    "discover": "bsp_gp.planning.discover",
    "fit_em": "bsp_gp.inference.em",
    "fit_law": "bsp_gp.fitting.law_fit",
    "infer": "bsp_gp.inference.e_step",
    "latents_of": "bsp_gp.inference.latents",
    "load_dataset": "bsp_gp.data.tables",
    "load_grammar": "bsp_gp.language.grammar",
    "load_means": "bsp_gp.planning.means",
    "load_report": "bsp_gp.loop.stored",
    "next_experiment": "bsp_gp.planning.plan",
    "parse_formula": "bsp_gp.language.parse",
    "register_operator": "bsp_gp.language.own_operators",
    "save_dataset": "bsp_gp.data.tables",
    "search_exhaustive": "bsp_gp.search.exhaustive",
    "simulate_law": "bsp_gp.fitting.simulation",
    "summary_text": "bsp_gp.report.summary",
    "write_report": "bsp_gp.report.folder",
}
"""Where the public names live; they are imported when first asked for (PEP 562)."""

_SPEAKING = {"LoopReport", "close_loop", "load_report"}
"""Names that give out reports: print(report) says in words what the room of reports knows."""

__all__ = [*_HOMES, "__version__"]


def __getattr__(name):
    if name == "__version__":
        from importlib.metadata import PackageNotFoundError, version

        try:
            value = version("bsp_gp")
        except PackageNotFoundError:  # a source tree that is not installed
            value = "0+source"
    elif name in _HOMES:
        value = getattr(importlib.import_module(_HOMES[name]), name)
        if name in _SPEAKING:
            importlib.import_module("bsp_gp.report.brief")
    else:
        raise AttributeError(f"module 'bsp_gp' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__():
    return sorted({*globals(), *__all__})
