"""Pieces of tracks, short enough that what forces do to them is a small matrix."""

from dataclasses import dataclass, replace

import numpy as np

from bsp_gp.fitting.led import are_led
from bsp_gp.fitting.shooting import Windows, cut_windows
from bsp_gp.fitting.tracks import ChainNoise
from bsp_gp.physics.bodies import Bodies
from bsp_gp.physics.engine.driven import Driven

MOST_COORDINATES = 300
"""Coordinates of a piece at the most, and its least number of rows."""
LEAST_ROWS = 12
LEAST_FLOWN = 4
"""Rows between two bounces that tell of a force."""
MOST_PIECES, FEWEST_PIECES = 64, 16
"""Pieces of a group of chains that are looked at, spread evenly over it; fewer where they are
large."""
MOST_CHANGES = 1 << 26
"""Numbers that tell what forces at all instants do to the states of all pieces at all instants."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """W pieces of like-built chains; those of bodies of one scene at one time stand P apart.

    Attributes
    ----------
    chain, first, stop : ndarray of int, shape (W,)
    leads : ndarray of bool, shape (W,)
        Whether the next piece begins where it ends: it has the first row of that, unseen, as well.
    count : int
        Pieces of one body, P.
    bodies : Bodies
        Of every piece: its own bodies first, other moving ones, driven ones.
    """

    chain: np.ndarray
    first: np.ndarray
    stop: np.ndarray
    leads: np.ndarray
    count: int
    bodies: Bodies

    @property
    def n_rows(self):
        return int((self.stop - self.first).sum())

    @property
    def _gather(self):
        """Rows of the chains, (L, W), and which belong to a piece."""
        end = self.stop + self.leads
        rows = self.first + np.arange(int((end - self.first).max()))[:, None]
        inside = rows < end
        return np.where(inside, rows, self.first), inside

    def runs(self, most):
        """Pieces that follow one another, at the most so many, as lists of their numbers."""
        out, run = [], []
        for k, leads in enumerate(self.leads):
            run.append(k)
            if not leads or len(run) == most:
                out.append(run)
                run = []
        return out

    def chains(self, chains):
        cut = chains.pieces(self.chain, self.first, self.stop + self.leads)
        rows, _ = self._gather
        seen = (rows < self.stop)[..., None, None]
        return replace(cut, observed=np.where(seen, cut.observed, np.nan))

    def noise(self, noise):
        rows, inside = self._gather
        inside_ = (inside & (rows < self.stop))[..., None, None]
        return ChainNoise(
            np.where(inside, noise.times[rows, self.chain], np.nan),
            np.where(inside_, noise.variance[rows, self.chain], np.nan),
            np.where(inside_, noise.amplitude[rows, self.chain], 0.0), noise.correlation_time,
            noise.adding,
        )  # fmt: skip

    def nodes(self, nodes):
        """States of their rows, (2, R, d, L, W); nan behind their ends."""
        rows, inside = self._gather
        return np.where(inside, nodes[..., rows, self.chain], np.nan)

    def put(self, nodes, states):
        """States of all chains, those of the rows of pieces (2, R, d, L, W) in their place."""
        rows, inside = self._gather
        inside = inside & (rows < self.stop)
        chain = np.broadcast_to(self.chain, rows.shape)
        found = states[..., inside]
        out = nodes.copy()
        out[..., rows[inside], chain[inside]] = np.where(
            np.isfinite(found), found, out[..., rows[inside], chain[inside]]
        )
        return out

    def tolerance(self, noise):
        """Errors that integrations may have, (W,), m."""
        size = noise.least[self.chain]
        return 1e-2 * np.where(np.isfinite(size), size, size[np.isfinite(size)].min())

    def states(self, chains, times, nodes):
        """Places and velocities of all bodies of the pieces at times (n, W), (n, W, N, d) each."""
        own = np.moveaxis(nodes, (3, 4), (1, 2))  # (2, n, W, R, d)
        n_groups = nodes.shape[-1] // self.count
        apart = own.reshape(2, len(times), n_groups, self.count, *own.shape[3:])
        others = [
            np.concatenate([apart[:, :, h] for h in range(n_groups) if h != g], axis=3)
            if n_groups > 1 else apart[:, :, g, :, :0]
            for g in range(n_groups)
        ]  # fmt: skip
        parts = [own, np.concatenate(others, axis=2)]  # (2, n, W, .., d)
        driven = Driven(chains)
        if driven.count:
            n, w = times.shape
            chain = np.broadcast_to(np.arange(w), (n, w)).ravel()
            places = driven.at(times.ravel(), chain)  # (2, D, d, n W)
            places = np.moveaxis(places.reshape(*places.shape[:3], n, w), (3, 4), (1, 2))
            self._as_they_lead(chains, parts[1], places)
            parts.append(places[:, :, np.arange(w)[:, None], self._still(chains)])
        whole = np.concatenate(parts, axis=3)
        return whole[0], whole[1]

    def _as_they_lead(self, chains, others, places):
        """Where others are not followed, they are where they lead: of tracks that are cut short."""
        for w in np.flatnonzero(np.isnan(others).any(axis=(0, 1, 3, 4))):
            members = range(w % self.count, len(chains.bodies), self.count)
            names = [name for k in members if k != w for name in chains.bodies[k]]
            for r, name in enumerate(names):
                if name in chains.fixed[w]:
                    lead = places[:, :, w, chains.fixed[w].index(name)]
                    mine = others[:, :, w, r]
                    others[:, :, w, r] = np.where(np.isfinite(mine), mine, lead)

    def _still(self, chains):
        """Which of the bodies beside each chain no force moves, (W, D): others lead it as well."""
        moving = _moving(chains)
        return np.array([
            [k for k, name in enumerate(fixed) if (scene, name) not in moving]
            for scene, fixed in zip(chains.scenes, chains.fixed, strict=True)
        ], dtype=int).reshape(len(chains.fixed), -1)


def _moving(chains):
    """Bodies that forces move, (scene, name)."""
    return {(scene, name) for scene, name, *_ in chains.members()}


def cut_pieces(chains, batch, n_held=0, per_row=1, hits=()):
    """Cut chains of the scenes of a batch into pieces.

    Parameters
    ----------
    n_held : int
        Coordinates that constraints take from a chain: what is slow on it shows in longer pieces.
    per_row : int
        Instants of forces for each row.
    hits : collection of (int, int)
        Chains, and rows behind which they bounce: there pieces end, and the next ones begin anew.
    """
    n_scenes = len(batch.scenes)
    n_groups = chains.n_chains // n_scenes
    n_own = chains.n_moving * chains.n_dims
    rows = max(int(MOST_COORDINATES / max(n_own - n_held / 2, 1)), LEAST_ROWS)
    # Bodies whose tracks are cut short lead others as they were seen, or are nowhere from there on.
    lengths = chains.lengths.reshape(n_groups, n_scenes)
    is_led = are_led(chains, _moving(chains))
    lengths = lengths.max(axis=0) if is_led else lengths.min(axis=0)
    windows = cut_windows(lengths, rows)
    if hits:
        windows = _between_hits(windows, {(chain % n_scenes, row) for chain, row in hits})
    chosen = np.arange(len(windows.chain))
    n_instants = per_row * int(windows.length.max(initial=1))
    most = MOST_CHANGES // (2 * (n_instants * n_own) ** 2 * n_groups)
    most = int(np.clip(most, FEWEST_PIECES, MOST_PIECES))
    if len(chosen) > most:
        chosen = np.unique(np.linspace(0, len(chosen) - 1, most).astype(int))
    scene = windows.chain[chosen]
    moving = batch.bodies.receivers
    driven = np.setdiff1d(np.arange(batch.bodies.shapes.code.shape[1]), moving)
    groups = [moving] if n_groups == 1 else [np.array([k]) for k in moving]
    order = [np.concatenate([own, np.setdiff1d(moving, own), driven]).astype(int) for own in groups]
    follows = (scene[1:] == scene[:-1]) & (np.diff(chosen) == 1)
    follows &= windows.first[chosen][1:] == windows.stop[chosen][:-1]
    return Pieces(
        chain=np.concatenate([g * n_scenes + scene for g in range(n_groups)]),
        first=np.tile(windows.first[chosen], n_groups),
        stop=np.tile(windows.stop[chosen], n_groups),
        leads=np.tile(np.append(follows, False), n_groups),
        count=len(scene),
        bodies=_bodies(batch.bodies, scene, order, len(groups[0])),
    )


def _between_hits(windows, hits):
    """Windows that end a row before a bounce, and begin again a row behind it."""
    out = []
    for chain, first, stop in zip(windows.chain, windows.first, windows.stop, strict=True):
        begin = first
        for row in sorted(row for s, row in hits if s == chain and first - 1 <= row < stop):
            out.append((chain, begin, row))
            begin = row + 2
        out.append((chain, begin, stop))
    out = [piece for piece in out if piece[2] - piece[1] >= LEAST_FLOWN]
    return Windows(*np.array(out, dtype=int).reshape(-1, 3).T) if out else windows


def _bodies(bodies, scene, order, n_own):
    """Bodies of the pieces, in the order of each group."""

    def taken(values):
        return np.concatenate([values[scene][:, rows] for rows in order])

    return replace(
        bodies,
        names=tuple(tuple(bodies.names[s][k] for k in rows) for rows in order for s in scene),
        receivers=np.arange(n_own),
        scenes=tuple(bodies.scenes[s] for _ in order for s in scene),
        properties={name: taken(values) for name, values in bodies.properties.items()},
        shapes=bodies.shapes.map(taken),
    )
