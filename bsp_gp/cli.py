"""The command ``bsp-gp``: parse, call, print. Results go to stdout, the rest to stderr."""

import contextlib
import csv
import os
import sys
from pathlib import Path

from bsp_gp.cli_inputs import (
    excluded_inputs,
    masked_grammar,
    read_constants,
    read_dataset,
    read_fit_settings,
    read_laws,
    read_loop_settings,
    refuse_fit_settings,
    unit_of_length,
)
from bsp_gp.cli_options import build_parser, joined
from bsp_gp.cli_progress import Progress as _Progress
from bsp_gp.cli_reports import run_again, run_record
from bsp_gp.errors import BspError, DataError, FitError, SettingsError, on_command_line
from bsp_gp.workers import hands

CHECKED_LEVELS = 8
"""Levels up to which a grammar is checked: those that the loop searches by default."""
LONGEST = 1000
"""Characters of a complaint; its beginning and its end, the remedy, are kept."""
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


def main(argv=None):
    """Run the command line.

    Parameters
    ----------
    argv : sequence of str, optional
        Without the name of the program; by default those of the process.

    Returns
    -------
    int
        0 done, 1 another answer than before (`rerun`), 2 bad input or usage, 130 interrupted
        (Ctrl-C, or the signal SIGTERM).
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    if "numpy" not in sys.modules:  # one thread: faster at these sizes, and always the same digits
        for name in _THREADS:
            os.environ.setdefault(name, "1")
    with contextlib.suppress(AttributeError, ValueError):
        sys.stdout.reconfigure(errors="replace")
    written = []
    try:
        if any("\0" in word for word in argv):
            raise SettingsError("an argument holds a NUL character; leave it out")
        with on_command_line():
            args = build_parser().parse_args(joined(argv))
        args.argv, args.written = argv, written
        is_quiet = getattr(args, "quiet", False)
        with _ended_like_ctrl_c(), _unwarned(is_quiet), _without_notes(is_quiet):
            with on_command_line(), contextlib.ExitStack() as args.held:
                status = _COMMANDS[args.command](args)
            sys.stdout.flush()
    except SystemExit as stop:  # --help and --version
        return stop.code or 0
    except KeyboardInterrupt:
        _say(
            f"interrupted; the result is in {written[0]}"
            if written
            else "interrupted; nothing was written"
        )
        return 130
    except BrokenPipeError:  # the reader, such as head, has had enough
        with contextlib.suppress(OSError, ValueError, AttributeError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except FitError as error:  # which knows numbers, and not from where they are
        data = getattr(args, "data", None) or ()
        files = ", ".join(map(str, [data] if isinstance(data, str) else data))
        _say(f"error: {files}{': ' * bool(files)}{error}")
        return 2
    except BspError as error:
        _say(f"error: {error}")
        return 2
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        _say(f"error: {where}{error.strerror or error}")
        return 2
    except MemoryError:
        _say("error: not enough memory for this; try fewer scenes or a smaller --max-levels")
        return 2
    except ValueError as error:
        if not _is_of_a_matrix(error):
            raise
        _say(
            f"error: the equations of this problem have no solution in these numbers ({error}); "
            "look for values far off all others in the data, or choose another unit"
        )
        return 2
    return status or 0


def _is_of_a_matrix(error):
    """Whether numpy or scipy gave up on a matrix, such as a decomposition without convergence."""
    numpy = sys.modules.get("numpy")
    return numpy is not None and isinstance(error, numpy.linalg.LinAlgError)


@contextlib.contextmanager
def _unwarned(quiet):
    """Meanwhile no warning is shown, here and in workers; where warnings are errors, they stay."""
    if not quiet:
        yield
        return
    import warnings

    shown, own = warnings.showwarning, os.environ.get("PYTHONWARNINGS")
    warnings.showwarning = lambda *args, **kwargs: None
    os.environ.setdefault("PYTHONWARNINGS", "ignore")
    try:
        yield
    finally:
        warnings.showwarning = shown
        if own is None:
            os.environ.pop("PYTHONWARNINGS", None)


@contextlib.contextmanager
def _without_notes(quiet):
    """Meanwhile no note of the library is shown; those that matter are in the results as well."""
    if not quiet:
        yield
        return
    import logging

    logger, silence = logging.getLogger("bsp_gp"), logging.NullHandler()
    logger.addHandler(silence)  # without any handler, logging writes to stderr
    try:
        yield
    finally:
        logger.removeHandler(silence)


@contextlib.contextmanager
def _ended_like_ctrl_c():
    """Meanwhile SIGTERM, as from `kill`, a batch system or a shutdown, is an interrupt."""
    import signal
    import threading

    def interrupt(number, frame):
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():  # only that one may
        yield
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _say(text):
    """One line on stderr, whatever is in the text."""
    if len(text) > LONGEST:  # it quotes a cell or a rule that is no sentence
        text = f"{text[: LONGEST // 2]} ... {text[-LONGEST // 2 :]}"
    text = "".join(c if c.isprintable() else " " for c in text)
    with contextlib.suppress(BrokenPipeError):
        print(f"bsp-gp: {' '.join(text.split())}", file=sys.stderr, flush=True)


# --- commands -------------------------------------------------------------------------------------


def _check(args):
    if args.out is None:
        args.overwrite = True  # only ever a check of ours is replaced
    out = _target(args, "check", f"{_data_name(args.data)}-check")
    try:
        dataset = read_dataset(args)
    except DataError:
        _tell_columns(args)
        raise
    from bsp_gp.data.torn import without_torn_ends
    from bsp_gp.report.drawing import png_bytes
    from bsp_gp.report.recording import data_figure, data_text

    dataset = without_torn_ends(dataset)  # as `close` and `fit` take it
    text = data_text(dataset)
    files = {"check.txt": f"{text}\n", "picture.png": png_bytes(data_figure(dataset))}
    _write_folder(args, "check", out, files)
    print(text)
    print(f"Picture: {out / 'picture.png'}")


def _tell_columns(args):
    """How the headings of tables are read that are refused, as far as they can be."""
    from bsp_gp.cli_inputs import columns_said
    from bsp_gp.data.folder import TRAJECTORIES
    from bsp_gp.data.glance import columns_of
    from bsp_gp.report.recording import columns_text

    for path in map(Path, args.data):
        table = path / TRAJECTORIES if path.is_dir() else path
        if table.suffix.lower() in (".trk", ".trz", ".parquet", ".pq"):
            continue
        with contextlib.suppress(BspError, OSError, csv.Error, UnicodeError):
            print(columns_text(path.name, columns_of(table, columns_said(args))))


def _close(args):
    args.target = out = _target(args, "report", f"{_data_name(args.data)}-report")
    with _Progress(args.quiet) as progress:
        report, settings = _run_loop(args, progress)
        from bsp_gp.report.folder import write_report

        progress("writing the report")
        run_info = {"argv": ["bsp-gp", *args.argv], **run_record(out), "settings": settings}
        args.written.append(write_report(report, out, overwrite=args.overwrite, run_info=run_info))
        if report.complete:
            args.kept.clear()
    declared = [term.formula for term in report.law.terms if term.is_declared]
    _tell_constants(args, dict.fromkeys(name for law in declared for name in law.constants))
    _finish(args, report, out)


def _run_loop(args, progress):
    """The report of the loop, and the settings that it ran with."""
    import numpy as np

    from bsp_gp.fitting.hypothesis import read_law
    from bsp_gp.language.grammar import load_grammar
    from bsp_gp.loop.close import close_loop
    from bsp_gp.loop.kept import joined_texts, text_of
    from bsp_gp.loop.writing_up import dataset_digest
    from bsp_gp.output.kept import Kept

    grammar = load_grammar(args.grammar)
    laws = read_laws(args)
    dataset = read_dataset(args)
    if args.latent or args.prior or dataset.latents:
        from bsp_gp.cli_latents import with_declared_latents

        dataset = with_declared_latents(args, dataset)
    settings = read_loop_settings(args)
    settings["exclude"] = excluded_inputs(args, grammar, dataset)
    law = laws if dataset.latents else read_law(dataset, laws)
    if not dataset.latents:
        if law.names:  # a slip shows before the work
            progress(f"constants to fit: {', '.join(law.names)}")
        _tell_masses(args, dataset, law)
    rounds = []
    args.kept = Kept(args.target, {
        "data": dataset_digest(dataset), "declared": laws, "grammar": grammar.fingerprint,
        **{name: value for name, value in settings.items() if name != "time_limit"},
    })  # fmt: skip
    earlier = args.kept.load() if getattr(args, "resume", False) else None

    def keep(done):
        if not done.left_out:
            rounds.append(text_of([done]))
            args.kept.save(joined_texts([earlier, *rounds]))

    with hands(args.workers, args.cluster) as pool:
        try:
            report = close_loop(
                dataset, law, rng=np.random.default_rng(args.seed), grammar=grammar, on_round=keep,
                earlier=earlier, workers=pool, progress=progress, **settings,
            )  # fmt: skip
        except BspError:  # it would end there again
            args.kept.clear()
            raise
    return report, {"grammar": args.grammar, "workers": args.workers, **settings}


def _sweep(args):
    from bsp_gp.cli_sweep import run_sweep

    laws = read_laws(args)
    with _Progress(args.quiet) as progress, hands(args.workers, args.cluster) as workers:
        try:
            text, n_defects = run_sweep(args, laws, workers, progress)
        except KeyboardInterrupt:
            _say(f"what was done is kept in {args.out}; --resume goes on from there")
            raise
    print(f"{text}\nSweep: {os.path.join(args.out, 'index.html')}")
    if n_defects:
        _say(f"error: bsp_gp failed on {n_defects} data sets; {args.out}/summary.csv says how")
    return 1 if n_defects else 0


def _fit(args):
    is_plain = not args.latent and (args.declare or args.model)
    if not is_plain:
        refuse_fit_settings(args, is_loop=not args.latent)
    if args.latent:
        _with_latents(args, "run_learn", "Law and posterior")
        return
    if not is_plain:
        _close(args)
        return
    out = _target(args, "fit")
    laws = read_laws(args)
    dataset = read_dataset(args)
    import json

    from bsp_gp.fitting.hypothesis import read_law
    from bsp_gp.fitting.law_fit import fit_law
    from bsp_gp.loop.told import factors_of, fit_retold

    law = read_law(dataset, laws)
    _tell_masses(args, dataset, law)
    settings = read_fit_settings(args, factors_of(law, dataset.units))
    with _Progress(args.quiet) as progress:
        progress("fitting")
        fit = fit_law(dataset, law, rng=args.seed, **settings)
    _tell_constants(args, law.names)
    text = fit_retold(fit, dataset.units).text()
    data = json.dumps({**fit.to_dict(), "seed": args.seed}, indent=1, ensure_ascii=False)
    if out is not None:
        _write_folder(args, "fit", out, {"fit.json": f"{data}\n", "fit.txt": f"{text}\n"})
    _tell_result(args, text, data, "Fit", out)


def _tell_constants(args, names):
    """Say which names of a typed law were taken as constants and not as inputs."""
    if names and not args.quiet:
        print(f"Constants to fit: {', '.join(names)}", file=sys.stderr, flush=True)


def _tell_masses(args, dataset, law):
    """Say at the start that a law needs masses and none is given."""
    from bsp_gp.physics.force import needs_masses
    from bsp_gp.physics.masses import NO_MASS, has_masses, without_masses

    if not args.quiet and needs_masses(law) and not has_masses(dataset):
        note = without_masses(dataset)
        if note != NO_MASS:
            _say(f"note: {note}")


def _tell_result(args, text, data, what, out):
    """A result as text, or as JSON, and where it is."""
    print(data if args.json else text)
    if out is not None:
        print(f"{what}: {out}", file=sys.stderr if args.json else sys.stdout)


def _infer(args):
    _with_latents(args, "run_infer", "Posterior")


def _with_latents(args, command, what):
    from bsp_gp import cli_latents

    out = _target(args, what.lower())
    laws = read_laws(args)
    dataset = read_dataset(args)
    import json

    with _Progress(args.quiet) as progress:
        text, data, files = getattr(cli_latents, command)(args, dataset, laws, progress)
    if out is not None:
        _write_folder(args, what.lower(), out, files)
    data = json.dumps(data, indent=1, ensure_ascii=False)
    _tell_result(args, text, data, what, out)


def _simulate(args):
    kind = "simulated data set"
    out = _target(args, kind)
    laws = read_laws(args)
    values = read_constants(args.set)
    dataset = read_dataset(args)
    import numpy as np

    from bsp_gp.data.tables import save_dataset
    from bsp_gp.fitting.simulation import simulate_law

    with _Progress(args.quiet) as progress:
        progress("simulating")
        made = simulate_law(
            dataset, laws, constants=values, rng=np.random.default_rng(args.seed),
            noise=[sigma * unit_of_length(dataset) for sigma in args.noise],
            integrator=args.integrator, substeps=args.substeps,
        )  # fmt: skip
        args.written.append(save_dataset(made, out, overwrite=args.overwrite, kind=kind))
    print(f"Data set: {out}")


def _make(args):
    from bsp_gp.cli_make import claim_places, make_data, read_settings

    group = args.held.enter_context(claim_places(args.out, args.overwrite))
    args.held.callback(_tell_kept, group.main)
    settings = read_settings(args)
    with _Progress(args.quiet) as progress:
        lines = make_data(args, settings, group, progress)
    args.written.append(group.path)
    print("\n".join(lines))


def _compare(args):
    files = ("results.csv", "certificate.txt")
    out = _target(args, "comparison")
    laws = read_laws(args)
    dataset = read_dataset(args)
    import numpy as np
    import pandas as pd

    from bsp_gp.data.cells import safe_table
    from bsp_gp.language.grammar import load_grammar
    from bsp_gp.search.comparison import compare_searches

    grammar, missing = masked_grammar(load_grammar(args.grammar), dataset)
    with _Progress(args.quiet) as progress, hands(args.workers, args.cluster) as pool:
        progress("comparing searches")
        rows, certificate, how = compare_searches(
            dataset, laws, grammar, rng=np.random.default_rng(args.seed), kind=args.kind,
            seeds=args.seeds, n_scored=args.laws, exclude=excluded_inputs(args, grammar, dataset),
            searches=args.searches, executor=pool, missing_inputs=missing, method=args.likelihood,
        )  # fmt: skip
    table = pd.DataFrame(rows)
    for row in table.itertuples():
        print(
            f"{row.search:14s} seed {row.seed}: explains {row.share:7.3%}, regret "
            f"{row.regret_nats:8.3g} nats, {row.n_evaluated:>9,} laws, {row.seconds:6.2f} s; "
            f"held-out data left {row.left_test:.4g} m/s^2\n    {row.constants}: {row.law}"
        )
    print(f"Accelerations: {how}")
    print(f"Exhaustive: {certificate.text()}")
    print("".join(f"Note: {note}\n" for note in dataset.notes), end="")
    if out is not None:
        texts = (safe_table(table).to_csv(index=False), f"{certificate.text()}\n")
        _write_folder(args, "comparison", out, dict(zip(files, texts, strict=True)))
        print(f"Table: {out / files[0]}")


def _grammar(args):
    from bsp_gp.language.grammar import grammar_directory, load_grammar

    if args.action == "list":
        for path in sorted(grammar_directory().glob("*.toml")):
            kinds = " and ".join(load_grammar(path.stem).start)
            print(f"{path.stem}: {kinds} laws ({path})")
        return
    grammar, missing = load_grammar(args.name), ()
    kinds = dict(grammar.start)
    if args.data:
        from bsp_gp.data.tables import load_dataset

        dataset = load_dataset(args.data)
        grammar, missing = masked_grammar(grammar, dataset)
        if all(len(scene.entities) == 1 for scene in dataset.scenes):
            kinds.pop("pair", None)
    print(f"grammar {grammar.name}, fingerprint {grammar.fingerprint}")
    if args.action == "show":
        _show_grammar(grammar)
    elif args.action == "check":
        _check_grammar(grammar, kinds)
    else:
        print("levels  " + "  ".join(f"{f'{k} ({s})':>24}" for k, s in kinds.items()))
        for level in range(1, args.levels + 1):
            counts = (_count_text(grammar.count(symbol, level)) for symbol in kinds.values())
            print(f"{level:>6}  " + "  ".join(f"{count:>24}" for count in counts))
    if args.data:
        print(f"not sayable on {args.data} for want of: {', '.join(missing) or 'nothing'}")


def _check_grammar(grammar, kinds):
    """Tell which searches take a grammar, what it counts, and ten of its laws with units."""
    import numpy as np

    from bsp_gp.errors import GrammarError
    from bsp_gp.language.expression import to_formula
    from bsp_gp.language.pcfg import Pcfg
    from bsp_gp.language.render import to_text
    from bsp_gp.physics.force import Term, constant_units
    from bsp_gp.search.choice import SEARCHES, searches_for
    from bsp_gp.search.inner import expanded

    for search in SEARCHES:
        try:
            runs = searches_for(search, grammar, kinds, CHECKED_LEVELS)
            levels = ", ".join(f"{name} to {k} levels" for name, k in runs.items())
            print(f"--search {search}: yes, {levels}")
        except GrammarError as error:
            print(f"--search {search}: no: {error}")
    def show(what, grammar, n, keep=lambda formula: True):
        rng, pcfg = np.random.default_rng(0), Pcfg.uniform(grammar)
        for kind, symbol in kinds.items():
            count = _count_text(grammar.count(symbol, CHECKED_LEVELS))
            print(f"{kind} laws{what}: {count} derivations of at most {CHECKED_LEVELS} levels, "
                  "such as")  # fmt: skip
            if grammar.min_levels[symbol] > CHECKED_LEVELS:
                continue
            drawn = pcfg.sample_many(rng, symbol, CHECKED_LEVELS, 20 * n)
            formulas = dict.fromkeys(to_formula(expression, grammar) for expression in drawn)
            for formula in [f for f in formulas if keep(f)][: n // len(kinds)]:
                term = Term(formula, kind)
                units = [f"{name} [{unit}]" for name, unit in constant_units(term).items()]
                print("; ".join([f"  {to_text(formula)}", *units]))

    show("", grammar, 10)
    if "beyond" in grammar.source:
        more = " with constants inside as well (cross_entropy, genetic, auto)"
        show(more, grammar.beyond, 4, lambda formula: len(formula.constants) > 1)
    forms = [*grammar.inside.get("common", ()), *grammar.inside.get("laws", ())]
    if forms:
        count = sum(len(expanded(text, grammar.inside)) for text in forms)
        print(f"forms with constants inside, scored by every search: {count}, such as {forms[0]}")
        ranges = "; ".join(f"{k}: {v}" for k, v in grammar.inside.get("ranges", {}).items())
        print(f"ranges of constants inside: {ranges}")
    if grammar.shapes is not None:
        one = grammar.source["shapes"]["of"][0]
        count = _count_text(grammar.shapes.count("Shape", CHECKED_LEVELS))
        print(f"shapes, bred where these leave more than noise: {count} functions of at most "
              f"{CHECKED_LEVELS} levels, such as of {one['variable']}")  # fmt: skip


def _show_grammar(grammar):
    for kind, symbol in grammar.start.items():
        print(f"start symbol of {kind} laws: {symbol}")
    width = max(map(len, (*grammar.types, *grammar.inputs)))
    print("inputs:")
    for name, type_ in grammar.inputs.items():
        print(f"  {name:<{width}}  {type_}")
    if grammar.constants:
        print(f"constants: {', '.join(grammar.constants)}")
    for name, meaning in grammar.operators.items():
        print(f"operator {name} means {meaning}")
    print("rules:")
    for name, rules in grammar.rules_of.items():
        print(f"  {name:<{width}}  ({grammar.types[name]})")
        for rule in rules:
            print(f"  {'':<{width}}    {rule.text}")
        if not rules:
            print(f"  {'':<{width}}    (none: not sayable on these data)")


def _count_text(count):
    if count < 10**18:
        return f"{count:,}"
    exponent = (count.bit_length() - 1) * 30103 // 100000  # floor(log10), or one too small
    exponent += count >= 10 ** (exponent + 1)
    return f"{count // 10 ** (exponent - 4) / 10**4:.4f}e{exponent}"


def _track(args):
    from bsp_gp.vision.calibration import Calibration
    from bsp_gp.vision.recording import RECORDING, parse_object, write_recording

    specs = [parse_object(name, text) for name, text in args.object]
    calibration = None
    if args.scale:
        calibration = Calibration.from_scale(args.scale, args.unit)
    elif args.known:
        pixels, world = zip(*(_known_point(*pair) for pair in args.known), strict=True)
        calibration = Calibration.from_points(pixels, world, args.unit)
    first, last = _frame_range(args.frames)
    out = args.out or f"{Path(args.video).stem}-track"
    _target(args, RECORDING, out)
    with _Progress(args.quiet) as progress:
        out, track = write_recording(
            args.video, specs, out, overwrite=args.overwrite, fps=args.fps, calibration=calibration,
            mat_colours=dict(args.mat), first=first, last=last, smooth=args.smooth,
            film=not args.no_film, progress=progress,
        )  # fmt: skip
    args.written.append(out)
    for k, name in enumerate(track.names):
        seen = int((track.rms[:, k] >= 0).sum())
        print(f"{name}: {seen} of {len(track.frames)} frames")
    print(f"Data set: {out / 'data'}\nQuality: {out / 'quality.html'}")


def _known_point(pixels, world):
    try:
        values = [[float(v) for v in side.split(",")] for side in (pixels, world)]
    except ValueError:
        values = []
    if [len(v) for v in values] != [2, 2]:
        raise SettingsError(f"--known must be x,y=X,Y, got {pixels}={world}")
    return values


def _frame_range(text):
    if text is None:
        return 0, None
    first, dots, last = text.partition("..")
    if not (dots and first.isdecimal() and last.isdecimal() and len(text) < 40):
        raise SettingsError(f"--frames must be A..B, got {text[:60]!r}")
    return int(first), int(last)


def _demo(args):
    if args.out is None:
        args.overwrite = True  # only ever a report of ours is replaced
    out = _target(args, "report", "demo-report")
    from bsp_gp.demo import run_demo

    with _Progress(args.quiet) as progress, hands(args.workers, args.cluster) as pool:
        run_info = {"argv": ["bsp-gp", *args.argv], **run_record(out)}
        report, folder = run_demo(
            out, overwrite=args.overwrite, seed=args.seed, workers=pool, progress=progress,
            run_info=run_info,
        )  # fmt: skip
        args.written.append(folder)
    _finish(args, report, out)


def _plan(args):
    import json

    from bsp_gp.cli_planning import planned

    place = _target(args, "plan")
    found, means, text = planned(args)
    told = json.dumps(found.to_dict(), indent=1)
    if place is not None:
        from io import BytesIO

        from bsp_gp.report.planned import draw_plan

        picture = BytesIO()
        draw_plan(found, means, picture)
        files = {"plan.json": told + "\n", "plan.txt": text + "\n", "plan.png": picture.getvalue()}
        _write_folder(args, "plan", place, files)
    print(told if args.json else text)


def _discover(args):
    import json

    from bsp_gp.cli_planning import discovered

    with _Progress(args.quiet) as progress:
        found, text = discovered(args, progress)
    print(json.dumps(found.to_dict(), indent=1) if args.json else text)


def _show(args):
    from bsp_gp.loop.stored import load_report
    from bsp_gp.report.summary import summary_text

    print(summary_text(load_report(args.report), _width()))
    folder = Path(args.report)
    page = (folder if folder.is_dir() else folder.parent).resolve() / "report.html"
    print(f"Report: {page}")
    _open(args, page.as_uri())


def _open(args, address):
    """Show a page in the browser, where somebody sits before it."""
    if not args.no_open and sys.stdout.isatty():
        import webbrowser

        webbrowser.open(address)


def _rerun(args):
    difference, notes = run_again(args.report, args.quiet)
    for note in notes:
        print(f"Note: {note}")
    if difference:
        print(f"Not the same: {difference}")
        return 1
    print("The same, bit for bit.")
    return 0


def _serve(args):
    import tempfile

    from bsp_gp.web.app import serve

    def tell(address):
        print(f"Page: {address}\nCtrl-C ends it and deletes what was dropped.", flush=True)
        _open(args, address)

    with tempfile.TemporaryDirectory(prefix="bsp-gp-") as folder:
        serve(os.path.realpath(folder), args.port, args.at_once, tell)
    return 0


def _completion(args):
    from bsp_gp.cli_completion import completion_script
    from bsp_gp.simulate.machines import MACHINES
    from bsp_gp.simulate.synth import PRESETS

    names = {"make": (*PRESETS, *MACHINES)}
    print(completion_script(build_parser(), args.shell, names), end="")


def _width():
    """Characters of a line: those of a terminal, up to a hundred, and a hundred elsewhere."""
    import shutil

    return min(shutil.get_terminal_size((100, 24)).columns, 100) if sys.stdout.isatty() else 100


def _finish(args, report, out):
    """A summary, or report.json where asked, and the last line: where the report is."""
    from bsp_gp.report.summary import summary_text

    if args.json:
        print((out / "report.json").read_text(encoding="utf-8"), end="")
    else:
        print(summary_text(report, _width()))
    print(f"Report: {out / 'report.html'}", file=sys.stderr if args.json else sys.stdout)


_COMMANDS = {
    run.__name__[1:]: run
    for run in (
        _check, _close, _sweep, _fit, _infer, _simulate, _make, _compare, _grammar, _track, _plan,
        _discover, _show, _rerun, _serve, _completion, _demo,
    )
}  # fmt: skip


# --- work and output ------------------------------------------------------------------------------


def _data_name(data):
    if len(data) > 1:
        from bsp_gp.data.several import name_of_several

        return name_of_several(data)
    path = Path(data[0])
    real = Path(os.path.realpath(path))  # of a loop of links too
    return path.stem if path.is_file() else real.name or "data"


def _target(args, kind, default=None):
    """The folder of the result, checked before any work and ours until its end; None without."""
    out = args.out or default
    if out is None:
        return None
    from bsp_gp.output.place import claim

    files = [getattr(args, name, None) for name in ("model", "video", "grammar")]
    data = getattr(args, "data", None)
    data = data if isinstance(data, list) else [data]
    inputs = [*data, *(f for f in files if f and os.path.isfile(f))]
    place = args.held.enter_context(
        claim(out, kind, inputs=[path for path in inputs if path], overwrite=args.overwrite)
    )
    args.held.callback(_tell_kept, place)
    return place.path


def _tell_kept(place):
    if place.kept:
        _say(f"{place.path}: kept what is not of bsp-gp or was altered: {', '.join(place.kept)}")


def _write_folder(args, kind, folder, files):
    """Write texts or bytes as the files of a folder, whole or not at all."""
    from bsp_gp.output.place import claim

    with (
        claim(folder, kind, overwrite=args.overwrite) as place,
        place.fill(kind, args.overwrite) as fresh,
    ):
        for name, content in files.items():
            content = content.encode("utf-8") if isinstance(content, str) else content
            (fresh / name).write_bytes(content)
    args.written.append(folder)
