"""What the experiment scripts share: options, data, tidy results, written whole."""

import argparse
import os
import sys
from pathlib import Path

from bsp_gp.workers import worker_pool

ROOT = Path(__file__).resolve().parents[1]


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
    args.out = args.out or Path("runs") / Path(sys.argv[0]).stem
    return args


def reference_data(*parts):
    """A folder of the reference data: $BSP_GP_DATA, by default ../shared/data."""
    folder = Path(os.environ.get("BSP_GP_DATA", ROOT.parent / "shared" / "data")).joinpath(*parts)
    if not folder.is_dir():
        sys.exit(
            f"no reference data in {folder}; set BSP_GP_DATA (README: where they are to be had)"
        )
    return folder


def write_table(rows, path):
    """Write rows as CSV, whole or not at all."""
    import pandas as pd

    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    pd.DataFrame(rows).to_csv(part, index=False)
    os.replace(part, path)


def write_text(text, path):
    """Write a text, whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    part.write_text(text, encoding="utf-8")
    os.replace(part, path)


def save_figure(figure, path):
    """Write a figure as PNG, whole or not at all, and close it."""
    import matplotlib.pyplot as plt

    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    figure.savefig(part, format="png", dpi=150)
    plt.close(figure)
    os.replace(part, path)


def write_study(text, figure, out, name):
    """Print the summary of a study, and write it and the figure beside the table.

    Parameters
    ----------
    text : str
        Markdown.
    figure : Figure
    out : Path
        The folder of `run_jobs`.
    name : str
        Of the figure.
    """
    print(text)
    write_text(text, out / "summary.md")
    save_figure(figure, out / f"{name}.png")
    print(f"table, figure and summary: {out}")


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
