"""Contact geometry of discs, walls and mats, as the paper's data have it (DESIGN §8)."""

from dataclasses import dataclass

import numpy as np

POINT, DISC, WALL, MAT = 0, 1, 2, 3
CODES = {"point": POINT, "disc": DISC, "rect_wall": WALL, "rect_mat": MAT}


@dataclass(frozen=True)
class Shapes:
    """Shape codes and sizes as broadcastable arrays; nan where a size does not apply."""

    code: np.ndarray
    radius: np.ndarray
    width: np.ndarray
    height: np.ndarray

    @classmethod
    def of(cls, entities):
        """Collect the shapes of entities, arrays of shape (N,)."""
        return cls(
            np.array([CODES[e.shape] for e in entities]),
            np.array([e.radius for e in entities], dtype=float),
            np.array([e.width for e in entities], dtype=float),
            np.array([e.height for e in entities], dtype=float),
        )

    def map(self, change):
        return Shapes(*map(change, (self.code, self.radius, self.width, self.height)))

    def __getitem__(self, index):
        return self.map(lambda values: values[index])

    def collides(self, p_self, other, p_other):
        """1.0 where a disc touches another disc or a wall, else 0.0.

        Disc and disc: centres closer than the sum of the radii. Disc and wall: |dx| < W/2 + r
        and |dy| < H/2 + r, the wall being the other.
        """
        gap = np.asarray(p_self) - p_other
        pairs, reach, walls, half_width, half_height, shape = self._sizes_with(other)
        touching = np.zeros(np.broadcast_shapes(gap.shape[:-1], shape), dtype=bool)
        # Most scenes have one sort of contact or none: a rollout asks at every instant.
        with np.errstate(invalid="ignore"):
            if pairs is not None:
                square = sum(gap[..., k] * gap[..., k] for k in range(gap.shape[-1]))
                touching = touching | pairs & (square < reach)
            if walls is not None:
                inside = (np.abs(gap[..., 0]) < half_width) & (np.abs(gap[..., 1]) < half_height)
                touching = touching | walls & inside
        return touching.astype(float)

    def _sizes_with(self, other):
        """What `collides` compares with, kept for the last other.

        Pairs of discs and their squared reach, walls and their half sizes, None if there are none;
        and the shape of all.
        """
        kept = self.__dict__.get("_met")
        if kept is not None and kept[0] is other:
            return kept[1]
        disc = self.code == DISC
        pairs, walls = disc & (other.code == DISC), disc & (other.code == WALL)
        sizes = (
            pairs if pairs.any() else None, (self.radius + other.radius) ** 2,
            walls if walls.any() else None,
            other.width / 2 + self.radius, other.height / 2 + self.radius, pairs.shape,
        )  # fmt: skip
        self.__dict__["_met"] = (other, sizes)
        return sizes

    def is_on(self, p_self, other, p_other):
        """1.0 where the centre is over a mat: |dx| <= W/2 and |dy| <= H/2, else 0.0."""
        gap = np.abs(np.asarray(p_self) - p_other)
        with np.errstate(invalid="ignore"):
            inside = (gap[..., 0] <= other.width / 2) & (gap[..., 1] <= other.height / 2)
        return ((other.code == MAT) & inside).astype(float)

    def contact_margin(self, p_self, other, p_other):
        """Signed distance to the nearest flip of `collides` or `is_on`, metres; inf if none.

        A row whose margin is below a few standard errors of position has an unsure condition.
        """
        gap = np.asarray(p_self) - p_other
        with np.errstate(invalid="ignore"):
            discs = np.sqrt(np.einsum("...k,...k->...", gap, gap)) - (self.radius + other.radius)
            size = np.where(self.code == DISC, self.radius, 0.0)
            extra = np.where(other.code == WALL, size, 0.0)
            dx = np.abs(gap[..., 0]) - (other.width / 2 + extra)
            dy = np.abs(gap[..., 1]) - (other.height / 2 + extra)
            box = np.where((dx > 0) & (dy > 0), np.hypot(dx, dy), np.maximum(dx, dy))
        margin = np.full(np.broadcast_shapes(discs.shape, box.shape), np.inf)
        disc_pair = np.broadcast_to((self.code == DISC) & (other.code == DISC), margin.shape)
        rect = np.broadcast_to((other.code == WALL) | (other.code == MAT), margin.shape)
        margin = np.where(disc_pair, np.abs(discs), margin)
        return np.where(rect, np.abs(box), margin)


def contact_point(p_self, other, p_other):
    """Point where the other would be touched: its centre, or for walls the foot point.

    For a wall wider than high (x_self, y_wall), otherwise (x_wall, y_self).
    """
    p_self, p_other = np.broadcast_arrays(p_self, p_other)
    point = p_other.copy()
    wall = np.broadcast_to(other.code == WALL, point.shape[:-1])
    wide = np.broadcast_to(other.width > other.height, point.shape[:-1])
    point[..., 0] = np.where(wall & wide, p_self[..., 0], point[..., 0])
    point[..., 1] = np.where(wall & ~wide, p_self[..., 1], point[..., 1])
    return point
