"""Machines that a declared model does not know whole: rods, wires, frames, logs, spins, by scipy.

Every kind is what people film or log, with its constraint, coordinate or input declared, and lacks
one effect, as strong as makes its signal-to-noise ratio the one asked for (defined as in
`power.py`). Counted is whether the effect is named, whether it is in the class that is told of, and
whether one name is given alone and is not true.
"""

import time
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from causes import causes_of, is_adopted
from common import of_share, options, run_jobs, take_share, write_study
from power import ALPHA, seen_against, strength_at
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset
from bsp_gp.errors import BspError
from bsp_gp.fitting.hypothesis import read_torque
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.close import close_loop
from bsp_gp.physics.bodies import dataset_types, stack
from bsp_gp.physics.force import ForceLaw, Term
from bsp_gp.physics.masses import with_usable_masses

SNRS = (30.0, 10.0)
N_SEEDS = 20
MAX_ROUNDS = 3
QUICK = ("cart with drag", "late thrust", "spin by scene")
G, MASS = 9.81, 0.5
CREEP = 1e-3
"""Speed below which dry friction fades, so that an integrator can stop a body."""
SAME, SIMILAR = 2e-3, 0.1
"""Part of the squared force by which a form, and a form with inner constants, may miss it."""
WEIGHT = "9.81 [m/s^2] * m_i * down"
METRES = {"length": "m", "time": "s", "mass": "kg"}


# --- machines: what moves, (states, missing accelerations) from a strength -----------------------


@dataclass(frozen=True)
class Kind:
    """A machine and what it lacks.

    Attributes
    ----------
    declared : tuple of str
    draw : callable
        ``draw(rng)`` gives the numbers of one scene.
    rate : callable
        ``rate(t, z, n, s)`` of a state (places, rates), of a strength.
    missing : callable
        ``missing(t, z, n, s)``: the undeclared part of the rates' rates, (q,) for (q,) places.
    strength : float
        To begin with.
    shown : callable or None
        Places and velocities (2, T, d) of states; None = the states themselves.
    logged : callable
        ``logged(t, n)``: further columns.
    properties : callable
        ``properties(n)``: of the body.
    codes : tuple of str
        Of causes that are right whatever they say.
    says : str
        What the text of a right cause has, where its form has constants inside.
    is_similar : bool
        Whether such a form is only like what is missing.
    is_held, hub : bool
        Whether forces act along the track only; whether a post stands at the origin.
    units : tuple of (str, str)
        Of further columns.
    """

    declared: tuple
    draw: object
    rate: object
    missing: object
    strength: float
    shown: object = None
    logged: object = lambda t, n: {}
    properties: object = lambda n: {}
    codes: tuple = ()
    says: str = ""
    is_similar: bool = False
    is_held: bool = False
    hub: bool = False
    units: tuple = ()
    n_scenes: int = 3
    n_rows: int = 120
    dt: float = 0.025
    sigma: float = 2e-3


def _waves(t, n, rates, offset):
    return offset + sum(
        a * np.sin(w * t + n["phase"] * (k + 1)) for k, (a, w) in enumerate(rates)
    )


def _thrust(t, n):
    t = np.clip(t, 0.0, n["end"])
    return _waves(t, n, ((1.2, 2.3), (0.6, 6.1)), MASS * G)


def _wind(t, n):
    return np.stack([2.0 * np.cos(1.3 * t + n["phase"]), 0.6 * np.sin(0.9 * t + n["phase"])])


def _motor(t, n):
    return _waves(t, n, ((0.8, 2.9), (0.4, 5.3)), 0.0)


def _norm(v):
    return np.sqrt((v * v).sum(axis=0))


def _linear(t, z, n, s):
    return -s * z[len(z) // 2 :]


def _quadratic(t, z, n, s):
    v = z[len(z) // 2 :]
    return -s * _norm(v) * v


def _dry(t, z, n, s):
    v = z[len(z) // 2 :]
    return -s * v / np.sqrt(_norm(v) ** 2 + CREEP**2)


def _flight(known=lambda t, z, n: np.zeros(2)):
    """The rate of a body in the plane: weight, what is known, what is missing."""

    def rate(missing):
        def of(t, z, n, s):
            return np.concatenate([z[2:], [0, -G] + known(t, z, n) + missing(t, z, n, s)])

        return of

    return rate


def _thrown(rng):
    return {"start": [0, 0, *rng.uniform((-3, 3), (3, 6))], "phase": rng.uniform(0, 6)}


def _hovering(rng):
    return {"start": [0, 1, *rng.uniform(-1, 1, 2)], "phase": rng.uniform(0, 6), "end": 2.975}


def _swinging(rng):
    """Of a pendulum: an arc length and its rate."""
    return {"start": [rng.uniform(0.5, 1.3) * 0.8, rng.uniform(-0.5, 0.5)]}


def _pendulum(t, z, n, s):
    return np.array([-G * np.sin(z[0] / 0.8)])


def _on_rod(z):
    """Of an arc length."""
    angle = z[0] / 0.8
    along = np.stack([np.cos(angle), np.sin(angle)])
    return np.stack([0.8 * np.stack([np.sin(angle), -np.cos(angle)]), z[1] * along])


def _as_angle(z):
    zero = np.zeros_like(z[0])
    return np.stack([np.stack([z[0], zero]), np.stack([z[1], zero])])


def _on_wire(z):
    """Of a place x on y = 0.6 x^2."""
    x, v = z
    return np.stack([np.stack([x, 0.6 * x * x]), np.stack([v, 1.2 * x * v])])


def _bead(t, z, n, s):
    """Lagrange's equation of a bead on y = 0.6 x^2, and the drag along it."""
    x, v = z
    metric = 1 + (1.2 * x) ** 2
    return np.array([v, -(1.44 * x * v * v + G * 1.2 * x) / metric - s * v])


def _on_incline(slope):
    way = np.array([1.0, slope]) / np.hypot(1.0, slope)
    return lambda z: np.stack([way[:, None] * z[0], way[:, None] * z[1]])


def _along(pull):
    """A motion along one coordinate under a steady or a known pull."""

    def rate(missing):
        return lambda t, z, n, s: np.concatenate(
            [z[1:], np.atleast_1d(pull(t, z, n, s)) + missing(t, z, n, s)]
        )

    return rate


def _spun(t, z, n, s):
    v = z[2:]
    return s * n["spin"] * np.stack([-v[1], v[0]])


def _against_wind(t, z, n, s):
    past = z[2:] - _wind(t, n)
    return -s * _norm(past) * past


def _late(t, z, n, s):
    push = (_thrust(t - s, n) - _thrust(t, n)) / MASS
    return np.stack([np.zeros_like(push), push])


def _lighter(t, z, n, s):
    push = _thrust(t, n) / MASS * (1 / (1 - s * t) - 1)
    return np.stack([np.zeros_like(push), push])


def _lifted(t, z, n, s):
    push = s * ((t > 1.1) & (t < 1.9))
    return np.stack([np.zeros_like(push), push])


def _turned(t, z, n, s):
    x, v = z[:2], z[2:]
    return s * s * x + 2 * s * np.stack([v[1], -v[0]])


def _pushed_up(t, z, n):
    return np.array([0.0, _thrust(t, n) / MASS])


THRUST = (WEIGHT, "thrust * up")
LOG = {"logged": lambda t, n: {"thrust": _thrust(t, n)}, "units": (("thrust", "N"),)}
SLOPE = 0.4
DOWN = -G * SLOPE / np.hypot(1, SLOPE)
ROD = {"declared": (WEIGHT, "norm(p_i - (0, 0)) = 0.8"), "draw": _swinging, "shown": _on_rod,
       "is_held": True}  # fmt: skip
ARM = {"declared": ("-k * m_i * sin(theta_i)",), "draw": lambda rng: {
    "start": [rng.uniform(0.6, 1.4), rng.uniform(-1, 1)]}, "shown": _as_angle,
    "units": (("theta", "rad"),), "sigma": 3e-3}  # fmt: skip
RAMP = {"declared": (WEIGHT, f"y_i = {SLOPE} * x_i"), "is_held": True, "shown": _on_incline(SLOPE),
        "draw": lambda rng: {"start": [0.0, rng.uniform(3, 5)]}}  # fmt: skip


def _swung(missing):
    return _along(_pendulum)(missing)


def _armed(missing):
    return _along(lambda t, z, n, s: -12.0 * np.sin(z[0]))(missing)


KINDS = {
    "rod with linear drag": Kind(**ROD, rate=_swung(_linear), missing=_linear, strength=0.05),
    "rod with quadratic drag": Kind(
        **ROD, rate=_swung(_quadratic), missing=_quadratic, strength=0.05),
    "joint viscous": Kind(**ARM, rate=_armed(_linear), missing=_linear, strength=0.05),
    "joint dry": Kind(**ARM, rate=_armed(_dry), missing=_dry, strength=0.05),
    "wire with drag": Kind(
        (WEIGHT, "y_i = 0.6 [1/m] * x_i^2"), lambda rng: {"start": [rng.uniform(0.5, 1.0), 0.0]},
        _bead, _linear, 0.05, shown=_on_wire, is_held=True),
    "incline with friction": Kind(
        **RAMP, rate=_along(lambda t, z, n, s: DOWN)(_dry), missing=_dry, strength=0.05),
    "turntable": Kind(
        ("-4 [N/m] * (p_i - p_j)",),
        lambda rng: {"start": [*rng.uniform(0.3, 0.8, 2), *rng.uniform(-1, 1, 2)]},
        lambda t, z, n, s: np.concatenate([z[2:], -4 / MASS * z[:2] + _turned(t, z, n, s)]),
        _turned, 0.05, hub=True, codes=("frame",)),
    "lift with a jerk": Kind(
        (WEIGHT,), _thrown, _flight()(_lifted), _lifted, 0.1, is_similar=True,
        says="sign(t -"),
    "cart with drag": Kind(
        ("motor * e_x",), lambda rng: {"start": [0.0, rng.uniform(-1, 1)],
                                       "phase": rng.uniform(0, 6)},
        _along(lambda t, z, n, s: _motor(t, n) / MASS)(_linear), _linear, 0.05, shown=_as_angle,
        logged=lambda t, n: {"motor": _motor(t, n)}, units=(("motor", "N"),)),
    "thrust with wind drag": Kind(
        THRUST, _hovering, _flight(_pushed_up)(_against_wind), _against_wind, 0.02,
        logged=lambda t, n: {"thrust": _thrust(t, n), "wind_x": _wind(t, n)[0],
                             "wind_y": _wind(t, n)[1]},
        units=(("thrust", "N"), ("wind_x", "m/s"), ("wind_y", "m/s"))),
    "late thrust": Kind(
        THRUST, _hovering, _flight(_pushed_up)(_late), _late, 0.01, codes=("late_log",), **LOG),
    "spin measured": Kind(
        (WEIGHT,), lambda rng: {**_thrown(rng), "spin": rng.uniform(-9, 9)}, _flight()(_spun),
        _spun, 0.02, properties=lambda n: {"spin": n["spin"]}, units=(("spin", "1/s"),),
        n_scenes=6, n_rows=50),
    "spin by scene": Kind(
        (WEIGHT,), lambda rng: {**_thrown(rng), "spin": rng.uniform(-9, 9)}, _flight()(_spun),
        _spun, 0.02, n_scenes=6, n_rows=50),
    "mass loss": Kind(
        THRUST, _hovering, _flight(_pushed_up)(_lighter), _lighter, 0.01,
        codes=("growing",), is_similar=True, **LOG),
    "rolling disc": Kind(
        ("k * m_i * down", f"y_i = {SLOPE} * x_i"), RAMP["draw"],
        _along(lambda t, z, n, s: DOWN / 1.5)(_dry), _dry, 0.05, shown=_on_incline(SLOPE),
        is_held=True),
}  # fmt: skip


# --- data -----------------------------------------------------------------------------------------


def made(name, strength, seed):
    """Exact data of a kind, and velocities and missing accelerations, (S, T, d) each."""
    kind = KINDS[name]
    rng = np.random.default_rng((list(KINDS).index(name), seed))
    t, frames, crews, speeds, missing = kind.dt * np.arange(kind.n_rows), {}, [], [], []
    for k in range(kind.n_scenes):
        n = kind.draw(rng)
        z = solve_ivp(
            lambda t, z, n=n: kind.rate(t, np.asarray(z), n, strength), (0, t[-1]), n["start"],
            t_eval=t, rtol=1e-9, atol=1e-11, max_step=0.02,
        ).y  # fmt: skip
        places, moving = (z[:2], z[2:]) if kind.shown is None else kind.shown(z)
        lacks = kind.missing(t, z, n, strength)
        if len(lacks) == 1:  # along the track, as the rate is
            way = moving / np.where(z[1] == 0, 1.0, z[1])
            lacks = np.where(z[1] == 0, 0.0, lacks[0]) * way
        speeds.append(moving.T)
        missing.append(lacks.T)
        frames[f"s{k}"] = _table(kind, t, places, n)
        crews.append({"entity": "object", "mass": MASS, **kind.properties(n), "scene": f"s{k}"})
    has_angle = "theta" in dict(kind.units)
    units = {**METRES, **dict(kind.units)}
    if has_angle:
        units = {"length": "rad", "time": "s"}
        frames = {s: f[["t", "x"]] for s, f in frames.items()}
    bodies = pd.DataFrame(crews)
    if kind.hub:
        hubs = pd.DataFrame([
            {"entity": "hub", "mass": np.nan, "dynamic": 0, "scene": s} for s in frames
        ])  # fmt: skip
        bodies = pd.concat([bodies.assign(dynamic=1), hubs], ignore_index=True)
    data = Dataset.from_frames(
        frames, None if has_angle else bodies, units=units, up=None if has_angle else "y",
        noise=kind.sigma,
    )
    return data, np.array(speeds), np.array(missing)


def _table(kind, t, places, n):
    table = pd.DataFrame(
        {"t": t, "entity": "object", "x": places[0], "y": places[1], **kind.logged(t, n)}
    )
    if not kind.hub:
        return table
    hub = pd.DataFrame({"t": t, "entity": "hub", "x": 0.0, "y": 0.0})
    return pd.concat([table, hub], ignore_index=True)


def noisy(kind, data, rng):
    """The data with noise on what moves; an axis that does not move has none."""
    scenes = []
    for scene in data.scenes:
        positions = np.array(scene.positions)
        moves = np.ptp(positions, axis=0) > 0
        positions += kind.sigma * moves * rng.standard_normal(positions.shape)
        scenes.append(replace(scene, positions=positions))
    return replace(data, scenes=tuple(scenes))


# --- what is right --------------------------------------------------------------------------------


class Referee:
    """Compares causes with the force that is missing, along the exact motion."""

    def __init__(self, name, data, speeds, missing):
        self.kind, self.data = KINDS[name], data
        (self.batch,) = stack(with_usable_masses(data).scenes, data.up)
        receivers = self.batch.bodies.receivers
        self.velocities = np.zeros(self.batch.positions.shape)
        self.velocities[:, :, receivers[0]] = np.moveaxis(speeds, 0, 1)
        self.missing = np.moveaxis(missing, 0, 1)
        self.types = dataset_types(data)

    def is_right(self, cause):
        """Whether a cause has the form of what is missing, or its code."""
        if cause.code in self.kind.codes or self.kind.says and self.kind.says in cause.text:
            return True
        try:
            law = self._law(cause)
            b = self.batch
            with np.errstate(all="ignore"):
                own = law.acceleration(b.bodies, b.positions, self.velocities, b.times)[:, :, 0]
        except (BspError, KeyError):
            return False
        is_by_scene = "[scene]" in cause.text
        sets = range(own.shape[1]) if is_by_scene else [slice(None)]
        limit = SIMILAR if self.kind.is_similar else SAME
        return all(self._misses(own[:, s], self.missing[:, s]) < limit for s in sets)

    def _law(self, cause):
        text = (cause.law or cause.text).replace("[scene]", "")
        formula = None
        if self.data.units.is_angle:
            formula = read_torque(text, self.types, self.data.units)
        formula = formula or parse_formula(text, self.types, units=self.data.units)
        known = {name: cause.constants.get(name, 1.0) for name in formula.constants}
        return ForceLaw((Term(formula),), known)

    def _misses(self, own, true):
        """Part of a squared force that another, at its best strength, does not make up."""
        if self.kind.is_held:  # of a force what acts along the track
            v = self.velocities[:, :, self.batch.bodies.receivers[0]].reshape(own.shape)
            size = np.linalg.norm(v, axis=-1, keepdims=True)
            way = v / np.where(size > 0, size, 1.0)
            own, true = ((a * way).sum(axis=-1) for a in (own, true))
        own, true = own.ravel(), true.ravel()
        if not np.isfinite(own).all() or not own.any():
            return 1.0
        return 1 - (own @ true) ** 2 / (own @ own) / (true @ true)


def score(referee, report):
    """What of a report is right: columns of a row."""
    rounds = [
        done for done in report.rounds if causes_of(done) and done.missing.p_value <= ALPHA
    ]
    causes = [causes_of(done) for done in rounds]
    named = bool(causes) and is_adopted(rounds[0]) and referee.is_right(causes[0][0])
    in_class = named or bool(causes) and any(map(referee.is_right, causes[0]))
    alone = [
        told[0] for done, told in zip(rounds, causes, strict=True)
        if done.verdict == "effect adopted" and len(told) == 1
    ]  # fmt: skip
    return {
        "verdict": report.verdict, "adopted": any(map(is_adopted, report.rounds)),
        "told": str(causes[0][0]) if causes else "",
        "beside": "; ".join(str(cause) for cause in causes[0][1:]) if causes else "",
        "named": named, "in_class": in_class,
        "n_class": len({str(cause) for cause in causes[0]}) if causes else 0,
        "wrong_confident": bool(alone) and not any(map(referee.is_right, alone)),
    }  # fmt: skip


def work(name, snr, seed):
    """One data set: a row."""
    kind, known = KINDS[name], []

    def seen(strength):
        known[:] = made(name, strength, seed)
        return seen_against(known[0], kind.declared, "", kind.sigma)

    strength, found = strength_at(snr, kind.strength * snr / 10, seen)
    exact, *truth = known
    noise_rng, loop_rng = np.random.default_rng((2, list(KINDS).index(name), seed)).spawn(2)
    data = noisy(kind, exact, noise_rng)
    started = time.process_time()
    report = close_loop(data, kind.declared, rng=loop_rng, alpha=ALPHA, max_rounds=MAX_ROUNDS)
    seconds = time.process_time() - started
    return [{
        "kind": name, "snr": snr, "snr_found": found, "seed": seed, "strength": strength,
        **score(Referee(name, exact, *truth), report), "law": report.law_text,
        "reason": report.rounds[0].reason, "cpu_s": seconds,
    }]  # fmt: skip


# --- the study ------------------------------------------------------------------------------------


def jobs_of(quick, seed, share=1.0, kinds=KINDS):
    """The jobs, kinds in turn."""
    if quick:
        return [(name, SNRS[0], seed) for name in QUICK]
    seeds = range(seed, seed + of_share(N_SEEDS, share))
    return [(name, snr, s) for s in seeds for snr in SNRS for name in kinds]


def summary(table):
    """Rates of each kind at each ratio."""
    lines = [
        "# Machines that a declared model does not know whole\n",
        "Named: the first cause that is adopted is the right one. In class: it is among those "
        "that are said not to be told apart. Wrong and confident: one name is adopted, nothing "
        "stands beside it, and it is not true.\n",
        "| SNR | kind | sets | adopted | named | named or in class | wrong and confident "
        "| CPU s | most |", "|---" * 9 + "|",
    ]  # fmt: skip
    for snr in sorted(table["snr"].unique(), reverse=True):
        rows = table[table["snr"] == snr]
        for name, part in [*rows.groupby("kind", sort=False), ("**all**", rows)]:
            cells = [f"{snr:g}", name, str(len(part))]
            rates = ("adopted", "named", "in_class", "wrong_confident")
            cells += [f"{part[rate].mean():.0%}" for rate in rates]
            cells += [f"{part['cpu_s'].median():.0f}", f"{part['cpu_s'].max():.0f}"]
            lines.append("| " + " | ".join(cells) + " |")
    failed = table[~table["in_class"]]
    if len(failed):
        lines += ["\n## Neither named nor in the class\n",
                  "| kind | SNR | seed | verdict | told of |", "|---" * 5 + "|"]  # fmt: skip
        for row in failed.astype(object).fillna("").itertuples():
            cells = (row.kind, f"{row.snr:g}", row.seed, row.verdict, row.told)
            lines.append("| " + " | ".join(str(c).replace("|", "/") for c in cells) + " |")
    return "\n".join(lines) + "\n"


def figure(table):
    """Share named, and in the class, of every kind."""
    import matplotlib.pyplot as plt

    names = list(dict.fromkeys(table["kind"]))
    fig, ax = plt.subplots(figsize=(7.2, 0.32 * len(names) + 1.2), layout="constrained")
    for offset, (snr, rows) in zip((-0.18, 0.18), table.groupby("snr"), strict=False):
        shares = rows.groupby("kind")[["in_class", "named"]].mean().reindex(names)
        places = np.arange(len(names)) + offset
        ax.barh(places, shares["in_class"], 0.34, color="#56b4e9", alpha=0.6)
        ax.barh(places, shares["named"], 0.34, color="#0072b2" if snr > 20 else "#009e73",
                label=f"named, SNR {snr:g}")  # fmt: skip
    ax.set_yticks(range(len(names)), names, fontsize=8)
    ax.invert_yaxis()
    ax.set(xlim=(0, 1), xlabel="share of data sets (light: in the class)")
    ax.legend(fontsize=8, frameon=False, loc="lower left")
    return fig


def declare(parser):
    take_share(parser)
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS))


def main():
    args = options(__doc__.splitlines()[0], declare=declare)
    jobs = jobs_of(args.quick, args.seed, args.share, args.kinds)
    table = run_jobs(jobs, work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "mechanics")


if __name__ == "__main__":
    main()
