"""Discs on renders with known sub-pixel truth: accuracy, covariance, identity, occlusion."""

import numpy as np
import pytest
from scipy.special import erf

from bsp_gp.errors import DataError
from bsp_gp.vision.colour import parse_colour
from bsp_gp.vision.disc_tracker import DiscTracker
from bsp_gp.vision.discs import DiscKind, place
from bsp_gp.vision.smoothing import calibrated
from bsp_gp.vision.video import open_video
from tests.renders import bouncing, frame, write_video

COLOURS = {c: parse_colour(c) for c in ("red", "blue", "yellow")}
MAT = ((0, 180, 0), 30, 40, 90, 120)


def rendered(path, seed, colours, n_frames, size, speed, **effects):
    """A video of bouncing discs and its truth (T, N, 2)."""
    rng = np.random.default_rng(seed)
    truth, contacts = bouncing(n_frames, len(colours), size, 17, rng, speed=speed)
    images = [frame((size, size), list(zip(colours, p, strict=True)), [MAT]) for p in truth]
    return open_video(write_video(path, images, rng=rng, **effects)), truth, contacts


def matched(track, truth):
    """Truth in the order of the track, by the first frame."""
    from scipy.optimize import linear_sum_assignment

    gaps = np.linalg.norm(track.positions[0][:, None] - truth[0][None], axis=2)
    return truth[:, linear_sum_assignment(np.nan_to_num(gaps, nan=1e3))[1]]


def track_discs(video, colours, counts=None):
    return DiscTracker(video, colours, counts=counts).run()


def errors(track, truth):
    return track.positions - matched(track, truth)


def test_clean_render_is_tracked_to_a_hundredth_of_a_pixel(tmp_path):
    video, truth, _ = rendered(tmp_path / "a.mkv", 3, ("red", "red", "blue"), 40, 180, 2.5)
    track = track_discs(video, COLOURS)
    assert sorted(track.names) == ["blue", "red1", "red2"]
    off = errors(track, truth)
    assert np.isfinite(off).all()
    assert np.sqrt(np.mean(off**2)) < 0.02  # the issue asks for 0.15
    assert video.is_lossy is False


def test_blurred_and_compressed_render_is_tracked_to_a_tenth(tmp_path):
    video, truth, _ = rendered(
        tmp_path / "a.mp4", 4, ("red", "blue"), 40, 180, 2.5, blur=1.2, noise=2.0
    )
    off = errors(track_discs(video, COLOURS), truth)
    assert np.isfinite(off).all()
    assert np.sqrt(np.mean(off**2)) < 0.15  # the issue asks for 0.4
    assert video.is_lossy


@pytest.mark.slow
def test_noisy_covariance_is_calibrated(tmp_path):
    video, truth, _ = rendered(
        tmp_path / "a.mkv", 5, ("red", "blue", "yellow"), 80, 220, 2.0, blur=0.7, noise=4.0
    )
    track = calibrated(track_discs(video, COLOURS))
    off = errors(track, truth).reshape(-1, 2)
    spread = track.covariances.reshape(-1, 2, 2)
    ratio = np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off) / 2
    # 240 positions: the mean of ratio has a sampling error of 0.06; neighbours in time add to it.
    assert 0.65 < ratio.mean() < 1.45


def test_hidden_disc_is_a_gap_and_keeps_its_name(tmp_path):
    n = 40
    x = np.linspace(30, 150, n)
    truth = np.stack([np.stack([x, np.full(n, 60.0)], 1), np.tile([90.0, 60.0], (n, 1))], axis=1)
    images = [frame((120, 180), [("red", p[0]), ("blue", p[1])]) for p in truth]
    video = open_video(write_video(tmp_path / "a.mkv", images))
    track = track_discs(video, {"red": COLOURS["red"], "blue": COLOURS["blue"]})
    red = track.of("red")
    missing = np.isnan(track.positions[:, red, 0])
    behind = np.abs(truth[:, 0, 0] - 90) < 4
    assert missing[behind].all()
    assert {r[1] for r in track.reasons} == {"red"}  # the one in front is seen throughout
    off = track.positions[~missing, red] - truth[~missing, 0]
    assert np.abs(off).max() < 0.3
    half = np.abs(truth[:, 0, 0] - 90)
    partly = ~missing & (half < 28) & (half > 15)
    free = ~missing & (half > 45)
    wide = np.median(track.covariances[partly, red, 0, 0])
    assert wide > 1.3 * np.median(track.covariances[free, red, 0, 0])


def test_a_fast_bounce_outside_of_the_window_is_found(tmp_path):
    x = np.concatenate([np.arange(40, 300, 52.0), np.arange(248, 40, -52.0)])
    images = [frame((80, 340), [("red", (v, 40.0))], radius=20) for v in x]
    track = track_discs(open_video(write_video(tmp_path / "a.mkv", images)),
                        {"red": COLOURS["red"]})  # fmt: skip
    np.testing.assert_allclose(track.positions[:, 0, 0], x, atol=0.05)


def test_no_disc_of_that_colour_is_an_error(tmp_path):
    images = [frame((80, 80), [("red", (40.0, 40.0))])] * 3
    video = open_video(write_video(tmp_path / "a.mkv", images))
    told = r"no free-standing round patch of the colour #[0-9a-f]{6}; .* moving:X,Y,W,H@FRAME"
    with pytest.raises(DataError, match=told):
        DiscTracker(video, {"blue": COLOURS["blue"]})


@pytest.mark.slow
def test_identities_survive_two_hundred_collisions(tmp_path):
    collisions = swaps = 0
    for seed in range(60):
        video, truth, contacts = rendered(
            tmp_path / f"{seed}.mkv", seed, ("red", "red", "red", "blue"), 60, 170, 3.5
        )
        track = track_discs(video, {c: COLOURS[c] for c in ("red", "blue")}, counts={
            "red": 3, "blue": 1})  # fmt: skip
        off = np.linalg.norm(errors(track, truth), axis=2)
        swaps += int((np.nanmax(off, axis=0) > 5).sum())
        collisions += len(contacts)
        if collisions >= 200:
            break
    assert collisions >= 200
    assert swaps == 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ending", "effects"),
    [(".mkv", {}), (".mkv", {"blur": 0.7, "noise": 4.0}), (".mp4", {"blur": 1.2, "noise": 2.0})],
)
def test_stated_covariance_is_calibrated(tmp_path, ending, effects):
    ratios = []
    for seed in range(8):
        video, truth, _ = rendered(
            tmp_path / f"{seed}{ending}", seed, ("red", "blue", "yellow"), 100, 260, 2.0, **effects
        )
        track = calibrated(track_discs(video, COLOURS))
        off = errors(track, truth).reshape(-1, 2)
        known = np.isfinite(off[:, 0])
        spread = track.covariances.reshape(-1, 2, 2)[known]
        ratios.append(
            np.mean(np.einsum("ni,nij,nj->n", off[known], np.linalg.inv(spread), off[known]) / 2)
        )
    print(ending, effects, np.round(ratios, 2), np.mean(ratios))
    assert 0.8 < np.mean(ratios) < 1.25


def test_a_small_disc_that_is_centred_on_a_pixel_is_placed():
    kind = DiscKind(np.array([0.0, 0.0, 200.0]), 4.0, 0.8, 4.5, np.array([255.0] * 3))
    y, x = np.mgrid[:41, :41]
    share = 0.5 * (1 - erf((np.hypot(x - 20.0, y - 20.0) - 4.0) / (0.8 * np.sqrt(2))))
    image = (255 + share[..., None] * (kind.colour - 255)).astype(np.uint8)
    fit = place(image, kind, (20.0, 20.0), [])
    assert not fit.reason
    assert fit.position == pytest.approx([20, 20], abs=0.02)
