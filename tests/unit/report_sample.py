"""Loop reports made up by formulas, one of every kind that a run can end with."""

import math
from dataclasses import asdict, fields, is_dataclass, replace

import numpy as np
import pandas as pd

from bsp_gp.fitting.estimates import ConstantEstimate, Errors
from bsp_gp.language.inputs import input_types
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.accounts import Ratio
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.outcome import Effect, LoopReport, Missing, Overlay, RoundRecord
from bsp_gp.loop.trace import Channel, Trace
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.metrics import METRICS

NAN = math.nan
DRAG = r"-{c}_{1}\,\mathbf{v}_i\,\left\|\mathbf{v}_i\right\|"
GRAVITY = r"9.81\,[\mathrm{m/s^2}]\,m_i\,\left(-\hat{\mathbf{u}}\right)"
RATIO = Ratio(0.18, 0.15, 0.22, "resampled")
RATIOS = dict.fromkeys(METRICS, RATIO)
HOSTILE = '<script>alert("x")</script>&$\\frac{'


def errors(scale, unit="m", acceleration_unit="m/s^2"):
    found = Errors(0.9 * scale, 0.01 * scale, 1.1 * scale, 1.9 * scale, unit, 2.2 * scale,
                   acceleration_unit)
    sizes = {metric: getattr(found, metric) for metric in METRICS}
    return replace(found, intervals={m: (0.8 * v, 1.3 * v) for m, v in sizes.items()})


def overlays_2d(n_scenes=4):
    out = []
    for s in range(n_scenes):
        rng = np.random.default_rng(s)
        t = np.arange(0, 3, 0.05)
        x, y = (3 + s) * t, 12 * t - 4.9 * t**2
        true = np.stack([x - 0.4 * t**2, y - 0.35 * t**2], axis=-1)
        observed = true + rng.normal(0, 0.05, true.shape)
        observed[20] = NAN
        out.append(Overlay(f"throw_{s}", "ball", t, observed, np.stack([x, y], -1), true, 6))
    return tuple(out)


def residual_table(n_rows=6000, entities=("ball",)):
    rng = np.random.default_rng(7)
    t = np.linspace(0, 3, n_rows)
    speed = 4 + 9 * np.abs(np.sin(t * 3)) + rng.normal(0, 0.2, n_rows)
    before = np.abs(0.1 * speed**2 / 4 + rng.normal(0, 0.3, n_rows))
    after = np.abs(rng.normal(0, 0.3, n_rows))
    return residuals(
        [f"throw_{k % 4}" for k in range(n_rows)],
        [entities[k % len(entities)] for k in range(n_rows)],
        ["test" if k % 3 == 0 else "train" for k in range(n_rows)],
        t, speed, np.full(n_rows, NAN), before, after, -before, after * np.sign(t - 1),
    )  # fmt: skip


def residuals(*columns):
    names = ("scene", "entity", "split", "t", "speed", "distance", "before", "after",
             "before_along", "after_along")  # fmt: skip
    return pd.DataFrame(dict(zip(names, columns, strict=True)))


def row(number, code, law, evidence, probability, gain=NAN):
    return {
        "id": number, "code": code, "law": law, "source": "laws" if number else "",
        "status": "converged", "log_evidence": evidence,
        "held_out": {"gain": gain, "se": 3.0, "promised": 400.0}, "p_value": 0.00201,
        "probability": probability,
    }  # fmt: skip


ROWS = (
    row(0, "base", "", -3000.0, 0.0), row(1, "law", "c1 * v_i * norm(v_i)", -2510.0, 0.86, 380.0),
    row(2, "law", "c1 * v_i", -2541.3, 0.1, 310.0),
    row(3, "scale", "x = (1 + scale) X", -2600.0, NAN),
)  # fmt: skip
TRACE = Trace(
    (Channel("along", "speed", 3, 3, 970.0, 1e-200, 0.97, 470.0),
     Channel("e_x", "", 1, 1, 9.0, 0.003, 0.01, 1.0)),
    (2.0, 6.0, 12.0), (-0.1, -0.9, -3.6), (0.1, 0.1, math.inf),
)  # fmt: skip
FINDING = {"code": "autocorrelation", "p_value": 1e-5, "scene": "", "entity": "", "row": -1}
BOUND = {"snr": 2.5, "force": 0.0124, "unit": "kg m/s^2", "percent": 0.31}


def adopted():
    """Drag found, then nothing left; one constant for all and one for every entity."""
    names = [f"ball {k:02d}" for k in range(14)]
    own = tuple(
        ConstantEstimate("c1", 0.02 * (1 + k % 7), 0.02 * (1 + k % 7) - 0.004,
                         0.02 * (1 + k % 7) + 0.005, "kg/m", name)
        for k, name in enumerate(names)
    )
    shared = (ConstantEstimate("g", 9.80665, 9.79123, 9.82211, "m/s^2"),)
    effect = Effect(
        "drag, quadratic in speed", "law", "field", "c1 * v_i * norm(v_i)", DRAG, tuple(names), own,
        0.00201, 0.86, ("c1 * v_i * norm(v_i)^1.1", "c1 * R_i * v_i * norm(v_i)"),
    )  # fmt: skip
    held_out = tuple({"scene": f"throw_{k}", "before": 6.1 + k, "after": 1.12} for k in range(4))
    first = RoundRecord(
        1, Missing(8.31, 0.0, 0.0213, "m/s^2"), effect, ROWS, True, "effect adopted", "adopted",
        errors(5.55), errors(1.0), errors(0.27), RATIO, held_out, (), (FINDING,), BOUND,
        "All 75,816 laws up to depth 5 were tried.\n12 rules masked.", 41.2, TRACE,
    )  # fmt: skip
    second = RoundRecord(
        2, Missing(1.03, 0.31, 0.0193, "m/s^2"), None, ROWS[:1], False, "nothing missing",
        "not_significant", errors(1.0), None, errors(0.27), Ratio(), (), (), (), BOUND, "", 0.4,
    )  # fmt: skip
    return LoopReport(
        dataset={"name": "Thrown balls", "n_scenes": 16, "n_rows": 960, "n_entities": 14,
                 "n_dims": 2, "up": None,
                 "train": ["a"] * 12, "test": ["b"] * 4, "provenance": {"source": "made up"},
                 "fingerprint": "sha256:3fa9", "split": "no split declared",
                 "units": {"length": "m", "time": "s"}, "symbols": {},
                 "notes": ["3 rows of throw_2 were dropped: y is empty (lines 40 to 42)."]},
        declared=({"law": "g * m_i * down", "latex": GRAVITY},),
        grammar={"name": "newtonian", "fingerprint": "sha256:77aa"}, search="exhaustive", seed=7,
        criteria=asdict(Criteria()),
        noise={"sigma": [0.05, 0.051], "unit": "m", "source": "quoted", "method": ""},
        rounds=(first, second), law=ForceLaw(),
        law_text="9.80665 [m/s^2] * m_i * down + -c1 * v_i * norm(v_i)",
        law_latex=r"\mathbf{F}_i = " + GRAVITY + " + " + DRAG, constants=shared + own,
        total={"before": errors(5.55), "after": errors(1.0), "floor": errors(0.27),
               "ratio": RATIO, "ratios": RATIOS},
        verdict="effect adopted", probability=0.86, equivalents=effect.equivalents,
        stop_reason="nothing_left", left_out=(), n_fits=4,
        hidden_bound=BOUND,
        versions={"bsp_gp": "0.1.0", "numpy": "2.4.6"}, wall_s=41.63, overlays=overlays_2d(),
        residuals=residual_table(entities=tuple(names)),
        extras=({"title": "Decomposition of the residual",
                 "paragraphs": ["Most of it lies against the velocity."],
                 "table": [["channel", "share"], ["along the velocity", 0.94], ["across", 0.03]]},),
    )


def nothing_missing():
    full = adopted()
    only = replace(full.rounds[1], number=1, before=errors(0.28), floor=errors(0.27))
    return replace(
        full, rounds=(only,), verdict="nothing missing", constants=full.constants[:1],
        law_text="9.80665 [m/s^2] * m_i * down", law_latex=r"\mathbf{F}_i = " + GRAVITY,
        total={"before": errors(0.28), "after": errors(0.28), "floor": errors(0.27),
               "ratio": Ratio(1.0, 1.0, 1.0), "ratios": {}},
        extras=(),
    )


def seen_not_adopted():
    full = adopted()
    effect = replace(full.rounds[0].effect, constants=(
        ConstantEstimate("c1", 0.02, 0.01, 0.05, "kg/m"),), entities=("ball 01",), p_value=0.003,
        formula=parse_formula("c1 * v_i * norm(v_i)", input_types({})))
    only = replace(full.rounds[0], effect=effect, adopted=False, verdict="seen, not adopted",
                   reason="held_out_refuses",
                   after=errors(5.2), ratio=Ratio(0.94, 0.88, 1.03))
    return replace(
        full, rounds=(only,), verdict="seen, not adopted", constants=full.constants[:1],
        total={"before": errors(5.55), "after": errors(5.55), "floor": errors(0.27),
               "ratio": Ratio(1.0, 1.0, 1.0), "ratios": {}},
        stop_reason="nothing_adopted", overlays=full.overlays[:1], residuals=None,
    )


def cannot_tell():
    full = adopted()
    only = replace(full.rounds[0], effect=None, adopted=False, verdict="cannot tell", after=None,
                   ratio=Ratio(), missing=Missing(1.4, 0.002, NAN),
                   before=errors(5.0, "px", "px/s^2"), floor=errors(NAN, "px", "px/s^2"),
                   reason="time_is_up", trace=None, hidden_bound=None, noise_findings=())
    return replace(
        full, rounds=(only,), verdict="cannot tell", constants=(), residuals=None, overlays=(),
        noise={"sigma": None, "unit": "px", "source": "unknown"},
        total={"before": only.before, "after": only.before, "floor": only.floor, "ratio": Ratio(),
               "ratios": {}},
        stop_reason="time_is_up", left_out=("fits",), hidden_bound=None,
    )


def orbit():
    """Mercury: three dimensions, models alike in a picture of the whole orbit, large numbers."""
    full = adopted()
    t = np.linspace(6.0e8, 6.0e8 + 2.0e8, 400)
    angle = 2 * np.pi * t / 7.6e6
    position = 5.8e10 * np.stack([np.cos(angle), np.sin(angle), 0.12 * np.sin(angle)], axis=-1)
    along = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=-1)
    drift = ((t - t[0]) / 2e8)[:, None]
    rng = np.random.default_rng(2)
    observed = position + rng.normal(0, 30.0, position.shape)
    overlays = (
        Overlay("sun", "Mercury", t, observed, position + 3e5 * drift * along,
                position + 80.0 * drift * along, 40),
        Overlay("sun", "Venus", t, 1.9 * observed, 1.9 * position + 2e4 * drift * along,
                1.9 * position + 60.0 * drift * along, 40),
    )
    n = len(t)
    table = residuals(["sun"] * n, ["Mercury"] * n, ["test"] * n, t,
                          4.8e4 + 1e4 * np.sin(angle), 5.8e10 * (1 + 0.2 * np.cos(angle)),
                          1e-8 * (1 + np.cos(angle) ** 2),
                          np.abs(rng.normal(0, 2e-11, n)), np.zeros(n), np.zeros(n))
    effect = replace(full.rounds[0].effect, name="inverse-cube attraction", kind="pair",
                     formula=None, code="hidden_body",
                     law="c1 * m_i / norm(p_j - p_i)^3 * normalize(p_j - p_i)",
                     entities=("Mercury",),
                     latex=r"\sum_{j\ne i} \frac{c_{1}\,m_i}{{r}_{ij}^{3}}\,\hat{\mathbf{r}_{ij}}",
                     constants=(ConstantEstimate("c1", 3.521e28, 3.48e28, 3.56e28, "m^4/s^2"),))
    before, after, floor = (errors(s, "m", "m/s^2") for s in (2.4e5, 71.0, 31.0))
    before, after, floor = (
        replace(e, residual_acceleration=a)
        for e, a in ((before, 1.4e-8), (after, 2.1e-11), (floor, 2.0e-11))
    )
    ratio = Ratio(0.000296, 0.000251, 0.000344)
    first = replace(full.rounds[0], effect=effect, before=before, after=after, floor=floor,
                    ratio=ratio, hypotheses=(), held_out=(), trace=None)
    return replace(
        full, dataset={**full.dataset, "name": "Inner planets"}, rounds=(first,), overlays=overlays,
        residuals=table, noise={"sigma": 30.0, "unit": "m", "source": "quoted"},
        law_text="GM * m_i / norm(p_j - p_i)^2 * normalize(p_j - p_i) + " + effect.law,
        law_latex=r"\mathbf{F}_i = \sum_{j\ne i} \frac{1.3271244\times 10^{20}\,"
        r"[\mathrm{m^3/s^2}]\,m_i}{{r}_{ij}^{2}}\,\hat{\mathbf{r}_{ij}} + " + effect.latex,
        constants=(ConstantEstimate("GM", 1.32712440018e20, 1.32712440010e20, 1.32712440026e20,
                                    "m^3/s^2"), *effect.constants),
        total={"before": before, "after": after, "floor": floor, "ratio": ratio, "ratios": {}},
        extras=(),
    )


def _spoiled(value):
    if is_dataclass(value) and not isinstance(value, ForceLaw):
        return replace(value, **{f.name: _spoiled(getattr(value, f.name)) for f in fields(value)})
    if isinstance(value, dict):
        return {k: _spoiled(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(_spoiled(v) for v in value)
    if isinstance(value, np.ndarray):
        return np.full_like(value, NAN, dtype=float)
    if isinstance(value, pd.DataFrame):
        return value.assign(**{k: NAN for k in value.select_dtypes("number")})
    return NAN if isinstance(value, float) else value


def all_nan():
    """The report of drag with nan for every number that is not a count."""
    return _spoiled(adopted())


CODES = ("verdict", "reason", "stop_reason", "left_out", "code", "kind", "method", "status",
         "direction", "variable", "split", "train", "test")  # fmt: skip


def _hostile(value):
    if is_dataclass(value) and not isinstance(value, ForceLaw):
        own = {f.name: getattr(value, f.name) for f in fields(value)}
        return replace(value, **{k: v if k in CODES else _hostile(v) for k, v in own.items()})
    if isinstance(value, dict):
        return {k: v if k in CODES else _hostile(v) for k, v in value.items()}
    if isinstance(value, tuple | list):
        return type(value)(_hostile(v) for v in value)
    return value + HOSTILE if isinstance(value, str) else value


def hostile():
    """The report of drag with markup in every text that is no code."""
    return _hostile(adopted())


ALL = {f.__name__: f for f in (adopted, nothing_missing, seen_not_adopted, cannot_tell, orbit,
                               all_nan, hostile)}
