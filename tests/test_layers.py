"""The rules of the house, read from the source: who may import whom, and what nobody may use."""

import ast
import configparser
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = "bsp_gp"

# In the order data flows; a room imports itself and earlier ones only.
ROOMS = (
    "grammars",
    "errors",
    "units",
    "randomness",
    "workers",
    "threads",
    "compiling",
    "output",
    "data",
    "language",
    "physics",
    "fitting",
    "search",
    "inference",
    "loop",
    "planning",
    "vision",
    "simulate",
    "report",
    "demo",
    "sweep",
    "web",
    "cli_options",
    "cli_inputs",
    "cli_machines",
    "cli_make",
    "cli_latents",
    "cli_planning",
    "cli_reports",
    "cli_sweep",
    "cli_completion",
    "cli_progress",
    "cli",
)
# Third-party import -> the only files (or folders, ending in /) that may have it; none: what the
# experiments alone use.
CONFINED = {
    "cv2": ("vision/",),
    "de421": ("data/ephemeris.py",),
    "deap": ("language/primitives.py", "search/genetic.py"),
    "emcee": ("inference/emcee_step.py",),
    "gplearn": (),
    "jax": (),
    "jplephem": ("data/ephemeris.py",),
    "optax": (),
    "pint": ("units.py",),
    "pymunk": ("simulate/",),
    "pyoperon": (),
    "pysindy": (),
    "starlette": ("web/",),
    "uvicorn": ("web/",),
}
IMPORT_NAMES = {"opencv-python-headless": "cv2", "arviz-base": "arviz_base",
                "python-calamine": "python_calamine"}
EVALUATORS = {"eval", "exec"}
PICKLERS = {"pickle", "_pickle", "cPickle", "cloudpickle", "dill", "marshal", "shelve"}
SEEDED = {  # what numpy.random offers without the global state
    "BitGenerator",
    "Generator",
    "MT19937",
    "PCG64",
    "PCG64DXSM",
    "Philox",
    "RandomState",
    "SFC64",
    "SeedSequence",
    "default_rng",
}
# Written in pieces, so that this file does not contain what it looks for.
PLACES = re.compile(
    r"(?<![\w.~-])/(?:wo" r"rk|ro" r"ot|ho" r"me|Us" r"ers|op" r"t)/"
    r"|/tm" r"p/w\b"
    r"|index" r"[-_]url|find" r"-links|trusted" r"-host"
    r"|py" r"pi\.org/simple|python" r"hosted|arti" r"factory"
)  # fmt: skip


def sources(*folders):
    return sorted(p for f in folders for p in (ROOT / f).rglob("*.py"))


def inner(path):
    """Path inside the package, as `data/scene.py`."""
    return path.relative_to(ROOT / PACKAGE).as_posix()


def room_of(where):
    """Room of a path inside the package; None for the two doors, which may import anything."""
    if where in ("__init__.py", "__main__.py"):
        return None
    return where.split("/")[0].removesuffix(".py")


def dotted(node):
    """`a.b.c` of nested attributes of a name, or an empty string."""
    names = []
    while isinstance(node, ast.Attribute):
        names.append(node.attr)
        node = node.value
    return ".".join([node.id, *reversed(names)]) if isinstance(node, ast.Name) else ""


def imports(tree, where):
    """Yield (line, full dotted name) of everything imported, inside functions too."""
    package = [PACKAGE, *where.split("/")[:-1]]
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            base = [*base, *(node.module or "").split(".")] if node.module else base
            yield from ((node.lineno, ".".join([*base, a.name])) for a in node.names)
        elif isinstance(node, ast.Call) and dotted(node.func).split(".")[-1] in (
            "import_module",
            "__import__",
        ):
            name = node.args[0] if node.args else None
            if isinstance(name, ast.Constant) and isinstance(name.value, str):
                yield node.lineno, name.value


def layer_faults(text, where):
    """Imports of rooms further down the list than the importing one."""
    room = room_of(where)
    if room is None:
        return []
    if room not in ROOMS:
        return [f"{where}: room {room!r} is not in the list of rooms, add it at its place"]
    faults = []
    for line, name in imports(ast.parse(text), where):
        parts = name.split(".")
        if parts[0] != PACKAGE:
            continue
        if len(parts) == 1 or parts[1].startswith("__"):
            continue
        if parts[1] not in ROOMS:
            if room != "cli":
                faults.append(f"{where}:{line}: imports {name}; name the room it comes from")
        elif ROOMS.index(parts[1]) > ROOMS.index(room):
            faults.append(f"{where}:{line}: {room} imports {name}, which is below it")
    return faults


def confinement_faults(text, where):
    """Libraries imported outside of the room that owns them."""
    faults = []
    for line, name in imports(ast.parse(text), where):
        library = name.split(".")[0]
        homes = CONFINED.get(library)
        if homes is None:
            continue
        if not any(where == h or (h[-1] == "/" and where.startswith(h)) for h in homes):
            allowed = ", ".join(homes) or "experiments"
            faults.append(f"{where}:{line}: imports {library}; only {allowed} may")
    return faults


def danger_faults(text, where):
    """Evaluated text, pickles, global or unseeded random numbers."""
    tree = ast.parse(text)
    imported = list(imports(tree, where))
    has_random = any(name == "random" for _, name in imported)
    faults = [
        f"{where}:{line}: imports {name}"
        for line, name in imported
        if name.split(".")[0] in PICKLERS
        or (name.startswith("numpy.random.") and name.split(".")[2] not in SEEDED)
        or (name.startswith("random.") and name != "random.Random")
    ]
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            name = dotted(node).split(".")
            if name[:2] in (["np", "random"], ["numpy", "random"]):
                if len(name) == 3 and name[2] not in SEEDED:
                    faults.append(f"{where}:{node.lineno}: {'.'.join(name)} reads the global rng")
            elif has_random and name[0] == "random" and name[1:] != ["Random"]:
                faults.append(f"{where}:{node.lineno}: {'.'.join(name)} reads the global rng")
            if node.attr in ("read_pickle", "to_pickle"):
                faults.append(f"{where}:{node.lineno}: {node.attr}")
        elif isinstance(node, ast.Call):
            name = dotted(node.func)
            if name.removeprefix("builtins.") in EVALUATORS:
                faults.append(f"{where}:{node.lineno}: {name}(")
            if name.split(".")[-1] in ("default_rng", "SeedSequence", "RandomState"):
                if not node.args and not node.keywords:
                    faults.append(f"{where}:{node.lineno}: {name}() without a seed")
            for keyword in node.keywords:
                refused = isinstance(keyword.value, ast.Constant) and keyword.value.value is False
                if keyword.arg == "allow_pickle" and not refused:
                    faults.append(f"{where}:{node.lineno}: allow_pickle")
    return faults


def print_faults(text, where):
    """Calls of print outside of the rooms that speak to people."""
    if room_of(where) in (None, "cli_options", "cli_progress", "cli", "report"):
        return []
    return [
        f"{where}:{node.lineno}: print(; use logging"
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Call) and dotted(node.func) == "print"
    ]


def package_faults(check):
    return [f for p in sources(PACKAGE) for f in check(p.read_text("utf-8"), inner(p))]


def setup_cfg():
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg", encoding="utf-8")
    return config


def words(value):
    return [line.strip() for line in value.splitlines() if line.strip()]


def report(faults):
    assert not faults, "\n" + "\n".join(faults)


def test_imports_point_up_the_list_of_rooms():
    report(package_faults(layer_faults))


def test_a_library_is_imported_in_its_room_only():
    report(package_faults(confinement_faults))


@pytest.mark.slow
def test_nothing_is_evaluated_pickled_or_drawn_from_a_global_rng():
    experiments = [
        f
        for p in sources("experiments")
        for f in danger_faults(p.read_text("utf-8"), p.relative_to(ROOT).as_posix())
    ]
    report(package_faults(danger_faults) + experiments)


def test_only_cli_and_report_print():
    report(package_faults(print_faults))


def test_setup_cfg_lists_the_folders_that_are_packages():
    found = {
        ".".join(p.parent.relative_to(ROOT).parts) for p in (ROOT / PACKAGE).rglob("__init__.py")
    } | {f"{PACKAGE}.grammars"}
    assert (ROOT / "grammars" / "__init__.py").is_file(), "editable installs need it"
    assert sorted(found) == words(setup_cfg()["options"]["packages"])


@pytest.mark.slow
def test_every_imported_library_is_declared():
    config = setup_cfg()
    lines = words(config["options"]["install_requires"])
    for extra in config["options.extras_require"].values():
        lines += words(extra)
    declared = {re.match(r"[\w.-]+", line).group() for line in lines}
    known = {IMPORT_NAMES.get(d, d) for d in declared} | sys.stdlib_module_names | {PACKAGE}
    faults = [
        f"{inner(p)}:{line}: {name.split('.')[0]} is in no list of setup.cfg"
        for p in sources(PACKAGE)
        for line, name in imports(ast.parse(p.read_text("utf-8")), inner(p))
        if name.split(".")[0] not in known
    ]
    report(faults)


def test_no_file_names_a_place_of_the_machine_it_was_written_on():
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    faults = []
    for name in filter(None, listed.stdout.split("\0")):
        path = ROOT / name
        data = path.read_bytes() if path.is_file() else b""
        if b"\0" in data[:4096]:
            continue
        for number, line in enumerate(data.decode("utf-8", "replace").splitlines(), 1):
            if found := PLACES.search(line):
                faults.append(f"{name}:{number}: {found.group()!r}")
    report(faults)


@pytest.mark.parametrize(
    ("check", "where", "text"),
    [
        (layer_faults, "search/genetic.py", "from bsp_gp.loop import close"),
        (layer_faults, "search/genetic.py", "def f():\n    import bsp_gp.report.html"),
        (layer_faults, "data/scene.py", "from ..physics import force"),
        (layer_faults, "data/scene.py", "from bsp_gp import cli"),
        (layer_faults, "data/scene.py", "from bsp_gp import Scene"),
        (layer_faults, "units.py", "importlib.import_module('bsp_gp.data')"),
        (layer_faults, "misc/things.py", ""),
        (confinement_faults, "search/exhaustive.py", "from deap import gp"),
        (confinement_faults, "report/figures.py", "def f():\n    import cv2"),
        (confinement_faults, "vision/film.py", "import pymunk.util"),
        (confinement_faults, "physics/force.py", "import jax.numpy as jnp"),
        (confinement_faults, "search/genetic.py", "def f():\n    from gplearn import genetic"),
        (danger_faults, "cli.py", "eval('1')"),
        (danger_faults, "cli.py", "builtins.exec('1')"),
        (danger_faults, "cli.py", "from pickle import dumps"),
        (danger_faults, "cli.py", "np.load(f, allow_pickle=True)"),
        (danger_faults, "cli.py", "np.random.normal()"),
        (danger_faults, "cli.py", "draw = numpy.random.seed"),
        (danger_faults, "cli.py", "from numpy.random import rand"),
        (danger_faults, "cli.py", "import random\nrandom.random()"),
        (danger_faults, "cli.py", "from random import choice"),
        (danger_faults, "cli.py", "np.random.default_rng()"),
        (print_faults, "loop/close.py", "print('x')"),
    ],
)
def test_a_fault_is_found(check, where, text):
    assert len(check(text, where)) == 1


@pytest.mark.parametrize(
    ("check", "where", "text"),
    [
        (layer_faults, "search/genetic.py", "from bsp_gp.errors import FitError"),
        (layer_faults, "search/genetic.py", "from .objective import loss"),
        (layer_faults, "data/scene.py", "from .. import units"),
        (layer_faults, "language/grammar.py", "import bsp_gp.grammars"),
        (layer_faults, "cli.py", "from bsp_gp import __version__, close_loop"),
        (layer_faults, "__init__.py", "from bsp_gp.loop import close"),
        (confinement_faults, "vision/film.py", "import cv2"),
        (confinement_faults, "search/genetic.py", "from deap import tools"),
        (danger_faults, "cli.py", "df.eval('a')\nre.compile('a')\nast.literal_eval('1')"),
        (danger_faults, "cli.py", "rng = np.random.default_rng(1)\nrng.random()"),
        (danger_faults, "cli.py", "def f(rng: np.random.Generator):\n    return rng.normal()"),
        (danger_faults, "cli.py", "np.load(f, allow_pickle=False)"),
        (print_faults, "report/summary.py", "print('x')"),
    ],
)
def test_what_is_allowed_is_no_fault(check, where, text):
    assert check(text, where) == []


def test_no_place_is_seen_in_ordinary_text():
    for text in ("a frame" "work/x", "https://a.org/wo" "rk/", "pip install bsp_gp", "m/s"):
        assert not PLACES.search(text)
    for text in ("'/wo" "rk/x'", "see /ro" "ot/.cache", "--index" "-url x"):
        assert PLACES.search(text)
