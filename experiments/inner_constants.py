"""Laws with a constant inside, on noisy motion: is the form told, do intervals hold the constant?

Seven kinds, each seen at one signal-to-noise ratio (defined as in `power.py`), moved by scipy, and
a spring recorded as one column. Where nothing is declared, the noise is chosen for that ratio;
elsewhere the strength. Right: the law that is told of first is the truth, up to its constants. In
class: it is among those that are said not to be told apart, or the power that is told holds the
true one. Run again, it goes on where it was left.
"""

import re
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from causes import Cause, Judge, causes_of
from common import options, run_jobs, write_study
from foreign_layouts import LAYOUTS, Layout
from foreign_motion import Plan, moved
from power import ALPHA, seen_against, strength_at
from scenes import with_noise

from bsp_gp.data.scene import Entity
from bsp_gp.data.tables import load_dataset
from bsp_gp.loop.close import close_loop

SNR, N_SETS, N_QUICK = 30.0, 20, 1
MAX_ROUNDS = 3
N_ROWS, ROW_NOISE = 200, 0.02
"""Of the spring in one column: rows, and noise over its amplitude."""
Z_90 = 1.645
"""Standard deviations in half an interval."""

ORBITING = "orbit about a place"


def _alone(rng):
    return [[Entity("a", properties={"mass": rng.uniform(0.2, 1.5)})]]


def _by_a_post(rng):
    post = Entity("post", is_static=True)
    return [[Entity("abc"[k], properties={"mass": rng.uniform(0.2, 1.5)}), post] for k in range(3)]


def _about_the_middle(size, speed):
    """The first body starts beside the origin, the others rest in it."""

    def start(rng, n_dims, crew):
        p, v = np.zeros((len(crew), n_dims)), np.zeros((len(crew), n_dims))
        turn = rng.uniform(0, 2 * np.pi)
        out, ahead = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        p[0] = size * rng.uniform(0.8, 1.2) * out
        v[0] = speed * rng.uniform(0.7, 1.2) * ahead
        return p, v

    return start


def _bare(start, crew, span, sigma=0.01):
    return Layout(lambda d: (), lambda at: np.zeros_like(at.p), start, crew, sigma, span)


NEAR_POST = _bare(_about_the_middle(1.0, 0.8), _by_a_post, 5.0)
ORBIT = _bare(_about_the_middle(1.0, 1.0), _alone, 12.0)


@dataclass(frozen=True)
class Kind:
    """One law with constants inside.

    Attributes
    ----------
    layout : Layout
    strength : float
        At which to begin, or, where the noise is chosen, that it has.
    force : callable
        ``force(at, strength, values)``, N.
    inner : callable
        ``inner(rng, t, y) -> dict``: constants by the stems of their names in the grammar, for
        recordings of length `t` in which bodies pass the heights `y` without the force.
    is_whole : bool
        Whether nothing else acts, so that the noise is chosen.
    n_scenes : int or None
    """

    layout: Layout
    strength: float
    force: Callable
    inner: Callable
    is_whole: bool = False
    n_scenes: int | None = None


def _drag(at, c, of):
    return -c * at.speed ** of["n"] * at.along


def _between(at, c, law):
    return c * (at.m[:, None] * at.m[None] * law(at.distance) * at.apart / at.distance).sum(axis=1)


def _to_post(at, c, of):
    r2 = np.square(at.to_post).sum(axis=-1, keepdims=True)
    return c * at.to_post * (r2 + of["L"] ** 2) ** -1.5


def _above(at, c, of):
    return c * (at.p[:, -1:] > of["h_y"]) * np.eye(at.p.shape[1])[0]


def _for_a_while(at, c, of):
    return c * float(of["t1"] < at.t < of["t2"]) * np.eye(at.p.shape[1])[0] * np.ones_like(at.p)


def _to_place(at, c, of, power):
    out = np.array([of["centre_x"], of["centre_y"]]) - at.p
    return c * out * np.linalg.norm(out, axis=-1, keepdims=True) ** (power - 1)


def _place(size):
    return lambda rng, t, y: dict(zip(("centre_x", "centre_y"), rng.uniform(-size, size, 2),
                                      strict=True))  # fmt: skip


KINDS = {
    "drag of the power 1.5": Kind(LAYOUTS["thrown"], 0.005, _drag, lambda rng, t, y: {"n": 1.5}),
    "screened pull": Kind(
        LAYOUTS["orbiting"], 0.02,
        lambda at, c, of: _between(at, c, lambda r: np.exp(-r / of["L"]) / r**2),
        lambda rng, t, y: {"L": rng.uniform(8.0, 16.0)},
    ),
    "softened pull": Kind(
        NEAR_POST, 0.8, _to_post, lambda rng, t, y: {"L": rng.uniform(0.4, 0.8)}, is_whole=True
    ),
    "push above a height": Kind(
        LAYOUTS["thrown"], 0.05, _above,
        lambda rng, t, y: {"h_y": np.quantile(y, rng.uniform(0.3, 0.7))},
    ),
    "push for a while": Kind(
        LAYOUTS["sliding"], 0.02, _for_a_while,
        lambda rng, t, y: {"t1": t * rng.uniform(0.2, 0.4), "t2": t * rng.uniform(0.55, 0.8)},
    ),
    "spring to a rest point": Kind(
        LAYOUTS["sliding"], 2.0, lambda at, c, of: _to_place(at, c, of, 1), _place(1.0),
        is_whole=True,
    ),
    ORBITING: Kind(
        ORBIT, 0.8, lambda at, c, of: _to_place(at, c, of, -2), _place(0.15), is_whole=True,
        n_scenes=1,
    ),
}  # fmt: skip
COLUMN = "spring in one column"
NAMES = (*KINDS, COLUMN)


def data_set(name, seed):
    """Noisy data, the truth, the declared laws, constants, strength and the SNR found."""
    number = NAMES.index(name)
    kind, rng = KINDS[name], np.random.default_rng((7, number, seed))
    layout = kind.layout
    plan = Plan("", 2, False, ("mass",), (5, number, seed))
    without = moved(plan, None, layout, kind.n_scenes)[0].scenes
    heights = np.concatenate([s.positions[:, s.dynamic, -1].ravel() for s in without])
    of = kind.inner(rng, without[0].times[-1], heights)
    of = {key: float(value) for key, value in of.items()}
    declared, sigma, made = layout.declared(2), layout.sigma, []

    def seen(strength):
        made[:] = moved(plan, lambda at: kind.force(at, strength, of), layout, kind.n_scenes)
        return seen_against(made[0], declared, "", sigma)

    strength, found = kind.strength, SNR
    if kind.is_whole:
        sigma *= seen(strength) / SNR
    else:
        strength, _ = strength_at(SNR, strength, seen)
        found = seen(strength)
    exact, truth = made
    scenes = tuple(with_noise(scene, sigma, rng) for scene in exact.scenes)
    noise = (sigma,) if seed % 2 else None
    return replace(exact, scenes=scenes, noise=noise), truth, declared, of, strength, found


def column(seed):
    """A mass on a spring, one coordinate as a logger writes it: data set, constants."""
    rng = np.random.default_rng((7, NAMES.index(COLUMN), seed))
    of = {"centre_x": float(rng.uniform(-3, 3)), "c": float(rng.uniform(2.0, 8.0))}
    times = np.linspace(0.0, 8.0, N_ROWS)
    swing = rng.uniform(0.3, 0.8) * np.cos(np.sqrt(of["c"]) * times + rng.uniform(0, 2 * np.pi))
    swing += ROW_NOISE * np.ptp(swing) / 2 * rng.standard_normal(N_ROWS)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "spring.csv"
        table = np.stack([times, of["centre_x"] + swing], axis=1)
        np.savetxt(path, table, "%.6f", ",", header="t,x", comments="")
        return load_dataset(path, units={"x": "m", "t": "s"}), of


# --- one set --------------------------------------------------------------------------------------


def held(report, of):
    """Constants by their stems: error in standard deviations, and whether the interval holds it."""
    out = {}
    for stem, true in of.items():
        for c in report.constants:
            if c.name.startswith(stem) and not c.entity and not c.state and c.high > c.low:
                sd = (c.high - c.low) / (2 * Z_90)
                out[stem] = ((c.value - true) / sd, c.low <= true <= c.high)
                break
    return out


def told_power(done, of):
    """Whether the power that is told with a law holds the true one."""
    return "n" in of and any(e["low"] <= of["n"] <= e["high"] for e in done.effect.exponents)


def work(name, search, seed):
    """One data set: a row."""
    if name == COLUMN:
        dataset, of = column(seed)
        declared, strength, found = (), of["c"], np.nan
    else:
        dataset, truth, declared, of, strength, found = data_set(name, seed)
    started = time.process_time()
    report = close_loop(
        dataset, declared, rng=np.random.default_rng((7, seed, 3)), alpha=ALPHA,
        max_rounds=MAX_ROUNDS, search=search,
    )  # fmt: skip
    seconds = time.process_time() - started
    rounds = [done for done in report.rounds if causes_of(done) and done.missing.p_value <= ALPHA]
    causes = causes_of(rounds[0]) if rounds else []
    if name == COLUMN:
        is_right = [describe_text(cause) for cause in causes]
        extra = {"push": any("cos(w" in cause.text for cause in causes)}
    else:
        judge = Judge(dataset, truth, declared)
        is_right = [is_form(name, judge, cause, of, strength) for cause in causes]
        extra = {"push": False}
    right = bool(is_right) and is_right[0]
    hits = held(report, of) if right else {}
    return [{
        "kind": name, "search": search, "seed": seed, "snr_found": found, "strength": strength,
        "verdict": report.verdict, "told": str(causes[0]) if causes else "", "right": right,
        "in_class": any(is_right) or (bool(rounds) and told_power(rounds[0], of)), **extra,
        "n_class": len(causes), "n_constants": len(hits),
        "n_held": sum(h for _, h in hits.values()),
        "worst_sd": max((abs(e) for e, _ in hits.values()), default=np.nan),
        "law": report.law_text, "cpu_s": seconds,
    }]  # fmt: skip


def describe_text(cause):
    """Whether a cause is Hooke's law about a rest point on the one axis."""
    return "centre_x" in cause.text and "norm" not in cause.text and "exp" not in cause.text


def is_form(name, judge, cause, of, strength):
    """Whether a cause is the truth, sought from the true constants where names tell which are.

    An unseen body at rest pulls as what is at a place does.
    """
    if cause.code == "hidden_body":
        return name == ORBITING and cause.text.startswith("at rest")
    names = set(re.findall(r"[A-Za-z_]\w*", cause.law))
    known = {n: v for n in names for stem, v in of.items()
             if re.fullmatch(rf"{stem}\d*", n)}  # fmt: skip
    starts = [{}, *({n: sign * strength for n in names if re.fullmatch(r"c\d+", n)}
                    for sign in (1.0, -1.0))]  # fmt: skip
    return any(judge.is_form(Cause(cause.code, cause.text, {**cause.constants, **more, **known}))
               for more in starts)  # fmt: skip


# --- the table ------------------------------------------------------------------------------------


def summary(table):
    """Rates of each kind."""
    lines = [
        "# Constants inside a law, on noisy motion\n",
        f"SNR {SNR:g} of the motion against what is declared, but for the spring in one column "
        f"({N_ROWS} rows, noise {ROW_NOISE:.0%} of the amplitude). Half of the sets declare their "
        "noise. Intervals (90 %): of inner constants of laws whose form is right.\n",
        "| kind | search | sets | right | right or in class | size of class | intervals hold "
        "| worst error, sd | CPU s (most) |", "|---" * 9 + "|",
    ]  # fmt: skip
    groups = [*table.groupby(["kind", "search"], sort=False)]
    for (name, search), part in [*groups, (("**all**", ""), table)]:
        n = part["n_constants"].sum()
        lines.append(
            f"| {name} | {search} | {len(part)} | {part['right'].sum()} | "
            f"{part['in_class'].sum()} | {part['n_class'].median():.0f} | "
            f"{part['n_held'].sum()} of {n}{f' = {part.n_held.sum() / n:.0%}' if n else ''} | "
            f"{part['worst_sd'].max():.1f} | {part['cpu_s'].median():.1f} "
            f"({part['cpu_s'].max():.1f}) |"
        )
    own = table[table["kind"] == COLUMN]
    if len(own):
        lines.append(f"\nThe periodic push is named beside Hooke's law in {own['push'].sum()} of "
                     f"{len(own)}.")  # fmt: skip
    failed = table[~table["in_class"]]
    if len(failed):
        lines += ["\n## Neither right nor in the class\n",
                  "| kind | search | seed | verdict | told of |", "|---" * 5 + "|"]  # fmt: skip
        for row in failed.itertuples():
            told = row.told if isinstance(row.told, str) else ""
            cells = (row.kind, row.search, row.seed, row.verdict, told)
            lines.append("| " + " | ".join(str(c).replace("|", "/") for c in cells) + " |")
    return "\n".join(lines) + "\n"


def figure(table):
    """Right, in class, neither, kind by kind."""
    import matplotlib.pyplot as plt

    fig, ax = plt.subplots(figsize=(7.2, 3.6), layout="constrained")
    names = [name for name in NAMES if name in set(table["kind"])]
    for y, name in enumerate(names):
        part = table[table["kind"] == name]
        right, known = part["right"].mean(), part["in_class"].mean()
        for low, high, colour in ((0, right, "#009e73"), (right, known, "#56b4e9"),
                                  (known, 1, "#d55e00")):  # fmt: skip
            ax.barh(y, high - low, left=low, color=colour)
    for label, colour in (("form right", "#009e73"), ("in its class", "#56b4e9"),
                          ("neither", "#d55e00")):  # fmt: skip
        ax.plot([], [], "s", color=colour, label=label)
    ax.set(xlabel=f"share of {len(table)} data sets, SNR {SNR:g}", xlim=(0, 1))
    ax.set_yticks(range(len(names)), names)
    ax.invert_yaxis()
    fig.legend(loc="outside upper center", ncols=3, frameon=False)
    return fig


def main():
    def declare(parser):
        parser.add_argument("--sets", type=int, default=N_SETS, help="data sets of each kind")
        parser.add_argument("--search", nargs="+", default=["exhaustive"])
        parser.add_argument("--only", nargs="+", default=list(NAMES), choices=NAMES)

    args = options(__doc__.splitlines()[0], declare=declare)
    n_sets = N_QUICK if args.quick else args.sets
    jobs = [(name, search, seed) for seed in range(args.seed, args.seed + n_sets)
            for search in args.search for name in args.only]  # fmt: skip
    table = run_jobs(jobs, work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "inner_constants")


if __name__ == "__main__":
    main()
