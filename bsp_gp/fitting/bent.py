"""Pieces of tracks whose moments are bent: what happens in few must not hide the law of all.

Moments are linear in forces about tracks that were smoothed. Where a body passes close to another
it turns between two rows, the smoothed track is not the body's, and its moments are off by a
thousand errors, whatever the law. A law of all the others is found beside them if every piece may
have errors of a size of its own: then it counts in how many pieces a law leaves little, and not how
much it leaves in the worst.
"""

import numpy as np

LEAST_PIECES = 8
"""Pieces from which some may be told from the others."""
SHOWN, EXPLAINED = 10.0, 10.0
"""Median over pieces of what is left, in that of noise, from which a law is missing in all of them,
and part of it that the usual laws must take."""
BENT, MOST_BENT = 30.0, 0.34
"""What is left of a piece, in the median of all, from which it is bent; part that may be."""
MOST_LAWS, MOST_STEPS = 3, 30
"""Laws that are taken together, and times that pieces are weighed anew."""
SETTLED = 1e-3
"""Nats by which the weights change no more."""
DEARER = 10.0
"""Nats that one more law must bring."""


def steadied(response, columns):
    """The response with the moments of bent pieces scaled down.

    It is as it was unless the usual laws explain most of the pieces, and few are left.

    Parameters
    ----------
    columns : callable
        ``columns()``: moments of the usual laws, (n, c); only asked for where they are needed.
    """
    pieces = _Pieces(response)
    before = np.median(pieces.left(pieces.target)) if len(pieces.sizes) >= LEAST_PIECES else 0.0
    if not before > SHOWN:
        return response
    left = pieces.left(pieces.beside_laws(columns()))
    typical = max(float(np.median(left)), 1.0)
    is_bent = left > BENT * typical
    if not is_bent.any() or is_bent.mean() > MOST_BENT or EXPLAINED * typical > before:
        return response
    scale = np.ones(len(pieces.target))
    scale[pieces.counts] = np.where(is_bent, np.sqrt(typical / left), 1.0)[pieces.number]
    return response.scaled(scale)


class _Pieces:
    """What is to be explained, `target` (n,), by the piece (`number`, of `sizes`) that it is of.

    `taken` (n, k) is what constants of the law that is there take up; `counts` are the moments that
    tell anything.
    """

    def __init__(self, response):
        self.target, self.taken = response.left()
        first, numbers = 0, []
        for batch in response.regression.batches:
            own = np.arange(first, first + batch.kept.shape[1])
            numbers.append(np.broadcast_to(own, batch.kept.shape[:2]).ravel())
            first += len(own)
        self.counts = np.concatenate([b.kept.ravel() for b in response.regression.batches])
        numbers = np.concatenate(numbers)[self.counts]
        _, self.number, self.sizes = np.unique(numbers, return_inverse=True, return_counts=True)

    def left(self, residual):
        """Mean square of what is left of every piece."""
        square = np.square(residual[self.counts])
        return np.bincount(self.number, square, minlength=len(self.sizes)) / self.sizes

    def _height(self, residual):
        """Nats by which errors of a size of its own for every piece speak against a residual."""
        return 0.5 * float(self.sizes @ np.log1p(self.left(residual)))

    def beside_laws(self, columns):
        """What the best of some laws leave, one added after the other."""
        chosen, (found, best) = self.taken, self._beside(self.taken)
        for _ in range(MOST_LAWS if columns.shape[1] else 0):
            trials = [self._beside(np.column_stack([chosen, column])) for column in columns.T]
            k = int(np.argmin([height for _, height in trials]))
            if not trials[k][1] < best - DEARER:
                break
            chosen, (found, best) = np.column_stack([chosen, columns[:, k]]), trials[k]
        return found

    def _beside(self, columns):
        """What columns leave that are fitted to the pieces by weight, and its height."""
        residual, height = self.target, self._height(self.target)
        for _ in range(MOST_STEPS if columns.shape[1] else 0):
            weight = np.zeros(len(residual))
            weight[self.counts] = (1 / np.sqrt(1 + self.left(residual)))[self.number]
            weighed = columns * weight[:, None]
            values = np.linalg.lstsq(weighed, self.target * weight, rcond=None)[0]
            residual, before = self.target - columns @ values, height
            height = self._height(residual)
            if not before - height > SETTLED:
                break
        return residual, height
