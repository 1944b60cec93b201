"""The main job's embedded default: what Newton's gravity lacks at Mercury.

Motion from the JPL ephemeris DE421; declared is Newtonian gravity among all bodies with the
ephemeris' own GM as fixed numbers. Nothing here tells the loop what is missing: it searches the
grammar `physics`. What follows the loop (the speed of light that the found law implies, the
perihelion, the rivals) is computed from whatever law was found.
"""

import re
from dataclasses import replace

import numpy as np

from bsp_gp.data.ephemeris import load_ephemeris
from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.errors import EvaluationError
from bsp_gp.fitting.hypothesis import declared_law
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.loop.close import close_loop
from bsp_gp.output.place import claim
from bsp_gp.physics.bodies import stack
from bsp_gp.physics.force import ForceLaw
from bsp_gp.physics.likelihood import build_regression
from bsp_gp.physics.metrics import residual_acceleration
from bsp_gp.report.folder import KIND, write_report
from bsp_gp.search.constants import fit_constants
from bsp_gp.units import UnitSystem

GRAVITY = "6.67430e-11 [m^3/kg/s^2] * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
J2000 = 2451545.0
YEAR = 365.25
STEP_DAYS = 0.5
TRAIN_YEAR = 2000
TEST_YEARS = (2003, 2006, 2009, 2012, 2015, 2018)
LIGHT = 299_792_458.0
GM_SUN_ERROR = 1.0e10 / 1.32712440041e20
"""Relative error of the Sun's GM (IAU 2009 system of constants: Luzum et al. 2011, Celest. Mech.
Dyn. Astr. 110, 293: 1.32712440041e20 +- 1.0e10 m^3/s^2)."""
KNOWN_ADVANCE = 42.98
"""Arcseconds a century from general relativity (Will 2014, Living Rev. Relativ. 17, 4)."""
ORBITS = 12

# Motion of the three terms of the post-Newtonian acceleration of a test body, for comparison
# with what was found: name, the motion, and what its coefficient (acceleration = coefficient *
# motion) is times the square of the speed of light, given GM.
_KNOWN_FORMS = (
    (
        "1/r^3 along the line to the Sun",
        lambda r, v: r / np.linalg.norm(r) ** 4,
        lambda gm: 4 * gm**2,
    ),
    (
        "v^2/r^2 along the line to the Sun",
        lambda r, v: r * (v @ v) / np.linalg.norm(r) ** 3,
        lambda gm: -gm,
    ),
    (
        "v_r v/r^2 along the velocity",
        lambda r, v: v * (v @ r) / np.linalg.norm(r) ** 3,
        lambda gm: 4 * gm,
    ),
)


def solar_system(receivers=("mercury",), years=(TRAIN_YEAR, *TEST_YEARS)):
    """Years of DE421 as a data set; the first year is for training, the others are held out.

    Parameters
    ----------
    receivers : tuple of str
        Bodies whose motion is to be explained; the others move as the ephemeris says.
    """
    scenes = tuple(
        load_ephemeris(
            receivers=tuple(receivers),
            start_jd=J2000 + (year - 2000) * YEAR,
            n_days=366,
            step_days=STEP_DAYS,
            name=str(year),
        )
        for year in years
    )
    return Dataset(
        "Solar System, DE421",
        scenes,
        train=(str(years[0]),),
        test=tuple(str(year) for year in years[1:]),
        velocity="measured",
        units=UnitSystem.from_declared({"length": "m", "time": "s", "mass": "kg"}),
        provenance={
            "source": "JPL ephemeris DE421 (Folkner, Williams & Boggs 2009, IPN Progress Report "
            "42-178), PyPI package de421",
            "masses": "GM of DE421 itself, divided by G = 6.67430e-11 m^3/kg/s^2",
        },
        notes=(
            "an ephemeris is a model that was fitted to observations: what is found here is "
            "what its makers put into their equations of motion, not a new measurement",
        ),
    )


def run_demo(out, *, overwrite=False, seed=0, progress=None, workers=None, run_info=None):
    """Close the loop on the Solar System and write the report.

    Parameters
    ----------
    out : path
        Folder of the report.
    progress : callable, optional
        ``progress(text)``.
    run_info : dict, optional
        For the report's ``run.json``.

    Returns
    -------
    report : LoopReport
    folder : Path
    """
    progress = progress or (lambda text: None)
    with claim(out, KIND, overwrite=overwrite):
        report = _demo_report(seed, progress, workers)
        return report, write_report(report, out, overwrite=overwrite, run_info=run_info)


def _demo_report(seed, progress, workers):
    progress("reading DE421")
    dataset = solar_system()
    report = close_loop(
        dataset,
        [GRAVITY],
        rng=np.random.default_rng(seed),
        seed=seed,
        max_rounds=1,  # terms are chosen together, as one set
        workers=workers,
        progress=progress,
    )
    progress("what the found law implies")
    extras = [_headline(report)]
    extras += _implied(dataset, report, progress)
    extras.append(_freed_mass(report, dataset))
    progress("trying Venus and Mars")
    extras.append(_other_planets(report))
    return replace(report, extras=tuple(section for section in extras if section))


def _headline(report):
    before = report.total["before"].residual_acceleration
    rows = [
        ["model", "rms residual acceleration, m/s^2", "of the declared model's"],
        ["declared", f"{before:.3e}", "100 %"],
    ]
    for r in report.rounds:
        if r.adopted:
            left = r.after.residual_acceleration
            rows.append([f"after round {r.number}", f"{left:.3e}", f"{left / before:.3%}"])
    return {
        "title": "What is left of Mercury's residual acceleration, held-out years",
        "paragraphs": [
            "Held out are the years " + ", ".join(report.dataset["test"]) + "; the law was found "
            "and fitted on " + ", ".join(report.dataset["train"]) + " alone."
        ],
        "table": rows,
    }


# --- what the law implies -------------------------------------------------------------------------


def _two_bodies(dataset):
    """Sun at rest and Mercury, from the first instant of the training year."""
    scene = dataset.scenes[0]
    sun, mercury = scene.names.index("sun"), scene.names.index("mercury")
    r = scene.positions[0, mercury] - scene.positions[0, sun]
    v = scene.velocities[0, mercury] - scene.velocities[0, sun]
    entities = (
        Entity("sun", is_static=True, properties=scene.entities[sun].properties),
        Entity("mercury", properties=scene.entities[mercury].properties),
    )
    return r, v, entities


def _acceleration_of(law, entities):
    """``a(r, v)`` of the second entity about the first, at rest."""
    still = np.stack([np.zeros((3, 3)), np.eye(3) + np.arange(3)[:, None]], axis=1)
    bodies = stack([Scene("two", np.arange(3.0), still, entities)])[0].bodies

    def acceleration(r, v):
        p = np.stack([np.zeros(3), r])[None]
        w = np.stack([np.zeros(3), v])[None]
        return law.acceleration(bodies, p, w, np.zeros(1))[0, 0]

    return acceleration


def _implied(dataset, report, progress):
    found = [term for term in report.law.terms if not term.is_declared]
    if not found:
        return []
    r, v, entities = _two_bodies(dataset)
    gm = 6.67430e-11 * entities[0].mass
    rows = [["term", "coefficient, SI", "expected", "implied speed of light, m/s", "off by"]]
    matched, lights = set(), []
    for term in found:
        single = ForceLaw((term,), {n: report.law.constants[n] for n in term.formula.constants})
        hit = _match(_acceleration_of(single, entities), r, v)
        if hit is None:
            rows.append(["not a term of general relativity", "", "", "", ""])
            continue
        (name, _, strength), coefficient = hit
        matched.add(name)
        with np.errstate(invalid="ignore"):
            light = float(np.sqrt(strength(gm) / coefficient))
        lights.append(light)
        numbers = (coefficient, strength(gm) / LIGHT**2, light)
        rows.append([name, *(f"{x:.5e}" for x in numbers), f"{light / LIGHT - 1:+.3%}"])
    text = (
        "General relativity adds three terms to the acceleration of a light body near the Sun: "
        "4 G²M²/c² over r³ and −GM/c² times v²/r² along the line to the Sun, and 4 GM/c² times "
        "v_r v/r² along the velocity. Read as these, the coefficients found imply the speed of "
        f"light beside them; in truth it is {LIGHT:,.0f} m/s."
        if matched
        else "None of the terms found is one of general relativity's, so no speed of light follows."
    )
    section = {
        "title": "The speed of light that the law implies", "paragraphs": [text], "table": rows
    }  # fmt: skip
    if len(found) == len(matched) == len(_KNOWN_FORMS) and np.isfinite(lights).all():
        off = max(abs(light / LIGHT - 1) for light in lights)
        section["headline"] = (
            "together they are those of general relativity (speed of light within "
            f"{100 * off:.1f} %)"
        )
    sections = [section]
    progress("integrating the perihelion")
    sections.append(_perihelion(report, r, v, entities))
    return sections


def _match(acceleration, r, v):
    """Known form that an acceleration is proportional to at several states; its coefficient."""
    states = [(r, v), (1.3 * r, 0.8 * v), (0.7 * r + 0.2 * np.linalg.norm(r), 1.1 * v[::-1])]
    for form in _KNOWN_FORMS:
        pattern = np.concatenate([form[1](*state) for state in states])
        value = np.concatenate([acceleration(*state) for state in states])
        coefficient = float(pattern @ value / (pattern @ pattern))
        if np.linalg.norm(value - coefficient * pattern) < 1e-9 * np.linalg.norm(value):
            return form, coefficient
    return None


def _perihelion(report, r, v, entities):
    declared = ForceLaw([t for t in report.law.terms if t.is_declared], {})
    turns = []
    for law in (declared, report.law):
        turn, period = _turn_per_orbit(
            _acceleration_of(law, entities), r, v, 6.67430e-11 * (entities[0].mass)
        )
        turns.append(turn)
    orbits = 36525.0 * 86400.0 / period
    advance = np.degrees(turns[1] - turns[0]) * 3600 * orbits
    return {
        "title": "The advance of Mercury's perihelion",
        "headline": f"the perihelion turns by {advance:.2f} arcseconds a century (known: "
        f"{KNOWN_ADVANCE:.2f})",
        "paragraphs": [
            f"Sun and Mercury alone, integrated over {ORBITS} orbits under the declared and under "
            f"the adopted law: the adopted terms turn the orbit forward by {advance:.2f} "
            f"arcseconds a century. General relativity gives {KNOWN_ADVANCE:.2f}, the famous 43."
        ],
        "table": [
            ["law", "advance, arcsec per century"],
            ["declared", f"{np.degrees(turns[0]) * 3600 * orbits:+.4f}"],
            ["adopted", f"{advance:.3f}"],
            ["general relativity", f"{KNOWN_ADVANCE:.2f}"],
        ],
        "values": {"arcsec_per_century": float(advance)},
    }


def _turn_per_orbit(acceleration, r, v, gm):
    """Angle by which the direction of perihelion turns in one orbit, radians; and the period, s."""
    from scipy.integrate import solve_ivp

    energy = v @ v / 2 - gm / np.linalg.norm(r)
    period = 2 * np.pi * gm / (-2 * energy) ** 1.5

    def motion(t, state):
        return np.concatenate([state[3:], acceleration(state[:3], state[3:])])

    def passes_perihelion(t, state):
        return state[:3] @ state[3:]

    passes_perihelion.direction = 1.0
    track = solve_ivp(
        motion, (0, (ORBITS + 1.2) * period), np.concatenate([r, v]), method="DOP853", rtol=1e-13,
        atol=1e-6, events=passes_perihelion,
    )  # fmt: skip
    places, moments = track.y_events[0], track.t_events[0]
    if len(places) < ORBITS + 1:
        raise EvaluationError("the orbit under the adopted law does not return to its perihelion")
    axis = np.cross(r, v) / np.linalg.norm(np.cross(r, v))
    first, last = places[0, :3], places[ORBITS, :3]
    angle = np.arctan2(np.cross(first, last) @ axis, first @ last)
    return angle / ORBITS, (moments[ORBITS] - moments[0]) / ORBITS


# --- rivals ---------------------------------------------------------------------------------------


def _freed_mass(report, dataset):
    """What the Sun's GM would have to be in the place of any new term."""
    freed = fit_law(dataset, [f"(1 + k) * {GRAVITY}"], rng=0)
    (k,) = freed.constants
    left = freed.errors.residual_acceleration / report.total["before"].residual_acceleration
    return {
        "title": "With the Sun's GM free",
        "paragraphs": [
            f"Freed in the place of any new term, the number of the declared law is off by "
            f"{100 * k.value:.2g}% of its value. That leaves {left:.0%} of the held-out residual: "
            f"a shift of GM imitates {1 - left:.0%} of the effect. But the published error of the "
            f"Sun's GM is {GM_SUN_ERROR:.1e} of its value (IAU 2009), so such a shift is excluded; "
            "GM stays as declared."
        ],
        "table": None,
    }


def _other_planets(report):
    """Sets of terms that Mercury cannot tell apart, fitted to Venus and Mars as well."""
    found = [term for term in report.law.terms if not term.is_declared]
    last = [r for r in report.rounds if r.adopted]
    if len(found) < 2 or not last or last[-1].effect is None:
        return None
    dataset = solar_system(("mercury", "venus", "mars"), years=(TRAIN_YEAR, TEST_YEARS[0]))
    train, test = dataset.scenes
    regression, held_out = (
        build_regression([scene], method="derivative", velocity="measured", sigma=np.ones(3))
        for scene in (train, test)
    )
    declared = declared_law(dataset, [GRAVITY])
    base = residual_acceleration(held_out, declared)
    rows = [["set of terms, each with one constant for all three planets", "left, held-out year"]]
    texts = [t for t in last[-1].effect.equivalents if t.count("c") >= 2 and " + c2" in t]
    own = " + ".join(f"c{n} * {_motion_text(t)}" for n, t in enumerate(found, 1))
    # Sets that differ only in whose velocity they name are one member of the class.
    members = {}
    for text in [own, *texts]:
        key = frozenset(
            part.partition(" * ")[2] for part in _parts(text.replace("v_i - v_j", "v_i"))
        )
        members.setdefault(key, text)
    for text in members.values():
        law = declared
        for part in declared_law(dataset, _parts(text)).terms:
            law = law.plus(
                replace(part, is_declared=False), {n: 0.0 for n in part.formula.constants}
            )
        fitted = fit_constants(regression, law)
        rows.append([text, f"{residual_acceleration(held_out, fitted.law) / base:.3%}"])
    return {
        "title": "Venus and Mars as well",
        "paragraphs": [
            "On one orbit, r⁻³, v² r⁻² and r⁻² are linearly dependent (v² = GM (2/r − 1/a)), so "
            "Mercury alone cannot tell sets apart that differ in these. Fitted to Mercury, Venus "
            "and Mars at once, each set with one constant for all three, they leave:"
        ],
        "table": rows,
    }


def _parts(text):
    """Terms of a set that is written as ``c1 * ... + c2 * ...``."""
    return re.split(r" \+ (?=c\d+ \*)", text)


def _motion_text(term):
    from bsp_gp.language.render import to_text
    from bsp_gp.physics.force import split_linear

    return to_text(split_linear(term.formula)[1])
