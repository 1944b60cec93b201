"""What the experiment scripts share: options, data, tidy results, written whole."""

import argparse
import atexit
import contextlib
import os
import sys
import time
from pathlib import Path

from bsp_gp.errors import OutputError
from bsp_gp.output.lock import take_lock
from bsp_gp.output.mark import MARK, Mark, read_mark, write_mark
from bsp_gp.output.place import claim, whole_file
from bsp_gp.workers import worker_pool

ROOT = Path(__file__).resolve().parents[1]
_HELD = contextlib.ExitStack()
"""Holds the folder of the study until the process ends, or takes up another one."""
atexit.register(_HELD.close)


def options(description, argv=None, declare=None):
    """``[--quick] [--seed S] [--out DIR] [--workers N]``; `declare(parser)` adds a study's own."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a small version, for a look")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None, help="folder (default: runs/NAME)")
    parser.add_argument("--workers", type=int, default=1)
    if declare is not None:
        declare(parser)
    args = parser.parse_args(argv)
    script = Path(sys.argv[0])
    bench = "bench-" if script.parent.name == "bench" else ""
    args.out = args.out or Path("runs") / f"{bench}{script.stem}"
    _hold(args.out)
    return args


def _hold(out):
    """Keep other processes out of the folder; refuse one that is not of a study, or the data's."""
    _HELD.close()
    try:
        place = _HELD.enter_context(claim(out, "study", inputs=(data_root(),), overwrite=True))
        if not (place.path / MARK).exists():
            with place.fill("study"):  # marked before a file goes into a folder below it
                pass
        for path in (*place.path.rglob(".*.bsp-gp-lock"), *place.path.rglob(".*.bsp-gp-part*")):
            path.unlink()  # of a killed run: nobody else writes here now
    except OutputError as error:
        _end(error)


def _end(error):
    """End the study with one line, as commands end."""
    print(f"{Path(sys.argv[0]).name}: error: {error}", file=sys.stderr)
    sys.exit(2)


@contextlib.contextmanager
def whole(path):
    """Write a file of a study, whole or not at all; one that no study wrote is left alone."""
    try:
        _list(path.resolve())
        path.parent.mkdir(parents=True, exist_ok=True)
        with whole_file(path) as part:
            yield part
    except OutputError as error:
        _end(error)


def _list(path):
    """Put a file on the list of its study's mark, before it is there for the first time."""
    folder = next((p for p in path.parents if (p / MARK).is_file() and _is_study(p)), None)
    if folder is None:
        folder = path.parent
        with claim(folder, "study") as place, place.fill("study"):
            pass  # empty but for its mark
    name = path.relative_to(folder).as_posix()
    if name in read_mark(folder).files:
        return
    with _turn(folder):  # workers have their own files to list
        mark = read_mark(folder)
        if name not in mark.files and path.exists():
            raise OutputError(f"{path}: is not of this study; move it away or choose another --out")
        write_mark(folder, Mark(mark.kind, {**mark.files, name: ""}, mark.beside))


def _is_study(folder):
    mark = read_mark(folder)
    return mark is not None and mark.kind == "study"


@contextlib.contextmanager
def _turn(folder):
    """Wait until no other process of the study changes its mark."""
    for remaining in range(200, -1, -1):
        try:
            lock = take_lock(folder / f"{MARK}-lock", folder)
            break
        except OutputError:
            if not remaining:
                raise
            time.sleep(0.05)
    try:
        yield
    finally:
        lock.release()


def take_share(parser):
    """Declare ``--share``, for studies whose kinds take turns, so that a part has all of them."""
    parser.add_argument(
        "--share", type=fraction, default=1.0, help="of the seeds of each kind (default: all)"
    )


def fraction(text):
    """A share as an option gives it."""
    share = float(text)
    if not 0 < share <= 1:
        raise argparse.ArgumentTypeError(f"must lie above 0 and at most at 1, got {text}")
    return share


def of_share(number, share):
    """A share of a number of sets, one at the least."""
    return max(round(share * number), 1)


def data_root():
    """The folder of all reference data: $BSP_GP_DATA, by default ../shared/data."""
    return Path(os.environ.get("BSP_GP_DATA", ROOT.parent / "shared" / "data"))


def reference_data(*parts):
    """A folder of the reference data."""
    folder = data_root().joinpath(*parts)
    if not folder.is_dir():
        sys.exit(
            f"no reference data in {folder}; set BSP_GP_DATA (README: where they are to be had)"
        )
    return folder


def write_table(rows, path):
    """Write rows as CSV, whole or not at all."""
    import pandas as pd

    with whole(path) as part:
        pd.DataFrame(rows).to_csv(part, index=False)


def write_text(text, path):
    """Write a text, whole or not at all."""
    with whole(path) as part:
        part.write_text(text, encoding="utf-8")


def save_figure(figure, path):
    """Write a figure as PNG, whole or not at all, and close it."""
    import matplotlib.pyplot as plt

    with whole(path) as part:
        figure.savefig(part, format="png", dpi=150)
    plt.close(figure)


def write_study(text, figure, out, name=""):
    """Print the summary of a study, and write it and the figure beside the table.

    Parameters
    ----------
    text : str
        Markdown.
    figure : Figure or None
    out : Path
        The folder of `run_jobs`.
    name : str
        Of the figure.
    """
    print(text)
    write_text(text, out / "summary.md")
    if figure is not None:
        save_figure(figure, out / f"{name}.png")
    print(f"table{', figure' if figure else ''} and summary: {out}")


def run_jobs(jobs, work, out, workers):
    """Do jobs that are not yet in the table, and return the rows of all.

    The table is written after every job, so that an interrupted run is taken up where it was
    left; a table of other jobs (other options) in the folder is refused.

    Parameters
    ----------
    jobs : list of tuple
        Of texts and numbers; what tells a job is its text.
    work : callable
        ``work(*job) -> list of dict``; importable, for other processes.
    out : Path
        Folder; the table is ``results.csv``.
    workers : int

    Returns
    -------
    DataFrame
        With a column "job"; in the order of the jobs.
    """
    import pandas as pd
    from tqdm import tqdm

    path = out / "results.csv"
    names = [" ".join(map(str, job)) for job in jobs]
    rows = {}
    if path.exists():
        known = pd.read_csv(path, dtype={"job": str}, keep_default_na=False, na_values=[""])
        foreign = sorted(set(known["job"]) - set(names))
        if foreign:
            sys.exit(
                f"{path} has rows of other options ({foreign[0]}); give another folder with --out"
            )
        for name, part in known.groupby("job", sort=False):
            rows[name] = part.to_dict("records")
    todo = [(name, job) for name, job in zip(names, jobs, strict=True) if name not in rows]
    bar = tqdm(total=len(jobs), initial=len(jobs) - len(todo), disable=None)
    for name, found in _done(todo, work, workers):
        rows[name] = [{"job": name, **row} for row in found]
        table = pd.DataFrame([row for name in names for row in rows.get(name, [])])
        write_table(table, path)
        bar.update()
    bar.close()
    return pd.read_csv(path, dtype={"job": str}, keep_default_na=False, na_values=[""])


def _done(todo, work, workers):
    if workers == 1:
        for name, job in todo:
            yield name, work(*job)
        return
    from concurrent.futures import as_completed

    with worker_pool(workers) as pool:
        futures = {pool.submit(work, *job): name for name, job in todo}
        for future in as_completed(futures):
            yield futures[future], future.result()
