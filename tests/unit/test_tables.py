import math

import numpy as np
import pandas as pd
import pytest

from bsp_gp.data.noise import estimate_noise
from bsp_gp.data.scene import Dataset, Entity, LatentDeclaration, Scene
from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.errors import DataError, OutputError
from bsp_gp.units import Unit

TRACK = "scene,t,entity,x,y\n" + "".join(
    f"{scene},{k * 0.1},ball,{scene + k},{k * k}\n" for scene in range(1, 7) for k in range(4)
)


@pytest.fixture
def folder(tmp_path):
    def write(trajectories=TRACK, entities=None, toml=None):
        (tmp_path / "trajectories.csv").write_text(trajectories, encoding="utf-8")
        if entities is not None:
            (tmp_path / "entities.csv").write_text(entities, encoding="utf-8")
        if toml is not None:
            (tmp_path / "dataset.toml").write_text(toml, encoding="utf-8")
        return tmp_path

    return write


def test_minimal_folder(folder):
    dataset = load_dataset(folder())
    assert [scene.name for scene in dataset.scenes] == list("123456")
    scene = dataset.scenes[0]
    assert scene.positions.shape == (4, 1, 2)
    assert scene.entities == (Entity("ball"),)
    assert math.isnan(scene.entities[0].mass)
    assert dataset.units.text(Unit.of(m=1, s=-2)) == "length/time^2"


def test_units_become_si(folder):
    toml = '[units]\nlength = "cm"\ntime = "ms"\nmass = "g"\nstiffness = "N/cm"\nspin = "deg/s"\n'
    entities = "entity,mass,stiffness,radius,spin_x,spin_y,spin_z\nball,500,2,3,180,0,0\n"
    dataset = load_dataset(folder(entities=entities, toml=toml + "[axes]\nup = '-y'\n"))
    scene, (ball,) = dataset.scenes[0], dataset.scenes[0].entities
    assert scene.times[1] == pytest.approx(1e-4)
    assert scene.positions[1, 0] == pytest.approx([0.02, 0.01])
    assert ball.mass == pytest.approx(0.5)
    assert ball.properties["stiffness"] == pytest.approx(200.0)
    assert ball.radius == pytest.approx(0.03)
    assert ball.shape == "disc"
    assert ball.properties["spin"] == pytest.approx((math.pi, 0, 0))
    assert dataset.property_units["spin"] == Unit.of(s=-1)
    assert dataset.up == "-y"


def test_a_unit_may_be_told_by_the_heading_of_the_file(tmp_path):
    path = tmp_path / "cart.csv"
    path.write_text("t [s],Place [km]\n" + "".join(f"{k},{2 * k}\n" for k in range(5)))
    data = load_dataset(path, units={"Place": "cm"}, columns={"x": "Place [km]"})
    assert data.scenes[0].positions[1, 0, 0] == pytest.approx(0.02)


def test_a_unit_of_x_alone_is_that_of_all_axes(tmp_path):
    path = tmp_path / "puck.csv"
    path.write_text("t,x,y\n" + "".join(f"{k},{2 * k},{k}\n" for k in range(5)))
    data = load_dataset(path, units={"x": "px", "t": "s"})
    assert any("y without a unit: taken as that of x, px" in note for note in data.notes)


def test_pixels_are_kept_and_named(folder):
    dataset = load_dataset(folder(toml='noise = 0.5\n[units]\nlength = "px"\ntime = "s"\n'))
    assert dataset.scenes[0].positions[1, 0, 0] == 2.0
    assert dataset.units.text(Unit.of(m=1, s=-2)) == "px/s^2"
    assert dataset.noise == (0.5,)


def test_noise_of_single_bodies(tmp_path):
    """A name wins over a glob, and what a point quotes over both; written out, it is quoted."""
    rows = [f"{t},{name},{t + k},{t},{'0.7' if (name, t) == ('cork', 1) else ''},"
            for t in range(4) for k, name in enumerate(("ball", "cork", "card"))]  # fmt: skip
    path = tmp_path / "made"
    path.mkdir()
    (path / "trajectories.csv").write_text("\n".join(["t,entity,x,y,sx,sy", *rows]) + "\n")
    (path / "dataset.toml").write_text(
        '[noise]\n"c*" = [1, 2]\ncard = 3\nball = 5\n[units]\nlength = "cm"\ntime = "s"\n'
    )
    dataset = load_dataset(path)
    assert dataset.noise is None
    (scene,) = dataset.scenes
    by_name = {n: 100 * scene.sigma[:, k] for k, n in enumerate(scene.names)}
    assert by_name["ball"] == pytest.approx(np.full((4, 2), 5.0))
    assert by_name["card"] == pytest.approx(np.full((4, 2), 3.0))
    assert by_name["cork"][:, 0] == pytest.approx([1, 0.7, 1, 1])
    assert by_name["cork"][:, 1] == pytest.approx(np.full(4, 2.0))
    assert estimate_noise(dataset).source == "quoted"
    save_dataset(dataset, tmp_path / "again")
    np.testing.assert_allclose(load_dataset(tmp_path / "again").scenes[0].sigma, scene.sigma)


def test_a_unit_may_carry_a_number(folder):
    dataset = load_dataset(folder(), units={"length": "0.17 um", "time": "s"})
    assert dataset.scenes[0].positions[1, 0, 0] == pytest.approx(0.34e-6)


def test_velocities_only_where_measured(folder):
    track = "t,x,y,vx,vy\n0,0,0,100,0\n1,1,0,100,\n2,2,0,100,0\n"
    ignored = load_dataset(folder(track))
    assert ignored.scenes[0].velocities is None
    assert any("velocity" in note for note in ignored.notes)
    units = {"length": "m", "time": "s", "velocity": "cm/s"}
    measured = load_dataset(folder(track), columns={"velocity": "measured"}, units=units)
    assert measured.velocity == "measured"
    assert measured.scenes[0].velocities[0, 0].tolist() == [1.0, 0.0]
    assert math.isnan(measured.scenes[0].velocities[1, 0, 1])


def test_quoted_errors(folder):
    dataset = load_dataset(folder("t,x,y,sx\n0,0,0,0.1\n1,1,0,\n2,2,0,0.3\n"))
    sigma = dataset.scenes[0].sigma[:, 0]
    assert sigma[0, 0] == 0.1
    assert np.isnan(sigma[1, 0])
    assert np.isnan(sigma[:, 1]).all()


@pytest.mark.parametrize("clock", [{"fps": 50}, {"dt": 0.02}])
def test_frames_become_times(folder, clock):
    dataset = load_dataset(folder("frame,x,y\n0,0,0\n1,1,0\n5,2,0\n"), **clock)
    assert dataset.scenes[0].times == pytest.approx([0, 0.02, 0.1])


def test_gaps_and_union_of_times(folder):
    track = (
        "t,entity,x,y\n0,a,0,0\n0.1,a,1,0\n0.30000000000000004,a,3,0\n"
        "0,b,0,1\n0.2,b,2,1\n0.3,b,3,1\n"
    )
    scene = load_dataset(folder(track)).scenes[0]
    assert scene.names == ("a", "b")
    assert scene.times == pytest.approx([0, 0.1, 0.2, 0.3])
    assert np.isnan(scene.positions[:, 0, 0]).tolist() == [False, False, True, False]
    assert np.isnan(scene.positions[:, 1, 0]).tolist() == [False, True, False, False]


@pytest.mark.parametrize("blank", ["", "  ", '"  "', "\u00a0"])
def test_a_row_without_coordinates_is_a_gap(folder, blank):
    dataset = load_dataset(folder(f"t,x,y\n0,0,1\n1,{blank},{blank}\n2,1,3\n3,2,4\n"))
    assert dataset.scenes[0].times.tolist() == [0.0, 2.0, 3.0]
    assert "1 row(s) without coordinates are gaps in the track" in dataset.notes
    with pytest.raises(DataError, match="line 3, column y: empty cell"):
        load_dataset(folder(f"t,x,y\n0,0,1\n1,0,{blank}\n2,1,3\n3,2,4\n"))
    with pytest.raises(DataError, match="no row has any coordinates"):
        load_dataset(folder(f"t,x,y\n0,{blank},{blank}\n1,{blank},{blank}\n"))


@pytest.mark.parametrize(("axis", "column", "still"), [("x", 0, "y"), ("y", 1, "x")])
def test_motion_along_a_line(folder, axis, column, still):
    dataset = load_dataset(folder(f"t (s),{axis} (cm),v (cm/s)\n0,0,1\n1,1,3\n2,4,5\n3,9,7\n"))
    positions = dataset.scenes[0].positions[:, 0]
    assert positions[:, column] == pytest.approx([0, 0.01, 0.04, 0.09])
    assert not positions[:, 1 - column].any()
    assert any(f"no column {still!r}" in note for note in dataset.notes)
    assert estimate_noise(dataset).inactive_axes == (still,)


def test_the_other_axis_under_an_unknown_name_is_asked_for(folder):
    with pytest.raises(DataError, match="no column 'y'.*along x, columns={\"gap\": \"ignore\"}"):
        load_dataset(folder("t,x,gap\n0,0,1\n1,1,3\n2,4,5\n"))


def test_entities_differ_between_scenes(folder):
    entities = (
        "entity,scene,shape,width,height,mass,friction,colour\n"
        "ball,,,,,1,,red\nball,2,,,,2,,red\nghost,,,,,1,0.1,blue\n"
    )
    dataset = load_dataset(folder(entities=entities))
    assert [scene.entities[0].mass for scene in dataset.scenes] == [1, 2, 1, 1, 1, 1]
    assert any("ghost" in note for note in dataset.notes)
    assert any("colour" in note for note in dataset.notes)
    assert math.isnan(dataset.scenes[0].entities[0].properties["friction"])


def test_walls_are_static_by_default_and_names_stay_texts(folder):
    track = "t,entity,x,y\n" + "".join(f"{k},001,{k},0\n{k},02,0,9\n" for k in range(3))
    entities = "entity,shape,width,height\n001,point,,\n02,rect_wall,2,1\n"
    scene = load_dataset(folder(track, entities)).scenes[0]
    assert scene.names == ("001", "02")
    assert [e.is_static for e in scene.entities] == [False, True]
    assert scene.dynamic.tolist() == [0]


@pytest.mark.parametrize(
    ("declared", "train", "test"),
    [
        ('train = "1..4"\ntest = ["5", 6]', "1234", "56"),
        ('train = ["1", "3..4"]\ntest = "[56]"', "134", "56"),
        ('test = "6"', "12345", "6"),
        ('train = "1..6"', "123456", ""),
    ],
)
def test_split(folder, declared, train, test):
    dataset = load_dataset(folder(toml=f"[split]\n{declared}\n"))
    assert dataset.train == tuple(train)
    assert dataset.test == tuple(test)


def test_arguments_win_over_the_file(folder):
    path = folder(toml='[split]\ntrain = "1..4"\ntest = "5..6"\n')
    assert load_dataset(path, train="1", test="2").test == ("2",)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("log_uniform:1:10", {"prior": "log_uniform", "low": 1e-3, "high": 1e-2}),
        ("normal:5:2", {"prior": "truncated_normal", "mean": 5e-3, "sd": 2e-3}),
        ("normal:5:2:1:9", {"prior": "truncated_normal", "mean": 5e-3, "sd": 2e-3, "low": 1e-3,
                            "high": 9e-3}),
        ("values:1,2", {"prior": "discrete", "values": (1e-3, 2e-3)}),
    ],
)  # fmt: skip
def test_a_prior_may_be_one_text_as_on_the_command_line(folder, text, told):
    toml = f'[units]\nlength = "m"\ntime = "s"\nmass = "g"\n[latent.mass]\nprior = "{text}"\n'
    (latent,) = load_dataset(folder(toml=toml)).latents
    for name, value in told.items():
        is_text = isinstance(value, str)
        assert getattr(latent, name) == (value if is_text else pytest.approx(value))


@pytest.mark.parametrize(
    ("lines", "match"),
    [('"normal:1"', "cannot be read"), ('"uniform:1"', "cannot be read"),
     ('"normal:1:2:3"', "cannot be read"), ('"uniform:a:b"', "cannot be read"),
     ('"uniform:1:2"\nlow = 1', "has low beside a prior"), ('"uniform:2:1"', "low must be below")],
)  # fmt: skip
def test_a_prior_that_cannot_be_read_is_told(folder, lines, match):
    with pytest.raises(DataError, match=match):
        load_dataset(folder(toml=f"[latent.mass]\nprior = {lines}\n"))


def test_latents_evaluation_and_provenance(folder):
    toml = (
        'name = "drops"\nsource = "here"\nauthors = ["A", "B"]\n[units]\nlength = "m"\ntime = "s"\n'
        'mass = "g"\n[latent.mass]\nprior = "log_uniform"\nlow = 1\nhigh = 10\nshare = "colour"\n'
        'entities = "ba*"\n[evaluation]\ninitial_rows = 12\nendpoint_row = 42\n'
        '[provenance]\ncamera = "phone"\n'
    )
    dataset = load_dataset(folder(entities="entity,colour\nball,red\n", toml=toml))
    (latent,) = dataset.latents
    assert latent == LatentDeclaration(
        "mass", "log_uniform", 1e-3, 1e-2, entities=("ball",), share="colour"
    )
    assert dataset.scenes[0].entities[0].properties["colour"] == 0.0
    assert (dataset.evaluation.initial_rows, dataset.evaluation.endpoint_row) == (12, 42)
    assert dataset.name == "drops"
    assert dataset.provenance["authors"] == "A, B"
    assert dataset.provenance["camera"] == "phone"
    assert len(dataset.provenance["sha256 of trajectories.csv"]) == 64


def test_renamed_columns(folder):
    path = folder("t,X_cm,Y_cm\n0,0,0\n1,1,0\n2,2,1\n")
    dataset = load_dataset(path, columns={"x": "X_cm", "y": "Y_cm"})
    assert dataset.scenes[0].positions[2, 0].tolist() == [2.0, 1.0]
    with pytest.raises(DataError, match="Z_cm"):
        load_dataset(path, columns={"x": "X_cm", "y": "Z_cm"})


def make_dataset():
    t = np.array([0.0, 0.1, 0.30000000000000004, 1 / 3])
    positions = np.random.default_rng(31).normal(size=(4, 2, 3))
    positions[1, 0] = np.nan
    ball = Entity(
        "ball, red", "disc", radius=0.1, properties={"mass": 0.1 + 0.2, "spin": (1, 2, 3)}
    )
    wall = Entity("wall", "rect_wall", width=2.0, height=1.0, is_static=True)
    return Dataset(
        'say "hi"\x7f',
        (
            Scene("1", t, positions, (ball, wall), sigma=np.abs(positions)),
            Scene("two", t + 5, positions[:, ::-1], (wall, ball), velocities=positions[:, ::-1]),
        ),
        train=("1",),
        test=("two",),
        up="-z",
        noise=(0.1, 0.2, 0.3),
        property_units={"spin": Unit.of(s=-1)},
        velocity="measured",
        latents=(LatentDeclaration("mass", low=0.5, high=1.5, entities=("wall",)),),
        provenance={"source": "made\nup"},
    )


def test_save_and_load_give_the_same(tmp_path):
    dataset = make_dataset()
    again = load_dataset(save_dataset(dataset, tmp_path / "d"))
    for attribute in ("name", "train", "test", "up", "noise", "velocity", "latents", "evaluation"):
        assert getattr(again, attribute) == getattr(dataset, attribute), attribute
    assert again.property_units["spin"] == Unit.of(s=-1)
    assert again.provenance["source"] == "made\nup"
    for one, two in zip(dataset.scenes, again.scenes, strict=True):
        assert (one.name, one.names) == (two.name, two.names)
        for attribute in ("times", "positions", "velocities", "sigma"):
            left, right = getattr(one, attribute), getattr(two, attribute)
            assert (left is None) == (right is None)
            if left is not None:
                np.testing.assert_array_equal(left, right)
        ball = two.entities[two.names.index("ball, red")]
        assert ball.mass == 0.1 + 0.2
        assert ball.properties["spin"] == (1.0, 2.0, 3.0)


def test_save_is_whole_or_not_at_all(tmp_path, monkeypatch):
    dataset = make_dataset()
    save_dataset(dataset, tmp_path / "d")
    with pytest.raises(OutputError, match="overwrite"):
        save_dataset(dataset, tmp_path / "d")
    before = (tmp_path / "d" / "trajectories.csv").read_bytes()

    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("bsp_gp.data.folder.toml_text", fail)
    with pytest.raises(OutputError, match="No space left"):
        save_dataset(dataset, tmp_path / "d", overwrite=True)
    monkeypatch.undo()
    assert (tmp_path / "d" / "trajectories.csv").read_bytes() == before
    save_dataset(dataset, tmp_path / "d", overwrite=True)
    assert [p.name for p in tmp_path.iterdir()] == ["d"]


def test_save_never_replaces_other_things(tmp_path):
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match=r"thesis\.tex"):
        save_dataset(make_dataset(), tmp_path / "d", overwrite=True)


@pytest.mark.parametrize("name", [" ball", "", "a\nb"])
def test_names_that_cannot_be_saved(tmp_path, name):
    scene = Scene("s", [0, 1, 2], np.zeros((3, 1, 2)), (Entity(name),))
    with pytest.raises(OutputError, match="cannot be saved"):
        save_dataset(Dataset("d", (scene,)), tmp_path / "d")
    assert not list(tmp_path.iterdir())


def test_from_frames():
    frame = pd.DataFrame({"t": [0.0, 1, 2], "x": [0.0, 1, 2], "y": [0.0, 1, 4]})
    entities = pd.DataFrame({"entity": ["object"], "mass": [2.0]})
    dataset = Dataset.from_frames({"a": frame, "b": frame}, entities, noise=0.1, train="a")
    assert [scene.name for scene in dataset.scenes] == ["a", "b"]
    assert dataset.scenes[1].entities[0].mass == 2.0
    assert (dataset.noise, dataset.test) == ((0.1,), ("b",))
    assert list(frame.columns) == ["t", "x", "y"]
    single = Dataset.from_frames(frame, (Entity("object", properties={"mass": 3.0}),))
    assert single.scenes[0].entities[0].mass == 3.0


def test_from_trackpy_frame():
    frame = pd.DataFrame(
        {
            "y": [1.0, 5.0, 2.0, 6.0, 3.0, 7.0],
            "x": [0.0, 9.0, 0.0, 9.0, 1.0, 9.0],
            "mass": 300.0,
            "frame": [0, 0, 1, 1, 2, 2],
            "particle": [0, 1, 0, 1, 0, 1],
        }
    )
    dataset = Dataset.from_frames(frame, fps=10, units={"length": "0.2 um"})
    scene = dataset.scenes[0]
    assert scene.names == ("0", "1")
    assert scene.times == pytest.approx([0, 0.1, 0.2])
    assert scene.positions[2, 0] == pytest.approx([0.2e-6, 0.6e-6])
    assert any("mass" in note for note in dataset.notes)


@pytest.mark.parametrize("kind", ["nbody", "bounce", "mat"])
def test_reference_scenes(shared_data, kind):
    dataset = load_dataset(shared_data / "synth" / kind)
    assert (len(dataset.train), len(dataset.test), dataset.noise) == (80, 20, (0.0,))
    assert all(scene.positions.shape[0] == 51 for scene in dataset.scenes)
    assert not any(np.isnan(scene.positions).any() for scene in dataset.scenes)


def test_ball_drops(shared_data):
    dataset = load_dataset(shared_data / "measured" / "ball_drops")
    assert len(dataset.scenes) == 22
    assert (len(dataset.train), len(dataset.test), dataset.up) == (11, 11, "y")
    volleyball = dataset.scene("volleyball_drop1").entities[0]
    assert math.isnan(volleyball.mass)
    assert volleyball.shape == "disc"


def test_a_folder_may_hold_its_positions_as_parquet(tmp_path, monkeypatch):
    table = pd.DataFrame({"t": [0.0, 1.0, 2.0], "entity": "a", "x": [0.0, 1.0, 4.0], "y": 0.0})
    (tmp_path / "trajectories.parquet").write_bytes(b"")
    monkeypatch.setattr(pd, "read_parquet", lambda path: table)
    assert load_dataset(tmp_path).scenes[0].positions[2, 0, 0] == 4.0


@pytest.mark.parametrize("header", ["t (s),x (m),mass (g)", "t,x,mass"])
def test_a_table_may_say_itself_what_its_body_weighs(tmp_path, header):
    path = tmp_path / "cart.csv"
    path.write_text(header + "\n" + "".join(f"{k},{k * k},250\n" for k in range(9)), "utf-8")
    units = None if "(" in header else {"length": "m", "time": "s", "mass": "g"}
    data = load_dataset(path, units=units)
    assert data.scenes[0].entities[0].mass == pytest.approx(0.25)
    assert not any("not used" in note for note in data.notes)


def test_masses_of_a_table_are_those_of_each_body_and_scene(tmp_path):
    path = tmp_path / "carts.csv"
    rows = [f"{s},{b},{k},{k * k + b},{s + b}" for s in (1, 2) for b in (3, 4) for k in range(5)]
    path.write_text("\n".join(["scene,entity,t,x,mass", *rows]), encoding="utf-8")
    data = load_dataset(path, units={"length": "m", "time": "s", "mass": "kg"})
    assert [[e.mass for e in s.entities] for s in data.scenes] == [[4, 5], [5, 6]]


def test_a_mass_that_changes_is_no_property_of_a_body(tmp_path):
    path = tmp_path / "rocket.csv"
    path.write_text("t,x,mass\n" + "".join(f"{k},{k},{9 - k}\n" for k in range(6)), "utf-8")
    with pytest.raises(DataError, match="mass changes along a track.*mass_now") as info:
        load_dataset(path, units={"length": "m", "time": "s", "mass": "kg"})
    assert info.value.row == 3
    assert load_dataset(path, units={"length": "m", "time": "s"}).scenes[0].entities[0].mass != 9


@pytest.mark.parametrize("word", ["release", "flight", "fall", "Swing"])
def test_recordings_are_told_by_what_was_done_in_each(tmp_path, word):
    rows = [f"{k},{0.1 * t:.1f},{t * t}" for k in (1, 2) for t in range(12)]
    path = tmp_path / "log.csv"
    path.write_text("\n".join([f"{word},t (s),x (m)", *rows]))
    assert [scene.name for scene in load_dataset(path).scenes] == ["1", "2"]


def test_frames_without_a_unit_of_time_ask_for_the_rate(tmp_path):
    rows = [f"{t},{3 * t},{t * t}" for t in range(12)]
    path = tmp_path / "film.csv"
    path.write_text("\n".join(["frame,x_px,y_px", *rows]))
    with pytest.raises(DataError, match="counts frames.*fps"):
        load_dataset(path)


@pytest.mark.parametrize(
    ("heading", "uses", "axis"),
    [
        ("height (mm)", ("k", "x_i", "e_x", "v_i"), "x"), ("height (mm)", ("k", "y_i", "e_y"), "y"),
        ("height (mm)", ("x_i", "down", "m_i"), "y"), ("height (mm)", ("v_i",), "y"),
        ("x (mm)", ("y_i", "e_y"), "y"),
    ],
)  # fmt: skip
def test_the_only_place_is_along_the_axis_that_laws_name(tmp_path, heading, uses, axis):
    path = tmp_path / "ball.csv"
    path.write_text(f"t (s),{heading}\n0,5\n1,7\n2,4\n", encoding="utf-8")
    data = load_dataset(path, uses=uses)
    moving = np.ptp(data.scenes[0].positions[:, 0], axis=0) > 0
    assert "xy"[int(np.argmax(moving))] == axis
    told = f"laws name {axis} alone, and {heading!r} is the only place: it is taken as {axis}"
    assert (told in data.notes) is ((heading[0], axis) in [("h", "x"), ("x", "y")])
