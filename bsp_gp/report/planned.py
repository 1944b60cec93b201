"""Plans and discoveries for people: a table, and a picture of what rivals foresee."""

import numpy as np


def plan_text(plan):
    """A plan as text: rivals, the best experiments with bits and power, what cannot be parted."""
    lines = ["What may be true:"]
    lines += [f"  {chr(65 + k)}  {r.probability:6.1%}  {r.text}" for k, r in enumerate(plan.rivals)]
    asked = f"the constant {plan.about}" if plan.about else "which of these holds"
    lines += ["", f"Experiments that tell most about {asked} ({plan.n_tried} were looked at):"]
    for number, option in enumerate(plan.options, 1):
        power = "" if np.isnan(option.power) else f", {option.power:.0%} sure afterwards"
        told = experiment_text(option.experiment)
        lines.append(f"  {number}. {option.bits:.2f} bits{power}: {told}")
    if not plan.is_worth_it:
        lines.append("  None of them is expected to tell anything.")
    letters = {r.text: chr(65 + k) for k, r in enumerate(plan.rivals)}
    for one, other in plan.inseparable:
        a, b = sorted((letters[one], letters[other]))
        lines.append(f"Nothing that was tried with these means parts {a} and {b}.")
    return "\n".join(lines)


def experiment_text(experiment):
    """One experiment in a line."""
    parts = []
    for body in experiment.bodies:
        told = f"{body.name} at ({', '.join(f'{x:.3g}' for x in body.position)}) m"
        if not body.is_static:
            told += f" with ({', '.join(f'{x:.3g}' for x in body.velocity)}) m/s"
        told += "".join(f", {name} {value:.3g}" for name, value in body.properties.items())
        parts.append(told)
    count, last = len(experiment.times), experiment.times[-1]
    return f"{'; '.join(parts)}; {count} rows to {last:.3g} s"


def discovery_text(found):
    """A discovery as text."""
    if found.law is None:
        lines = ["No law was found."]
    else:
        state = "It stands." if found.stands else "It does not stand yet."
        lines = [f"F_i = {found.law.text()}", state]
    lines.append(f"{found.rounds} round(s), {len(found.experiments)} experiments.")
    lines += [f"  {r.probability:6.1%}  {r.text}" for r in found.posterior if r.probability > 1e-3]
    words = {
        "no_law": "no law was found", "rivals": "rivals are not told apart",
        "misfit": "the law misses recordings by more than their noise",
        "series": "so many terms act along one direction that they may stand for another form",
        "unforeseen": "the law has not foreseen a round of experiments yet",
        "untried": "the law was not tried at the ends of what can be chosen",
        "missing": "something is missing that was not adopted",
        "inseparable": "some rivals cannot be parted with these means",
    }  # fmt: skip
    lines += [f"Open: {words[code]}." for code in found.open]
    return "\n".join(lines)


def draw_plan(plan, means, path):
    """Draw what the likeliest rivals foresee for the best experiments, beside the noise, a PNG."""
    from matplotlib.figure import Figure

    from bsp_gp.planning.plan import foreseen

    shown, rivals = plan.options[:4], plan.rivals[:5]
    draws = [r.draws(np.random.default_rng(0), 12) for r in rivals]
    seen = foreseen(rivals, draws, [o.experiment for o in shown], means, np.random.default_rng(0))
    figure = Figure(figsize=(3.2 * len(shown), 3.4), layout="constrained")
    for k, (option, (rows, _, sigma)) in enumerate(zip(shown, seen, strict=True)):
        axes = figure.add_subplot(1, len(shown), k + 1)
        times = np.array(option.experiment.times[1:])
        tracks = rows.reshape(*rows.shape[:2], len(times), -1)
        spread = sigma.reshape(len(times), -1)
        axis = int(np.argmax(np.nanmax(np.ptp(tracks[:, 0], axis=0), axis=0)))
        for letter, track in zip("ABCDE", tracks, strict=False):
            axes.errorbar(times, track[0, :, axis], spread[:, axis], marker=".", label=letter)
        axes.set_title(f"{k + 1}: {option.bits:.2f} bits")
        axes.set_xlabel("time / s")
        axes.set_ylabel("coordinate in which they differ most / m" if k == 0 else "")
        axes.legend()
    figure.savefig(path, dpi=110)
