"""Noise of another kind as a cause: what looks like a force may be noise with a memory."""

from dataclasses import replace

import numpy as np

from bsp_gp.fitting.hypothesis import TrackNoise
from bsp_gp.loop.proposal import Family, Proposal
from bsp_gp.loop.questions import MOST_QUICK, least_chance, noise_findings

TIMES, SHARES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0), (0.3, 0.6, 0.9)
"""Correlation times, in median steps, and shares of the variance to begin with."""

TINY = np.finfo(float).tiny


class Noise:
    """Noise of another kind as a proposer: a rival, not a finding of its own.

    Noise that was declared is estimated instead, with whatever parts it has, where the pure error
    contradicts it. Where it is estimated, memory is asked for in every fit, on what is left beside
    forces that know no physics; on few rows, or where it is slow, there is not enough of that. Here
    it stands beside the forces that would do as well.
    """

    name = "noise"
    asks_rows = True

    def propose(self, view):
        """Noise that is estimated, or with a memory."""
        model = view.fit.noise
        if "declared" in model.sources:
            return self.doubted(view)
        is_open = view.dataset.is_of_sight or not model.is_correlation_known
        if not model.is_free.any() or not is_open:
            return Family(self.name)
        plain = replace(model.plain(), is_correlation_known=False)
        shares = (*SHARES, model.correlated) if model.correlated else SHARES
        models = [
            replace(plain, correlated=share, correlation_time=float(time * view.step))
            for time in TIMES for share in shares
        ]  # fmt: skip
        gains = [_gain(view, remembered) for remembered in models]
        best = int(np.argmax(gains))
        if gains[best] <= 0:
            return Family(self.name)
        noise = TrackNoise(models[best], is_given=True, is_all=True)
        proposal = Proposal(
            "noise", "a memory of the noise", view.hypothesis + noise, 0.0, gains[best], 2,
            kind="noise",
        )  # fmt: skip
        return Family(self.name, (proposal,), is_control=True)

    def doubted(self, view):
        """Noise that was declared, estimated where the pure error contradicts it.

        Where a force that knows no physics explains as much, the error beside what is quick has to
        contradict it, too: either may be a memory of the noise.
        """
        chance = least_chance(view.noise_findings)
        if chance <= view.criteria.alpha and view.free_gain > view.criteria.noise_nats:
            chance = least_chance(noise_findings(view, MOST_QUICK))
        if chance > view.criteria.alpha:
            return Family(self.name)
        model = view.fit.noise
        sources = ("estimated" if how == "declared" else how for how in model.sources)
        freed = replace(model, sources=tuple(sources), is_correlation_known=False)
        proposal = Proposal(
            "noise", "noise as the tracks show it", view.hypothesis + TrackNoise(freed), 0.0,
            -2.0 * np.log(max(chance, TINY)), 1, kind="noise",
        )  # fmt: skip
        return Family(self.name, (proposal,), is_control=True)


def _gain(view, model):
    """Twice the gain of the likelihood of the residual, its level as it comes."""
    channels, rows = view.fit.channels, np.nan_to_num(view.fit.residual)
    if not rows.any():
        return 0.0
    heights = []
    for noise in (view.fit.noise, model):
        whitener = noise.whitener(channels)
        size = float(np.square(whitener.whiten(rows)).sum())
        count = int(channels.seen.sum())
        heights.append(-count * np.log(size / count) - whitener.log_det)
    return float(heights[1] - heights[0])
