"""Films: what is drawn is where the truth says, to a small part of a pixel."""

import cv2
import numpy as np
import pytest

from bsp_gp.data.scene import Entity, Scene
from bsp_gp.errors import OutputError, SettingsError
from bsp_gp.simulate.synth import make, preset
from bsp_gp.vision.film import Camera, Look, film_scene, write_film, write_frames

BACKGROUND = 240
CAMERA = Camera(120, 90, 10.0, (0.0, 0.0))


def centre(frame, near, reach, floor=0.0):
    """Centre of gravity of what differs from the background, pixels."""
    x0, y0 = (int(c) - reach for c in near)
    box = frame[y0 : y0 + 2 * reach + 1, x0 : x0 + 2 * reach + 1].astype(float)
    weight = np.abs(BACKGROUND - box).sum(axis=2)
    weight[weight < floor] = 0  # grain, and what compression leaves around edges
    y, x = np.mgrid[y0 : y0 + len(box), x0 : x0 + box.shape[1]]
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


def flight(speed=(2.0, 1.0), n_frames=20, radius=0.6, with_velocities=True):
    """One disc in straight flight, 10 pixels a metre."""
    t = 0.05 * np.arange(n_frames)
    p = np.array([-1.37, -0.71]) + t[:, None] * np.array(speed)
    v = np.broadcast_to(speed, p.shape)[:, None] if with_velocities else None
    ball = Entity("ball", "disc", radius=radius, properties={"mass": 1.0})
    return Scene("1", t, p[:, None], [ball], v)


def worst(scene, look, camera=CAMERA, reach=14):
    """Largest distance in pixels of what is seen from the truth."""
    frames, truth = film_scene(scene, camera, look, rng=np.random.default_rng(3))
    floor = 5 * look.noise + (60 if look.quality else 0)
    found = np.array([centre(f, t, reach, floor) for f, t in zip(frames, truth[:, 0], strict=True)])
    return np.abs(found - truth[:, 0]).max()


@pytest.mark.parametrize(
    ("look", "limit"),
    [
        (Look(), 0.005),
        (Look(blur=1.5), 0.005),
        (Look(exposure=0.8), 0.005),
        (Look(exposure=1.0, n_exposures=3, blur=1.0, noise=4.0), 0.2),
        (Look(quality=60), 0.1),
        (Look(exposure=0.5, blur=1.0, noise=4.0, quality=50), 0.25),
    ],
)
@pytest.mark.parametrize("radius", [0.35, 0.6])
def test_truth_is_where_the_disc_is_seen(look, limit, radius):
    assert worst(flight(radius=radius), look) < limit


def test_a_picture_that_is_shifted_is_noticed():
    """The check above can fail: a shift of a tenth of a pixel is more than its limit."""
    scene = flight()
    frames, truth = film_scene(scene, CAMERA, rng=np.random.default_rng(0))
    shifted = Camera(120, 90, 10.0, (0.01, 0.0))
    found = centre(next(frames), truth[0, 0], 14)
    assert np.abs(found - shifted.pixels(scene.positions[0, 0])).max() > 0.08


def test_motion_blur_is_as_long_as_the_exposure():
    scene = flight((4.0, 0.0))  # 2 pixels a frame
    spreads = []
    for exposure in (0.0, 1.0):
        look = Look(exposure=exposure, n_exposures=16)
        frames, truth = film_scene(scene, CAMERA, look, rng=np.random.default_rng(0))
        frame = list(frames)[5].astype(float)
        weight = (BACKGROUND - frame).sum(axis=(0, 2))
        spreads.append((weight * (np.arange(120) - truth[5, 0, 0]) ** 2).sum() / weight.sum())
    assert spreads[1] - spreads[0] == pytest.approx(2.0**2 / 12, rel=0.05)


def test_without_velocities_they_are_taken_from_the_track():
    given, truth = film_scene(flight(), CAMERA, Look(exposure=0.7), rng=np.random.default_rng(0))
    taken, other = film_scene(
        flight(with_velocities=False), CAMERA, Look(exposure=0.7), rng=np.random.default_rng(0)
    )
    np.testing.assert_allclose(truth, other, atol=1e-9)
    np.testing.assert_array_equal(next(given), next(taken))


def test_rectangles_cover_their_area_and_bodies_lie_above():
    wall = Entity("w", "rect_wall", width=3.13, height=2.07, is_static=True)
    mat = Entity("m", "rect_mat", width=1.0, height=1.0, is_static=True)
    ball = Entity("b", "disc", radius=0.3, properties={"mass": 1.0})
    at = np.array([(0.1, 0.2), (4.0, 2.0), (4.0, 2.0)])
    scene = Scene("1", [0, 1, 2], np.tile(at, (3, 1, 1)), [wall, mat, ball])
    frames, truth = film_scene(scene, CAMERA, rng=np.random.default_rng(0))
    frame = next(frames).astype(float)
    part = (BACKGROUND - frame[:, :85, 0]) / (BACKGROUND - 150)
    assert part.sum() == pytest.approx(31.3 * 20.7, rel=1e-3)
    x, y = truth[0, 2].round().astype(int)
    np.testing.assert_array_equal(frame[y, x], (0, 114, 178))
    np.testing.assert_array_equal(frame[y + 4, x + 4], (222, 222, 222))


def test_camera_maps_there_and_back_and_sees_everything():
    _, truth = make(preset("nbody", n_scenes=3), np.random.default_rng(1))
    scenes = [truth.scene(k) for k in range(3)]
    camera = Camera.fitting(scenes, 320, 200)
    for scene in scenes:
        pixels = camera.pixels(scene.positions)
        assert pixels.min() >= 0
        assert pixels[..., 0].max() <= 319 and pixels[..., 1].max() <= 199
        back = (pixels - (159.5, 99.5)) / (camera.scale, -camera.scale) + camera.centre
        np.testing.assert_allclose(back, scene.positions, atol=1e-9)
    up = camera.pixels([[0.0, 1.0]]) - camera.pixels([[0.0, 0.0]])
    np.testing.assert_allclose(up, [[0, -camera.scale]])


def test_same_generator_same_frames():
    look = Look(noise=5.0, quality=70)
    one, two, other = (
        np.stack(list(film_scene(flight(), CAMERA, look, rng=np.random.default_rng(s))[0]))
        for s in (1, 1, 2)
    )
    np.testing.assert_array_equal(one, two)
    assert (one != other).any()
    assert one.dtype == np.uint8 and one.shape == (20, 90, 120, 3)


def test_gaps_are_not_drawn():
    scene = flight()
    p = np.array(scene.positions)
    p[4] = np.nan
    scene = Scene("1", scene.times, p, scene.entities)
    for exposure in (0.0, 0.5):
        frames, truth = film_scene(scene, CAMERA, Look(exposure), rng=np.random.default_rng(0))
        assert np.isnan(truth[4]).all()
        assert (list(frames)[4] == BACKGROUND).all()


def read(path):
    capture = cv2.VideoCapture(str(path))
    frames = []
    while True:
        ok, frame = capture.read()
        if not ok:
            return np.stack(frames), capture.get(cv2.CAP_PROP_FPS)
        frames.append(frame[..., ::-1])


@pytest.mark.parametrize(("ending", "limit"), [(".mkv", 0.005), (".avi", 0.1), (".mp4", 0.15)])
def test_a_written_film_shows_the_same(tmp_path, ending, limit):
    frames, truth = film_scene(flight(), CAMERA, rng=np.random.default_rng(0))
    frames = list(frames)
    path = write_film(frames, tmp_path / f"film{ending}", 20.0)
    back, fps = read(path)
    assert fps == 20 and back.shape == (20, 90, 120, 3)
    if ending == ".mkv":
        np.testing.assert_array_equal(back, frames)
    floor = 0 if ending == ".mkv" else 60
    found = np.array([centre(f, t, 14, floor) for f, t in zip(back, truth[:, 0], strict=True)])
    assert np.abs(found - truth[:, 0]).max() < limit
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_films_and_frames_are_not_overwritten(tmp_path):
    frames = list(film_scene(flight(), CAMERA, rng=np.random.default_rng(0))[0])
    write_film(frames, tmp_path / "a.avi", 20)
    with pytest.raises(OutputError, match="exists already"):
        write_film(frames, tmp_path / "a.avi", 20)
    write_film(frames, tmp_path / "a.avi", 20, overwrite=True)
    with pytest.raises(OutputError, match=r"must end in one of .mp4"):
        write_film(frames, tmp_path / "a.gif", 20)
    with pytest.raises(OutputError, match="at least one frame"):
        write_film([], tmp_path / "b.avi", 20)
    folder = write_frames(frames, tmp_path / "frames")
    np.testing.assert_array_equal(cv2.imread(str(folder / "0003.png"))[..., ::-1], frames[3])
    with pytest.raises(OutputError, match="exists already"):
        write_frames(frames, folder)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.avi", "frames"]


@pytest.mark.parametrize(
    "bad",
    [
        lambda: Camera(4, 4),
        lambda: Camera(scale=0.0),
        lambda: Look(exposure=1.5),
        lambda: Look(noise=-1.0),
        lambda: Look(quality=0),
        lambda: Look(background=300),
        lambda: Camera.fitting(
            [Scene("1", [0, 1, 2], np.zeros((3, 1, 2)),
                   [Entity("w", "rect_wall", width=1.0, height=1.0, is_static=True)])]
        ),
        lambda: film_scene(
            Scene("1", [0, 1, 2], np.zeros((3, 1, 3)), [Entity("a", properties={"mass": 1.0})]),
            CAMERA, rng=np.random.default_rng(0),
        ),
    ],
)  # fmt: skip
def test_what_cannot_be_filmed_is_refused(bad):
    with pytest.raises(SettingsError):
        bad()
