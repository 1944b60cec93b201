"""What takes up a little of the little that a law leaves, and no more, is no cause of its own.

Of a motion that was really filmed something is always left: bobs leave their plane, cameras look
aslant, springs are no springs. Some force takes up a part of it, the next one of what that leaves.
"""

from dataclasses import replace

import numpy as np

from bsp_gp.data.noise import estimate_noise

LITTLE = 0.05
"""Part of what the declared law leaves of the tracks, up to which it is little that is left."""
TAKEN = 0.5
"""Part of an error that a cause must take away there, unless it leaves noise alone."""
ALONE = 1.5
"""Mean square of what is left, in that of the noise from row to row, up to which it is noise."""
KINDS = ("force", "hidden_body")
MOST_CAUSES = 3
"""Forces that may be missing from what people declare, and kicks of one body in a recording: more
of them add up to a force of another form as terms of a series do."""


def leaves_little(first, found):
    """Whether a fit leaves little of what that of the declared law does."""
    is_told = first.shows_tracks and found.shows_tracks
    return is_told and size_left(found) < LITTLE * size_left(first)


def is_slight(first, done, dataset):
    """Whether a force takes up less than half of the little that is left, and leaves the rest.

    Parameters
    ----------
    first : Fit
        Of what is declared.
    done : Round
        Any but the first.
    dataset : Dataset
    """
    best = done.decision.best
    if not (done.decision.is_adopted and best.kind in KINDS and first.shows_tracks):
        return False
    before, after = size_left(done.entering), size_left(done.fits[best.id])
    if not (before < LITTLE * size_left(first) and after > (1 - TAKEN) * before):
        return False
    return after**2 > ALONE * noise_size(done.entering, dataset) ** 2


def noise_size(found, dataset):
    """Size of the noise from row to row, as `size_left` has what is left."""
    sigma = np.array(estimate_noise(dataset).sigma)
    sigma = sigma[np.isfinite(sigma)]
    return 1.0 if found.noise.adding else float(np.sqrt(np.mean(np.square(sigma))))


def size_left(found):
    """Root mean square of what a fit leaves, m; of sums, of what is left of each that is added."""
    left = found.residual
    if found.noise.adding:  # whose errors are estimated, of each fit its own
        left = found.whitened * np.sqrt(found.noise.parts(found.channels)[0])
    return float(np.sqrt(np.nanmean(np.square(left))))


def is_much_for_little(first, done):
    """Whether a sum of many forces describes the little that is left.

    Enough of them describe anything.
    """
    best = done.decision.best
    if not (done.decision.is_adopted and best.n_terms > MOST_CAUSES and first.shows_tracks):
        return False
    return size_left(done.entering) < LITTLE * size_left(first)


def without_the_slight(first, done, dataset):
    """A round in which nothing slight is adopted, and no sum of many forces for little."""
    if is_much_for_little(first, done):
        reason = "many_causes"
    elif is_slight(first, done, dataset):
        reason = "slight"
    else:
        return done
    decision = replace(done.decision, verdict="seen, not adopted", reason=reason, is_adopted=False)
    return replace(done, decision=decision)
