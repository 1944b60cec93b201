"""Tracks of the planets from a JPL ephemeris: the only importer of `jplephem`."""

import numpy as np

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.errors import DataError, MissingDependencyError

GRAVITATIONAL_CONSTANT = 6.67430e-11
"""m^3/(kg s^2), CODATA 2018. Only GM is known well; mass = GM / G with exactly this G."""
DAY_S = 86400.0
BODIES = (
    "sun", "mercury", "venus", "earth", "moon", "mars", "jupiter", "saturn", "uranus", "neptune",
    "pluto",
)  # fmt: skip
_GM_CONSTANT = {
    "sun": "GMS", "mercury": "GM1", "venus": "GM2", "mars": "GM4", "jupiter": "GM5",
    "saturn": "GM6", "uranus": "GM7", "neptune": "GM8", "pluto": "GM9",
}  # fmt: skip


def load_ephemeris(
    bodies=BODIES, *, receivers=("mercury",), start_jd, n_days, step_days, name="solar_system"
):
    """Tabulate the Sun, the planets and the Moon from DE421 as a scene.

    Positions and velocities are barycentric (ICRF), metres and metres/second; the velocities
    are derivatives of the ephemeris' own polynomials, not differences of positions. Outer
    planets are the barycentres of their systems. Masses are GM / G with the GM values of the
    same ephemeris (Folkner, Williams & Boggs 2009, IPN Progress Report 42-178) and
    G = `GRAVITATIONAL_CONSTANT`.

    Parameters
    ----------
    bodies : sequence of str
        Among `BODIES`.
    receivers : sequence of str
        Those that forces move; the others run along their tracks as sources.
    start_jd : float
        First instant, Julian date, TDB; t = 0 s there.
    n_days, step_days : float
        Length and sampling.
    name : str
        Name of the scene.

    Raises
    ------
    MissingDependencyError
        Without jplephem and de421.
    DataError
        If a body is unknown or the dates are outside of the ephemeris.
    """
    _require_bodies(bodies, receivers)
    if not (n_days > 0 and step_days > 0):
        raise DataError(f"n_days and step_days must be positive, got {n_days}, {step_days}")
    ephemeris = _open()
    days = step_days * np.arange(round(n_days / step_days) + 1)
    last = start_jd + days[-1]
    if start_jd < ephemeris.jalpha or last > ephemeris.jomega:
        raise DataError(
            f"DE421 covers Julian dates {ephemeris.jalpha} to {ephemeris.jomega}, "
            f"got {start_jd} to {last}"
        )
    tracks = [_track(ephemeris, body, start_jd, days) for body in bodies]
    masses = [_gm(ephemeris, body) / GRAVITATIONAL_CONSTANT for body in bodies]
    entities = [Entity(body, is_static=body not in receivers, properties={"mass": mass})
                for body, mass in zip(bodies, masses, strict=True)]  # fmt: skip
    positions, velocities = (np.stack(each, axis=1) for each in zip(*tracks, strict=True))
    return Scene(name, days * DAY_S, positions, tuple(entities), velocities)


def _require_bodies(bodies, receivers):
    for argument, given, allowed in (("bodies", bodies, BODIES), ("receivers", receivers, bodies)):
        unknown = [body for body in given if body not in allowed]
        if unknown or isinstance(given, str):
            known = ", ".join(allowed)
            raise DataError(f"{argument} must be a sequence among {known}, got {given!r}")


def _open():
    try:
        import de421
        from jplephem import Ephemeris
    except ImportError as error:
        raise MissingDependencyError(
            "the ephemeris needs jplephem and de421: pip install 'bsp_gp[astro]'"
        ) from error
    return Ephemeris(de421)


def _state(ephemeris, series, start_jd, days):
    """Position (n, 3) in km and velocity in km/day; the date stays in two parts for precision."""
    position, velocity = ephemeris.position_and_velocity(series, start_jd, days)
    return position.T, velocity.T


def _track(ephemeris, body, start_jd, days):
    if body in ("earth", "moon"):
        centre = _state(ephemeris, "earthmoon", start_jd, days)
        moon = _state(ephemeris, "moon", start_jd, days)  # from the centre of the Earth
        share = ephemeris.moon_share if body == "moon" else -ephemeris.earth_share
        position, velocity = (c + share * m for c, m in zip(centre, moon, strict=True))
    else:
        position, velocity = _state(ephemeris, body, start_jd, days)
    return position * 1e3, velocity * (1e3 / DAY_S)


def _gm(ephemeris, body):
    """GM in m^3/s^2 from the constants of the ephemeris (au^3/day^2, its own au in km)."""
    if body in ("earth", "moon"):
        share = ephemeris.moon_share if body == "earth" else ephemeris.earth_share
        value = ephemeris.GMB * share
    else:
        value = getattr(ephemeris, _GM_CONSTANT[body])
    return float(value) * (ephemeris.AU * 1e3) ** 3 / DAY_S**2
