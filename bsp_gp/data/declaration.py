"""What a data set says about itself: ``dataset.toml`` in and out, checked key by key."""

import dataclasses
import fnmatch
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from bsp_gp.data.conversion import KINDS, is_unit
from bsp_gp.data.headings import ALIASES, IGNORE, NUMBER_COLUMNS, is_angle_name, is_frame_name
from bsp_gp.data.scene import SIGHT, Evaluation, LatentDeclaration
from bsp_gp.data.toml import TomlError, parse_toml
from bsp_gp.errors import DataError

PROVENANCE_KEYS = (
    "description", "source", "license", "licence", "authors", "url", "doi", "citation", "date",
    "version", "contact",
)  # fmt: skip
TOP_KEYS = (
    "name", *PROVENANCE_KEYS, "dt", "fps", "noise", "noise_memory", "steps",
    "units", "axes", "columns", "initial", "latent", "sky", "split", "evaluation", "provenance",
)  # fmt: skip
SKY = ("distance", "parallax")
SEEN = ("measured", "only", "unseen", SIGHT, "ignore")
"""What velocities are, see `Dataset`."""
FIRST_PLACES = ("exact", "measured")
FIRST_VELOCITIES = ("exact", "measured", "rest", "unknown")
PRIOR_FORMS = ("uniform:LOW:HIGH", "log-uniform:LOW:HIGH", "normal:MEAN:SD[:LOW:HIGH]",
               "values:A,B,C")  # fmt: skip
UP_AXES = ("x", "y", "z", "-x", "-y", "-z")
ANGLE_FROM = ("x", "y")
ANGLE_TURNS = ("counter-clockwise", "clockwise")
SPELLINGS = {"counterclockwise": "counter-clockwise", "anticlockwise": "counter-clockwise"}
"""Other words for the same."""


@dataclass(frozen=True)
class Declaration:
    """The content of a ``dataset.toml``, or of the arguments that stand in for one.

    Attributes
    ----------
    units : mapping of str to str
        Kind or column -> unit.
    angle_from, angle_turns : str or None
        Axis on which an angle is 0, and how it turns, see `polar.from_polar`; None if unsaid.
    up, dt, fps, noise, noise_memory, steps, velocity
        As in `bsp_gp.data.scene.Dataset`; times and lengths in the data's own units. Noise may be
        a mapping of bodies, or of globs of them, to their own.
    columns : mapping of str to str
        Our name of a column -> its name in the file.
    properties : mapping
        What is said of properties of bodies, see `properties.read_properties`.
    sky : mapping of str to str
        ``distance`` or ``parallax`` of what is seen, see `sky.from_sky`.
    uses : tuple of str
        Names in laws: columns of these names are inputs, if their headings tell their units.
    first_position, first_velocity : str
        What is known of the first row of every scene, of `FIRST_PLACES` and `FIRST_VELOCITIES`.
    train, test : tuple of str
        Patterns as declared, see `select_scenes`.
    provenance : mapping of str to str
    file : str or None
        Where all this was read from.
    """

    name: str | None = None
    units: Mapping = field(default_factory=dict)
    up: str | None = None
    angle_from: str | None = None
    angle_turns: str | None = None
    dt: float | None = None
    fps: float | None = None
    noise: tuple[float, ...] | Mapping | None = None
    noise_memory: float | None = None
    steps: tuple[float, ...] = ()
    velocity: str = "ignore"
    columns: Mapping = field(default_factory=dict)
    properties: Mapping = field(default_factory=dict)
    sky: Mapping = field(default_factory=dict)
    uses: tuple[str, ...] = ()
    first_position: str = "measured"
    first_velocity: str = "unknown"
    latents: tuple[LatentDeclaration, ...] = ()
    train: tuple[str, ...] = ()
    test: tuple[str, ...] = ()
    evaluation: Evaluation = field(default_factory=Evaluation)
    provenance: Mapping = field(default_factory=dict)
    file: str | None = None

    def __post_init__(self):
        if self.dt is not None and self.fps is not None:
            raise DataError(
                "dt and fps are both given", file=self.file, remedy="keep the one you measured"
            )

    def override(
        self, *, units=None, columns=None, fps=None, dt=None, train=None, test=None, noise=None,
        properties=None, sky=None, uses=(),
    ):  # fmt: skip
        """Let the caller's arguments win over the file."""
        reader = _Reader({"noise": noise}, "arguments")
        changes = {} if noise is None else {"noise": reader.noise()}
        if uses:
            changes["uses"] = tuple(uses)
        if properties is not None:
            changes["properties"] = dict(properties)
        if sky is not None:
            for key in set(sky) - set(SKY):
                reader.fail(f"[sky] has {' or '.join(SKY)}, not {key!r:.60}")
            changes["sky"] = reader.texts(sky, "sky")
        if units is not None:
            changes["units"] = {**self.units, **reader.texts(units, "units")}
        if columns is not None:
            renames = reader.texts(columns, "columns")
            changes["velocity"] = reader.choice(renames, "velocity", SEEN, self.velocity)
            renames.pop("velocity", None)
            ours = _our_keys(renames)
            changes["columns"] = {**self.columns, **ours}
            said = changes.get("units", self.units)  # by the names that columns were given
            named = {key: name for key, name in zip(renames, ours, strict=True) if key not in KINDS}
            changes["units"] = {named.get(name, name): unit for name, unit in said.items()}
        if fps is not None or dt is not None:
            changes["fps"] = reader.positive({"fps": fps}, "fps")
            changes["dt"] = reader.positive({"dt": dt}, "dt")
        if train is not None or test is not None:
            changes["train"] = reader.patterns({"train": train}, "train")
            changes["test"] = reader.patterns({"test": test}, "test")
        return dataclasses.replace(self, **changes)._with_frames()

    @property
    def kept_names(self):
        """Names with a unit at their end by which laws and units call a column: they are kept."""
        taken = {*self.columns, *self.columns.values(), *NUMBER_COLUMNS}
        names = [n for n in (*self.uses, *self.units) if "_" in n and n not in taken]
        parts = {n: n.rpartition("_") for n in names}
        return {n: n for n, (stem, _, unit) in parts.items()
                if stem not in taken and is_unit(unit)}  # fmt: skip

    def _with_frames(self):
        """With a rate, a column t that is called frame counts them."""
        has_rate = self.fps is not None or self.dt is not None
        is_counted = has_rate and "frame" not in self.columns
        if not is_counted or not is_frame_name(self.columns.get("t", "")):
            return self
        columns = {"frame" if name == "t" else name: c for name, c in self.columns.items()}
        return dataclasses.replace(self, columns=columns)


_KEYS = {
    **{alias: ours for alias, ours in ALIASES.items() if ours == "entity"},
    "body": "entity", "individual": "entity",
    "time": "t", "run": "scene", "trial": "scene", "recording": "scene",
}  # fmt: skip
"""What users call what a column is."""
_BODY_ANGLE = re.compile(r"(\w+)_(?:theta|phi|angle)")
_BODY_PLACE = re.compile(r"([xyz])_?(\d+)")


def _our_keys(columns):
    """Columns under our keys; what is left out keeps its name, which is one of the file's."""
    kept = {key: theirs for key, theirs in columns.items() if theirs.strip() != IGNORE}
    ours = dict(zip(kept, _named_as_ours(kept), strict=True))
    return {ours.get(key, key): theirs for key, theirs in columns.items()}


def _named_as_ours(columns):
    """Our keys: a lone angle is the coordinate x, each of several that of a body."""
    columns = {
        _KEYS[key] if key in _KEYS and _KEYS[key] not in columns else
        _BODY_PLACE.sub(r"\2_\1", key) if _BODY_PLACE.fullmatch(key) else key: theirs
        for key, theirs in columns.items()
    }
    angles = [key for key in columns if is_angle_name(key)]
    if {"x", "y", "r", "distance", "separation"} & set(columns):
        return columns
    columns = {_BODY_ANGLE.sub(r"\1_x", key): theirs for key, theirs in columns.items()}
    own = {key: f"{key}_x" for key in angles} if len(angles) > 1 else dict.fromkeys(angles, "x")
    return {own.get(key, key): theirs for key, theirs in columns.items()}


def read_declaration(path):
    """Read and check a ``dataset.toml``.

    Raises
    ------
    DataError
        If the file is no TOML, or holds an unknown key or a value that is not allowed.
    """
    path = Path(path)
    try:
        content = parse_toml(path.read_bytes())
    except UnicodeDecodeError as error:
        raise DataError("the file is not UTF-8", file=path, remedy="save it as UTF-8") from error
    except TomlError as error:
        line = re.search(r"line (\d+)", str(error))
        raise DataError(
            f"this is not valid TOML: {error}", file=path, row=int(line[1]) if line else None,
            remedy='texts stand in quotes and tables in brackets: [units], length = "m"',
        ) from error  # fmt: skip
    return _Reader(content, str(path)).declaration()


class _Reader:
    """Checks the tables of one file; every complaint names the file and the key."""

    def __init__(self, content, file):
        self.content = content
        self.file = file

    def fail(self, problem, key=None, remedy=None):
        raise DataError(problem, file=self.file, column=key, remedy=remedy)

    def known(self, table, allowed, where):
        unknown = sorted(set(table) - set(allowed))
        if unknown:
            self.fail(f"unknown key {unknown[0]!r} {where}; allowed are {', '.join(allowed)}")

    def table(self, key, allowed=None):
        table = self.content.get(key, {})
        if not isinstance(table, Mapping):
            self.fail(f"{key!r} must be a table, got {table!r:.60}", remedy=f"write [{key}]")
        if allowed is not None:
            self.known(table, allowed, f"in [{key}]")
        return table

    def texts(self, table, where):
        for key, value in table.items():
            if not isinstance(value, str):
                self.fail(f"{key!r} in [{where}] must be a text in quotes, got {value!r:.60}")
        return dict(table)

    def choice(self, table, key, allowed, default=None):
        value = table.get(key, default)
        value = SPELLINGS.get(value, value) if isinstance(value, str) else value
        if value is not None and value not in allowed:
            self.fail(f"{key} must be one of {', '.join(allowed)}, got {value!r:.60}")
        return value

    def number(self, value, key):
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not math.isfinite(value):
            self.fail(f"{key} must be a finite number, got {value!r:.60}")
        return float(value)

    def positive(self, table, key):
        if table.get(key) is None:
            return None
        value = self.number(table[key], key)
        if value <= 0:
            self.fail(f"{key} must be positive, got {value:g}")
        return value

    def patterns(self, table, key):
        value = table.get(key)
        items = () if value is None else value if isinstance(value, list | tuple) else (value,)
        for item in items:
            if isinstance(item, bool) or not isinstance(item, str | int):
                self.fail(f"{key} must hold names, globs or ranges a..b, got {item!r:.60}")
        return tuple(str(item) for item in items)

    def declaration(self):
        self.known(self.content, TOP_KEYS, "at the top level")
        axes = self.table("axes", ("up", "angle_from", "angle_turns"))
        split = self.table("split", ("train", "test"))
        initial = self.table("initial", ("position", "velocity"))
        columns = self.texts(self.table("columns"), "columns")
        velocity = self.choice(columns, "velocity", SEEN, "ignore")
        columns.pop("velocity", None)
        top = {k: self.content[k] for k in ("name", *PROVENANCE_KEYS) if k in self.content}
        top = self.texts({k: _flat(v) for k, v in top.items()}, "top level")
        name = top.pop("name", None)
        return Declaration(
            name=name,
            units=self.texts(self.table("units"), "units"),
            up=self.choice(axes, "up", UP_AXES),
            angle_from=self.choice(axes, "angle_from", ANGLE_FROM),
            angle_turns=self.choice(axes, "angle_turns", ANGLE_TURNS),
            dt=self.positive(self.content, "dt"),
            fps=self.positive(self.content, "fps"),
            noise=self.noise(),
            noise_memory=self.noise_memory(),
            steps=self.levels(self.content["steps"], "steps") if "steps" in self.content else (),
            velocity=velocity,
            columns=_our_keys(columns),
            sky=self.texts(self.table("sky", SKY), "sky"),
            first_position=self.choice(initial, "position", FIRST_PLACES, "measured"),
            first_velocity=self.choice(initial, "velocity", FIRST_VELOCITIES, "unknown"),
            latents=self.latents(),
            train=self.patterns(split, "train"),
            test=self.patterns(split, "test"),
            evaluation=self.evaluation(),
            provenance={**self.texts(self.table("provenance"), "provenance"), **top},
            file=self.file,
        )

    def noise(self):
        value = self.content.get("noise")
        if not isinstance(value, Mapping):
            return None if value is None else self.levels(value, "noise")
        of_bodies = {body: self.levels(item, f"noise of {body}") for body, item in value.items()}
        for body, values in of_bodies.items():
            if min(values) == 0:
                self.fail(f"noise of {body} must be positive", remedy="noise = 0: all are exact")
        return of_bodies

    def levels(self, value, key):
        items = value if isinstance(value, list | tuple) else [value]
        values = tuple(self.number(item, key) for item in items)
        if len(values) not in (1, 2, 3):
            self.fail(f"{key} must be a number or one per axis, got {value!r:.60}")
        if min(values) < 0:
            self.fail(f"{key} must not be negative, got {min(values):g}", remedy="0 means exact")
        return values

    def noise_memory(self):
        value = self.content.get("noise_memory")
        value = None if value is None else self.number(value, "noise_memory")
        if value is not None and value < 0:
            problem = f"noise_memory must not be negative, got {value:g}"
            self.fail(problem, remedy="0 means white noise")
        return value

    def latents(self):
        allowed = ("prior", "low", "high", "mean", "sd", "entities", "share", "values")
        found = []
        for name, table in self.table("latent").items():
            if not isinstance(table, Mapping):
                self.fail(f"latent {name!r} must be a table", remedy=f"write [latent.{name}]")
            self.known(table, allowed, f"in [latent.{name}]")
            if ":" in str(table.get("prior", "")):
                table = {**table, **self.prior(table, name)}
            known = [k for k in ("low", "high", "mean", "sd") if k in table]
            numbers = {k: self.number(table[k], k) for k in known}
            bounds = {k: numbers[k] for k in known if k in ("low", "high")}
            if len(bounds) == 2 and bounds["low"] >= bounds["high"]:
                self.fail(f"low must be below high in [latent.{name}], got {bounds}")
            values = table.get("values", [])
            if not isinstance(values, list):
                self.fail(f"values in [latent.{name}] must be a list, got {values!r:.60}")
            texts = self.texts({k: table[k] for k in ("prior", "share") if k in table}, name)
            found.append(LatentDeclaration(
                name, **numbers, **texts, entities=self.patterns(table, "entities"),
                values=tuple(self.number(v, "values") for v in values),
            ))  # fmt: skip
        return tuple(found)

    def prior(self, table, name):
        """The keys that a prior in one text stands for."""
        if doubled := sorted({"low", "high", "mean", "sd", "values"} & set(table)):
            self.fail(f"[latent.{name}] has {', '.join(doubled)} beside a prior with its numbers",
                      remedy="leave them out")  # fmt: skip
        try:
            return split_prior(str(table["prior"]))
        except (ValueError, IndexError):
            self.fail(f"prior in [latent.{name}] cannot be read: {table['prior']!r:.60}",
                      remedy=f"write {', '.join(PRIOR_FORMS)}")  # fmt: skip

    def evaluation(self):
        table = self.table("evaluation", ("initial_rows", "endpoint_row"))
        for key, value in table.items():
            if isinstance(value, bool) or not isinstance(value, int) or value < 1:
                self.fail(f"{key} in [evaluation] must be a whole number from 1, got {value!r:.60}")
        return Evaluation(**table)


def split_prior(text):
    """What a prior such as ``log-uniform:0.01:100`` says, as keys of ``[latent.NAME]``.

    Raises
    ------
    ValueError, IndexError
        If it is none of `PRIOR_FORMS`.
    """
    kind, *rest = text.split(":")
    if kind == "values":
        return {"prior": "discrete", "values": [float(value) for value in rest[0].split(",")]}
    numbers = [float(value) for value in rest]
    if kind in ("normal", "truncated-normal"):
        keys, kind = ("mean", "sd", "low", "high")[: max(2, len(numbers))], "truncated_normal"
        if len(numbers) == 3:
            raise ValueError("an end is missing")
    else:
        keys = ("low", "high")
    return {"prior": kind, **dict(zip(keys, numbers, strict=True))}


def _flat(value):
    is_texts = isinstance(value, list) and all(isinstance(item, str) for item in value)
    return ", ".join(value) if is_texts else value if isinstance(value, str | list) else str(value)


def select_scenes(patterns, names, *, what="split", file=None):
    """Expand names, globs and inclusive ranges ``a..b`` to names, in the order of `names`.

    Raises
    ------
    DataError
        If a pattern matches nothing.
    """
    chosen = set()
    for pattern in patterns:
        span = re.fullmatch(r"\s*(-?\d{1,300})\s*\.\.\s*(-?\d{1,300})\s*", pattern)
        if pattern in names:
            matches = {pattern}
        elif span:
            low, high = int(span.group(1)), int(span.group(2))
            numbers = [n for n in names if re.fullmatch(r"-?\d{1,300}", n)]
            matches = {n for n in numbers if low <= int(n) <= high}
        else:
            matches = set(fnmatch.filter(names, pattern))
        if not matches:
            raise DataError(
                f"{what} {pattern!r:.60} matches nothing; present are "
                f"{', '.join(list(names)[:20])}", file=file,
                remedy="give a name, a glob such as 'drop_*', a range such as '1..80', or a list",
            )  # fmt: skip
        chosen |= matches
    return tuple(name for name in names if name in chosen)


def toml_text(tables):
    """Write nested mappings of texts, numbers and lists as TOML; None and {} are left out."""
    lines = _lines({k: v for k, v in tables.items() if not isinstance(v, Mapping)})
    for name, table in tables.items():
        if not isinstance(table, Mapping) or not table:
            continue
        if all(isinstance(value, Mapping) for value in table.values()):
            for inner, values in table.items():
                lines += ["", f"[{_key(name)}.{_key(inner)}]", *_lines(values)]
        else:
            lines += ["", f"[{_key(name)}]", *_lines(table)]
    return "\n".join(lines).lstrip("\n") + "\n"


def _lines(table):
    return [f"{_key(k)} = {_value(v)}" for k, v in table.items()]


def _key(name):
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else _value(name)


def _value(value):
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return repr(value)
