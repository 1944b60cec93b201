"""The Solar System with one outer planet withheld: where must it be, and how heavy?

DE421 without Jupiter, Saturn or Neptune in turn. The other outer planets are the ones whose motion
is to be explained by Newton's gravity; the Sun and the inner planets are sources. Once with the
ephemeris' own velocities, then from positions alone with errors of so many arcseconds times the
distance from the Sun, up to where nothing can be told.
"""

import json
from dataclasses import replace
from functools import partial

import numpy as np
from common import options, run_jobs, save_figure, write_study, write_text

from bsp_gp.data.ephemeris import BODIES, load_ephemeris
from bsp_gp.data.scene import Dataset, Scene
from bsp_gp.data.split import choose_split
from bsp_gp.demo import GRAVITY, J2000, YEAR
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.loop import run_rounds
from bsp_gp.loop.proposers.companions import Companions
from bsp_gp.loop.proposers.hidden import Hidden
from bsp_gp.report.hidden_map import draw_hidden_map
from bsp_gp.units import UnitSystem

OUTER = ("jupiter", "saturn", "uranus", "neptune")
WITHHELD = ("jupiter", "saturn", "neptune")
FIRST_YEAR, N_YEARS = 1980, 35
"""The last 30 % of the time are held out, after a gap: 21 years are left to learn from."""
STEP_DAYS = 20.0
N_EPOCHS = 60
ARCSEC = (0.1, 3.0, 100.0, 3000.0)
QUICK_EPOCHS = 30
LIMITS = {"direction_deg": 2.0, "mass_percent": 10.0}
SI = UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"})
COLOURS = {"jupiter": "#d55e00", "saturn": "#009e73", "neptune": "#0072b2"}


def years(bodies, receivers):
    """The ephemeris of some bodies over the years of the study."""
    return load_ephemeris(
        bodies, receivers=receivers, start_jd=J2000 + (FIRST_YEAR - 2000) * YEAR,
        n_days=N_YEARS * YEAR, step_days=STEP_DAYS, name="outer planets",
    )  # fmt: skip


def without(planet, arcsec, n_epochs, seed):
    """The data set that lacks a planet; `arcsec` 0: exact, with velocities."""
    bodies = tuple(b for b in BODIES if b != planet)
    scene = years(bodies, tuple(b for b in OUTER if b != planet))
    if not arcsec:
        return Dataset("outer planets", (scene,), velocity="measured", units=SI)
    rows = np.unique(np.linspace(0, len(scene.times) - 1, n_epochs).astype(int))
    positions = scene.positions[rows]
    from_sun = np.linalg.norm(positions - positions[:, :1], axis=-1, keepdims=True)
    sigma = np.radians(arcsec / 3600) * from_sun * np.ones(3)
    rng = np.random.default_rng([seed, WITHHELD.index(planet), round(10 * arcsec)])
    noisy = positions + sigma * rng.standard_normal(positions.shape)
    scene = Scene(scene.name, scene.times[rows], noisy, scene.entities, sigma=sigma)
    return Dataset("outer planets", (scene,), units=SI)


def work(planet, arcsec, n_epochs, seed, out):
    """One planet withheld: a row of the table, and the details for its map."""
    dataset = without(planet, arcsec, n_epochs, seed)
    split_rng, rng = np.random.default_rng(seed).spawn(2)
    train = replace(dataset, scenes=choose_split(dataset, split_rng).train, train=(), test=())
    # Nothing in the sky moves in steps from row to row.
    hypothesis = Hypothesis.from_laws(train, [GRAVITY], paper_steps=False)
    (done,) = run_rounds(hypothesis, train, [Hidden(), Companions()], rng=rng, max_rounds=1)
    decision, scene = done.decision, train.scenes[0]
    row = {
        "planet": planet, "arcsec": arcsec, "verdict": "cannot tell",
        "p_value": done.table.p_value, "n_epochs": len(scene.times),
        "years": float(np.ptp(scene.times)) / (YEAR * 86400), "reason": decision.reason,
    }  # fmt: skip
    if not done.details:
        return [row]
    details = {**done.details, "p_value": done.table.p_value}
    best = done.fits[decision.best.id]
    truth = years(("sun", planet), ())
    sun, true = (
        np.stack([np.interp(scene.times, truth.times, x) for x in truth.positions[:, k].T], axis=1)
        for k in (0, 1)
    )
    part = done.hypotheses[decision.best.id].parts[-1]
    at = np.abs(scene.times - details["epoch"]).argmin()
    draws, mass = np.array(details["draws"]), truth.entities[1].mass
    spread = _angles(draws[:, :3] - sun[at], np.array(details["best"][:3]) - sun[at])
    told = json.dumps({**details, "truth": true[at].tolist()})
    write_text(told, out / f"{planet}_{arcsec:g}.json")
    return [
        {
            **row,
            # Adopted beside another motion that does as well, it may be anywhere.
            "verdict": "found" if decision.is_fact else "cannot tell",
            "motion": details["motion"],
            "direction_deg": float(_angles(part.track(best, scene.times) - sun, true - sun).max()),
            "direction_90_deg": float(np.quantile(spread, 0.9)),
            "mass_percent": 100 * (details["best"][-1] / mass - 1),
            "mass_sd_percent": 100 * draws[:, -1].std() / mass,
            "evidence_nats": decision.best.log_evidence - done.table.base.log_evidence,
        }
    ]


def _angles(a, b):
    """Angles between vectors (n, 3), degrees."""
    cosine = (a * b).sum(axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def draw(table):
    """Errors of direction and mass, with their posterior widths, against the noise."""
    import matplotlib.pyplot as plt

    noises = sorted(table["arcsec"].unique())
    figure, panels = plt.subplots(1, 2, figsize=(7.6, 3.0), layout="constrained")
    for axes, error, width, label in (
        (panels[0], "direction_deg", "direction_90_deg", "error of direction (degrees)"),
        (panels[1], "mass_percent", "mass_sd_percent", "error of mass (%)"),
    ):
        for k, (planet, colour) in enumerate(COLOURS.items()):
            part = table[table["planet"] == planet]
            x = part["arcsec"].map(noises.index) + 0.16 * (k - 1)
            is_found = part["verdict"] == "found"
            for chosen, face in ((is_found, colour), (~is_found, "white")):
                axes.plot(
                    x[chosen], part[error].abs()[chosen], "o", ms=5, color=colour, mfc=face,
                )  # fmt: skip
            axes.plot(x, part[width], "_", ms=9, mew=1.4, color=colour, alpha=0.7)
            axes.plot([], [], "o", color=colour, label=planet.capitalize())
        axes.axhline(LIMITS[error], color="0.5", lw=0.8, ls=":")
        axes.set(yscale="log", ylabel=label, xlabel="position noise (arcsec × distance)")
        axes.set_xticks(range(len(noises)), ["exact" if n == 0 else f"{n:g}" for n in noises])
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].plot([], [], "o", color="0.4", mfc="white", label="cannot tell")
    panels[0].plot([], [], "_", color="0.4", ms=9, mew=1.4, label="posterior (90 %; sd of mass)")
    panels[0].legend(frameon=False, fontsize=7)
    return figure


def summary(table):
    """Markdown."""
    lines = [
        "# One outer planet withheld",
        "",
        "Direction: greatest error over the years of training, as seen from the Sun. Wanted: "
        f"{LIMITS['direction_deg']:g} degrees, mass within {LIMITS['mass_percent']:g} %.",
        "",
        "| withheld | noise | verdict | direction error | 90 % | mass error | sd | p |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in table.itertuples():
        noise = "exact" if row.arcsec == 0 else f"{row.arcsec:g} arcsec"
        if np.isfinite(getattr(row, "direction_deg", np.nan)):
            numbers = (
                f"{row.direction_deg:.2g}° | {row.direction_90_deg:.2g}° | "
                f"{row.mass_percent:+.2g} % | {row.mass_sd_percent:.2g} % | {row.p_value:.3g}"
            )
        else:
            numbers = " | ".join("–" * 5)
        lines.append(f"| {row.planet} | {noise} | {row.verdict} | {numbers} |")
    return "\n".join(lines)


def main():
    args = options(__doc__.splitlines()[0])
    jobs = [(planet, 0.0, 0, args.seed) for planet in WITHHELD]
    if args.quick:
        jobs.append(("neptune", ARCSEC[0], QUICK_EPOCHS, args.seed))
    else:
        jobs += [(planet, arcsec, N_EPOCHS, args.seed) for arcsec in ARCSEC for planet in WITHHELD]
    table = run_jobs(jobs, partial(work, out=args.out), args.out, args.workers)
    for path in sorted(args.out.glob("*_*.json")):
        details = json.loads(path.read_text(encoding="utf-8"))
        figure = draw_hidden_map(details, details["truth"])
        save_figure(figure, args.out / f"map_{path.stem}.png")
    write_study(summary(table), draw(table), args.out, "hidden_planet")


if __name__ == "__main__":
    main()
