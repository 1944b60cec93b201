"""The work of ``bsp-gp make``: made-up data, its truth, its model, pictures and films."""

from bsp_gp.cli_machines import MachineSettings, make_machine, read_machine, undeclared_of
from bsp_gp.errors import SettingsError

_TRUTH, _FILM, _MODEL, _PICTURE = "-truth", "-film", "-model.toml", "-scenes.png"
_CAMERA = "camera.toml"
_NO_MODEL = "none (bsp-gp fit looks from no force at all)"


def read_settings(args):
    """Settings of what is to be made, from the command line.

    Raises
    ------
    SettingsError
        Naming what is not there, or not allowed.
    """
    from bsp_gp.simulate.effects import parse_effect
    from bsp_gp.simulate.machines import MACHINES

    if args.preset in MACHINES:
        return read_machine(args)
    from bsp_gp.simulate.synth import RECORDED, preset, read_numbers

    numbers = {
        "n_scenes": args.scenes, "n_frames": args.frames, "substeps": args.substeps,
        "noise": args.noise, "dt": 1 / args.fps if args.fps else args.dt,
    }  # fmt: skip
    numbers = {name: value for name, value in numbers.items() if value is not None}
    recorded = RECORDED.get(args.preset, {})
    texts = {}
    for name, text in args.set:
        if name in texts or name in numbers:
            raise SettingsError(f"{name} is given twice")
        texts[name] = text
    names = [text.partition("=")[0].strip() for text in args.effect]
    hidden = undeclared_of(args, names)
    effects = [
        parse_effect(text, is_declared=name not in hidden)
        for name, text in zip(names, args.effect, strict=True)
    ]
    plain = preset(args.preset)
    numbers = {**recorded, **numbers, **read_numbers(plain, texts)}
    settings = preset(args.preset, effects, **numbers)
    if args.film > settings.n_scenes:
        raise SettingsError(f"--film {args.film}: there are only {settings.n_scenes} scenes")
    return settings


def claim_places(out, overwrite):
    """Hold the places of the data and of what goes with them, beside; see `claim_group`."""
    from bsp_gp.output.group import claim_group
    from bsp_gp.simulate.truth import KIND

    kinds = {"": "made-up data set", _TRUTH: KIND, _FILM: "folder of films"}
    return claim_group(out, kinds, (_MODEL, _PICTURE), overwrite=overwrite)


def make_data(args, settings, group, progress):
    """Make the data and write all that was asked for.

    Returns
    -------
    list of str
        What to tell the user.
    """
    if isinstance(settings, MachineSettings):
        make_machine(args, settings, group, (_TRUTH, _MODEL, _PICTURE), progress)
        model, notes = group.beside(_MODEL), []
    else:
        _make_worlds(args, settings, group, progress)
        model = group.beside(_MODEL) if settings.declared else _NO_MODEL
        notes = _contacts_note(settings)
    return [
        f"Data set: {group.path}", *([f"Film: {group.beside(_FILM)}"] if args.film else []),
        f"Truth: {group.beside(_TRUTH)}", f"Declared model: {model}",
        f"Picture: {group.beside(_PICTURE)}", *notes,
    ]  # fmt: skip


def _make_worlds(args, settings, group, progress):
    import numpy as np

    from bsp_gp.data.declaration import toml_text
    from bsp_gp.data.folder import fill_dataset
    from bsp_gp.report.drawing import png_bytes
    from bsp_gp.report.scenes import draw_scenes
    from bsp_gp.simulate.synth import make
    from bsp_gp.simulate.truth import fill_truth

    rng = np.random.default_rng(args.seed)
    progress(f"making {settings.n_scenes} scene(s) of {settings.name}")
    dataset, truth = make(settings, rng)
    view = _view(args, truth) if args.film else None  # complains before anything is written
    progress("writing")
    with group.fill() as paths:
        fill_dataset(dataset, paths[""])
        pixels = None
        if args.film:
            (film_rng,) = rng.spawn(1)
            pixels = _films(args, truth, view, paths[_FILM], film_rng, progress)
        fill_truth(truth, paths[_TRUTH], pixels, args.seed)
        if settings.declared:
            model = toml_text({"declare": list(settings.declared)})
            paths[_MODEL].write_text(model, encoding="utf-8")
        progress("drawing")
        paths[_PICTURE].write_bytes(png_bytes(draw_scenes(dataset.scenes)))


def _contacts_note(settings):
    """That bodies hit each other, which no declared model of ours says."""
    if not (settings.contacts.has_contacts and settings.declared):
        return []
    return [
        "Note: bodies that touch hit each other, and the declared model has no contacts; --set "
        "has_contacts=no lets them pass"
    ]


def _view(args, truth):
    """The scenes that are filmed, the camera that sees them, and what it does to them."""
    from bsp_gp.vision.film import Camera, Look

    scenes = [truth.scene(k) for k in range(args.film)]
    look = Look(exposure=args.exposure, blur=args.blur, noise=args.grain, quality=args.quality)
    return scenes, Camera.fitting(scenes, *args.size), look


def _films(args, truth, view, folder, rng, progress):
    """Films of the first scenes in a folder, and where everything is in them."""
    import pandas as pd

    from bsp_gp.vision.film import film_scene, write_film, write_frames

    scenes, camera, look = view
    fps = 1 / truth.settings.dt
    tables = []
    for scene, scene_rng in zip(scenes, rng.spawn(len(scenes)), strict=True):
        progress(f"filming scene {scene.name}")
        frames, places = film_scene(scene, camera, look, rng=scene_rng)
        frames = list(frames)
        write_film(frames, folder / f"scene-{scene.name}.mp4", fps)
        if args.png:
            write_frames(frames, folder / f"scene-{scene.name}")
        tables += [
            pd.DataFrame(
                {"scene": scene.name, "frame": range(len(places)), "t": scene.times,
                 "entity": name, "x_px": places[:, k, 0], "y_px": places[:, k, 1]}
            )
            for k, name in enumerate(scene.names)
        ]  # fmt: skip
    (folder / _CAMERA).write_text(_camera_text(camera, fps), encoding="utf-8")
    return pd.concat(tables, ignore_index=True)


def _camera_text(camera, fps):
    from bsp_gp.data.declaration import toml_text

    return toml_text(
        {
            "width_px": camera.width, "height_px": camera.height,
            "pixels_per_metre": camera.scale, "centre_m": list(camera.centre), "fps": fps,
        }
    )  # fmt: skip
