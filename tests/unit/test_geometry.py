"""Contact as the paper's data have it (DESIGN, section 8)."""

import numpy as np
import pytest

from bsp_gp.data.scene import Entity
from bsp_gp.physics.geometry import DISC, MAT, POINT, WALL, Shapes, contact_point

BALL = Entity("ball", "disc", radius=1.0)
BIG = Entity("big", "disc", radius=2.0)
WIDE = Entity("wide", "rect_wall", width=8.0, height=2.0, is_static=True)
HIGH = Entity("high", "rect_wall", width=2.0, height=8.0, is_static=True)
SQUARE = Entity("square", "rect_wall", width=4.0, height=4.0, is_static=True)
MATTE = Entity("mat", "rect_mat", width=8.0, height=2.0, is_static=True)
DOT = Entity("dot")
EPS = 2.0**-30


def shapes(entity):
    """Shape of one entity, arrays without an axis."""
    return Shapes.of([entity])[0]


def collides(one, p, other, q=(0.0, 0.0)):
    return float(shapes(one).collides(np.array(p, float), shapes(other), np.array(q, float)))


def is_on(one, p, other, q=(0.0, 0.0)):
    return float(shapes(one).is_on(np.array(p, float), shapes(other), np.array(q, float)))


def margin(one, p, other, q=(0.0, 0.0)):
    return float(shapes(one).contact_margin(np.array(p, float), shapes(other), np.array(q, float)))


def point(p, other, q=(0.0, 0.0)):
    return contact_point(np.array(p, float), shapes(other), np.array(q, float)).tolist()


def test_shapes_of_entities():
    found = Shapes.of([BALL, WIDE, MATTE, DOT])
    assert found.code.tolist() == [DISC, WALL, MAT, POINT]
    np.testing.assert_array_equal(found.radius, [1, np.nan, np.nan, np.nan])
    np.testing.assert_array_equal(found.width, [np.nan, 8, 8, np.nan])
    assert found[1].height == 2


@pytest.mark.parametrize(
    ("distance", "expected"), [(3 - EPS, 1.0), (3.0, 0.0), (3 + EPS, 0.0), (0.5, 1.0)]
)
def test_discs_collide_below_the_sum_of_radii(distance, expected):
    for direction in ((1, 0), (0, -1), (0.6, 0.8)):
        p = distance * np.array(direction)
        if direction == (0.6, 0.8) and distance == 3.0:
            continue  # 0.6^2 + 0.8^2 is 1 up to rounding only
        assert collides(BALL, p, BIG) == collides(BIG, p, BALL) == expected


def test_collision_is_strict_and_separate_per_axis_at_walls():
    """|dx| < W/2 + r and |dy| < H/2 + r: a box with square corners."""
    assert collides(BALL, (0, 2 - EPS), WIDE) == 1
    assert collides(BALL, (0, 2.0), WIDE) == 0
    assert collides(BALL, (5 - EPS, 0), WIDE) == 1
    assert collides(BALL, (5.0, 0), WIDE) == 0
    assert collides(BALL, (-5 + EPS, -2 + EPS), WIDE) == 1  # the corner of a true disc is free
    assert collides(BALL, (0, 5 - EPS), HIGH) == 1
    assert collides(BALL, (2.0, 0), HIGH) == 0
    # The wall's own place counts.
    assert collides(BALL, (10, 12 - EPS), WIDE, (10, 10)) == 1
    assert collides(BALL, (10, 12), WIDE, (10, 10)) == 0


@pytest.mark.parametrize(
    ("one", "other"),
    [(WIDE, BALL), (WIDE, HIGH), (BALL, MATTE), (MATTE, BALL), (BALL, DOT), (DOT, BALL),
     (DOT, DOT), (DOT, WIDE), (MATTE, MATTE)],
)  # fmt: skip
def test_only_discs_touch_discs_and_walls(one, other):
    assert collides(one, (0.1, 0.1), other) == 0


@pytest.mark.parametrize(
    ("p", "expected"),
    [((0, 0), 1), ((4, 1), 1), ((-4, -1), 1), ((4 + EPS, 0), 0), ((0, 1 + EPS), 0)],
)
def test_a_mat_holds_centres_and_its_edge(p, expected):
    for one in (BALL, DOT, BIG):
        assert is_on(one, p, MATTE) == expected
    assert is_on(BALL, np.add(p, (7, -9)), MATTE, (7, -9)) == expected
    for other in (WIDE, BALL, DOT):
        assert is_on(BALL, p, other) == 0


def test_contact_points():
    assert point((3, 5), BIG) == [0, 0]
    assert point((3, 5), DOT, (1, 2)) == [1, 2]
    assert point((3, 5), MATTE, (1, 2)) == [1, 2]
    assert point((3, 5), WIDE, (1, 2)) == [3, 2]  # (x_i, y_j)
    assert point((3, 5), HIGH, (1, 2)) == [1, 5]  # (x_j, y_i)
    assert point((3, 5), SQUARE, (1, 2)) == [1, 5]  # not wider than high


def test_contact_point_leaves_its_arguments_alone_and_broadcasts():
    p = np.random.default_rng(1).normal(size=(4, 3, 1, 2))
    other = Shapes.of([WIDE, HIGH, BALL])
    q = np.arange(6.0).reshape(3, 2)
    before = p.copy(), q.copy()
    found = contact_point(p, other, q)
    assert found.shape == (4, 3, 3, 2)
    np.testing.assert_array_equal(p, before[0])
    np.testing.assert_array_equal(q, before[1])
    np.testing.assert_array_equal(found[..., 0, 0], p[..., 0, 0] + 0 * found[..., 0, 0])
    np.testing.assert_array_equal(found[..., 0, 1], np.full((4, 3), q[0, 1]))
    np.testing.assert_array_equal(found[..., 1, 0], np.full((4, 3), q[1, 0]))
    np.testing.assert_array_equal(found[..., 2, :], np.broadcast_to(q[2], (4, 3, 2)))


def test_margins_by_hand():
    assert margin(BALL, (5, 0), BIG) == 2
    assert margin(BALL, (0, 1), BIG) == 2  # inside: 2 m to leave
    assert margin(BALL, (0, 7), WIDE) == 5
    assert margin(BALL, (8, 6), WIDE) == 5  # 3 and 4 m off the box's corner (5, 2)
    assert margin(BALL, (4, 0), WIDE) == 1
    assert margin(BALL, (0, 0), WIDE) == 2
    assert margin(BALL, (7, 0), MATTE) == 3  # of the centre: the radius does not count
    assert margin(DOT, (0, 0), MATTE) == 1
    for one, other in ((BALL, DOT), (DOT, BALL), (DOT, DOT)):
        assert margin(one, (3, 4), other) == np.inf


@pytest.mark.parametrize("other", [BIG, WIDE, HIGH, MATTE])
def test_no_condition_flips_within_the_margin(other):
    """The margin is the distance to the nearest flip: none nearer, one just beyond it."""
    rng = np.random.default_rng(2)
    flag = is_on if other is MATTE else collides

    def flags(points):
        one, origin = shapes(BALL), np.zeros(2)
        return (one.is_on if other is MATTE else one.collides)(points, shapes(other), origin)

    angles = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    for p in rng.uniform(-7, 7, (60, 2)):
        size = margin(BALL, p, other)
        here = flag(BALL, p, other)
        assert np.all(flags(p + 0.999 * size * ring) == here)
        # 720 directions miss the nearest point by at most 0.25 degrees: 1.0001 of the distance
        # for edges; corners and discs curve away, so a further per cent is given.
        assert np.any(flags(p + (1.01 * size + 1e-9) * ring) != here)


def test_unknown_places_touch_nothing():
    nan = (np.nan, 0.0)
    assert collides(BALL, nan, BIG) == collides(BALL, nan, WIDE) == is_on(BALL, nan, MATTE) == 0
