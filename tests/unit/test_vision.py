"""Video in and out, regions, calibration, smoothing, templates, blobs, flow, recordings."""

import numpy as np
import pytest

from bsp_gp.data.tables import load_dataset
from bsp_gp.errors import DataError, OutputError, SettingsError
from bsp_gp.vision.blobs import BlobSettings, track_blob
from bsp_gp.vision.calibration import Calibration
from bsp_gp.vision.colour import NAMED, coverage, parse_colour
from bsp_gp.vision.recording import parse_object, track_video, write_recording
from bsp_gp.vision.regions import arena, mats
from bsp_gp.vision.smoothing import measurement_factor, smooth_track
from bsp_gp.vision.templates import track_point, track_template
from bsp_gp.vision.track import Track
from bsp_gp.vision.video import open_video
from tests.renders import frame, write_video


def textured(rng, shape=(160, 200)):
    import cv2

    return cv2.GaussianBlur(rng.uniform(60, 200, (*shape, 3)), (0, 0), 3.0) * 1.0


def shifted(background, patch, x, y):
    """The patch drawn on the background with its top left corner at a fraction of a pixel."""
    import cv2

    height, width = background.shape[:2]
    move = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    layer = cv2.warpAffine(patch, move, (width, height), flags=cv2.INTER_CUBIC)
    share = cv2.warpAffine(np.ones(patch.shape[:2]), move, (width, height), flags=cv2.INTER_LINEAR)
    return background * (1 - share[..., None]) + layer * share[..., None]


def test_coverage_is_the_share_of_the_mixture():
    red, white = np.array([0.0, 0, 255]), np.array([255.0, 255, 255])
    for share in (0.0, 0.3, 0.8, 1.0):
        pixel = np.round(share * red + (1 - share) * white).astype(np.uint8)[None, None]
        assert coverage(pixel, red, white)[0, 0] == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize("text", ["", "ff0000", "#ff00", "crimson-ish", "#gg0000"])
def test_unknown_colour_says_what_is_allowed(text):
    with pytest.raises(SettingsError, match="#rrggbb"):
        parse_colour(text)


@pytest.mark.parametrize("name", ["teal", "Magenta", "grey", *NAMED])
def test_names_of_css_are_colours_and_ours_are_among_them(name):
    assert parse_colour(name).shape == (3,)


@pytest.mark.parametrize(("name", "bgr"), [
    ("red", (0, 0, 255)), ("yellow", (0, 255, 255)), ("blue", (255, 0, 0)), ("green", (0, 128, 0)),
    ("white", (255, 255, 255)), ("black", (0, 0, 0)), ("orange", (0, 165, 255)),
    ("purple", (128, 0, 128)), ("brown", (42, 42, 165)),
])  # fmt: skip
def test_colours_are_blue_green_and_red(name, bgr):
    assert tuple(parse_colour(name)) == bgr
    assert name in NAMED


def test_video_round_trip_is_lossless_and_counts_frames(tmp_path):
    rng = np.random.default_rng(0)
    images = [rng.integers(0, 255, (40, 60, 3)).astype(np.uint8) for _ in range(5)]
    video = open_video(write_video(tmp_path / "a.mkv", images, fps=30.0))
    assert (video.n_frames, video.width, video.height) == (5, 60, 40)
    assert video.fps == pytest.approx(30.0, rel=1e-3)
    for k, image in video.frames():
        assert np.array_equal(image, images[k])
    assert [k for k, _ in video.frames(2, 4)] == [2, 3]


def test_bad_videos_are_named(tmp_path):
    with pytest.raises(DataError, match="no such video"):
        open_video(tmp_path / "none.mp4")
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(DataError, match="text.mp4"):
        open_video(tmp_path / "text.mp4")


def test_mats_that_overlap_are_found_whole():
    bgr = {"green": (50, 205, 154), "brown": (42, 42, 165)}
    image = np.full((200, 260, 3), 250, dtype=np.uint8)
    image[:20] = image[-20:] = 0
    image[:, :20] = image[:, -20:] = 0
    image[60:120, 40:140] = bgr["green"]
    image[90:150, 100:200] = bgr["brown"]  # on top
    image[30:70, 180:220] = bgr["green"]
    inner = arena(image)
    assert inner.box == (19.5, 19.5, 239.5, 179.5)
    found = mats(image, np.ones(image.shape[:2], dtype=bool),
                 {n: np.array(c, dtype=np.float32) for n, c in bgr.items()}, inner)  # fmt: skip
    boxes = {(r.colour, *(round(v + 0.5) for v in r.box)) for r in found}
    assert boxes == {("green", 40, 60, 140, 120), ("brown", 100, 90, 200, 150),
                     ("green", 180, 30, 220, 70)}  # fmt: skip
    hidden = {r.colour: r.hidden for r in found if r.x < 100}
    assert hidden["green"] == pytest.approx(40 * 30 / 6000, abs=0.03)


def test_two_mats_of_one_colour_that_overlap_are_two():
    image = np.full((200, 260, 3), 250, dtype=np.uint8)
    image[30:100, 40:150] = (139, 0, 139)
    image[60:160, 100:200] = (139, 0, 139)
    colour = {"purple": np.array([139, 0, 139], dtype=np.float32)}
    found = mats(image, np.ones((200, 260), dtype=bool), colour)
    boxes = {tuple(round(v + 0.5) for v in r.box) for r in found}
    assert boxes == {(40, 30, 150, 100), (100, 60, 200, 160)}


def test_two_points_give_scale_and_axes():
    c = Calibration.from_points([(100, 200), (100, 100)], [(0, 0), (0, 2)])
    np.testing.assert_allclose(c.world([[100, 150], [150, 200]]), [[0, 1], [1, 0]], atol=1e-12)
    s = Calibration.from_scale(50.0)
    np.testing.assert_allclose(s.world([[0, -50], [50, 0]]), [[0, 1], [1, 0]], atol=1e-12)


def test_four_points_of_a_tilted_plane_give_a_homography():
    rng = np.random.default_rng(1)
    true = np.array([[0.02, 0.003, -1.0], [-0.002, -0.03, 5.0], [1e-4, 2e-4, 1.0]])
    pixels = np.array([[10, 10], [300, 20], [280, 200], [20, 220]], dtype=float)
    world = Calibration(true).world(pixels)
    c = Calibration.from_points(pixels, world)
    inside = rng.uniform(20, 200, (20, 2))
    np.testing.assert_allclose(c.world(inside), Calibration(true).world(inside), atol=1e-6)
    step = 1e-4
    moved = (c.world(inside + [step, 0]) - c.world(inside - [step, 0])) / (2 * step)
    np.testing.assert_allclose(c.jacobian(inside)[..., 0], moved, rtol=1e-5, atol=1e-9)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_too_few_known_points_are_an_error(n):
    points = np.arange(2.0 * n).reshape(n, 2) ** 2
    with pytest.raises(SettingsError, match="known points"):
        Calibration.from_points(points, points)


def noisy_track(rng, n=300, sigma=0.3, stated=0.1):
    t = np.arange(n)
    truth = np.stack([50 + 30 * np.sin(t / 15), 2.0 * t], axis=1)
    z = truth + rng.normal(0, sigma, truth.shape)
    z[100:110] = np.nan
    cov = np.broadcast_to(np.eye(2) * stated**2, (n, 1, 2, 2))
    blank = np.ones((n, 1))
    return truth, Track(("a",), t, 30.0, z[:, None], cov, blank, blank, lossy=False)


def test_measurement_error_is_read_off_the_track():
    _, track = noisy_track(np.random.default_rng(2))
    factor = measurement_factor(track.positions[:, 0], track.covariances[:, 0])
    assert factor == pytest.approx(9.0, rel=0.25)  # (0.3 / 0.1)²; 580 differences, half of them


def test_smoother_beats_the_measurement_and_states_its_error():
    from bsp_gp.vision.smoothing import calibrated

    truth, track = noisy_track(np.random.default_rng(3))
    result = smooth_track(calibrated(track), "a")
    off = result.positions - truth
    known = np.isfinite(track.positions[:, 0, 0])
    assert np.sqrt(np.mean(off[known] ** 2)) < 0.2
    ratio = np.einsum("ti,tij,tj->t", off, np.linalg.inv(result.covariances), off) / 2
    assert 0.6 < ratio[known].mean() < 1.6
    assert result.covariances[105, 0, 0] > 4 * result.covariances[50, 0, 0]  # the gap


def test_template_is_followed_to_a_fraction_of_a_pixel(tmp_path):
    rng = np.random.default_rng(4)
    background, patch = textured(rng), textured(rng, (30, 40))
    corners = [(20 + 2.37 * k, 30 + 1.13 * k) for k in range(20)]
    images = [shifted(background, patch, *c) for c in corners]
    video = open_video(write_video(tmp_path / "a.mkv", images))
    track = track_template(video, "p", (22, 32, 34, 24), 0)
    moved = track.positions[:, 0] - track.positions[0, 0]
    true = np.array(corners) - corners[0]
    assert np.sqrt(np.mean((moved - true) ** 2)) < 0.1
    with pytest.raises(SettingsError, match="inside|lie in the picture"):
        track_template(video, "p", (190, 32, 34, 24), 0)


def test_point_is_followed_by_flow(tmp_path):
    rng = np.random.default_rng(5)
    background, patch = textured(rng), textured(rng, (50, 60))
    corners = [(20 + 1.6 * k, 30 + 0.7 * k) for k in range(15)]
    images = [shifted(background, patch, *c) for c in corners]
    video = open_video(write_video(tmp_path / "a.mkv", images))
    track = track_point(video, "p", (50.0, 55.0), 0)
    moved = track.positions[:, 0] - track.positions[0, 0]
    assert np.abs(moved - (np.array(corners) - corners[0])).max() < 0.3
    assert track.covariances[-1, 0, 0, 0] > track.covariances[1, 0, 0, 0]


def test_patch_is_followed_in_front_of_a_plain_wall(tmp_path):
    import cv2

    images, truth = [], []
    for k in range(15):
        image = np.full((160, 220, 3), (190, 180, 175), dtype=np.uint8)
        centre = (40 + 8 * k, 60 + 3 * k)
        box = cv2.boxPoints((centre, (44, 30), 9.0 * k))
        cv2.fillConvexPoly(image, np.round(box * 16).astype(np.int32), (90, 130, 190), cv2.LINE_AA,
                           4)  # fmt: skip
        images.append(image)
        truth.append(centre)
    video = open_video(write_video(tmp_path / "a.mkv", images))
    settings = BlobSettings((60, 68, 12, 8), 3, "surround")
    track = track_blob(video, "block", settings)
    assert np.abs(track.positions[:, 0] - truth).max() < 1.0


def red_ball(tmp_path, n=12):
    x = 30 + 6.25 * np.arange(n)
    images = [frame((90, 140), [("red", (v, 40 + 0.2 * (v - 30)))]) for v in x]
    return write_video(tmp_path / "ball.mkv", images, fps=25.0), x


def test_recording_reads_back_as_a_data_set(tmp_path):
    path, x = red_ball(tmp_path)
    out, _ = write_recording(
        path, [parse_object("ball", "disc:red")], tmp_path / "out",
        calibration=Calibration.from_scale(100.0),
    )  # fmt: skip
    dataset = load_dataset(out / "data")
    scene = dataset.scenes[0]
    np.testing.assert_allclose(scene.positions[:, 0, 0], x / 100, atol=1e-4)
    np.testing.assert_allclose(scene.positions[:, 0, 1], -(40 + 0.2 * (x - 30)) / 100, atol=1e-4)
    np.testing.assert_allclose(np.diff(scene.times), 0.04, rtol=1e-6)
    assert scene.entities[0].radius == pytest.approx(0.17, abs=0.006)
    assert np.all(scene.sigma > 0)
    assert "12 of 12" in (out / "quality.html").read_text("utf-8")
    film = open_video(out / "film.mp4")
    assert (film.n_frames, film.width, film.height) == (12, 140, 90)
    with pytest.raises(OutputError, match="exists"):
        write_recording(path, [parse_object("ball", "disc:red")], tmp_path / "out")


@pytest.mark.parametrize(
    "text",
    ["disc:", "disc:red:-1", "disc:red:x", "patch:1,2,3@4", "template:a@1", "blob:1", "point:1,2"],
)
def test_bad_object_is_named(text):
    with pytest.raises(SettingsError, match="ball|colour"):
        parse_object("ball", text)


def test_frames_outside_of_the_video_are_an_error(tmp_path):
    video = open_video(red_ball(tmp_path)[0])
    with pytest.raises(SettingsError, match=r"0\.\.11"):
        track_video(video, [parse_object("ball", "disc:red")], 5, 40)


def test_a_frame_in_which_nothing_is_seen_is_a_gap(tmp_path):
    x = 30 + 4.0 * np.arange(12)
    images = [frame((90, 140), [("red", (v, 40))] if k != 5 else []) for k, v in enumerate(x)]
    path = write_video(tmp_path / "ball.mkv", images, fps=25.0)
    out, _ = write_recording(path, [parse_object("ball", "disc:red")], tmp_path / "out")
    scene = load_dataset(out).scenes[0]
    assert len(scene.times) == 11 and np.isfinite(scene.positions).all()
    assert np.diff(scene.times).max() == pytest.approx(0.08)


def test_track_command(tmp_path, capsys, monkeypatch):
    from bsp_gp.cli import main

    path, _ = red_ball(tmp_path)
    monkeypatch.chdir(tmp_path)
    words = [
        "track",
        str(path),
        "--object",
        "ball=disc:red",
        "--scale",
        "100",
        "--no-film",
        "--quiet",
    ]
    assert main(words) == 0
    assert "ball: 12 of 12 frames" in capsys.readouterr().out
    assert load_dataset(tmp_path / "ball-track" / "data").scenes[0].names == ("ball",)
    assert load_dataset(tmp_path / "ball-track").scenes[0].names == ("ball",)
    assert main(words) == 2
    assert "exists already" in capsys.readouterr().err
