"""Grammar files: those of the package and a small one, with lines changed."""

import functools

from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.commands import GRAMMAR
from tests.fuzz.pieces import PLANTED, damaged, mostly, odd_names, odd_units
from tests.fuzz.recordings import plain_recording

_BODIES = (
    "c1", "m_i", "mul(c1, v_i)", "mul(Force, Force)", "Force", "Const", "norm(v_i)", "mul(c1",
    "mul(c1, m_i, m_i)", "add(v_i, m_i)", "div(v_i, v_i)", "", "|", "c1 | ", "c1 || c1", "x_i",
    "foo(c1)", "__class__", "mul(c1, mul(Const, e_x))", "1", "c1 * v_i", "v_i.x", "mul(*v_i)",
    "mul(a=c1)", "c1 # note", "does_collide(s_i, p_i, s_j, p_j)", "square(square(c1))",
    "pow(c1, 2)",
    "norm(v_i)", "m_i", "e_x", "normalize(v_i)", "mul(c1, normalize(v_i))",
    "norm(" * 200 + "v_i" + ")" * 200, "norm(" * 3000 + "v_i" + ")" * 3000,
    " | ".join(["c1"] * 900),
)  # fmt: skip
_VALUES = ("1", "true", "[]", '["Force", "Const"]', "{}", "1e400", '"pair"', '"field"', '"both"',
           "nan", '""', '"vector m"', '"scalar"', '"matrix 1"', "[1, 2]", "-1",
           "9" * 5000)  # fmt: skip
_TABLES = ("[grammar]", "[types]", "[inputs]", "[constants]", "[operators]", "[rules]", "[weights]",
           "[what]", "[[rules]]", "[rules.Force]")  # fmt: skip


@functools.cache
def _sources():
    from importlib.resources import files

    names = ("newtonian", "newtonian_no_units", "physics", "newtonian_sum", "ullman")
    folder = files("bsp_gp.grammars")
    texts = [(folder / f"{name}.toml").read_text("utf-8") for name in names]
    return (GRAMMAR.decode(), GRAMMAR.decode(), *texts)


@st.composite
def texts(draw):
    """A grammar with a few lines changed."""
    lines = draw(st.sampled_from(_sources())).splitlines()
    for _ in range(draw(st.integers(0, 2))):
        at = draw(st.integers(0, len(lines) - 1))
        key = lines[at].partition("=")[0].strip() or "Force"
        part = next((line for line in reversed(lines[: at + 1]) if line.startswith("[")), "")
        usual = {"[rules]": "body", "[types]": "unit", "[inputs]": "unit"}.get(part[:8].strip())
        how = draw(st.sampled_from("drop double body value table unit key planted".split()))
        how = usual if usual and draw(st.integers(0, 3)) else how
        if how == "drop":
            lines[at] = ""
        elif how == "double":
            lines.insert(at, lines[draw(st.integers(0, len(lines) - 1))])
        elif how == "table":
            lines.insert(at, draw(st.sampled_from(_TABLES)))
        elif how == "body":
            bodies = draw(st.lists(st.sampled_from(_BODIES), min_size=1, max_size=3))
            lines[at] = f'{key} = "{" | ".join(bodies)}"'
        elif how == "value":
            lines[at] = f"{key} = {draw(st.sampled_from(_VALUES))}"
        elif how == "unit":
            shape = draw(st.sampled_from(("scalar", "vector", "point", "bool", "shape", "")))
            lines[at] = f'{key} = "{shape} {draw(mostly(st.sampled_from("*1"), odd_units, 3))}"'
        elif how == "planted":
            lines[at] = f"{key} = '''{draw(st.sampled_from(PLANTED))}'''"
        else:
            lines[at] = f'"{draw(odd_names)}" = {lines[at].partition("=")[2] or 1}'
    return "\n".join(lines)


@st.composite
def cases(draw):
    """A grammar file, shown, counted, or searched."""
    content = draw(damaged(draw(texts()).encode("utf-8", "replace"), 16))
    files = {"g.toml": content}
    is_small = b'name = "small"' in content  # the search of a large one is long by right
    how = draw(st.sampled_from(("show", "show", "count", "data", *(("compare",) * 3 * is_small))))
    if how in ("data", "compare"):
        files |= plain_recording(draw(st.sampled_from(("fall", "pair"))))
    levels = draw(st.sampled_from(("3", "8", "16")))
    argv = {
        "show": ("grammar", "show", "g.toml"),
        "count": ("grammar", "count", "g.toml", "--levels", levels),
        "data": ("grammar", "show", "g.toml", "--data", "data"),
        "compare": ("compare", "data", "--grammar", "g.toml", "--laws", "10", "--seeds", "1",
                    "--searches", "random", "--quiet"),
    }[how]  # fmt: skip
    return Case("grammars", argv, files)
