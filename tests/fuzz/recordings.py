"""Recordings: tables of tracks, rosters and declarations, mostly as they should be."""

import functools

from hypothesis import strategies as st

from tests.fuzz.pieces import mostly, odd_names, odd_numbers, seeds, tracks

PLAIN = ("fall", "pair", "deep")
"""Small sound recordings for tries that are about something else."""


@functools.cache
def plain_recording(name):
    """Files of one of `PLAIN` in the folder ``data``."""
    import random

    rng = random.Random(PLAIN.index(name))
    bodies = {"fall": ("ball",), "pair": ("a", "b"), "deep": ("a",)}[name]
    n_dims = 3 if name == "deep" else 2
    n_scenes = 2 if name == "fall" else 1
    axes = "xyz"[:n_dims]
    lines = [f"scene,t,entity,{','.join(axes)}"]
    for scene in range(n_scenes):
        for body in bodies:
            for t, *place in tracks(rng, 12, n_dims):
                lines.append(f"s{scene},{t:.3f},{body},{','.join(f'{x:.6f}' for x in place)}")
    roster = ["entity,shape,radius,mass,friction,charge,dynamic"]
    roster += [f"{body},disc,0.05,{0.5 + k},0.2,1,1" for k, body in enumerate(bodies)]
    up = "z" if n_dims == 3 else "y"
    toml = f'[units]\nlength = "m"\ntime = "s"\nmass = "kg"\n[axes]\nup = "{up}"\n'
    texts = {"trajectories.csv": lines, "entities.csv": roster, "dataset.toml": [toml]}
    return {f"data/{file}": "\n".join((*text, "")).encode() for file, text in texts.items()}


@st.composite
def grids(draw, names=None, odd_share=4):
    """A table of tracks as (columns, rows of texts), with a few odd cells, rows and columns."""
    rng = draw(seeds)
    n_dims = draw(st.sampled_from((1, *(2,) * 20, 3, 3)))
    scenes = draw(st.sampled_from(((), ("1",), ("a", "b"), ("s1", "s2", "s3"))))
    bodies = names or draw(st.sampled_from(((), ("ball",), ("a", "b"), ("a", "b", "c"))))
    scale = 10.0 ** draw(st.sampled_from((*(0,) * 30, 3, -6, 11, -12, 100, 150)))
    extras = draw(st.lists(st.sampled_from(("vx", "sx", "sy", "note", "frame")), max_size=2))
    columns = ["scene"] * bool(scenes) + ["t"] + ["entity"] * bool(bodies) + list("xyz")[:n_dims]
    rows = []
    n_rows = draw(st.sampled_from((1, 2, 3, *(5, 8, 12, 16, 20) * 8)))
    for scene in scenes or ("",):
        for body in bodies or ("",):
            for t, *place in tracks(rng, n_rows, n_dims, scale):
                cells = [scene] * bool(scenes) + [f"{t:.4g}"] + [body] * bool(bodies)
                rows.append([*cells, *(f"{x:.8g}" for x in place)])
    for extra in dict.fromkeys(extras):
        columns.append(extra)
        for k, row in enumerate(rows):
            row.append(str(k % n_rows) if extra == "frame" else f"{rng.uniform(0, 0.01):.4g}")
    if draw(st.integers(0, odd_share - 1)) == 0:
        _make_odd(draw, columns, rows)
    return columns, rows


def _make_odd(draw, columns, rows):
    """A few edits in place, such as people and programs make."""
    for _ in range(draw(st.integers(1, 3))):
        at = draw(st.integers(0, len(rows) - 1)) if rows else 0
        column = draw(st.integers(0, len(columns) - 1))
        how = draw(st.sampled_from("cell cell cell blank swap double short long text time still "
                                   "column same header".split()))  # fmt: skip
        if how == "header":
            columns[column] = draw(odd_names)
        elif how in ("column", "same"):
            value = draw(odd_numbers)
            for k, row in enumerate(rows):
                if column < len(row):
                    row[column] = value if how == "same" or k % 2 else row[column]
        elif rows:
            _edit_row(draw, rows, at, column, how)


def _edit_row(draw, rows, at, column, how):
    row = rows[at]
    if how == "swap":
        other = draw(st.integers(0, len(rows) - 1))
        rows[at], rows[other] = rows[other], rows[at]
    elif how == "double":
        rows.insert(at, list(row))
    elif how == "short":
        del row[draw(st.integers(0, len(row))) :]
    elif how == "long":
        row.append(draw(odd_numbers))
    elif how == "still":
        for other in rows[at:]:
            other[column:] = row[column:]
    elif column < len(row):
        row[column] = "" if how == "blank" else draw(odd_names if how == "text" else odd_numbers)


_SHAPES = (*("disc", "point", "rect_wall", "rect_mat", "") * 4, "rect", "DISC")


@st.composite
def rosters(draw, bodies):
    """The text of an entities.csv for these bodies."""
    known = ("shape", "radius", "width", "height", "dynamic", "mass", "friction", "charge",
             "stiffness", "rest_length", "spin_x", "spin_y", "spin_z", "scene", "p", "v",
             "note")  # fmt: skip
    columns = draw(st.lists(st.sampled_from(known), max_size=5, unique=True))
    if draw(st.integers(0, 7)) == 0:
        columns.append(draw(odd_names))
    names = list(bodies)
    if draw(st.integers(0, 4)) == 0:
        names.append(draw(odd_names))
    if draw(st.integers(0, 15)) == 0:
        names = names[1:]
    lines = [",".join(("entity", *columns))]
    cell = mostly(st.floats(0, 10).map(lambda x: f"{x:.3g}"), odd_numbers, 25)
    for name in names:
        cells = []
        for column in columns:
            usual = {"shape": st.sampled_from(_SHAPES), "dynamic": st.sampled_from("1101"),
                     "scene": st.sampled_from(("", "s1", "1"))}  # fmt: skip
            cells.append(draw(usual.get(column, cell)))
        lines.append(",".join((name, *cells)))
    return "\n".join((*lines, ""))


_values = st.one_of(
    st.sampled_from(
        ("1", "0", "-1", "0.02", "1e400", "nan", "inf", "true", '"a"', "[]", "[1, 2]", "{}", "-0.0",
         "{a = 1}", "1979-05-27", "[0.1, nan]", '["a", 1]', "9" * 30, '"""x\ny"""', "0x10")
    ),
    st.floats(0, 10).map(repr),
)  # fmt: skip
_tables = {
    "": ("name", "dt", "fps", "noise", "noise", "noise_memory", "description"),
    "units": ("length", "time", "mass", "angle", "x", "t", "charge", "velocity"),
    "axes": ("up", "angle_from"),
    "columns": ("x", "y", "t", "entity", "velocity", "z"),
    "split": ("train", "test"),
    "evaluation": ("initial_rows", "endpoint_row"),
    "provenance": ("source", "what"),
    "latent.mass": ("prior", "low", "high", "mean", "sd", "entities", "share", "values"),
    "latent.what": ("prior", "low", "high"),
}
_sizes = st.sampled_from((0.02, 0.1, 1, 3))
_usual = {
    "up": st.sampled_from(("x", "y", "-y", "y", "z")),
    "angle_from": st.sampled_from("xy"),
    "velocity": st.sampled_from(("measured", "ignore")),
    "prior": st.sampled_from(("uniform", "log-uniform", "normal", "values", "gauss")),
    "share": st.sampled_from(("entity", "all", "note")),
    "train": st.sampled_from(("s1", "s*", "1..2", "a", "*", "1")),
    "test": st.sampled_from(("s2", "s3", "b", "2..9", "zz")),
    "columns": st.sampled_from(("x", "y", "X", "t", "note")), "units": st.sampled_from("ms"),
    "provenance": st.just("a"), "name": st.just("a"), "description": st.just("a"),
    "entities": st.sampled_from(("ball", "a", "*")), "values": st.just([1, 2]),
    "initial_rows": st.sampled_from((1, 2, 3)), "endpoint_row": st.sampled_from((1, 5)),
}  # fmt: skip


@st.composite
def declarations(draw):
    """The text of a dataset.toml: tables and keys that there are, values that may not be."""
    lines = ['[units]\nlength = "m"\ntime = "s"\nmass = "kg"'] * (draw(st.integers(0, 5)) > 0)
    top = []
    names = [t for t in _tables if not (lines and t == "units")]
    for table in draw(st.lists(st.sampled_from(names), max_size=2, unique=True)):
        body = []
        for key in draw(st.lists(st.sampled_from(_tables[table]), max_size=2, unique=True)):
            usual = _usual.get(key, _usual.get(table, _sizes))
            text = mostly(usual.map(_quoted), _values, 10)
            body.append(f"{key} = {draw(text)}")
        if table:
            lines.append("\n".join((f"[{table}]", *body)))
        else:
            top = body
    return "\n".join((*top, *lines, ""))


def _quoted(text):
    from bsp_gp.data.declaration import toml_text

    return toml_text({"x": text}).removeprefix("x = ").rstrip("\n")
