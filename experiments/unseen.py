"""What nobody sees: a star about an unseen body, a binary with a third one, and nothing at all.

38 epochs over 1.2 periods with quoted errors, at the half axis over 10 and 30. The whole loop is
asked, with nothing declared, or with the gravity of the two visible stars. The star is also seen
aslant ("aslant"), and a companion from its primary, with the plane of its orbit inclined to the sky
("inclined") or a third body that pulls both ("relative"), at errors five times smaller.
"""

import time

import numpy as np
from common import options, run_jobs, write_study
from scipy.integrate import solve_ivp

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.loop.close import close_loop
from bsp_gp.units import UnitSystem, parse_unit

N_SETS, QUICK_SETS = 20, 2
SNRS = (30, 10)
KINDS = ("star", "third", "nothing", "aslant", "inclined", "relative")
FROM_PRIMARY = ("inclined", "relative")
N_EPOCHS, N_PERIODS = 38, 1.2
AU, YEAR, SUN = (parse_unit(name)[0] for name in ("au", "yr", "Msun"))
G = 6.6743e-11 * SUN * YEAR**2 / AU**3
"""au^3 / (Msun yr^2)."""
KEPLER = "M * (p_j - p_i) / norm(p_j - p_i)^3"
FINER = 5.0
"""Times by which errors of a companion from its primary are smaller."""
GRAVITY = "6.6743e-11 [m^3/(kg s^2)] * m_i * m_j * (p_j - p_i) / norm(p_j - p_i)^3"
UNITS = UnitSystem.from_declared({"length": "au", "time": "yr", "mass": "Msun"})


def moved(masses, state, years):
    """Places (T, N, 2) of bodies that attract each other, au, from places and velocities."""
    masses = np.array(masses)

    def slope(_, y):
        p, v = y.reshape(2, -1, 2)
        gap = p[None] - p[:, None]
        r = np.linalg.norm(gap, axis=-1)
        np.fill_diagonal(r, np.inf)
        return np.concatenate([v.ravel(), (G * masses[None, :, None] * gap / r[..., None] ** 3)
                               .sum(axis=1).ravel()])  # fmt: skip

    found = solve_ivp(slope, (0, years[-1]), np.ravel(state), method="DOP853", t_eval=years,
                      rtol=1e-11, atol=1e-12)  # fmt: skip
    return found.y[: 2 * len(masses)].T.reshape(len(years), -1, 2)


def made(kind, snr, seed):
    """A data set, and what is to be found: mass and place of the unseen body, or None."""
    rng = np.random.default_rng([26, KINDS.index(kind), snr, seed])
    half, mass, e = rng.uniform(3, 12), rng.uniform(0.5, 4), rng.uniform(0, 0.6)
    masses = (mass,) if kind != "third" else (0.6 * mass, 0.4 * mass)
    period = np.sqrt(half**3 / mass)
    years = np.sort(rng.uniform(0, N_PERIODS * period, N_EPOCHS))
    years[0] = 0.0
    turn = rng.uniform(0, 2 * np.pi)
    way = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    gap, speed = half * (1 + e), np.sqrt(G * mass / half * (1 - e) / (1 + e))
    truth, where, seen = None, rng.uniform(-half, half, 2), np.eye(2)
    around = [[0, 0], gap * way[0], [0, 0], speed * way[1]]
    if kind == "nothing":
        drift = speed * way[1]
        places = (where + years[:, None] * drift)[:, None]
    elif kind == "inclined":
        places, seen = moved((mass, 0.0), around, years)[:, 1:], _aslant(rng)
    elif kind in ("star", "aslant"):
        seen = seen if kind == "star" else _aslant(rng)
        places = moved((mass, 0.0), around, years)[:, 1:] + where
        truth = mass, where @ seen
    elif kind == "relative":
        third, far = rng.uniform(0.2, 0.5) * mass, rng.uniform(2.5, 3.5) * half
        out, across = _circle(rng, far, mass + third)
        state = [[0, 0], gap * way[0], far * out, [0, 0], speed * way[1], across]
        whole = moved((mass, 0.0, third), state, years)
        places = whole[:, 1:2] - whole[:, :1]
        truth = (third / mass, whole[0, 2] - whole[0, 0])
    else:
        share = np.array([-0.4, 0.6])[:, None]
        third, far = rng.uniform(0.3, 1.0) * mass, rng.uniform(3.0, 5.0) * half
        out, across = _circle(rng, far, mass + third)
        state = [*(share * gap * way[0]), far * out, *(share * speed * way[1]), across]
        whole = moved((*masses, third), state, years)
        places, truth = whole[:, :2], (third, whole[0, 2])
    sigma = half / snr / (FINER if kind in FROM_PRIMARY else 1.0)
    places = places @ seen
    places = places + sigma * rng.standard_normal(places.shape)
    sigmas = np.full(places.shape, AU * sigma)
    bodies = [Entity(f"star {k}", properties={"mass": m * SUN} if kind == "third" else {})
              for k, m in enumerate(masses)]  # fmt: skip
    if kind in FROM_PRIMARY:
        bodies.append(Entity("primary", is_static=True))
        places = np.concatenate([places, np.zeros_like(places)], axis=1)
        sigmas = np.concatenate([sigmas, np.full_like(sigmas, np.nan)], axis=1)
    scene = Scene(kind, years * YEAR, AU * places, bodies, sigma=sigmas)
    return Dataset(kind, (scene,), units=UNITS), truth


def _circle(rng, far, mass):
    """Way and velocity of a body that goes round so much mass at a distance."""
    angle = rng.uniform(0, 2 * np.pi)
    out = np.array([np.cos(angle), np.sin(angle)])
    return out, np.array([-out[1], out[0]]) * np.sqrt(G * mass / far)


def _aslant(rng):
    """What a plane at some inclination shows of places (n, 2) in it, when these multiply it."""
    cosine, node = np.cos(np.radians(rng.uniform(25, 70))), rng.uniform(0, np.pi)
    across = np.array([-np.sin(node), np.cos(node)])
    return np.eye(2) - (1 - cosine) * np.outer(across, across)


def work(kind, snr, seed):
    """One data set: a row."""
    dataset, truth = made(kind, snr, seed)
    began = time.process_time()
    declared = {"third": GRAVITY, **dict.fromkeys(FROM_PRIMARY, KEPLER)}.get(kind, "nothing")
    report = close_loop(dataset, declared, rng=seed, n_bootstrap=0)
    row = {"kind": kind, "snr": snr, "seed": seed, "cpu_s": time.process_time() - began,
           "verdict": report.verdict}  # fmt: skip
    found = [r.effect for r in report.rounds if r.adopted]
    row["found"] = " + ".join(e.code for e in found)
    hidden = next((e for e in found if e.code == "hidden_body"), None)
    wanted = "inclined" if kind == "inclined" else "hidden_body"
    row["is_named"] = [effect.code for effect in found] == [wanted]
    if hidden is not None and truth is not None and hidden.details:
        known = {c.name: c for c in hidden.constants}
        numbers = [known[name] for name in hidden.details["names"] if name in known]
        mass, *places = numbers[-1], *numbers[:2]
        unit = 1.0 if kind == "relative" else SUN
        row["mass_ratio"] = mass.value / unit / truth[0]
        at = hidden.details.get("seen_at", [c.value for c in places])
        row["direction"] = _direction(dataset, at, AU * truth[1])
        wanted = [(mass, truth[0] * unit)]
        if "seen_at" not in hidden.details:  # the place is told in the plane of the orbit
            wanted += zip(places, AU * truth[1], strict=True)
        row["misses"] = max(
            abs(c.value - true) / max((c.high - c.low) / 3.29, 1e-300) for c, true in wanted
        )
        row["motion"] = hidden.details["motion"]
    return [row]


def _direction(dataset, place, truth):
    """Degrees between two places, from the middle of what is seen at first."""
    middle = dataset.scenes[0].positions[0].mean(axis=0)
    one, other = (np.arctan2(*(np.array(p) - middle)[::-1]) for p in (place, truth))
    return float(np.degrees(abs((one - other + np.pi) % (2 * np.pi) - np.pi)))


def jobs_of(quick, seed):
    """Every kind at every level."""
    n = QUICK_SETS if quick else N_SETS
    return [(kind, snr, seed + k) for k in range(n) for snr in SNRS for kind in KINDS]


def summary(table):
    """How often the body is named, how far its numbers are off, and what is invented."""
    lines = ["# Bodies that nobody sees", ""]
    for (kind, snr), part in table.groupby(["kind", "snr"], sort=False):
        if kind == "nothing":
            quiet = int((part.verdict == "nothing missing").sum())
            lines.append(f"- nothing, {snr}: {quiet} of {len(part)} told to lack nothing.")
            continue
        named = part[part.is_named.astype(bool)]
        near = int((named.misses <= 3).sum()) if "misses" in named else 0
        lines.append(
            f"- {kind}, {snr}: named in {len(named)} of {len(part)}"
            + ("" if kind == "inclined" else
               f"; mass and place within three standard deviations in {near}")
            + f"; {part.cpu_s.median():.0f} s."
        )
    return "\n".join(lines) + "\n"


def figure(table):
    """Masses found over true ones."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(figsize=(5.0, 3.0), layout="constrained")
    for kind, part in table.groupby("kind", sort=False):
        if "mass_ratio" in part and part.mass_ratio.notna().any():
            axes.plot(part.snr, part.mass_ratio, "o", ms=4, alpha=0.6, label=kind)
    axes.axhline(1, color="0.6", lw=0.8)
    axes.set(xlabel="half axis over error", ylabel="mass found over true")
    axes.legend(frameon=False)
    return fig


def main():
    args = options(__doc__.splitlines()[0])
    table = run_jobs(jobs_of(args.quick, args.seed), work, args.out, args.workers)
    write_study(summary(table), figure(table), args.out, "unseen")


if __name__ == "__main__":
    main()
