"""Films that hold what is to be tracked, films that do not, and files that are no films."""

import functools
import random
import tempfile
from pathlib import Path

import cv2
import numpy as np
from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.pieces import damaged, mostly, numbers, odd_names, odd_numbers, units

_CODECS = {"a.mp4": "mp4v", "a.avi": "MJPG", "b.avi": "FFV1"}
_COLOURS = {"red": (0, 0, 255), "blue": (255, 0, 0), "green": (0, 128, 0), "black": (0, 0, 0)}
WIDTH, HEIGHT, RADIUS = 160, 120, 12


@functools.lru_cache(maxsize=64)
def film(name, seed, n_frames, colour, scene):
    """The bytes of a film: a disc that flies, hides, leaves, or is not there."""
    rng = random.Random(seed)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        codec = cv2.VideoWriter_fourcc(*_CODECS[name])
        writer = cv2.VideoWriter(str(path), codec, 30, (WIDTH, HEIGHT))
        grain = np.random.default_rng(seed)
        start, speed = (rng.uniform(20, 40), rng.uniform(25, 50)), (rng.uniform(0, 3), 1.0)
        for k in range(n_frames):
            image = np.full((HEIGHT, WIDTH, 3), 240, np.uint8)
            if scene == "mat":
                cv2.rectangle(image, (80, 10), (150, 100), (0, 200, 200), -1)
            moved = k * (scene != "still")
            place = [round(16 * (start[d] + speed[d] * moved)) for d in (0, 1)]  # 1/16 px
            if scene != "empty" and not (scene == "hidden" and 2 < k < 5):
                _draw(image, place, colour)
            if scene == "two":
                _draw(image, (2000 - place[0] // 3, 1500), colour)
            if scene == "grain":
                image = np.clip(image + grain.normal(0, 20, image.shape), 0, 255).astype(np.uint8)
            writer.write(image)
        writer.release()
        return path.read_bytes(), tuple(round(s) for s in start)


def _draw(image, place, colour):
    cv2.circle(image, place, 16 * RADIUS, _COLOURS[colour], -1, cv2.LINE_AA, 4)


_SCENES = (*("fly",) * 6, "still", "empty", "hidden", "two", "grain", "mat")


@st.composite
def _spec(draw, place, colour):
    """SPEC of an object, mostly where it is."""
    x, y = place
    box = f"{x - 15},{y - 15},30,30@0"
    inside = f"{x - 5},{y - 5},10,10@0"
    usual = (f"disc:{colour}", f"disc:{colour}:{RADIUS}", f"patch:{inside}", f"moving:{inside}",
             f"template:{box}", f"point:{x},{y}@0")  # fmt: skip
    odd = ("disc:", "disc:#12", "disc:white", f"disc:{colour}:1e9", f"disc:{colour}:1.5", "disc",
           "patch:0,0,0,0@0", "patch:90,70,50,50@0", "template:0,0,96,72@0", "template:1,1,1,1@0",
           f"moving:{box[:-1]}999999", "point:-1,-1@0", "point:95,71@0", "point:1e9,0@0", "x:1",
           "patch:1,2,3@0", "moving:0,0,1,1@1", "template:99999999999999999999,0,5,5@0",
           "point:1,1@99999999999999999999", "patch:0,0,96,72@0", "moving:0,0,96,72@0")  # fmt: skip
    return draw(mostly(st.sampled_from(usual), st.sampled_from(odd), 8))


_RANGES = ("0..5", "1..9", "0..4", "2..3", "5..2", "0..0", "3..999999", "..", "-1..3", "9..",
           "a..b", "²..³")  # fmt: skip


@st.composite
def _options(draw):
    out = []
    rare = st.integers(0, 5).map(lambda k: k == 0)
    if draw(rare):
        out += ["--fps", draw(mostly(st.just("30"), odd_numbers, 8))]
    if draw(rare):
        out += ["--scale", draw(mostly(st.just("20"), odd_numbers, 8))]
    elif draw(rare):
        known = draw(st.lists(st.builds("{},{}={},{}".format, *[numbers] * 4), max_size=4))
        known = known if draw(rare) else ["0,0=0,0", "96,0=1,0", "96,72=1,1", "0,72=0,1"]
        for point in known:
            out += ["--known", point]
    if draw(rare):
        out += ["--unit", draw(units)]
    if draw(rare):
        out += ["--frames", draw(st.sampled_from(_RANGES))]
    if draw(rare):
        out += ["--mat", f"{draw(mostly(st.just('rug'), odd_names, 4))}=yellow"]
    if draw(rare):
        out.append("--smooth")
    if not draw(rare):
        out.append("--no-film")
    return out


@st.composite
def cases(draw):
    """A film and what is to be followed in it."""
    name = draw(st.sampled_from(sorted(_CODECS)))
    colour = draw(st.sampled_from(sorted(_COLOURS)))
    n_frames = draw(st.sampled_from((2, *(6, 10, 14, 18) * 4)))
    content, place = film(name, draw(st.integers(0, 3)), n_frames, colour,
                          draw(st.sampled_from(_SCENES)))  # fmt: skip
    content = draw(damaged(content, 4))
    if draw(st.integers(0, 19)) == 0:
        content = draw(st.sampled_from((b"", b"t,x,y\n0,1,2\n", b"\x00" * 5000, content[:40])))
        name = draw(st.sampled_from((name, "a.gif", "a.png", "film", "a%d.png", "a.m3u8")))
    objects = []
    for k in range(draw(st.sampled_from((1, 1, 1, 2)))):
        label = draw(mostly(st.just(f"b{k}"), odd_names.filter(lambda n: "\x00" not in n), 8))
        objects += ["--object", f"{label}={draw(_spec(place, colour))}"]
    argv = ("track", name, *objects, *draw(_options()), "--out", "out", "--quiet")
    return Case("films", argv, {name: content})
