"""The work of ``bsp-gp make``: made-up data, its truth, its model, pictures and films."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

from bsp_gp.errors import OutputError, SettingsError

__all__ = ["FILES", "SUFFIXES", "make_data", "read_settings"]

FILES = {
    "": ("trajectories.csv", "entities.csv", "dataset.toml"),
    "-truth": ("truth.json", "states.csv", "pixels.csv"),
}
"""What the folders hold, by the ending of their names; only such folders are overwritten."""
SUFFIXES = ("-truth", "-model.toml", "-scenes.png")
_CAMERA = "camera.toml"
_N_DRAWN = 3


def read_settings(args):
    """Settings of what is to be made, from the command line.

    Raises
    ------
    SettingsError
        Naming what is not there, or not allowed.
    """
    from bsp_gp.simulate.effects import parse_effect
    from bsp_gp.simulate.synth import preset, read_numbers

    numbers = {
        "n_scenes": args.scenes, "n_frames": args.frames, "substeps": args.substeps,
        "noise": args.noise, "dt": 1 / args.fps if args.fps else args.dt,
    }  # fmt: skip
    numbers = {name: value for name, value in numbers.items() if value is not None}
    texts = {}
    for name, text in args.set:
        if name in texts or name in numbers:
            raise SettingsError(f"{name} is given twice")
        texts[name] = text
    names = [text.partition("=")[0].strip() for text in args.effect]
    undeclared = args.undeclared
    if undeclared is not None and not names:
        raise SettingsError("--undeclared needs an --effect that the declared model is to lack")
    for name in undeclared or ():
        if name not in names:
            raise SettingsError(f"--undeclared {name}: there is no --effect of that name")
    hidden = set(undeclared or names) if undeclared is not None else set()
    effects = [
        parse_effect(text, is_declared=name not in hidden)
        for name, text in zip(names, args.effect, strict=True)
    ]
    plain = preset(args.preset)
    settings = preset(args.preset, effects, **numbers, **read_numbers(plain, texts))
    if args.film > settings.n_scenes:
        raise SettingsError(f"--film {args.film}: there are only {settings.n_scenes} scenes")
    return settings


def make_data(args, settings, out, progress):
    """Make the data and write all that was asked for.

    Returns
    -------
    list of str
        What to tell the user.
    """
    import numpy as np

    from bsp_gp.data.folder import save_dataset
    from bsp_gp.simulate.synth import make
    from bsp_gp.simulate.truth import save_truth

    _require_films_only(_beside(out, "-film"), args.overwrite)
    rng = np.random.default_rng(args.seed)
    progress(f"making {settings.n_scenes} scene(s) of {settings.name}")
    dataset, truth = make(settings, rng)
    view = _view(args, truth) if args.film else None  # complains before anything is written
    progress("writing")
    pixels = None
    film = _beside(out, "-film")
    if film.exists():  # of older data
        shutil.rmtree(film)
    lines = [f"Data set: {save_dataset(dataset, out, overwrite=args.overwrite)}"]
    if args.film:
        (film_rng,) = rng.spawn(1)
        pixels = _films(args, truth, view, film, film_rng, progress)
        lines.append(f"Film: {film}")
    folder = save_truth(
        truth, _beside(out, "-truth"), overwrite=args.overwrite, pixels=pixels, seed=args.seed
    )
    lines.append(f"Truth: {folder}")
    model = _beside(out, "-model.toml")
    if settings.declared:
        from bsp_gp.data.declaration import toml_text

        _write(model, toml_text({"declare": list(settings.declared)}).encode())
        lines.append(f"Declared model: {model}")
    else:
        model.unlink(missing_ok=True)
        lines.append("Declared model: none")
    progress("drawing")
    from bsp_gp.report.drawing import png_bytes
    from bsp_gp.report.scenes import draw_scenes

    picture = _beside(out, "-scenes.png")
    _write(picture, png_bytes(draw_scenes(dataset.scenes, _N_DRAWN)))
    lines.append(f"Picture: {picture}")
    return lines


def _beside(out, suffix):
    return out.with_name(out.name + suffix)


def _write(path, data):
    """Write a file, whole or not at all."""
    handle, part = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.chmod(part, 0o644)
        os.replace(part, path)
    finally:
        Path(part).unlink(missing_ok=True)


def _view(args, truth):
    """The scenes that are filmed, the camera that sees them, and what it does to them."""
    from bsp_gp.vision.film import Camera, Look

    scenes = [truth.scene(k) for k in range(args.film)]
    look = Look(exposure=args.exposure, blur=args.blur, noise=args.grain, quality=args.quality)
    return scenes, Camera.fitting(scenes, *args.size), look


def _films(args, truth, view, folder, rng, progress):
    """Films of the first scenes in a folder, and where everything is in them."""
    import pandas as pd

    from bsp_gp.data.folder import whole_folder
    from bsp_gp.vision.film import film_scene, write_film, write_frames

    scenes, camera, look = view
    fps = 1 / truth.settings.dt
    tables = []
    with whole_folder(folder) as partial:
        for scene, scene_rng in zip(scenes, rng.spawn(len(scenes)), strict=True):
            progress(f"filming scene {scene.name}")
            frames, places = film_scene(scene, camera, look, rng=scene_rng)
            frames = list(frames)
            write_film(frames, partial / f"scene-{scene.name}.mp4", fps)
            if args.png:
                write_frames(frames, partial / f"scene-{scene.name}")
            tables += [
                pd.DataFrame(
                    {"scene": scene.name, "frame": range(len(places)), "t": scene.times,
                     "entity": name, "x_px": places[:, k, 0], "y_px": places[:, k, 1]}
                )
                for k, name in enumerate(scene.names)
            ]  # fmt: skip
        _write(partial / _CAMERA, _camera_text(camera, fps).encode())
    return pd.concat(tables, ignore_index=True)


def _camera_text(camera, fps):
    from bsp_gp.data.declaration import toml_text

    return toml_text(
        {
            "width_px": camera.width, "height_px": camera.height,
            "pixels_per_metre": camera.scale, "centre_m": list(camera.centre), "fps": fps,
        }
    )  # fmt: skip


def _require_films_only(folder, overwrite):
    if not folder.exists():
        return
    strangers = (
        [
            path.name
            for path in folder.iterdir()
            if path.name != _CAMERA and not path.name.startswith("scene-")
        ]
        if folder.is_dir()
        else [folder.name]
    )
    if strangers:
        raise OutputError(f"{folder}: holds other files ({strangers[0]}), never overwritten")
    if not overwrite:
        raise OutputError(f"{folder}: exists already; pass --overwrite or choose another --out")
