"""Arrays of MATLAB's .mat and NumPy's .npz files as plain tables: every vector is a column."""

import csv
import io

import numpy as np

from bsp_gp.errors import DataError

ENDINGS = (".mat", ".npz")
_AXES = ("x", "y", "z")
_REMEDY = "save vectors of one length: t, x, y (and others), or a table as CSV"
_TIMES = ("time", "t", "tout")


def as_table(path):
    """The longest set of vectors of one length in a file as text with tabs, and notes.

    What is nested has the names of what it is in before it, and what Simulink logs with its time
    is a column of its own name. A matrix of as many rows is a column for each of its own.

    Raises
    ------
    DataError
        If the file cannot be read, or has no two vectors of one length.
    """
    columns = {}
    for name, value in _variables(path).items():
        _put(columns, name, value)
    sizes = {len(v) for v in columns.values()}
    most = max(sizes, key=lambda n: (sum(len(v) == n for v in columns.values()), n), default=0)
    table = {name: v for name, v in columns.items() if len(v) == most}
    if len(table) < 2 or most < 2:
        told = ", ".join(f"{n} ({len(v)})" for n, v in list(columns.items())[:8])
        raise DataError(
            f"no two vectors have one length; there are {told or 'none'}", file=path, remedy=_REMEDY
        )
    table = _with_one_clock(table)
    out = io.StringIO()
    writer = csv.writer(out, delimiter="\t", lineterminator="\n")
    writer.writerow(table)
    writer.writerows(zip(*(v.tolist() for v in table.values()), strict=True))
    others = [f"{n} ({len(v)})" for n, v in columns.items() if len(v) != most]
    note = f"of {path.name} vectors of {most:,} numbers are read, not {', '.join(others[:8])}"
    return out.getvalue(), (note,) if others else ()


def _variables(path):
    from scipy.io.matlab import MatReadError, loadmat  # a tenth of a second at every start

    try:
        if path.suffix.lower() == ".npz":
            with np.load(path, allow_pickle=False) as found:
                return {name: found[name] for name in found.files}
        found = loadmat(path, simplify_cells=True)
    except NotImplementedError:
        raise DataError(
            "a .mat file of version 7.3 is not read", file=path,
            remedy="in MATLAB: save(name, '-v7'), or writetable(...) as CSV",
        ) from None  # fmt: skip
    except (OSError, ValueError, TypeError, MatReadError) as error:
        raise DataError(f"the file cannot be read ({error})", file=path, remedy=_REMEDY) from None
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _put(columns, name, value):
    """Add the vectors of a value to columns, by name."""
    if isinstance(value, dict) and isinstance(value.get("signals"), dict) and "time" in value:
        _put(columns, f"{name}_time", value["time"])  # a structure with time, of Simulink
        _put(columns, name, value["signals"].get("values"))
    elif isinstance(value, dict):
        for key, own in value.items():
            _put(columns, f"{name}_{key}" if name else key, own)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        value = np.squeeze(value)
        if value.ndim == 2 and min(value.shape) <= 12:
            value = value if value.shape[0] >= value.shape[1] else value.T
            is_place = 2 <= value.shape[1] <= len(_AXES)
            for k, own in enumerate(value.T):
                columns[f"{name}_{_AXES[k] if is_place else k + 1}"] = own
        elif value.ndim == 1 and len(value) > 1:
            columns[name] = value


def _with_one_clock(table):
    """Times that are the same are one column `t`; a plain one is it, whatever else there is."""
    clocks = [n for n in table if n.lower() in _TIMES or n.lower().endswith("_time")]
    if not clocks or any(not np.array_equal(table[n], table[clocks[0]]) for n in clocks):
        return table
    return {"t": table[clocks[0]], **{n: v for n, v in table.items() if n not in clocks}}
