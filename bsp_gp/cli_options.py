"""What the command line takes: commands, options, checks of single values. Nothing heavy here."""

import argparse
import math
import re

from bsp_gp.errors import SettingsError

MAX_LEVELS, MAX_COUNTED_LEVELS, MAX_ROUNDS, MAX_WORKERS = 20, 16, 100, 256
MAX_SCENES, MAX_SCORED = 100_000, 10**9
MIN_ALPHA = 1e-4
_OPTION = re.compile(r"-h|--|--[a-z][a-z-]*(=.*)?", re.DOTALL)
_TAKES_DASH = ("--declare", "--law", "--up", "--set", "--constrain")
_TIME = re.compile(r"(\d+(?:\.\d*)?|\.\d+)\s*(s|m|min|h)?")
_SECONDS = {"": 1.0, "s": 1.0, "m": 60.0, "min": 60.0, "h": 3600.0}
_LAW_HELP = """\
A law is one force, with v_i, p_j, m_i, norm(...), normalize(...), up, down, e_x, ...:
  --declare "9.81 [m/s^2] * m_i * down" --declare="-c1 * v_i"
A number carries its unit in brackets and is fixed; a name that is no property is fitted."""

_MAKE_HELP = """\
Effects: drag, quadratic_drag, wind, field, perpendicular, magnetic, push, friction, mat, spring,
pair, exponent, hidden, dashpot, inelastic; each NAME=VALUE[,OPTION=VALUE...].
  bsp-gp make nbody --scenes 100 --seed 1 --effect drag=0.1 --undeclared --out orbits
  bsp-gp close orbits --model orbits-model.toml"""


class _Parser(argparse.ArgumentParser):
    """Complaints are one line, as of every other bad input."""

    def __init__(self, *args, **kwargs):
        kwargs.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(*args, allow_abbrev=False, **kwargs)

    def error(self, message):
        if "--declare --model" in message and self.prog.endswith("close"):
            message = (
                'say what is known of the forces, such as --declare "9.81 [m/s^2] * m_i * down" '
                "(--model FILE holds several); where nothing is known, --declare nothing, or "
                "bsp-gp fit DATA, which looks for a law from no force at all"
            )
        if message.startswith("unrecognized") and any(mark in message for mark in "*^("):
            message += '; each law takes a --declare of its own: --declare "LAW" --declare "LAW"'
        if "--object" in message and "required" in message:
            message += ", such as --object ball=disc:red or --object ball=disc:#2060b0"
        raise SettingsError(f"{message}; see {self.prog} --help")


class _Version(argparse.Action):
    def __init__(self, option_strings, dest, **kwargs):
        super().__init__(option_strings, dest, nargs=0, help="show the version and exit")

    def __call__(self, parser, namespace, values, option_string=None):
        from bsp_gp import __version__

        print(f"bsp-gp {__version__}")
        parser.exit()


def joined(argv):
    """Arguments with values that begin with "-" tied to their options: ``--law=-c1 * v_i``.

    argparse would take such a value for an option.
    """
    out, rest = [], list(argv)
    while rest:
        word = rest.pop(0)
        if word == "--":
            return [*out, word, *rest]
        if word in _TAKES_DASH and rest and rest[0][:1] == "-" and not _OPTION.fullmatch(rest[0]):
            word = f"{word}={rest.pop(0)}"
        out.append(word)
    return out


def _integer(low, high):
    def read(text):
        try:
            value = int(text)
        except ValueError:
            value = None
        if value is None or not low <= value <= high:
            raise argparse.ArgumentTypeError(
                f"must be a whole number from {low} to {high}, got {text[:60]!r}"
            )
        return value

    return read


def _number(low, high, ends="()"):
    """Reader of finite numbers of an interval; square brackets include its ends."""

    def read(text):
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        above = value >= low if ends[0] == "[" else value > low
        below = value <= high if ends[1] == "]" else value < high
        if not (above and below and math.isfinite(value)):
            span = (
                f"from {low:g} to {high:g}"
                if high < math.inf
                else ("not negative" if ends[0] == "[" else "positive")
            )
            raise argparse.ArgumentTypeError(f"must be a finite number, {span}, got {text[:60]!r}")
        return value

    return read


_NOT_NEGATIVE = _number(0, math.inf, "[)")


def _pair(text):
    key, equals, value = text.partition("=")
    if not (equals and key.strip() and value.strip()):
        raise argparse.ArgumentTypeError(f"must be NAME=VALUE, got {text[:60]!r}")
    return key.strip(), value.strip()


def build_parser():
    """Build the parser of ``bsp-gp``."""
    parser = _Parser(
        prog="bsp-gp",
        description="Measured motion in; a force law in symbols, with units and error bars, out.",
        epilog="Exit status: 0 done (whatever the verdict), 1 not the same (rerun), 2 bad input or "
        "usage, 130 interrupted (Ctrl-C or SIGTERM).",
    )
    parser.add_argument("--version", action=_Version)
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for add in (
        _add_check, _add_close, _add_sweep, _add_fit, _add_infer, _add_simulate, _add_make,
        _add_compare, _add_grammar, _add_track, _add_plan, _add_discover, _add_reports, _add_serve,
        _add_demo,
    ):  # fmt: skip
        add(commands)
    complete = _add(
        commands, "completion", "print what a shell needs to complete commands and options",
        'bash: eval "$(bsp-gp completion bash)" in ~/.bashrc; zsh the same in ~/.zshrc',
    )  # fmt: skip
    complete.add_argument("shell", choices=("bash", "zsh"))
    return parser


def _add(commands, name, help_, epilog=None):
    return commands.add_parser(name, help=help_, description=f"{help_}.", epilog=epilog)


def _several(group, option, metavar, help_, default=None, type_=_pair):
    """An option with several values, which may come again."""
    group.add_argument(option, action="extend", nargs="+", type=type_, default=default,
                       metavar=metavar, help=help_)  # fmt: skip


def _add_check(commands):
    parser = _add(
        commands, "check", "say what is understood of a data set, with a picture, and run nothing",
        "If a column is taken for the wrong thing, name the right one:\n"
        "  --columns scene=Versuch t=Zeit x='Weg (cm)'",
    )  # fmt: skip
    _data(parser)
    parser.add_argument("--out", metavar="DIR", help="folder of the picture (default: NAME-check)")
    _common(parser)


def _add_close(commands):
    parser = _add(
        commands, "close",
        "find what a declared model lacks, add it, and report the error before and after",
        _LAW_HELP,
    )  # fmt: skip
    _data(parser)
    _declared(parser)
    _rounds(parser)
    _unknowns(parser)
    _output(parser, "folder of the report (default: NAME-report here)")


def _declared(parser):
    """The model that is believed, and what may be missing beside it."""
    help_ = "a force of the declared model; repeat for more"
    _model(parser, "--declare", required=True, help_=help_)
    _descent(parser, "fit of the declared model")
    _loop(parser)


def _add_sweep(commands):
    parser = _add(
        commands, "sweep",
        "close the loop on many data sets: one table and one page; may be stopped and taken up",
        _LAW_HELP,
    )  # fmt: skip
    parser.add_argument(
        "datasets", nargs="+", metavar="DATASETS",
        help="data sets, folders of them, globs, or a table with a column path",
    )  # fmt: skip
    _reading(parser)
    _declared(parser)
    group = parser.add_argument_group("time")
    _time_limit(group, "that each data set may take, after which its row tells what was found")
    group.add_argument(
        "--resume", action="store_true",
        help="go on with the data sets that a stopped sweep has not closed, or that are new",
    )  # fmt: skip
    parser.add_argument(
        "--out", metavar="DIR", default="sweep", help="folder of the table and page (default sweep)"
    )
    _common(parser)


def _add_fit(commands):
    parser = _add(
        commands, "fit",
        "fit the constants of a law; without a law, search one from no force at all",
        _LAW_HELP.replace("--declare", "--law"),
    )  # fmt: skip
    _data(parser)
    _model(parser, "--law", "--declare", help_="a force; repeat for more", required=False)
    _time_limit(_descent(parser, "fit"), "after which it ends with what it has")
    _loop(parser)
    _latents(parser)
    _output(
        parser,
        "folder for fit.json and fit.txt (with a law; default: print only), of the learnt law and "
        "the posterior (with --latent; default: print only), or of the report (default: "
        "NAME-report here)",
    )


def _add_compare(commands):
    parser = _add(
        commands, "compare",
        "search what a model leaves with every search, and compare them with the certified optimum",
        _LAW_HELP,
    )  # fmt: skip
    _data(parser)
    _model(
        parser, "--declare", required=False,
        help_="a force that is there already; repeat for more (default: none)",
    )  # fmt: skip
    group = parser.add_argument_group("search")
    _grammar(group, "what may be said: a name or a .toml file")
    group.add_argument(
        "--kind", choices=("pair", "field"),
        help="forces of bodies on each other, or on each alone (default: the grammar's first that "
        "the data allow)",
    )  # fmt: skip
    group.add_argument(
        "--searches", nargs="+", metavar="NAME",
        help="cross_entropy, genetic, random (default all); the exhaustive one always runs",
    )  # fmt: skip
    group.add_argument(
        "--seeds", type=_integer(1, 1000), default=5, metavar="N", help="runs of each (default 5)"
    )
    group.add_argument(
        "--laws", type=_integer(1, 10**9), default=5_000, metavar="N",
        help="budget of a run, in scored laws (default 5000)",
    )  # fmt: skip
    _inputs(group, "laws")
    group.add_argument(
        "--likelihood", choices=("gls", "weak"),
        help="accelerations from noisy positions: differences with their covariance (the default), "
        "or the weak form, integrated against smooth test functions",
    )  # fmt: skip
    _workers(parser)
    _seed(parser)
    parser.add_argument("--out", metavar="DIR", help="folder for results.csv and certificate.txt")
    _common(parser)


def _add_infer(commands):
    parser = _add(
        commands, "infer",
        "posterior of unknown properties (masses, friction, ...) under a given law",
        _LAW_HELP.replace("--declare", "--law"),
    )  # fmt: skip
    _data(parser)
    _model(
        parser, "--law", "--declare", required=True,
        help_="a force; repeat for more; its named constants are sampled together with the "
        "unknowns",
    )  # fmt: skip
    _latents(parser)
    _seed(parser)
    _output(parser, "folder of the posterior: tables, draws, figures (default: print only)")


def _add_simulate(commands):
    parser = _add(
        commands, "simulate",
        "roll a law out from the initial states of a data set; write the motion as a data set",
        _LAW_HELP.replace("--declare", "--law"),
    )  # fmt: skip
    _data(parser, with_noise=False)
    _model(parser, "--law", "--declare", help_="a force; repeat for more", required=True)
    _several(
        parser, "--set", "NAME=VALUE",
        'values of named constants, SI or with a [unit]: c1=0.2 "c2=3 [g/s]"', [],
    )  # fmt: skip
    parser.add_argument(
        "--noise", nargs="+", type=_NOT_NEGATIVE, default=[0.0], metavar="SIGMA",
        help="noise to add to positions, one or one per axis, in the data's unit of length "
        "(default 0)",
    )  # fmt: skip
    parser.add_argument(
        "--integrator", choices=("euler", "leapfrog", "rk4"),
        help="default: rk4, or euler for laws with contacts",
    )  # fmt: skip
    parser.add_argument("--substeps", type=_integer(1, 1000), help="steps per row (default: many)")
    _seed(parser)
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of the new data set")
    _common(parser)


def _add_make(commands):
    parser = _add(
        commands, "make", "make up scenes with a physics engine: a data set, and its truth apart",
        _MAKE_HELP,
    )  # fmt: skip
    parser.add_argument(
        "preset", metavar="PRESET",
        help="discs: nbody, bounce, mat, magnet, fall, spring, pucks; machines: pendulum, arm, "
        "double_pendulum, driven_cart, turntable, quadrotor_lite; stars and beads: binary, "
        "star_about_unseen, beads",
    )
    _count = _integer(1, MAX_SCENES)
    parser.add_argument("--scenes", type=_count, default=1, metavar="N", help="(default 1)")
    parser.add_argument("--frames", type=_integer(3, 10**6), metavar="T", help="frames a scene")
    _clock(parser, "seconds per frame")
    parser.add_argument(
        "--substeps", type=_integer(1, 10_000), metavar="N", help="steps of the engine per frame"
    )
    _several(
        parser, "--effect", "NAME=VALUE",
        "what is different from the preset: drag=0.1, push=2,period=0.5, ...; repeat for more", [],
        None,
    )  # fmt: skip
    parser.add_argument(
        "--undeclared", nargs="*", metavar="NAME",
        help="effects that the declared model lacks (without names: all)",
    )  # fmt: skip
    _several(
        parser, "--set", "NAME=VALUE",
        "any number of the preset: n_bodies=6 mass=0.1..2 restitution=0.9 memory=0.5 ...", [],
    )  # fmt: skip
    parser.add_argument("--noise", type=_NOT_NEGATIVE, metavar="SIGMA", help="of positions, metres")
    film = parser.add_argument_group("film")
    film.add_argument(
        "--film", nargs="?", type=_integer(1, MAX_SCENES), const=1, default=0, metavar="N",
        help="film the first N scenes (default 1), with where bodies are in the truth",
    )  # fmt: skip
    film.add_argument("--png", action="store_true", help="single frames as PNG files as well")
    film.add_argument("--size", type=_size, default=(640, 480), metavar="WxH", help="pixels")
    film.add_argument(
        "--exposure", type=_number(0, 1, "[]"), default=0.0, metavar="SHARE",
        help="share of the time between frames that the shutter is open (motion blur)",
    )  # fmt: skip
    film.add_argument(
        "--blur", type=_number(0, 1000, "[]"), default=0.0, metavar="PX", help="defocus"
    )
    film.add_argument(
        "--grain", type=_number(0, 255, "[]"), default=0.0, metavar="LEVELS", help="pixel noise"
    )
    film.add_argument(
        "--quality", type=_integer(1, 100), metavar="Q", help="JPEG quality of every frame"
    )
    _seed(parser)
    parser.add_argument(
        "--out", required=True, metavar="DIR",
        help="folder of the data; beside it DIR-truth, DIR-model.toml, DIR-scenes.png, DIR-film",
    )  # fmt: skip
    _common(parser)


def _size(text):
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not match:
        raise argparse.ArgumentTypeError(
            f"must be WIDTHxHEIGHT, such as 640x480, got {text[:60]!r}"
        )
    return int(match[1]), int(match[2])


def _add_grammar(commands):
    parser = _add(commands, "grammar", "show what may be said, and count it")
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    show = _add(actions, "show", "print a grammar: types, inputs, rules")
    show.add_argument("name", metavar="NAME", help="newtonian, physics, ... or a .toml file")
    count = _add(actions, "count", "print the number of derivations, level by level")
    count.add_argument("name", metavar="NAME", help="newtonian, physics, ... or a .toml file")
    count.add_argument(
        "--levels", type=_integer(1, MAX_COUNTED_LEVELS), default=6, metavar="N",
        help="up to this many levels (default 6)",
    )  # fmt: skip
    check = _add(
        actions, "check",
        "check a grammar: which searches take it, how much it says, ten of its laws with units",
    )  # fmt: skip
    check.add_argument("name", metavar="FILE", help="a .toml file, or a name")
    _add(actions, "list", "name the grammars that come with the package")
    for each in (show, count, check):
        each.add_argument("--data", metavar="DATA", help="only what can be said on this data set")


def _add_track(commands):
    parser = _add(
        commands, "track", "track objects in a video: data set, annotated film, quality page",
        "SPEC: disc:COLOUR[:RADIUS] (all discs of a colour), patch:X,Y,W,H@FRAME (an object of one "
        "colour, from a rectangle inside of it), moving:X,Y,W,H@FRAME (the same against the still "
        "background), template:X,Y,W,H@FRAME (a pattern), point:X,Y@FRAME (optical flow). Pixels "
        "from the top left; COLOUR is a name or #rrggbb.",
    )  # fmt: skip
    parser.add_argument("video", metavar="VIDEO")
    parser.add_argument(
        "--object", action="append", required=True, type=_pair, metavar="NAME=SPEC",
        help="what to track; repeat for more",
    )  # fmt: skip
    parser.add_argument(
        "--mat", action="append", type=_pair, default=[], metavar="NAME=COLOUR",
        help="find still rectangles of this colour; repeat for more",
    )  # fmt: skip
    parser.add_argument("--fps", type=_number(0, 1e5, "(]"), help="true frames a second")
    scale = parser.add_mutually_exclusive_group()
    scale.add_argument("--scale", type=_number(0, math.inf), metavar="PX", help="pixels per unit")
    scale.add_argument(
        "--known", action="append", type=_pair, metavar="x,y=X,Y",
        help="a known point, pixels = world; two give scale and axes, four a tilted plane",
    )  # fmt: skip
    parser.add_argument("--unit", default="m", metavar="UNIT", help="of the world (default m)")
    parser.add_argument("--frames", metavar="A..B", help="only these frames, both included")
    parser.add_argument("--smooth", action="store_true", help="Kalman/RTS-smoothed positions")
    parser.add_argument("--no-film", action="store_true", help="leave out the annotated film")
    parser.add_argument("--out", metavar="DIR", help="folder (default: VIDEO's name + -track)")
    _common(parser)


def _add_plan(commands):
    parser = _add(commands, "plan", "tell which experiment would part the rivals of a report")
    parser.add_argument("report", metavar="REPORT", help="folder of the report")
    _means(parser)
    parser.add_argument(
        "--about", metavar="CONSTANT", help="ask about this constant of the law in place of rivals"
    )
    parser.add_argument(
        "--tries", type=_integer(1, 100_000), default=96, metavar="N",
        help="experiments that are looked at (default 96)",
    )  # fmt: skip
    _seed(parser)
    _output(parser, "folder for plan.json and plan.png (default: none)")


def _add_discover(commands):
    parser = _add(
        commands, "discover", "find a law by experiments that a program makes, until one stands"
    )
    _means(parser)
    parser.add_argument(
        "--command", dest="command_line", required=True, metavar="PROGRAM",
        help="reads experiments as lines of JSON, answers what was seen: './apparatus --quick'",
    )  # fmt: skip
    parser.add_argument(
        "--rounds", type=_integer(1, MAX_ROUNDS), default=16, metavar="N", help="(default 16)"
    )
    parser.add_argument(
        "--declare", action="append", metavar="LAW", help="a force that is believed beforehand"
    )
    _grammar(parser, "what laws may say")
    group = parser.add_argument_group("time")
    _time_limit(group, "of every closing of the loop")
    parser.add_argument("--resume", action="store_true", help="go on from the rounds in --out")
    _seed(parser)
    parser.add_argument(
        "--out", default="discovery", metavar="DIR", help="rounds and result (default: discovery)"
    )
    parser.add_argument("--json", action="store_true", help="print the result as JSON to stdout")
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")


def _means(parser):
    parser.add_argument(
        "--means", required=True, metavar="FILE.toml", help="what may be chosen in an experiment"
    )


def _add_reports(commands):
    show = _add(commands, "show", "print the result of an older report, and open its page")
    again = _add(
        commands, "rerun", "run what made a report once more, and say whether it is the same bits"
    )
    for parser in (show, again):
        parser.add_argument("report", metavar="REPORT", help="folder of the report")
        parser.add_argument("--quiet", action="store_true", help="no progress on stderr")
    show.add_argument("--no-open", action="store_true", help="leave the browser alone")


def _add_serve(commands):
    parser = _add(
        commands, "serve",
        "a page on this machine to drop a file on: check, declare, run, read, download",
        "Only this machine can open the page, and only with its whole address, which holds a token;"
        " what was dropped is deleted at the end (Ctrl-C).",
    )  # fmt: skip
    parser.add_argument(
        "--port", type=_integer(0, 65_535), default=0, metavar="N", help="(default: any free one)"
    )
    parser.add_argument(
        "--at-once", type=_integer(1, MAX_WORKERS), default=1, metavar="N",
        help="runs at the same time; further ones wait (default 1)",
    )  # fmt: skip
    parser.add_argument("--no-open", action="store_true", help="leave the browser alone")


def _add_demo(commands):
    parser = _add(commands, "demo", "close the loop on the motion of Mercury (JPL ephemeris)")
    _workers(parser)
    _seed(parser)
    _output(
        parser, "folder of the report (default: demo-report here, replaced if it is an older one)"
    )


def _data(parser, with_noise=True):
    parser.add_argument(
        "data", metavar="DATA", nargs="+",
        help="data set folder, or a lone table; several are recordings of one motion, a scene each",
    )  # fmt: skip
    _reading(parser, with_noise)


def _reading(parser, with_noise=True):
    group = parser.add_argument_group("data (in place of dataset.toml)")
    for option, metavar, help_ in (
        ("units", "KIND=UNIT", "units of the numbers: length=m time=s mass=kg, or with commas"),
        ("columns", "OURS=THEIRS", "names of columns: x=X_cm"),
        ("property", "NAME=VALUE", "what is known of bodies: mass=0.3, mass=305.8[g], "
         "mass=star1:1.2,star2:0.8; without a [unit] in that of --units"),
        ("sky", "WHAT=HOW_FAR", 'how far away it is, so that angles are lengths: '
         'distance="8.2 kpc", parallax="379.2 mas"'),
    ):  # fmt: skip
        _several(group, f"--{option}", metavar, help_)
    group.add_argument(
        "--up", choices=("x", "y", "z", "-x", "-y", "-z"), help="axis that points up"
    )
    _clock(group, "time per frame")
    for side, what in (("train", "scenes to train on"), ("test", "scenes held out")):
        told = f"{what}: names, globs, ranges a..b"
        _several(group, f"--{side}", "SCENES", told, type_=None)
    if with_noise:
        group.add_argument(
            "--noise", nargs="+", type=_NOT_NEGATIVE, metavar="SIGMA",
            help="standard deviation of positions, one or one per axis, in the data's unit of "
            "length; 0 = exact (default: estimated)",
        )  # fmt: skip


def _clock(parser, per_frame):
    clock = parser.add_mutually_exclusive_group()
    clock.add_argument("--fps", type=_number(0, math.inf), metavar="RATE", help="frames a second")
    clock.add_argument("--dt", type=_number(0, math.inf), metavar="T", help=per_frame)


def _model(parser, *names, help_, required):
    """Laws, typed or from a file."""
    model = parser.add_mutually_exclusive_group(required=required)
    model.add_argument(*names, dest="declare", action="append", metavar="LAW", help=help_)
    model.add_argument("--model", metavar="FILE", help='TOML file with declare = ["LAW", ...]')
    parser.add_argument(
        "--constrain", action="append", default=[], metavar="EQUATION",
        help='what bodies keep to: "norm(p_i - (0, 1.2)) = 0.8" (a rod to a point; names in place '
        'of numbers are fitted), "norm(p_bob - p_hand) = L", "norm(p_i - (0, 1.2)) <= L" (a '
        'string), "y_i = 0.3 * x_i" (an incline)',
    )  # fmt: skip


USUAL_LIMIT = "10m"
"""Of a closing of the loop: long recordings of what no law explains may take hours."""


def _time(text):
    if text.strip().lower() == "none":
        return None
    match = _TIME.fullmatch(text.strip())
    seconds = float(match[1]) * _SECONDS[match[2] or ""] if match else 0.0
    if not 0 < seconds < math.inf:
        raise argparse.ArgumentTypeError(
            f"must be a time such as 20s, 2m or 1h, or none, got {text[:60]!r}"
        )
    return seconds


def _descent(parser, title):
    group = parser.add_argument_group(title)
    _several(
        group, "--start", "NAME=VALUE",
        'where constants begin, in the units they are told in or with a [unit]: n=-2 "c1=3 [g/s]" '
        "(default: found from the data)", [],
    )  # fmt: skip
    _several(
        group, "--bounds", "NAME=LOW..HIGH",
        "between which constants stay, in the same units: n=-4..0 c1=0..", [],
    )  # fmt: skip
    return group


def _grammar(group, what):
    group.add_argument("--grammar", default="physics", metavar="NAME",
                       help=f"{what} (default physics)")  # fmt: skip


def _inputs(group, who):
    told = f"inputs that {who} may not use, such as v_i (t is always one)"
    _several(group, "--exclude", "INPUT", told, [], None)
    group.add_argument("--allow-time", action="store_true", help=f"let {who} use t")


def _loop(parser):
    group = parser.add_argument_group("search")
    _grammar(group, "what may be missing: a name or a .toml file")
    group.add_argument(
        "--search", choices=("exhaustive", "cross_entropy", "genetic", "auto"),
        default="exhaustive",
        help="how it is searched (default exhaustive; auto: the others beyond its bound as well)",
    )  # fmt: skip
    group.add_argument(
        "--search-budget", type=_integer(1, MAX_SCORED), default=5_000, metavar="N",
        help="laws of a kind that each of the others may score in a round (default 5000)",
    )  # fmt: skip
    group.add_argument(
        "--max-levels", type=_integer(1, MAX_LEVELS), default=8, metavar="N",
        help="bound of the search, in levels of a derivation (default 8)",
    )  # fmt: skip
    group.add_argument(
        "--max-rounds", type=_integer(1, MAX_ROUNDS), default=5, metavar="N", help="(default 5)"
    )
    group.add_argument(
        "--alpha", type=_number(MIN_ALPHA, 1, "[)"), default=0.01,
        help="level of the tests (default 0.01)",
    )  # fmt: skip
    group.add_argument(
        "--bootstrap", type=_integer(0, 9999), metavar="N",
        help="copies of the held-out data that are simulated for the noise floor and the intervals "
        "of errors; 0 = none (default 40)",
    )  # fmt: skip
    _inputs(group, "the search")
    group.add_argument(
        "--all-rows", action="store_true",
        help="take every row of long tracks as it is (default: dense rows are averaged over short "
        "blocks, and recordings of very many turns followed in stretches)",
    )  # fmt: skip
    _workers(parser)
    _seed(parser)


def _rounds(parser):
    """What concerns rounds that take long."""
    group = parser.add_argument_group("time")
    _time_limit(
        group, "after which the report is written of what was found out till then", USUAL_LIMIT
    )
    group.add_argument(
        "--resume", action="store_true",
        help="go on from the rounds that an interrupted run with the same data and options kept",
    )  # fmt: skip


def _time_limit(group, what, usual="none"):
    group.add_argument(
        "--time-limit", type=_time, default=usual, metavar="TIME",
        help=f"{what}: 20s, 2m, none (default: {usual})",
    )  # fmt: skip


def _unknowns(parser):
    group = parser.add_argument_group("unknown properties")
    _several(
        group, "--latent", "PROPERTY",
        "properties that are unknown, such as mass (default: those of [latent.*])", type_=None,
    )  # fmt: skip
    for option, metavar, help_ in (
        ("prior", "PROPERTY=PRIOR", "mass=uniform:LOW:HIGH, log-uniform:LOW:HIGH, "
         "normal:MEAN:SD[:LOW:HIGH] or values:A,B,C (default: that of [latent.PROPERTY])"),
        ("entities", "PROPERTY=E1,E2",
         "entities whose property is unknown (default: those without a value)"),
        ("share", "PROPERTY=HOW", "entity (default), all, or a column of entities.csv"),
    ):  # fmt: skip
        _several(group, f"--{option}", metavar, help_)


def _latents(parser):
    _unknowns(parser)
    group = parser.add_argument_group("inference")
    group.add_argument(
        "--likelihood", choices=("auto", "one-step", "gls", "propagated", "track", "ahead"),
        default="auto",
        help="auto: whole tracks for posteriors, single steps for searches; ahead: five steps",
    )  # fmt: skip
    group.add_argument(
        "--e-step",
        choices=("auto", "emcee", "importance", "laplace", "tempered", "enumeration"),
        default="auto", help="auto: emcee, and enumeration of discrete unknowns",
    )  # fmt: skip
    for option, low, high, default, help_ in (
        ("n-eff", 10, 10**6, 1000, "effective sample size to stop at (default 1000)"),
        ("max-steps", 100, 10**7, 5_000, "bound of a chain (default 5000)"),
        ("starts", 1, 100, 3, "starts of EM (default 3)"),
    ):
        group.add_argument(
            f"--{option}", type=_integer(low, high), default=default, metavar="N", help=help_
        )


def _workers(parser):
    parser.add_argument(
        "--workers", type=_integer(1, MAX_WORKERS), default=1, metavar="N",
        help="processes; the answer does not depend on it (default 1)",
    )  # fmt: skip
    parser.add_argument(
        "--cluster", metavar="tcp://HOST:PORT",
        help="scheduler of a Dask cluster that works as well (needs the extra [cluster])",
    )  # fmt: skip


def _seed(parser):
    parser.add_argument("--seed", type=_integer(0, 2**63 - 1), default=0, help="(default 0)")


def _output(parser, help_):
    parser.add_argument("--out", metavar="DIR", help=help_)
    parser.add_argument("--json", action="store_true", help="print the result as JSON to stdout")
    _common(parser)


def _common(parser):
    parser.add_argument("--overwrite", action="store_true", help="replace an older result in --out")
    parser.add_argument("--quiet", action="store_true", help="no progress on stderr")
