"""Typed laws: well-typed ones, almost well-typed ones, and text that is no law."""

import re

from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.pieces import PLANTED, mostly, numbers, units, weighted
from tests.fuzz.recordings import PLAIN, plain_recording

GOOD = (
    "9.81 [m/s^2] * m_i * down",
    "-c * v_i",
    "-c * norm(v_i) * v_i",
    "k * (norm(p_i - p_j) - 0.3 [m]) * normalize(p_j - p_i)",
    "g * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)",
    "b * perp(v_i)",
    "c * m_i * mu_j * normalize(v_i) * is_on(s_i, p_i, s_j, p_j)",
    "c * sin(w * t) * e_x",
    "c * m_i * norm(v_i)^n * normalize(v_i)",
    "c * e_x",
)
CONSTANTS = ("c", "k", "g", "n", "w", "b", "c1", "c2", "c3", "w1")
_SCALARS = (
    "m_i", "m_j", "mu_i", "mu_j", "q_i", "R_i", "R_j", "l_j", "k_j", "mass_i", "norm(v_i)",
    "norm(p_i - p_j)", "dot(v_i, e_x)", "c", "k", "n", "t", "pi", "e", "E", "I", "x", "w1",
    "c[scene]", "c[body]", "c[", "lambda", "1 [kg]", "0 [m]", "2", "nan", "inf", "1e999", "0.5",
    "is_on(s_i, p_i, s_j, p_j)", "does_collide(s_i, p_i, s_j, p_j)", "True", "None", "m_k", "_i",
    "norm", "v_i.x", "p_c", "1j", "'a'", "0x1F", "1_0", "m i", "é", "𝑚_i", "m_ｉ",
)  # fmt: skip
_VECTORS = (
    "v_i", "v_j", "p_i - p_j", "p_j - p_i", "p_i", "p_j", "p_c - p_i", "normalize(v_i)", "e_x",
    "e_y", "e_z", "up", "down", "normalize(p_j - p_i)", "perp(v_i)", "cross(v_i, e_z)",
    "along(v_i, e_x)", "v_i - v_j", "0", "spin_i",
)  # fmt: skip
_CALLS = (
    "sqrt", "abs", "square", "inverse", "exp", "log", "sin", "cos", "tanh", "sign", "norm",
    "normalize", "perp", "eval", "exec", "print", "step", "float", "max", "sum", "getattr",
)  # fmt: skip
_GLUE = (
    "*", "/", "^", "**", "+", "-", "%", "//", "@", "&", "|", "<<", "==", "<", "if", "for", ",",
    ";", ":", ".", "=", ":=", "~", "not", "(", ")", "[", "]", "{", "}", "\\", "\n", "#", "\x00",
)  # fmt: skip

_numbers = st.one_of(
    st.builds("{} [{}]".format, numbers, units), numbers, st.just("1 [kg m/s^2]")
)
_scalars = st.recursive(
    st.one_of(mostly(st.sampled_from(_SCALARS[:16]), st.sampled_from(_SCALARS)), _numbers),
    lambda inner: st.one_of(
        st.builds("({} {} {})".format, inner, st.sampled_from("*/+-"), inner),
        st.builds("{}^{}".format, inner, st.sampled_from(["2", "-1", "0.5", "n", "-2", "99"])),
        st.builds("{}({})".format, st.sampled_from(_CALLS), inner),
        st.builds("-{}".format, inner),
    ),
    max_leaves=6,
)
_vectors = st.sampled_from(_VECTORS)
_kinematics = ("norm(v_i)", "m_i", "mu_i", "q_i", "R_i", "2", "q_i^n", "t")
_product = st.lists(
    st.builds(
        "{}{}{}".format,
        st.sampled_from("*/"),
        mostly(st.sampled_from(_kinematics), st.sampled_from(_SCALARS), 16),
        st.sampled_from(("", "", "^2", "^-1", "^0.5", "^n", "^-3", "^99")),
    ),
    max_size=3,
).map("".join)
_own = ("v_i", "e_x", "e_y", "up", "down", "normalize(v_i)", "perp(v_i)", "along(v_i, e_x)")
_sound = st.builds(
    "{}c1{} * {}".format, st.sampled_from(("", "-", "1e3 * ", "exp(2) * ")), _product,
    mostly(st.sampled_from(_own), st.sampled_from(_VECTORS), 12),
)  # fmt: skip
_typed = st.one_of(
    st.builds("{} * {}".format, _scalars, _vectors),
    st.builds("c1 * {} * {}".format, _scalars, _vectors),
    st.builds("-{} * {} / {}".format, _scalars, _vectors, _scalars),
    st.builds("{} + {}".format, st.sampled_from(GOOD), st.sampled_from(GOOD)),
)
_soup = st.lists(
    st.one_of(st.sampled_from((*_SCALARS, *_VECTORS, *_CALLS, *_GLUE)), numbers), max_size=12
).map(" ".join)


@st.composite
def _edited(draw):
    """A good law with one piece replaced, doubled or left out."""
    law = draw(st.sampled_from(GOOD))
    at = draw(st.integers(0, len(law)))
    end = draw(st.integers(at, min(len(law), at + 4)))
    piece = draw(st.one_of(st.sampled_from((*_GLUE, *_SCALARS, *PLANTED)), st.text(max_size=4)))
    return law[:at] + piece + law[end:]


_extreme = st.sampled_from(
    (
        "(" * 150 + "c" + ")" * 150 + " * v_i",
        "(" * 5000 + "c" + ")" * 5000 + " * v_i",
        "-" * 3000 + "c * v_i",
        "c * v_i" + " + c * v_i" * 400,
        "c * v_i" + " + c * v_i" * 5000,
        "c^" * 300 + "2 * v_i",
        "9^9^9^9^9 * v_i",
        "9**9**9**9 * v_i",
        "norm(" * 400 + "v_i" + ")" * 400 + " * v_i",
        "9" * 5000 + " * v_i",
        "c" * 100_000 + " * v_i",
        "[" * 4000,
        "1 [" + "m" * 10_000 + "] * v_i",
        "1 [m^" + "9" * 400 + "] * v_i",
        "c * exp(exp(exp(exp(norm(v_i) / 1 [m/s])))) * v_i",
        "c / (p_i - p_i) * v_i",
        "c / norm(v_i - v_i) * v_i",
        "log(-norm(v_i) / 1 [m/s]) * c * v_i",
        "sqrt(-1) * c * v_i",
        "(-2)^0.5 * c * v_i",
        "0^-1 * c * v_i",
        "c * v_i / 0",
        "1e300 * 1e300 * c * v_i",
        "1e308 [kg/s] * v_i",
        "-1e308 [kg/s] * v_i",
        "1e308 [kg m/s^2] * e_x",
        "1e-320 [kg/s] * v_i",
        "c * norm(v_i)^n * norm(v_i)^n * v_i",
        "c1*v_i + c2*v_i + c3*v_i + c4*v_i + c5*v_i + c6*v_i + c7*v_i + c8*v_i",
        "",
        " ",
        "\n",
        "0 * v_i",
        "c - c",
    )
)
_texts = st.text(st.characters(max_codepoint=0x2FF), max_size=30)
_nonsense = st.one_of(
    st.sampled_from(PLANTED), _texts, st.builds("{} * v_i".format, st.sampled_from(PLANTED)), _soup
)
laws = weighted(
    (4, st.sampled_from(GOOD)), (14, _sound), (2, _typed), (4, _edited()), (1, _extreme),
    (2, _nonsense),
)  # fmt: skip


@st.composite
def cases(draw):
    """A typed law on a plain recording: rolled out, or fitted."""
    recording = plain_recording(draw(st.sampled_from(("pair", *PLAIN))))
    texts = draw(st.lists(laws, min_size=1, max_size=draw(st.sampled_from((1, 1, 1, 2)))))
    files = dict(recording)
    said = [f"--law={text}" for text in texts]
    if draw(st.integers(0, 9)) == 0 and not any("\x00" in text for text in texts):
        from bsp_gp.data.declaration import toml_text

        files["model.toml"] = toml_text({"declare": texts}).encode("utf-8", "replace")
        said = ["--model", "model.toml"]
    command = draw(st.sampled_from(("simulate", "simulate", "fit")))
    if command == "simulate":
        words = set(re.findall(r"[A-Za-z_]\w*", " ".join(texts)))
        names = [name for name in CONSTANTS if name in words]
        given = [f"{name}={draw(mostly(st.just('0.1'), numbers))}" for name in names]
        extra = ["--out", "out", "--substeps", "2", *(["--set", *given] if given else [])]
    else:
        extra = draw(st.sampled_from((["--out", "out"], ["--json"], [])))
    return Case("laws", (command, "data", *said, *extra, "--quiet"), files)
