"""A fitted law in words: the table for a terminal, how the fit ended, what is doubtful."""

import math

from bsp_gp.data.scene import CHECK
from bsp_gp.fitting.starts import roles_of

MIN_CORRELATION = 0.1
UNKNOWN = "—"
"""In the place of an interval that there is not."""


def fit_text(found):
    """The fit as a table for a terminal; variables stand with their 90 % intervals."""
    e = found.errors
    lines = [
        "[[Model]]", f"    F_i = {found.law_text}",
        "[[Fit Statistics]]",
        f"    data set           = {found.dataset}; {found.split}",
        f"    # data points      = {found.n_rows}",
        f"    # variables        = {len(found.constants)} constants, {found.n_free} free in all",
        f"    chi-square         = {found.chisqr:.6g}",
        f"    reduced chi-square = {found.chi2_red:.6g}",
        f"    Bayesian info crit = {found.bic:.6g}",
        f"    log evidence       = {found.log_evidence:.6g} nats",
        f"    noise              = {_noise(found.noise)}",
        f"    status             = {found.status}: {found.message}",
        "[[Held-out Errors]]", *(_errors(e) or ["    none: nothing was held out"]),
        "[[Variables]] (± half of the 90 % interval)",
        *(list(variables(found.constants)) or ["    none: every number of the law is given"]),
    ]  # fmt: skip
    pairs = found.correlations()
    if pairs:
        lines.append(f"[[Correlations]] (unreported correlations are < {MIN_CORRELATION:g})")
        width = max(len(a) + len(b) for a, b, _ in pairs)
        lines += [
            f"    C({a}, {b}){' ' * (width - len(a) - len(b))} = {value:+.4f}"
            for a, b, value in pairs
        ]
    lines += [f"Note: {note}" for note in found.notes]
    return "\n".join(lines)


def _errors(e):
    """A line for every error that is known: of what a rod holds none of accelerations is."""
    told = {
        "rollout rms       ": (e.rollout_rmse, e.unit),
        "end point (median)": (e.endpoint, e.unit),
        "one-step nrmse    ": (e.one_step_nrmse, e.unit),
        "residual accel.   ": (e.residual_acceleration, e.acceleration_unit),
    }  # fmt: skip
    return [
        f"    {name} = {value:.4g} {unit}"
        for name, (value, unit) in told.items() if not math.isnan(value)
    ]  # fmt: skip


def how_it_ended(found, constants, time_limit=None):
    """The status of a fit in words: what it means and, where it is not good, what to do."""
    if found.status == "nonfinite":
        return (
            "failed, no value of the constants gives finite tracks; give --start and --bounds, or "
            "look for a division by zero or a power of a negative number in the law"
        )
    if found.status == "unconverged":
        cause = "no minimum was reached; give --start or --bounds"
        if found.lost:
            tracks = "; ".join(f"{', '.join(p.bodies)} in scene {p.scene}" for p in found.lost)
            cause = f"no path under the law follows {tracks}; leave that out"
        if found.message == "stopped" and time_limit is not None:
            cause = (
                f"the time limit of {time_limit:g} s came first; give a longer --time-limit, or "
                "--start near the answer"
            )
        return f"failed, {cause}; the values are where it stood"
    if found.status == "aliased":
        return (
            "failed, the motion turns more than once between two rows: slower and faster rates fit "
            "alike; give --bounds of the rate, or record more rows"
        )
    starts = _starts(found)
    if found.status == "at_bound":
        names = ", ".join(label(c) for c in constants if c.state == "at_bound")
        return (
            f"{starts}; {names or 'a constant'} ends at a bound, beyond which the data would have "
            "it: widen --bounds, or take it out of the law"
        )
    if found.status == "refuted":
        return (
            f"{starts}, but more is left than the known errors of the positions: the law lacks "
            "something (bsp-gp close looks for it), or the errors are too small"
        )
    if not constants:
        return "initial states fitted, there is no constant"
    return starts


def _starts(found):
    """How many starts led here."""
    if found.n_starts == 1:
        return "a minimum, from one start"
    return f"a minimum, to which {found.n_agree} of {found.n_starts} starts lead"


def without_prediction(found, rollout_rmse):
    """A note where a fitted law has no track on what is held out; empty where it has."""
    if found.is_failed or not math.isinf(rollout_rmse):
        return []
    roles = roles_of(found.law)
    named = zip(found.parameters, found.values, strict=True)
    unbounded = [(n, v) for (n, _), v in named if roles[n] == "exponent" and v < 0]
    note = f"{CHECK}the law runs away on held-out scenes: it holds for the fitted rows alone"
    for name, value in unbounded:
        note += (
            f"; with {name} = {value:.3g} a force is without bound where the base of its power is "
            f"zero, as that of a speed is at rest: bound it (--bounds {name}=0..4)"
        )
    return [note]


def doubts(found, widening, has_test):
    """Notes on what is doubtful about a fit."""
    notes = []
    if found.is_failed:
        said = "the fit failed ({}): its values say nothing of the law"
        if found.status == "unconverged":
            said = "the fit was not brought to an end ({}): its values are where it stood"
        notes.append(CHECK + said.format(found.status))
    elif widening > 1:
        what = "known errors" if found.status == "refuted" else "noise"
        note = f"{CHECK}{found.chi2_red:.3g} times the variance of the {what} is left"
        if found.parameters:
            note += f"; for that the intervals were widened {widening:.3g} times"
        notes.append(note)
    if not found.is_failed and found.n_starts > 2 and found.n_agree == 1 and found.parameters:
        notes.append(
            f"{CHECK}of {found.n_starts} starts only one leads to this minimum; there may be a "
            "better one"
        )
    if not has_test:
        notes.append("nothing is held out: there are no errors of prediction")
    return notes


def _noise(noise):
    """Level per axis, source, memory and tails."""
    levels = ", ".join(f"{s:.3g}" if math.isfinite(s) else "-" for s in noise["sigma"])
    said = [f"{levels} {noise['unit']} ({noise['source']})"]
    if noise["correlation_time"] is not None:
        said.append(
            f"{100 * noise['correlated']:.3g} % of its variance with a memory of "
            f"{noise['correlation_time']:.3g} s"
        )
    if noise["tails"] is not None:
        said.append(f"tails of Student's t with {noise['tails']:.3g} degrees of freedom")
    return "; ".join(said)


def label(constant):
    """Name of a constant, with the body that it belongs to."""
    if not constant.entity:
        return constant.name
    return f"{constant.name.partition('[')[0]}[{constant.entity}]"


def variables(constants):
    """A line for each constant: its value, and half of its 90 % interval."""
    width = max((len(label(c)) for c in constants), default=0) + 1
    for c in constants:
        head = f"    {label(c) + ':':<{width}}"
        unit = f" {c.unit}" if c.unit not in ("", "1") else ""
        half = (c.high - c.low) / 2
        if c.state == "undetermined":
            at = f" (left at {c.value:.3g}{unit})" if math.isfinite(c.value) else ""
            yield f"{head} undetermined by these data{at}"
        elif c.state == "unfinished":
            yield f"{head} {c.value:.4g}{unit}, where the fit stood when it was ended"
        elif c.state == "at_bound":
            yield f"{head} at its bound, {c.value:.8g}{unit}"
        elif not math.isfinite(half):
            yield f"{head} {c.value:.8g} ± {UNKNOWN}{unit}"
        else:
            value, error = _rounded(c.value, half)
            share = f" ({100 * half / abs(c.value):.2g} %)" if c.value else ""
            yield f"{head} {value} ± {error}{unit}{share}"


def _rounded(value, half):
    """Value and half-width with two digits of the half-width."""
    if not half > 0:
        return f"{value:.8g}", f"{half:.2g}"
    digits = math.floor(math.log10(max(abs(value), half))) - math.floor(math.log10(half)) + 2
    return f"{value:.{min(max(digits, 2), 15)}g}", f"{half:.2g}"


def strong_correlations(constants, correlation):
    """Pairs of constants whose correlation exceeds 0.1, strongest first: (a, b, value)."""
    names = [label(c) for c in constants]
    pairs = [
        (names[a], names[b], float(correlation[a, b]))
        for a in range(len(names))
        for b in range(a + 1, len(names))
        if abs(correlation[a, b]) > MIN_CORRELATION
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))
