"""Arrays of MATLAB's .mat and NumPy's .npz files as plain tables: every vector is a column."""

import numpy as np

from bsp_gp.data.conversion import is_unit
from bsp_gp.data.headings import is_error
from bsp_gp.errors import DataError

ENDINGS = (".mat", ".npz")
_REMEDY = "save vectors of one length: t, x, y (and others), or a table as CSV"
_TIMES = ("time", "t", "tout", "times")
MOST_SIDE_BY_SIDE, MOST_BODIES = 12, 1000
"""Columns of a matrix, and bodies of an array (times, bodies, axes)."""


def as_table(path):
    """The longest set of vectors of one length in a file as rows, the header first, and notes.

    What is nested has the names of what it is in before it, and what Simulink logs with its time
    is a column of its own name. A matrix of as many rows is a column for each of its own, and an
    array (times, bodies, axes) one for each axis of a body.

    Raises
    ------
    DataError
        If the file cannot be read, or has no two vectors of one length.
    """
    table, others = longest(_variables(path), path)
    rows = [[*table], *zip(*(v.tolist() for v in table.values()), strict=True)]
    note = f"of {path.name} vectors of {len(rows) - 1:,} numbers are read, not "
    return rows, (note + ", ".join(others[:8]),) if others else ()


def longest(variables, path):
    """The longest set of vectors of one length, by name, and the names of others with theirs.

    Raises
    ------
    DataError
        If no two vectors have one length.
    """
    columns, labels = {}, _labels(variables)
    for name, value in variables.items():
        _put(columns, name, value, labels)
    sizes = {len(v) for v in columns.values()}
    most = max(sizes, key=lambda n: (sum(len(v) == n for v in columns.values()), n), default=0)
    table = {name: v for name, v in columns.items() if len(v) == most}
    if len(table) < 2 or most < 2:
        told = ", ".join(f"{n} ({len(v)})" for n, v in list(columns.items())[:8])
        raise DataError(
            f"no two vectors have one length; there are {told or 'none'}", file=path, remedy=_REMEDY
        )
    others = [f"{n} ({len(v)})" for n, v in columns.items() if len(v) != most]
    return _with_one_clock(table), others


def _labels(variables):
    """Names of bodies by how many they are: of the lists of texts."""
    lists = (np.atleast_1d(np.squeeze(value)) for value in variables.values()
             if isinstance(value, np.ndarray) and value.dtype.kind in "UO")  # fmt: skip
    return {
        len(texts): [str(text).strip() for text in texts.tolist()] for texts in lists
        if texts.ndim == 1 and all(isinstance(text, str) for text in texts.tolist())
    }  # fmt: skip


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


def _put(columns, name, value, labels):
    """Add the vectors of a value to columns, by name; `labels` are names of so many bodies."""
    if isinstance(value, dict) and isinstance(value.get("signals"), dict) and "time" in value:
        _put(columns, f"{name}_time", value["time"], labels)  # a structure with time, of Simulink
        _put(columns, name, value["signals"].get("values"), labels)
    elif isinstance(value, dict):
        are_tracks = len(value) > 1 and all(np.ndim(own) == 2 for own in value.values())
        for key, own in value.items():
            key = _body(key) if are_tracks else f"{name}_{key}" if name else key
            _put(columns, key, own, labels)
    elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu":
        value = np.squeeze(value)
        if value.ndim == 3:
            _put_bodies(columns, name, value, labels)
        elif value.ndim == 2 and min(value.shape) <= MOST_SIDE_BY_SIDE:
            value = value if value.shape[0] >= value.shape[1] else value.T
            is_place = 2 <= value.shape[1] <= 3
            for k, own in enumerate(value.T):
                columns[f"{name}_{'xyz'[k] if is_place else k + 1}"] = own
        elif value.ndim == 1 and len(value) > 1:
            columns[name] = value


def _put_bodies(columns, name, value, labels):
    """Add the axes of bodies, (times, bodies, axes) or (bodies, times, axes)."""
    value = value if value.shape[0] >= value.shape[1] else np.swapaxes(value, 0, 1)
    _, count, n_axes = value.shape
    if not 2 <= n_axes <= 3 or count > MOST_BODIES:
        return
    names = labels.get(count, [f"body{k + 1}" for k in range(count)])
    for k, body in enumerate(map(_body, names)):
        is_first = f"{body}_x" not in columns and not is_error(name)
        for axis, own in zip("xyz", value[:, k].T, strict=False):
            columns[f"{body}_{axis}" if is_first else f"{body}_{name}_{axis}"] = own


def _body(name):
    """The name of a body, told from a unit: ``A_x`` may be anything."""
    return f"body {name}" if is_unit(name) else name


def _with_one_clock(table):
    """Times that are the same are one column `t`; a plain one is it, whatever else there is."""
    clocks = [n for n in table if n.lower() in _TIMES or n.lower().endswith("_time")]
    if not clocks or any(not np.array_equal(table[n], table[clocks[0]]) for n in clocks):
        return table
    return {"t": table[clocks[0]], **{n: v for n, v in table.items() if n not in clocks}}
