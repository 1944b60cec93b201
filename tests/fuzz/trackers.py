"""Tracker's .trk files, built slot by slot."""

from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.commands import uses
from tests.fuzz.pieces import damaged, mostly, odd_names, odd_numbers, odd_units, seeds, tracks
from tests.fuzz.trial import CANARY

_PREFIX = "org.opensourcephysics.cabrillo.tracker."
_HEADS = (
    "",
    '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/hostname">]>',
    '<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">'
    '<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;"><!ENTITY x "&c;&c;&c;&c;&c;&c;&c;&c;">]>',
    f'<?xml-stylesheet href="javascript:{CANARY}"?>',
    "<!-- " + "-" * 50 + " -->",
)


def _tag(name, value, kind="double"):
    return f'<property name="{name}" type="{kind}">{value}</property>'


def _thing(name, kind, inner):
    thing = f'<object class="{kind}">{inner}</object>'
    return _tag(name, thing, "object")


@st.composite
def _slot(draw, value):
    return draw(mostly(st.just(str(value)), odd_numbers, 60))


@st.composite
def _mass(draw, name):
    rows = tracks(draw(seeds), draw(st.sampled_from((0, 3, *(8, 14, 20) * 4))), 2, 100)
    steps = ""
    for k, (_, x, y) in enumerate(rows):
        inner = _tag("x", draw(_slot(x))) + _tag("y", draw(_slot(y)))
        index = k if draw(st.integers(0, 80)) else draw(st.sampled_from((0, -1, 10**12, "a", "")))
        steps += _thing(f"[{index}]", f"{_PREFIX}PointMass$FrameData", inner)
    kind = draw(mostly(st.just("PointMass"), st.sampled_from(("TapeMeasure", "Vector", "")), 8))
    body = _tag("name", name, "string") + _tag("mass", draw(_slot(0.25)))
    body += f'<property name="framedata" type="array" class="[L">{steps}</property>'
    return _thing("item", f"{_PREFIX}{kind}", body)


@st.composite
def texts(draw):
    """The text of a .trk file."""
    names = draw(st.sampled_from((*(("ball",), ("a", "b")) * 8, ("a", "a"), ())))
    if draw(st.integers(0, 7)) == 0:
        names = (*names, draw(odd_names).replace("<", "&lt;"))
    clip = "".join(_tag(n, draw(_slot(v)), "int")
                   for n, v in (("startframe", 0), ("stepsize", 1), ("stepcount", 20)))  # fmt: skip
    places = (("xorigin", 100), ("yorigin", 200), ("angle", 10), ("xscale", 50), ("yscale", 50))
    axes = "".join(_tag(n, draw(_slot(v))) for n, v in places)
    axes = _thing("[0]", f"{_PREFIX}ImageCoordSystem$FrameData", axes)
    unit = draw(mostly(st.just("m"), odd_units.map(lambda u: u.replace("<", "")), 8))
    parts = [
        _thing("videoclip", f"{_PREFIX}VideoClip", clip),
        _thing("clipcontrol", f"{_PREFIX}ClipControl", _tag("delta_t", draw(_slot(33.3)))),
        _thing("coords", f"{_PREFIX}ImageCoordSystem",
               f'<property name="framedata" type="array" class="[L">{axes}</property>'),
        _tag("length_unit", unit, "string"),
        '<property name="tracks" type="collection">' + "".join(draw(_mass(n)) for n in names)
        + "</property>",
    ]  # fmt: skip
    if draw(st.integers(0, 12)) == 0:
        parts.pop(draw(st.integers(0, len(parts) - 1)))
    if draw(st.integers(0, 12)) == 0:
        parts.append("<a>" * 5000 + "</a>" * 5000)
    if draw(st.integers(0, 30)) == 0:
        parts.append(_tag("name", "&x;", "string"))
    root = draw(mostly(st.just(f"{_PREFIX}TrackerPanel"), odd_names, 15)).replace("<", "")
    head = draw(st.sampled_from((*("",) * 30, *_HEADS)))
    inner = "\n".join(parts)
    return f'<?xml version="1.0" encoding="UTF-8"?>{head}<object class="{root}">{inner}</object>'


@st.composite
def cases(draw):
    """A .trk file, and a command that reads it."""
    content = draw(damaged(draw(texts()).encode("utf-8", "replace"), 10))
    files, argv = draw(uses("a.trk"))
    return Case("trackers", argv, {**files, "a.trk": content})
