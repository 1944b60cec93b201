"""Eleven balls dropped from a bridge: the loop trained on one drop of each, tested on the other.

The 12-frame protocol: both directions, ten balls (one drop of the bowling ball is too short), 20
predictions. The form of the missing force is chosen on the training drops alone; the start of a
predicted drop is fitted on its first 12 rows; scored is the height error at row 42.
"""

import numpy as np
from common import options, reference_data, write_table

from bsp_gp.data.tables import load_dataset
from bsp_gp.loop.close import close_loop, declared_law
from bsp_gp.loop.preparing import observe

DECLARED = "9.81 [m/s^2] * m_i * down"
LEFT_OUT = "bowling_ball"


def run(train, test, seed):
    """One direction: rows of the table, and the report."""
    dataset = load_dataset(reference_data("measured", "ball_drops"), train=train, test=test)
    rng = np.random.default_rng(seed)
    report = close_loop(dataset, [DECLARED], rng=rng, seed=seed)
    declared = declared_law(dataset, [DECLARED])
    observation = observe(dataset, declared, rng, sources=False)
    rows = []
    for label, law in (("declared", declared), ("adopted", report.law)):
        _, per_scene = observation.errors(law)
        for row in per_scene:
            if row["endpoints"] and LEFT_OUT not in row["scene"]:
                rows.append(
                    {"scene": row["scene"], "model": label, "endpoint_m": row["endpoints"][0]}
                )
    return rows, report


def main():
    args = options(__doc__.splitlines()[0])
    rows = []
    for train, test in (("*_drop1", "*_drop2"), ("*_drop2", "*_drop1")):
        more, report = run(train, test, args.seed)
        rows += more
        found = [r.effect.name for r in report.rounds if r.adopted]
        print(f"trained on {train}: {report.verdict}: {', '.join(found)}; {report.law_text}")
        signs = [c.value for c in report.constants]
        print(f"    {sum(v > 0 for v in signs)} of {len(signs)} coefficients push forward")
        for rival in report.rounds[0].rivals:
            if rival.kind == "declared_term_change":
                print(f"    rival: {rival.name}: {rival.reason}")
        for note in report.notes:
            if "cannot be told from" in note:
                print(f"    {note}")
    for label in ("declared", "adopted"):
        errors = [row["endpoint_m"] for row in rows if row["model"] == label]
        print(
            f"{label:9s} {len(errors)} predictions: end point median {np.median(errors):.2f} m, "
            f"mean {np.mean(errors):.2f} m"
        )
    write_table(rows, args.out / "results.csv")
    print(f"table: {args.out / 'results.csv'}")


if __name__ == "__main__":
    main()
