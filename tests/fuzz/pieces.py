"""What hostile and careless people write: numbers, names, units, and damage to files."""

import math
import random

from hypothesis import strategies as st

from tests.fuzz.trial import CANARY

PLANTED = (
    f"__import__('os').system('touch {CANARY}')",
    f"open('{CANARY}', 'w')",
    f"exec(\"open('{CANARY}', 'w')\")",
    f"eval('open(\"{CANARY}\", \"w\")')",
    f"().__class__.__base__.__subclasses__()[0]('{CANARY}')",
    f"(lambda: open('{CANARY}', 'w'))()",
    f"[open('{CANARY}', 'w') for _ in (1,)]",
    f"$(touch {CANARY})",
    f"`touch {CANARY}`",
    f"; touch {CANARY} #",
    f"{{{{open('{CANARY}', 'w')}}}}",
    f"!!python/object/apply:os.system ['touch {CANARY}']",
)
"""Texts that make a file if anything evaluates them."""
ODD_NUMBERS = (
    "nan", "NaN", "NA", "inf", "-inf", "1e999", "-1e308", "1e308", "1e-320", "0", "-0.0", "1,5",
    "1.234,5", "1,234.5", "0x10", "1_000", "--1", "1e", "e5", "TRUE", "#N/A", "#DIV/0!", "-", "?",
    "2026-01-01", "12:30:01.5", "01/02/2026 12:00", " 1 ", "1 m", "5%", "1/3", "1 000", "٣", "−3",
    "9" * 40, "9" * 400, "0." + "1" * 300, "1e-400", "\x00", "\"", "'", "1\t2", "1;2", "\u00a01",
    "1e22", "-1e-30", "123456789012345678", "+3", ".5", "5.", "1d3", "*",
)  # fmt: skip
ODD_NAMES = (
    "ball", "a b", "ä", "b;c", "=1+1", "+1", "-2", "@x", "nan", "1", "1.0", "..", "../x", "a/b",
    "p", "t", "x", "v", "c", "i", "j", "m", "mass", "y" * 300, "\u202eabc", "None", "true", "*",
    "[a]", "a,b", "#", "\"q\"", "'", "\\", "%s", "{0}", "<b>", "&amp;", "CON", "e_x", "up", "",
    " ", "\x00", "lambda", "norm", "k", "l", "R", "scene", "entity", "frame", *PLANTED[:3],
)  # fmt: skip
UNITS = ("m", "cm", "mm", "km", "s", "ms", "min", "h", "kg", "g", "px", "1", "m/s", "N", "deg",
         "rad", "AU", "day", "C", "m^2", "kg m/s^2", "inch", "ft", "year", "K", "degC",
         "dB")  # fmt: skip
ODD_UNITS = (
    "", " ", "m/", "/s", "m**9999999", "m^(2^9999)", "m^-1e9", "xyz", "m;s", "1e400 m", "0 m",
    "-1 m", "nan m", "m m m", "(" * 200 + "m" + ")" * 200, "µm", "°", "Å", "m^0.5", "9**9**9",
    "m+s", "delta_degC", "m\x00", "%", "meter_per_second", "1/0", "0*m", *PLANTED[:3],
)  # fmt: skip


def mostly(usual, odd, share=5):
    """`usual`, and one time in `share` something of `odd`."""
    return st.integers(0, share - 1).flatmap(lambda k: odd if k == share - 1 else usual)


def weighted(*pairs):
    """One of the strategies, each so many times; `one_of` would flatten and merge them."""
    table = [strategy for times, strategy in pairs for _ in range(times)]
    return st.integers(0, len(table) - 1).flatmap(lambda k: table[k])


odd_numbers = st.one_of(
    st.sampled_from(ODD_NUMBERS),
    st.floats(allow_nan=True, allow_infinity=True).map(repr),
    st.integers(-(10**25), 10**25).map(str),
)
odd_names = st.one_of(st.sampled_from(ODD_NAMES), st.text(max_size=12))
odd_units = st.one_of(st.sampled_from(ODD_UNITS), st.sampled_from(UNITS), st.text(max_size=6))
units = mostly(st.sampled_from(UNITS), odd_units, 10)
plain_numbers = st.one_of(
    st.integers(-20, 20).map(str), st.floats(-100, 100).map(lambda x: f"{x:.4g}")
)
numbers = mostly(plain_numbers, odd_numbers, 10)


@st.composite
def damaged(draw, content, share=3):
    """The same bytes; one time in `share` as a disc, an editor or a prankster leaves them."""
    if draw(st.integers(0, share - 1)) != share - 1:
        return content
    for _ in range(draw(st.integers(1, 3))):
        size = len(content)
        at = draw(st.integers(0, max(0, size - 1)))
        end = min(size, at + draw(st.integers(1, 40)))
        how = draw(st.sampled_from(_DAMAGE))
        content = how(content, at, end)
    return content


def _recoded(encoding):
    def damage(content, at, end):
        return content.decode("utf-8", "replace").encode(encoding, "replace")

    return damage


_DAMAGE = (
    lambda c, a, e: c[:a],
    lambda c, a, e: c[a:],
    lambda c, a, e: c[:a] + c[e:],
    lambda c, a, e: c[:a] + c[a:e] * 3 + c[e:],
    lambda c, a, e: c[:a] + b"\x00" * (e - a) + c[e:],
    lambda c, a, e: c[:a] + bytes((b ^ 0x80) for b in c[a:e]) + c[e:],
    lambda c, a, e: c[:a] + b"\xff\xfe" + c[a:],
    lambda c, a, e: c[:a] + "ü¼€".encode() + c[a:],
    lambda c, a, e: c[:a] + "ü²€".encode("latin-1", "replace") + c[a:],
    lambda c, a, e: b"\xef\xbb\xbf" + c,
    lambda c, a, e: c.replace(b"\n", b"\r\n"),
    lambda c, a, e: c.replace(b"\n", b"\r"),
    lambda c, a, e: c + b"\x1a",
    lambda c, a, e: c + c,
    lambda c, a, e: b"",
    lambda c, a, e: b"\n" * 50 + c,
    lambda c, a, e: c[:a] + b'"' + c[a:],
    lambda c, a, e: c[:a] + b"\n" + c[a:],
    lambda c, a, e: c[:a] + b"[" * 3000 + c[a:],
    lambda c, a, e: c[:a] + b"9" * 5000 + c[a:],
    lambda c, a, e: c[:a] + b"a" * 200_000 + c[a:],
    _recoded("utf-16"),
    _recoded("utf-16-le"),
    _recoded("utf-32"),
    _recoded("latin-1"),
    _recoded("cp1252"),
)

seeds = st.integers(0, 2**32 - 1).map(random.Random)


def tracks(rng, n_rows, n_dims, scale=1.0):
    """One smooth track with a little noise, rows of (t, x, y[, z])."""
    step = 0.05
    noise = scale * rng.choice([0, 1e-9, 1e-3, 1e-2])
    start = [rng.uniform(-2, 2) * scale for _ in range(n_dims)]
    speed = [rng.uniform(-3, 3) * scale for _ in range(n_dims)]
    pull = [rng.choice([0, 0, -9.81, rng.uniform(-5, 5)]) * scale for _ in range(n_dims)]
    wobble = rng.choice([0, 0, 0.1]) * scale
    rows = []
    for k in range(n_rows):
        t = step * k
        place = [
            start[d] + speed[d] * t + pull[d] * t * t / 2 + wobble * math.sin(5 * t + d)
            + rng.gauss(0, 1) * noise
            for d in range(n_dims)
        ]  # fmt: skip
        rows.append((t, *place))
    return rows
