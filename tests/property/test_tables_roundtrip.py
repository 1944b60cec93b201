"""Whatever can be said in the format reads back bit for bit, and nothing else gets a traceback."""

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bsp_gp.data.scene import Dataset, Entity, Scene
from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.errors import DataError

NAMES = st.text(
    st.characters(codec="utf-8", exclude_categories=("C", "Z"), include_characters=" ,;\"'#"),
    min_size=1,
    max_size=8,
).filter(lambda name: name == name.strip())
NUMBERS = st.floats(-1e100, 1e100)
SIZES = st.one_of(st.just(np.nan), st.floats(0, 1e10))
PROFILE = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])


@st.composite
def entities(draw, name):
    is_rect = draw(st.booleans())
    sides = st.floats(0, 1e10) if is_rect else st.just(np.nan)
    properties = {"mass": draw(st.floats(1e-3, 1e3)), "q": draw(NUMBERS)}
    if draw(st.booleans()):
        properties["spin"] = tuple(draw(st.lists(NUMBERS, min_size=3, max_size=3)))
    return Entity(
        name,
        "rect_wall" if is_rect else draw(st.sampled_from(["point", "disc"])),
        radius=draw(SIZES),
        width=draw(sides),
        height=draw(sides),
        is_static=draw(st.booleans()),
        properties=properties,
    )


@st.composite
def scenes(draw, name, n_dims):
    members = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    n_times = draw(st.integers(3, 6))
    steps = draw(st.lists(st.floats(1e-3, 1e3), min_size=n_times, max_size=n_times))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    positions = rng.normal(size=(n_times, len(members), n_dims)) * 10.0 ** rng.integers(-20, 20)
    if draw(st.booleans()) and len(members) > 1:
        positions[1 + draw(st.integers(0, 1)), 0] = np.nan
    blocks = {}
    for key in ("velocities", "sigma"):
        if draw(st.booleans()):
            blocks[key] = np.where(np.isnan(positions), np.nan, np.abs(rng.normal()))
    crew = tuple(draw(entities(member)) for member in members)
    return Scene(name, np.cumsum(steps), positions, crew, **blocks)


@st.composite
def datasets(draw):
    names = draw(st.lists(NAMES, min_size=1, max_size=4, unique=True))
    n_dims = draw(st.sampled_from([2, 3]))
    made = tuple(draw(scenes(name, n_dims)) for name in names)
    noise = draw(st.one_of(st.none(), st.tuples(st.floats(0, 1e3))))
    train = names[:1] if draw(st.booleans()) and len(names) > 1 else ()
    return Dataset(
        draw(NAMES), made, train=train, test=tuple(names[1:]) if train else (), noise=noise,
        velocity="measured" if any(s.velocities is not None for s in made) else "ignore",
        up=draw(st.sampled_from([None, "x", "-y"])),
    )  # fmt: skip


def same(left, right):
    if left is None or right is None:
        return left is right
    left, right = np.asarray(left, dtype=float), np.asarray(right, dtype=float)
    return left.shape == right.shape and np.array_equal(left, right, equal_nan=True)


def known(entity):
    return {k: v for k, v in entity.properties.items() if np.all(np.isfinite(v))}


@PROFILE
@given(datasets())
def test_round_trip(dataset):
    with tempfile.TemporaryDirectory() as parent:
        again = load_dataset(save_dataset(dataset, Path(parent) / "d"))
    for attribute in ("name", "noise", "velocity", "up"):
        assert getattr(again, attribute) == getattr(dataset, attribute)
    assert (tuple(again.train), tuple(again.test)) == (tuple(dataset.train), tuple(dataset.test))
    for one, two in zip(dataset.scenes, again.scenes, strict=True):
        assert (one.name, one.names) == (two.name, two.names)
        for attribute in ("times", "positions", "velocities", "sigma"):
            assert same(getattr(one, attribute), getattr(two, attribute)), attribute
        for a, b in zip(one.entities, two.entities, strict=True):
            assert (a.shape, a.is_static, known(a)) == (b.shape, b.is_static, known(b))
            assert same((a.radius, a.width, a.height), (b.radius, b.width, b.height))


GOOD = {
    "trajectories.csv": b"scene,t,entity,x,y\n"
    + b"".join(b"%d,%d,ball,%d,0.5\n" % (s, k, k) for s in range(2) for k in range(4)),
    "entities.csv": b"entity,shape,radius,mass,spin_x,spin_y\nball,disc,0.1,2,1,0\n",
    "dataset.toml": b'noise = 0.1\n[units]\nlength = "cm"\ntime = "s"\n[split]\ntrain = "0"\n',
}


@PROFILE
@given(
    st.sampled_from(sorted(GOOD)),
    st.lists(
        st.tuples(
            st.integers(0, 200),
            st.integers(0, 3),
            st.one_of(st.binary(max_size=3), st.sampled_from([b",", b"\n", b'"', b";", b"nan"])),
        ),
        min_size=1,
        max_size=3,
    ),
)
def test_damaged_files_give_data_errors_only(name, damages):
    content = GOOD[name]
    for place, length, replacement in damages:
        place %= len(content) + 1
        content = content[:place] + replacement + content[place + length :]
    with tempfile.TemporaryDirectory() as parent:
        for file, good in GOOD.items():
            (Path(parent) / file).write_bytes(content if file == name else good)
        try:
            load_dataset(parent)
        except DataError as error:
            assert parent in str(error)
