"""Words by which headings speak of a distance and an angle, of their errors, and of dates."""

import re

from bsp_gp.data.words import folded, words_for
from bsp_gp.units import OF_THE_SKY

_ARCSEC = ('"', "″", "''", "”", "arcsecs", "arcseconds")
_FILLER = words_for("filler")
_ERROR = words_for("sky_error")
_GLUED = re.compile(r"(?:err|sigma|sig|unc|e|σ|s)_?(.+)|(.+?)_?(?:error|err|sigma|sig|unc)")
"""``erho``, ``σθ``, ``PAerr``: an error without a blank."""
_BEHIND = re.compile(r"(?<=[A-Za-z])(?=(?:Obs|Meas|Err)(?![a-z]))|(?<=\b[Tt])(?=obs\b)")
"""In ``PAObs`` and ``Tobs``, before what changes little."""
_YEAR = words_for("year")
_DAY = words_for("day")
_SINCE = re.compile(r"\s*[-−–]\s*\d[\d.,]{3,}$")
"""What Julian dates count from: ``BJD-2450000``, ``JD - 2,450,000``."""
_DATE = words_for("observed") | _YEAR | _DAY


def plain_words(text):
    """The words of a heading, folded; ``P.A.`` is ``pa``."""
    text = _BEHIND.sub(" ", text)
    words = re.split(r"[\s_\-()\[\]/,]+", folded(text).replace("+/-", "±"))
    return {word.replace(".", "") for word in words} - {""}


def _is_of(text, known):
    words = plain_words(text)
    return bool(words & (known - _FILLER)) and words <= known | _FILLER


def is_far(text):
    """Whether a heading speaks of a distance from where an angle is measured."""
    return _is_of(text, words_for("separation"))


def is_angle_word(text):
    """Whether all words of a heading are those of an angle."""
    return bool(plain_words(text)) and plain_words(text) <= words_for("sky_angle") | _FILLER


def is_position_angle(text):
    """Whether a heading names an angle that is counted from north through east."""
    return bool(plain_words(text) & words_for("position_angle"))


def sky_unit(text):
    """A unit as it is known: ``"`` and its like are arcseconds; others as they are."""
    return "arcsec" if text.strip().lower() in _ARCSEC else text


def is_of_sky(unit):
    """Whether a unit is one of small angles on the sky."""
    return sky_unit(unit).strip() in OF_THE_SKY


def error_of(text):
    """Of which column a heading is the error: "distance", "angle", or None."""
    words = plain_words(text)
    rest = words - _ERROR
    glued = _GLUED.fullmatch(text.strip().lower())
    names = [" ".join(rest)] if words & _ERROR else [glued[1] or glued[2]] if glued else []
    for name in names:
        if is_far(name):
            return "distance"
        if is_angle_word(name):
            return "angle"
    return None


def is_bare_error(text):
    """Whether a heading says error and nothing else, as beside the column that it is of."""
    return bool(plain_words(text)) and plain_words(text) <= _ERROR


def date_unit(text):
    """The unit that the name of a column of dates implies ("yr", "day"), "" if none is; or None.

    >>> date_unit("Besselian year"), date_unit("Epoch (MJD)"), date_unit("Obs. date")
    ('yr', 'day', '')
    >>> date_unit("observer") is None
    True
    """
    words = plain_words(_SINCE.sub("", text))
    if not words or not words <= _DATE or words <= {"obs", "observed", "of"}:
        return None
    return "yr" if words & _YEAR else "day" if words & _DAY else ""


def is_date(text):
    """Whether a heading speaks of dates, and not of any time."""
    return date_unit(text) is not None and bool(
        plain_words(text) & ({"date", "epoch", "ep"} | _YEAR | _DAY)
    )


def is_julian(text):
    """Whether a heading counts days in the manner of Julius Scaliger."""
    return date_unit(text) == "day" and bool(plain_words(text) & _DAY)


def is_besselian(text):
    """Whether a heading counts years in the manner of Bessel."""
    return bool(plain_words(text) & {"besselian", "bessel", "byear"})
