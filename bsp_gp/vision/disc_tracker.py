"""Several discs followed through a video, each under its own name from first frame to last.

A disc is looked for where its motion so far puts it, without any gate on the distance other than
the search window; discs of one colour are told apart by assigning all found places to all
predictions at once (least total squared distance).
"""

import logging
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import linear_sum_assignment

from bsp_gp.errors import DataError
from bsp_gp.vision.colour import background
from bsp_gp.vision.discs import MIN_GAIN, calibrate_kind, find_discs, follow, gap, place
from bsp_gp.vision.track import Track

log = logging.getLogger(__name__)

N_SAMPLES = 12  # frames from which colours, radii, background and number of discs are learned
LOST_GAIN = 0.6
SETTLED = 0.3  # px: neighbours that moved less than this need no second round
IN_FRONT = 0.2  # rms misfit of coverage up to which a disc is seen whole
NEAR = 3.0  # px: a fit that ends farther from the prediction is searched for again


@dataclass
class _Body:
    """State of one disc while it is followed in one direction of time."""

    name: str
    kind_name: str
    place: np.ndarray
    velocity: np.ndarray
    missing: int = 0

    @property
    def predicted(self):
        return self.place + self.velocity


class DiscTracker:
    """What discs look like in one video, and how many there are; then `run` follows them.

    Parameters
    ----------
    colours : mapping of str to ndarray, shape (3,)
        BGR by the name of the kind.
    radius : float or mapping of str to float, optional
        Of the coloured part, px; measured if not given.
    counts : mapping of str to int, optional
        How many discs of each kind; if not given, the number seen in most sample frames.
    """

    def __init__(self, video, colours, radius=None, counts=None):
        self.video = video
        self.sample_frames, self.samples = video.sample(N_SAMPLES)
        self.behind, _ = background(self.samples)
        counts = counts or {}
        self.kinds = self._learn(colours, radius, counts)
        self.found = [
            {name: self._verified(image, kind) for name, kind in self.kinds.items()}
            for image in self.samples
        ]
        usual = {name: self._usual([len(f[name]) for f in self.found]) for name in self.kinds}
        self.counts = {name: counts.get(name, usual[name]) for name in self.kinds}
        if not any(self.counts.values()):
            raise DataError(
                f"most frames show no disc of the kind {' or '.join(self.counts)}",
                file=video.path,
                remedy="give the colour as #rrggbb and the radius in px (disc:#0072b2:12); a disc "
                "of less than about 8 px is followed with template:X,Y,W,H@FRAME",
            )  # fmt: skip

    def _learn(self, colours, radius, counts):
        kinds, failures = {}, {}
        for name, colour in colours.items():
            given = radius.get(name) if isinstance(radius, dict) else radius
            try:
                kinds[name] = calibrate_kind(self.samples, colour, given, behind=self.behind)
            except DataError as error:
                failures[name] = error
        missing = [name for name in failures if counts.get(name)]
        if not kinds or missing:
            raise failures[(missing or list(failures))[0]]
        for name in failures:
            log.info("no disc of the kind %s in %s", name, self.video.path.name)
        return kinds

    def _verified(self, image, kind):
        fits = []
        for start in find_discs(image, kind):
            others = [(f.position[0], f.position[1], kind.reach) for f in fits]
            fit = place(image, kind, start, others, self.behind)
            if not fit.reason:
                fits.append(fit)
        return fits

    @staticmethod
    def _usual(counts):
        values, times = np.unique(counts, return_counts=True)
        return int(values[np.argmax(times + 1e-6 * values)])

    def run(self, first=0, last=None):
        """Follow all discs from the best sample frame to both ends of ``first..last``."""
        last = self.video.n_frames - 1 if last is None else last
        anchor = self._anchor(first, last)
        bodies = self._start(anchor)
        start = int(self.sample_frames[anchor])
        kept = list(self.video.frames(first, start + 1))  # only these are needed backwards
        before = self._follow(bodies, reversed(kept))
        settled = self._restarted(before, bodies)
        after = self._follow(settled, self.video.frames(start, last + 1))
        placed = {**before, **after}
        return self._gathered(bodies, placed)

    def _anchor(self, first, last):
        best, choice = -np.inf, None
        for k, (frame, found) in enumerate(zip(self.sample_frames, self.found, strict=True)):
            if not first <= frame <= last:
                continue
            exact = sum(len(found[n]) == self.counts[n] for n in self.kinds)
            fits = [f for n in self.kinds for f in found[n]]
            gaps = [np.hypot(*(a.position - b.position)) for a, b in combinations(fits, 2)]
            # Free-standing discs are named safely; early frames keep the backward run short.
            score = exact + min([*gaps, 100.0]) / 1000 - 1e-2 * k / len(self.samples)
            if score > best:
                best, choice = score, k
        if choice is None or best < len(self.kinds) - 0.5:
            raise DataError(
                f"no sampled frame shows all of {self.counts} at once", file=self.video.path,
                remedy="give how many discs of each colour there are",
            )  # fmt: skip
        return choice

    def _start(self, anchor):
        bodies = []
        for kind_name in self.kinds:
            fits = sorted(self.found[anchor][kind_name], key=lambda f: tuple(f.position))
            fits = fits[: self.counts[kind_name]]
            for k, fit in enumerate(fits, 1):
                name = f"{kind_name}{k}" if self.counts[kind_name] > 1 else kind_name
                bodies.append(_Body(name, kind_name, fit.position.copy(), np.zeros(2)))
        return bodies

    @staticmethod
    def _restarted(before, bodies):
        """Bodies at the anchor again, with the velocity that the backward run measured."""
        earlier, now = (before[frame] for frame in (2 * sorted(before))[-2:])
        again = []
        for body, old, new in zip(bodies, earlier, now, strict=True):
            place, velocity = new.position, new.position - old.position
            place = place if np.all(np.isfinite(place)) else body.place
            velocity = velocity if np.all(np.isfinite(velocity)) else np.zeros(2)
            again.append(replace(body, place=place, velocity=velocity))
        return again

    def _follow(self, bodies, images):
        bodies = [replace(b) for b in bodies]
        placed = {}
        for body in bodies:  # at the anchor the place is known, the velocity is not yet
            body.place = body.place - body.velocity
        for frame, image in images:
            fits = self._measure(image, bodies)
            for body, fit in zip(bodies, fits, strict=True):
                if fit.reason:
                    body.missing += 1
                    body.place = body.predicted  # coasts; the position stays a gap
                else:
                    step = fit.position - body.place
                    body.velocity = step / (body.missing + 1) if body.missing > 3 else step
                    body.place, body.missing = fit.position.copy(), 0
            placed[frame] = fits
        return placed

    def _measure(self, image, bodies):
        """Place all discs of one image: prediction, else search and assignment; then refit."""
        reach = [self.kinds[b.kind_name].reach for b in bodies]
        centres = [b.predicted for b in bodies]

        def others(k, of_kind=None):
            return [(*centres[j], reach[j]) for j, other in enumerate(bodies)
                    if j != k and of_kind in (None, other.kind_name)]  # fmt: skip

        def alike(k):
            return others(k, bodies[k].kind_name)

        fits, lost = [None] * len(bodies), []
        for k, body in enumerate(bodies):
            fits[k] = place(image, self.kinds[body.kind_name], centres[k], others(k), self.behind)
            if fits[k].reason or np.hypot(*(fits[k].position - body.predicted)) > NEAR:
                lost.append(k)
        centres = [c if k in lost else fits[k].position for k, c in enumerate(centres)]
        if not lost and not self._touching(centres, reach):
            return fits
        absent = set()
        for k in lost:
            spot, gain = self._searched(image, bodies[k], others(k))
            if gain < MIN_GAIN:  # perhaps it covers the others
                spot, gain = self._searched(image, bodies[k], alike(k))
            if gain < MIN_GAIN:
                absent.add(k)
            else:
                centres[k] = np.array(spot)
        centres = self._assigned(bodies, centres)
        for _ in range(2):
            before = [np.array(c) for c in centres]
            for k, body in enumerate(bodies):
                alone = [centres[j] for j in range(len(bodies)) if j != k]
                near = [reach[j] for j in range(len(bodies)) if j != k]
                if k not in lost and not self._touching([centres[k], *alone], [reach[k], *near], 0):
                    continue  # its fit has no neighbour that could have moved
                if k in absent:
                    fits[k] = gap("its colour is not seen")
                    continue
                kind = self.kinds[body.kind_name]
                fits[k] = place(image, kind, centres[k], others(k), self.behind)
                if fits[k].reason:  # it may lie in front: only its own kind can be mistaken
                    front = place(image, kind, centres[k], alike(k), self.behind)
                    if not front.reason and front.rms < IN_FRONT:
                        fits[k] = front
                if not fits[k].reason:
                    centres[k] = fits[k].position
            if max(np.abs(a - b).max() for a, b in zip(before, centres, strict=True)) < SETTLED:
                break
        return fits

    def _searched(self, image, body, others):
        """Coarse place near the prediction, or anywhere if it is not there."""
        kind = self.kinds[body.kind_name]
        spot, gain = follow(image, kind, body.predicted, others)
        if gain < LOST_GAIN:  # a fast bounce leaves the window
            wide, better = follow(image, kind, body.predicted, others, max(image.shape))
            if better > gain + 0.1:
                return wide, better
        return spot, gain

    @staticmethod
    def _touching(centres, reach, one=None):
        """Whether any two discs (or disc `one` and any other) touch, to 4 px."""
        return any(
            np.hypot(*(centres[i] - centres[j])) < reach[i] + reach[j] + 4
            for i in range(len(centres))
            for j in range(i)
            if one is None or one in (i, j)
        )

    @staticmethod
    def _assigned(bodies, centres):
        """Discs of one kind get the places with the least total squared distance."""
        centres = list(centres)
        for kind_name in {b.kind_name for b in bodies}:
            same = [k for k, b in enumerate(bodies) if b.kind_name == kind_name]
            if len(same) > 1:
                predicted = [bodies[k].predicted for k in same]
                cost = [[np.sum((centres[j] - p) ** 2) for j in same] for p in predicted]
                _, columns = linear_sum_assignment(np.array(cost))
                spots = [centres[same[c]] for c in columns]
                for k, spot in zip(same, spots, strict=True):
                    centres[k] = spot
        return centres

    def _gathered(self, bodies, placed):
        frames, names = sorted(placed), tuple(body.name for body in bodies)
        rows = [placed[frame] for frame in frames]
        reasons = tuple(
            (frame, name, fit.reason) for frame, row in zip(frames, rows, strict=True)
            for name, fit in zip(names, row, strict=True) if fit.reason
        )  # fmt: skip

        def table(attribute):
            return np.array([[getattr(fit, attribute) for fit in row] for row in rows])

        # One frame says little about the clustering of pixel errors, the whole track much.
        known = table("reason") == ""
        wider = np.array([
            max(c[k].mean(), 0.2) if k.any() else 1.0
            for c, k in zip(table("clustering").T, known.T, strict=True)
        ])  # fmt: skip
        return Track(
            names, np.array(frames, dtype=int), self.video.fps, table("position"),
            table("covariance") * wider[:, None, None], table("rms"), table("seen"), reasons,
            {b.name: f"disc, colour {b.kind_name}" for b in bodies},
            {b.name: self.kinds[b.kind_name].reach for b in bodies}, lossy=self.video.is_lossy,
        )  # fmt: skip
