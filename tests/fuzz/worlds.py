"""Made-up worlds: presets, effects and settings of ``bsp-gp make``."""

from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.pieces import mostly, odd_names, odd_numbers

_PRESETS = ("nbody", "bounce", "mat", "magnet", "fall", "spring", "pucks")
_few = st.sampled_from
_usual = _few((*("0.1", "1", "2", "0.5", "0.3", "5") * 2, "-1", "0", "10"))
_values = mostly(_usual, odd_numbers, 20)


def _span(ends):
    """A range; in order, if it is one of numbers."""
    try:
        low, high = sorted(ends, key=float)
    except ValueError:
        low, high = ends
    return f"{low}..{high}"


_bounds = st.one_of(_values, _values, st.tuples(_values, _values).map(_span))
_SMALL = ("n_bodies", "n_discs", "n_mats", "n_walls", "n_pucks", "n_scenes", "n_frames", "substeps")
"""Counts: large ones only ask for much work."""


def _effects():
    from bsp_gp.simulate.effects import EFFECTS

    return sorted(EFFECTS)


def _settings(name):
    from bsp_gp.simulate.synth import numbers_of, preset

    known = set(numbers_of(preset(name))) - {"n_scenes", "n_frames", "substeps", "dt", "noise"}
    return sorted(known)


@st.composite
def _effect(draw):
    import inspect

    from bsp_gp.simulate.effects import EFFECTS

    name = draw(_few(_effects()))
    options = list(inspect.signature(EFFECTS[name][0]).parameters)[1:]
    text = f"{draw(mostly(st.just(name), odd_names, 25))}={draw(_values)}"
    if options:
        for option in draw(st.lists(_few(options), max_size=2, unique=True)):
            usual = _few(("mass", "charge", "zz", "p", "")) if option == "column" else _values
            text += f",{option}={draw(usual)}"
    return text


@st.composite
def cases(draw):
    """``make`` in small."""
    preset = draw(mostly(_few(_PRESETS), odd_names, 30))
    known = preset if preset in _PRESETS else "fall"
    argv = ["make", preset, "--out", "out"]
    argv += ["--scenes", draw(_few(("1", "1", "2", "6")))]
    argv += ["--frames", draw(_few(("3", "6", "12")))]
    argv += ["--substeps", draw(_few(("1", "4", "20")))]
    effects = draw(st.lists(_effect(), max_size=draw(_few((0, 1, 1, 2)))))
    for text in effects:
        argv += ["--effect", text]
    if effects and draw(st.integers(0, 2)) == 0:
        argv += ["--undeclared", *draw(_few(((), effects[0].partition("=")[:1])))]
    for name in draw(st.lists(_few(_settings(known)), max_size=draw(_few((0, 1, 2))), unique=True)):
        if name in _SMALL or name.startswith("n_"):
            argv += ["--set", f"{name}={draw(_few(('1', '2', '5', '0', '-1', 'x', '1e9')))}"]
        else:
            argv += ["--set", f"{name}={draw(_bounds)}"]
    rare = st.integers(0, 5).map(lambda k: k == 0)
    if draw(rare):
        argv += [draw(_few(("--fps", "--dt"))), draw(_values)]
    if draw(rare):
        argv += ["--noise", draw(_values)]
    if draw(rare):
        argv += ["--film", "--size", draw(_few(("64x48", "65x49", "1x1", "0x5", "99999x2", "a")))]
        for option in ("--exposure", "--blur", "--grain", "--quality"):
            if draw(rare):
                argv += [option, draw(mostly(_few(("0", "1", "0.5", "50")), odd_numbers, 3))]
        if draw(rare):
            argv.append("--png")
    return Case("worlds", (*argv, "--seed", draw(_few(("0", "1", "2"))), "--quiet"), {})
