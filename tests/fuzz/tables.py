"""Data sets: lone tables of many dialects, and folders."""

from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.commands import uses
from tests.fuzz.pieces import damaged, mostly, odd_names
from tests.fuzz.recordings import declarations, grids, rosters

_HEADS = {
    "t": ("t", "Time (s)", "Zeit t (s)", "t / s", "t in s", "time", "frame", "t[ms]", "t (h)"),
    "x": ("x", "x / cm", "X", "x (m)", "x-position (mm)", "x, m", "Ort x", "distance", "x [px]"),
    "y": ("y", "y / cm", "Y", "y (m)", "y-position (mm)", "angle", "y [kg]", "Weg y (km)"),
    "z": ("z", "z (m)", "Z"),
    "vx": ("vx", "v_x (m/s)", "x-velocity"),
    "entity": ("entity", "particle", "object", "track", "Entity"),
}
_ENCODINGS = (*("utf-8",) * 40, "utf-8-sig", "utf-8-sig", "latin-1", "utf-16", "cp1252", "utf-32")


@st.composite
def dialects(draw, grid):
    """The bytes of a table in some program's dialect."""
    columns, rows = grid
    mark = draw(st.sampled_from(",,,,;;;\t\t  |:"))
    comma = mark != "," and draw(st.booleans())
    quote = draw(st.sampled_from((*("",) * 20, '"', '"', "'")))
    columns = [draw(st.sampled_from(_HEADS.get(c, (c,)))) if draw(st.booleans()) else c
               for c in columns]  # fmt: skip
    lines = [mark.join(f"{quote}{c}{quote}" for c in columns)]
    title = draw(st.integers(0, 31))
    if title == 0:
        lines.insert(0, draw(mostly(st.just("mass A"), odd_names, 3)))
    elif title == 1:
        lines.insert(0, "# made by a program\n\n# 2026")
    elif title == 2:
        lines.append(mark.join("s" if c == "t" else "m" for c in columns))
    elif title == 3:
        lines = lines[1:]
    for row in rows:
        cells = [cell.replace(".", ",") if comma else cell for cell in row]
        lines.append(mark.join(f"{quote}{c}{quote}" for c in cells))
    end = draw(st.sampled_from(("\n", "\n", "\r\n", "\r")))
    tail = draw(st.sampled_from((*(end,) * 30, "", end * 3, f"{end}end of file{end}", mark)))
    encoding = draw(st.sampled_from(_ENCODINGS))
    return (end.join(lines) + tail).encode(encoding, "replace")


@st.composite
def lone(draw):
    """A lone table, and a command that reads it."""
    grid = draw(grids())
    content = draw(dialects(grid)) if draw(st.integers(0, 3)) else plain(grid)
    content = draw(damaged(content, 16))
    name = draw(mostly(st.just("falls.csv"), st.sampled_from(
        ("falls.txt", "falls.tsv", "falls", "fä lls.csv", "-f.csv", "falls.CSV", "a=b.csv",
         "falls.parquet", "falls.xlsx", "falls.json", "falls.trk", "falls.csv.gz",
         "%s.csv")), 10))  # fmt: skip
    files, argv = draw(uses(name))
    return Case("tables", argv, {**files, name: content})


def plain(grid):
    """The bytes of a table as comma-separated values."""
    columns, rows = grid
    return "\n".join((",".join(columns), *(",".join(row) for row in rows), "")).encode(
        "utf-8", "replace"
    )


@st.composite
def folders(draw):
    """A folder of a data set, and a command that reads it."""
    bodies = draw(st.sampled_from((("ball",), ("a", "b"), ("a", "b", "c"))))
    grid = draw(grids(bodies))
    table = plain(grid) if draw(st.integers(0, 15)) else draw(dialects(grid))
    files = {"data/trajectories.csv": draw(damaged(table, 40))}
    if draw(st.integers(0, 4)):
        roster = draw(rosters(bodies)).encode("utf-8", "replace")
        files["data/entities.csv"] = draw(damaged(roster, 40))
    if draw(st.integers(0, 4)):
        toml = draw(declarations()).encode("utf-8", "replace")
        files["data/dataset.toml"] = draw(damaged(toml, 40))
    if draw(st.integers(0, 60)) == 0:
        files.pop("data/trajectories.csv")
        files["data/notes.txt"] = b"nothing here"
    beside, argv = draw(uses("data"))
    return Case("folders", argv, {**beside, **files})
