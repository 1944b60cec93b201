"""The work of ``bsp-gp make`` for machines: a table with its units, its truth, its model."""

import json
from dataclasses import dataclass

from bsp_gp.errors import SettingsError


@dataclass(frozen=True)
class MachineSettings:
    """What is to be made of a machine, see `bsp_gp.simulate.machines.made_machine`."""

    name: str
    options: dict


def read_machine(args):
    """Settings of a machine, from the command line.

    Raises
    ------
    SettingsError
        Naming what is not there, or not allowed.
    """
    from bsp_gp.simulate.effects import read_number

    if args.film or args.substeps:
        raise SettingsError(f"{args.preset} is a table: --film and --substeps are for discs")
    effects = {}
    for text in args.effect:
        name, sign, value = (part.strip() for part in text.partition("="))
        if name in effects:
            raise SettingsError(f"effect {name} is given twice")
        effects[name] = read_number(name, value) if sign else None
    return MachineSettings(args.preset, {
        "n_scenes": args.scenes, "n_frames": args.frames, "noise": args.noise,
        "dt": 1 / args.fps if args.fps else args.dt, "effects": effects,
        "numbers": {name: read_number(name, text) for name, text in args.set},
        "undeclared": undeclared_of(args, effects),
    })  # fmt: skip


def undeclared_of(args, names):
    """Names of the effects that the declared model is to lack, a set; of these there are."""
    if args.undeclared is None:
        return set()
    if not names:
        raise SettingsError("--undeclared needs an --effect that the declared model is to lack")
    for name in args.undeclared:
        if name not in names:
            raise SettingsError(f"--undeclared {name}: there is no --effect of that name")
    return set(args.undeclared or names)


def make_machine(args, settings, group, suffixes, progress):
    """Make the data and write all that was asked for, at the endings of truth, model, picture."""
    import numpy as np
    import pandas as pd

    from bsp_gp.data.declaration import toml_text
    from bsp_gp.data.folder import ENTITIES, TOML, TRAJECTORIES
    from bsp_gp.data.tables import load_dataset
    from bsp_gp.report.drawing import png_bytes
    from bsp_gp.report.scenes import draw_scenes
    from bsp_gp.simulate.machines import made_machine

    progress(f"making {settings.options['n_scenes']} scene(s) of {settings.name}")
    made = made_machine(settings.name, np.random.default_rng(args.seed), **settings.options)
    progress("writing")
    with group.fill() as paths:
        folder = paths[""]
        truth, model, picture = (paths[suffix] for suffix in suffixes)
        made.table.to_csv(folder / TRAJECTORIES, index=False, lineterminator="\n")
        if np.isfinite(made.mass):
            entities = pd.DataFrame({"entity": ["object"], "mass": [made.mass]})
            entities.to_csv(folder / ENTITIES, index=False, lineterminator="\n")
        about = {"name": settings.name, "source": "made up", "units": made.units}
        axes = {"axes": {"up": made.up}} if made.up else {}
        (folder / TOML).write_text(toml_text(about | axes), encoding="utf-8")
        made.truth.to_csv(truth / "states.csv", index=False, lineterminator="\n")
        told = {
            "schema": 1, "name": settings.name, "declared": made.declared, "acting": made.acting,
            "undeclared": sorted(settings.options["undeclared"]), "effects": made.effects,
            "numbers": made.numbers, "seed": args.seed,
        }  # fmt: skip
        (truth / "truth.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
        model.write_text(toml_text({"declare": list(made.declared)}), encoding="utf-8")
        progress("drawing")
        picture.write_bytes(png_bytes(draw_scenes(load_dataset(folder).scenes)))
