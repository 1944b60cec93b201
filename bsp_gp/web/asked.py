"""What the page asks for, as words of the command line; what is not known is refused."""

import re

from bsp_gp.data.declaration import UP_AXES
from bsp_gp.errors import SettingsError

_TIME = re.compile(r"\d{1,5}(s|m|h)")
_COLOUR = re.compile(r"#[0-9a-f]{6}")
MAX_TEXT, MAX_LAWS = 2000, 20


def _texts(asked, name):
    """A mapping of texts to texts; empty values are left out."""
    found = asked.get(name) or {}
    if not isinstance(found, dict) or len(found) > 100:
        raise SettingsError(f"{name} must be pairs of texts")
    for pair in found.items():
        if not all(isinstance(word, str) and len(word) <= 200 for word in pair):
            raise SettingsError(f"{name} must be pairs of texts")
    return {key.strip(): value.strip() for key, value in found.items() if value.strip()}


def _number(asked, name):
    value = asked.get(name)
    if value in (None, ""):
        return None
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = 0.0
    if not 0 < number < 1e9:
        raise SettingsError(f"{name} must be a positive number, got {str(value)[:40]!r}")
    return number


def data_options(asked):
    """How data are to be read: arguments of `load_dataset`, and ``up``."""
    options = {
        "units": _texts(asked, "units") or None, "columns": _texts(asked, "columns") or None,
        "fps": _number(asked, "fps"), "up": asked.get("up") or None,
    }  # fmt: skip
    if options["up"] not in (None, *UP_AXES):
        raise SettingsError(f"the vertical must be one of {', '.join(UP_AXES)}")
    return {name: value for name, value in options.items() if value is not None}


def data_words(options):
    """The same for the command line."""
    words = []
    for name in ("units", "columns"):
        pairs = [f"{key}={value}" for key, value in options.get(name, {}).items()]
        words += [f"--{name}", *pairs] if pairs else []
    words += [f"--fps={options['fps']:g}"] if "fps" in options else []
    return [*words, *([f"--up={options['up']}"] if "up" in options else [])]


def laws_of(asked):
    """Texts of laws and constraints, those that are not blank."""
    laws = asked.get("laws") or []
    if not isinstance(laws, list) or not all(isinstance(law, str) for law in laws):
        raise SettingsError("laws must be a list of texts")
    laws = [law.strip() for law in laws if law.strip()]
    if len(laws) > MAX_LAWS or any(len(law) > MAX_TEXT for law in laws):
        raise SettingsError(f"at most {MAX_LAWS} laws of {MAX_TEXT} characters")
    return laws


def run_words(asked, options):
    """The command of a run and its options, without data and folder."""
    laws = laws_of(asked)
    forces = [law for law in laws if "=" not in law]
    limit = asked.get("time_limit") or ""
    if limit and not _TIME.fullmatch(str(limit)):
        raise SettingsError("the time must be such as 60s, 5m or 1h")
    if laws and not forces:
        raise SettingsError("a rod or an incline needs a force beside it, such as the weight")
    words = ["close" if forces else "fit"]  # without any law, from no force at all
    words += [f"--{'constrain' if '=' in law else 'declare'}={law}" for law in laws]
    words += [f"--time-limit={limit}"] if limit and forces else []
    return [*words, *data_words(options)]


def track_words(asked):
    """The command that follows one object of a film."""
    colour, name = str(asked.get("colour", "")).lower(), str(asked.get("name") or "body")
    if not _COLOUR.fullmatch(colour):
        raise SettingsError("click on the object in the picture, so that its colour is known")
    if not re.fullmatch(r"\w{1,30}", name):
        raise SettingsError("the name of the object must be one word")
    scale, fps = _number(asked, "scale"), _number(asked, "fps")
    if scale is None:
        raise SettingsError("click on two points, and say how far apart they are")
    words = ["track", "--no-film", f"--object={name}=disc:{colour}", f"--scale={scale:.6g}"]
    return [*words, *([f"--fps={fps:g}"] if fps else [])]
