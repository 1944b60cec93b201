"""Figures of posteriors: traces, corners, and predicted tracks with bands."""

import numpy as np

MOST_NAMES = 12
"""Names beyond this number are left out of a figure, the least determined ones first kept."""


def _pyplot():
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    return plt


def trace_figure(posterior, path, most=MOST_NAMES):
    """Chains of every name beside their histogram with the prior.

    Parameters
    ----------
    posterior : Posterior
        With its chain (``EStep(keep_chain=True)``), otherwise only histograms are drawn.
    """
    plt = _pyplot()
    shown = min(len(posterior.names), most)
    fig, axes = plt.subplots(
        shown, 2, figsize=(8, 1.2 + 1.1 * shown), squeeze=False, constrained_layout=True,
        gridspec_kw={"width_ratios": [3, 1]},
    )  # fmt: skip
    for k in range(shown):
        left, right = axes[k]
        if posterior.chain is not None:
            left.plot(posterior.chain[:, :, k], lw=0.3, color="C0", alpha=0.35)
        else:
            left.plot(posterior.draws[:, k], ".", ms=1, color="C0")
        left.set_ylabel(posterior.names[k], fontsize=8)
        right.hist(
            posterior.draws[:, k], weights=posterior.weights, bins=40, density=True,
            orientation="horizontal", color="C0",
        )  # fmt: skip
        right.sharey(left)
        right.tick_params(labelleft=False)
        _add_prior(right, posterior.priors[k])
        if np.isfinite(posterior.truth[k]):
            for ax in (left, right):
                ax.axhline(posterior.truth[k], color="k", lw=0.8)
        if k < shown - 1:
            left.tick_params(labelbottom=False)
    axes[-1, 0].set_xlabel("step" if posterior.chain is not None else "draw")
    axes[-1, 1].set_xlabel("density")
    fig.align_ylabels(axes[:, 0])
    _add_key(fig, posterior, prior=True)
    fig.savefig(path, dpi=130)
    plt.close(fig)


def _add_prior(ax, prior):
    """The prior's density beside a lying histogram, over the range that is shown."""
    if prior is None or prior.is_discrete:
        return
    low, high = ax.get_ylim()
    y = np.linspace(low, high, 400)
    with np.errstate(divide="ignore"):
        density = np.exp(prior.log_prob(y))
    ax.plot(density, y, color="C1", lw=1)
    ax.set_ylim(low, high)


def _add_key(fig, posterior, prior=False):
    """What the lines are, above the panels."""
    from matplotlib.lines import Line2D

    lines = []
    if np.isfinite(posterior.truth).any():
        lines.append(Line2D([], [], color="k", lw=0.8, label="recorded value"))
    if prior and any(p is not None and not p.is_discrete for p in posterior.priors):
        lines.append(Line2D([], [], color="C1", lw=1, label="prior"))
    if lines:
        fig.legend(handles=lines, loc="outside upper right", ncols=2, fontsize=8, frameon=False)


def corner_figure(posterior, path, most=6):
    """All pairs of (at most `most`) names, the least determined ones first."""
    plt = _pyplot()
    index = _widest(posterior, most)
    n = len(index)
    fig, axes = plt.subplots(
        n, n, figsize=(1.2 + 1.5 * n, 1.2 + 1.5 * n), squeeze=False, constrained_layout=True
    )
    draws, weights, truth = posterior.draws[:, index], posterior.weights, posterior.truth[index]
    names = [posterior.names[k] for k in index]
    spans = [_span(d, t) for d, t in zip(draws.T, truth, strict=True)]
    for row in range(n):
        for column in range(n):
            ax = axes[row, column]
            if column > row:
                ax.axis("off")
                continue
            if column == row:
                ax.hist(draws[:, row], bins=30, weights=weights, color="C0")
                ax.set_yticks([])
            else:
                ax.hist2d(
                    draws[:, column], draws[:, row], bins=40, weights=weights, cmap="Blues",
                    cmin=weights[weights > 0].min() / 2,
                )  # fmt: skip
                ax.set_ylim(spans[row])
                if np.isfinite(truth[row]):
                    ax.axhline(truth[row], color="k", lw=0.7)
            if np.isfinite(truth[column]):
                ax.axvline(truth[column], color="k", lw=0.7)
            ax.set_xlim(spans[column])
            ax.tick_params(labelsize=7)
            if row == n - 1:
                ax.set_xlabel(names[column], fontsize=8)
            else:
                ax.tick_params(labelbottom=False)
            if column == 0 and row > 0:
                ax.set_ylabel(names[row], fontsize=8)
            elif column > 0:
                ax.tick_params(labelleft=False)
    fig.align_labels()
    _add_key(fig, posterior)
    fig.savefig(path, dpi=130)
    plt.close(fig)


def _span(draws, truth):
    """Limits of an axis: all draws and the recorded value, with a margin."""
    values = np.append(draws, truth) if np.isfinite(truth) else draws
    low, high = values.min(), values.max()
    margin = 0.04 * (high - low) or 0.5
    return low - margin, high + margin


def _widest(posterior, most):
    """Indices of the names least determined beside their priors, in their order."""
    if len(posterior.names) <= most:
        return list(range(len(posterior.names)))
    width = [
        posterior.sd[k] / (p.spread if p is not None else np.abs(posterior.mean[k]) or 1.0)
        for k, p in enumerate(posterior.priors)
    ]
    return sorted(np.argsort(width)[::-1][:most].tolist())


def rollout_figure(bands, path):
    """Observed tracks over the predicted ones with their bands, one panel an axis."""
    plt = _pyplot()
    n_dims = bands.median.shape[-1]
    fig, axes = plt.subplots(
        n_dims, 1, figsize=(7, 1 + 2 * n_dims), sharex=True, squeeze=False, constrained_layout=True
    )
    for axis in range(n_dims):
        ax = axes[axis, 0]
        for r, name in enumerate(bands.names):
            color = f"C{r % 10}"
            ax.fill_between(
                bands.times, bands.low[:, r, axis], bands.high[:, r, axis], color=color,
                alpha=0.25, lw=0,
            )  # fmt: skip
            ax.plot(bands.times, bands.median[:, r, axis], color=color, lw=1, label=name)
            ax.plot(bands.times, bands.observed[:, r, axis], ".", color=color, ms=3)
        ax.set_ylabel("xyz"[axis] + ", m")
    handles, labels = axes[0, 0].get_legend_handles_labels()
    fig.legend(
        handles, labels, loc="outside upper center", fontsize=8, title_fontsize=8, ncols=8,
        title=f"scene {bands.scene}: dots measured, lines median, bands 90 %", frameon=False,
    )  # fmt: skip
    axes[-1, 0].set_xlabel("t, s")
    fig.savefig(path, dpi=130)
    plt.close(fig)
