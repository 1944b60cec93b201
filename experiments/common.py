"""What the experiment scripts share: options, data, tidy results, written whole."""

import argparse
import os
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def options(description, argv=None):
    """``[--quick] [--seed S] [--out DIR] [--workers N]``."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a small version, for a look")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None, help="folder (default: runs/NAME)")
    parser.add_argument("--workers", type=int, default=1)
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
