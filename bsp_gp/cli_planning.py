"""The work of ``bsp-gp plan`` and ``bsp-gp discover``."""

import json
from pathlib import Path

from bsp_gp.errors import SettingsError

_MARKED = "discovery.json"


def planned(args):
    """The plan that a report asks for, its means, and its text."""
    from bsp_gp.loop.stored import load_report
    from bsp_gp.planning.means import load_means
    from bsp_gp.planning.plan import next_experiment
    from bsp_gp.report.planned import plan_text

    means = load_means(args.means)
    found = next_experiment(load_report(args.report), means, rng=args.seed, about=args.about or "",
                            n_tried=args.tries)  # fmt: skip
    return found, means, plan_text(found)


def discovered(args, progress):
    """The discovery of a program, and its text; its rounds are kept in ``--out``."""
    from bsp_gp.output.place import whole_file
    from bsp_gp.planning.apparatus import Command
    from bsp_gp.planning.discover import discover
    from bsp_gp.planning.means import load_means
    from bsp_gp.report.planned import discovery_text

    means, out = load_means(args.means), Path(args.out)
    if out.exists() and (not out.is_dir() or any(out.iterdir()) and not (out / _MARKED).is_file()):
        raise SettingsError(f"{out} is there and holds no discovery; choose another --out")
    if (out / _MARKED).is_file() and not args.resume:
        raise SettingsError(
            f"{out} holds a discovery; go on from it with --resume, or choose another --out"
        )
    with Command(args.command_line) as run:
        found = discover(
            run, means, args.rounds, rng=args.seed, declared=args.declare or (), out=out,
            grammar=args.grammar, time_limit=args.time_limit, progress=progress,
        )  # fmt: skip
    text = discovery_text(found)
    for name, content in (
        ("law.txt", text), ("result.json", json.dumps(found.to_dict(), indent=1)),
    ):  # fmt: skip
        with whole_file(out / name) as part:
            part.write_text(content + "\n", encoding="utf-8")
    return found, text
