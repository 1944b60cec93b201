"""Forces that a frame makes: Coriolis, centrifugal and Euler's are one cause with one Omega.

Places and velocities are those that an observer sees who turns with the frame. An accelerated frame
needs nothing of its own: it is a push in proportion to mass.
"""

import re

from bsp_gp.errors import LawError

_ROTATING = re.compile(r"\brotating\(([^(),]+)(?:,([^(),]+))?\)(?:\s*about\s*\(([^()]*)\))?")
_NAME = re.compile(r"\s*[A-Za-z_]\w*\s*")


def expanded(text, n_dims):
    """A typed law with ``rotating(Omega)`` written out as the forces that it stands for.

    Parameters
    ----------
    text : str
        ``rotating(Omega)``, ``rotating(Omega, rate)`` of a frame that speeds up by `rate`, each
        followed by ``about (x, y)`` if the axis does not go through the origin. In three
        dimensions the names are those of vectors with the constants ``Omega_x`` and so on.
    n_dims : int

    Raises
    ------
    LawError
        If what is given for a vector is no name.
    """
    return _ROTATING.sub(lambda found: _forces(text, n_dims, *found.groups()), text)


def _forces(text, n_dims, spin, rate, centre):
    arm = "(p_i - origin)"
    if centre is not None:
        parts = centre.split(",")
        if len(parts) != n_dims:
            raise LawError(f"law {text!r}: a point has {n_dims} coordinates here, got ({centre})")
        arm = f"(p_i - origin - ({_vector(parts)}))"
    spin, rate = (_of_axes(text, n_dims, each) for each in (spin, rate))
    now = spin if rate is None else f"({spin} + {rate} * t)"
    if n_dims == 2:
        parts = [f"{now}^2 * {arm}", f"(-2) * {now} * perp(v_i)"]
        parts += [] if rate is None else [f"(-1) * {rate} * perp{arm}"]
    else:
        parts = [f"(-1) * cross({now}, cross({now}, {arm}))", f"(-2) * cross({now}, v_i)"]
        parts += [] if rate is None else [f"(-1) * cross({rate}, {arm})"]
    return f"m_i * ({' + '.join(parts)})"


def _of_axes(text, n_dims, given):
    if given is None or n_dims == 2:
        return given and f"({given.strip()})"
    if not _NAME.fullmatch(given):
        raise LawError(
            f"law {text!r}: in three dimensions a rotation is a vector and must be a name such as "
            f"Omega, whose Omega_x, Omega_y and Omega_z are fitted or held, got {given.strip()!r}"
        )
    return f"({_vector([f'{given.strip()}_{axis}' for axis in 'xyz'])})"


def _vector(parts):
    return " + ".join(f"({part}) * e_{axis}" for part, axis in zip(parts, "xyz", strict=False))
