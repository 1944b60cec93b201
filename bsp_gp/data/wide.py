"""Tables with runs or bodies side by side: whose the columns are, and one long table of them."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from bsp_gp.data.headings import LITERAL, UNKNOWN, is_run
from bsp_gp.data.notes import quoted
from bsp_gp.errors import DataError

MOST_LISTED = 8


@dataclass(frozen=True)
class Group:
    """Columns of one run or body.

    Attributes
    ----------
    kind : {"scene", "entity"}
    columns : dict of str to int
        Our name -> position in the table.
    run : str
        Of a body in one of several runs.
    """

    kind: str
    label: str
    columns: dict
    run: str = ""


def groups_of(found, titles=(), *, file=None, line=None, is_track=True):
    """Groups of the columns of a table; () where it is a long one.

    Parameters
    ----------
    titles : sequence of str
        Cells of the line above the header, which may name the groups.
    file, line : optional
        For complaints.
    is_track : bool
        Whether it is a table of positions, in which columns that mean nothing to us may share a
        name.
    """
    owners = dict.fromkeys(h.owner for h in found if h.sure != UNKNOWN and h.owner != ("", ""))
    groups = _owned(found, owners) if owners else _repeated(found, titles)
    if not groups:
        _require_once(found, is_track, file, line)
    labels = [(group.run, group.label) if group.run else group.label for group in groups]
    if len(set(labels)) != len(labels):
        raise DataError(f"two masses have one name: {labels}", file=file)
    return groups


def _require_once(found, is_track, file, line):
    """DataError where a column that counts comes twice."""
    names = [h.name for h in found]
    twice = [h for h in found if h.name and names.count(h.name) > 1
             and not (is_track and h.sure == UNKNOWN)]  # fmt: skip
    if twice and twice[0].run:
        listed = ", ".join(h.theirs for h in found[:MOST_LISTED])
        raise DataError(
            f"of {twice[0].run} no column is a place for sure; the first columns are {listed}",
            file=file, row=line, column="x",
            remedy='say of one run which it is, for all of them: --columns x="..."',
        )  # fmt: skip
    if twice:
        name = twice[0].name
        theirs = dict.fromkeys(h.theirs for h in twice if h.name == name)
        is_told = len(theirs) == names.count(name)
        listed = f" ({', '.join(theirs)})" if is_told else ""
        left = "; leave out all but one: --columns " + " ".join(
            f"{quoted(text)}=ignore" for text in [*theirs][1:])  # fmt: skip
        raise DataError(
            f"the header names {name!r} twice{listed}", file=file, row=line, column=name,
            remedy="every column needs a name of its own" + left * is_told,
        )  # fmt: skip


def _owned(found, owners):
    """Groups whose headings say so; columns without an owner are everyone's."""
    shared = {h.name: k for k, h in enumerate(found) if h.owner == ("", "") and h.sure != UNKNOWN}
    groups = []
    for owner in owners:
        own = {h.name: k for k, h in enumerate(found) if h.owner == owner and h.sure != UNKNOWN}
        if not own.keys() & {"x", "y"}:
            continue
        kind, is_both = "entity" if owner[1] else "scene", all(owner) and is_run(owner[0])
        if is_both:  # the times of the run are those of its bodies
            of_run = (k for k, h in enumerate(found)
                      if h.owner == (owner[0], "") and h.sure != UNKNOWN)  # fmt: skip
            own = {**{found[k].name: k for k in of_run}, **own}
        if kind == "scene" and "t" not in own and len(owners) > 1 and not is_run(owner[0]):
            kind = "entity"  # they share their times
        if kind == "scene":  # what was logged in that run
            logs = [k for k, h in enumerate(found) if h.sure == UNKNOWN and h.run == owner[0]]
            own = {**{found[k].name: k for k in logs}, **own}
        run = owner[0] if is_both else ""
        groups.append(Group(kind, owner[1] or owner[0], {**shared, **own}, run))
    if len(groups) == 1 and groups[0].kind == "scene" and not is_run(groups[0].label):
        return (Group("", "", groups[0].columns),)  # such as "Latest": not worth a name
    return tuple(groups)


def _repeated(found, titles):
    """Groups of columns that come again and again: ``t, x, y, t, x, y``."""
    names = [h.name for h in found]
    clock = "t" if "t" in names else "frame"
    where = {name: [k for k, n in enumerate(names) if n == name] for name in (clock, *"xyz")}
    n_groups = max(len(where["x"]), len(where["y"]))
    if n_groups < 2 or len(where[clock]) not in (1, n_groups) or "entity" in names:
        return ()
    if any(len(where[axis]) not in (0, n_groups) for axis in "xyz"):
        return ()
    axes = [axis for axis in "xyz" if where[axis]]
    own_time = len(where[clock]) == n_groups
    if axes == ["x"] and found[where["x"][0]].sure == LITERAL and not own_time:
        return ()  # t, x, x is a slip
    starts = [min(where[name][k] for name in (axes + [clock] * own_time)) for k in range(n_groups)]
    cells = [cell for cell in titles if cell]
    groups = []
    for k in range(n_groups):
        stop = starts[k + 1] if k + 1 < n_groups else len(names)
        label = next((c for c in titles[starts[k] : stop] if c), None)
        if len(cells) == n_groups:
            label = cells[k]
        label = re.sub(r"^#?\s*", "", label) if label and not is_run(label) else label
        is_scene = is_run(label) if label else own_time and len(axes) == 1
        label = label or f"{'run' if is_scene else 'mass'}_{k + 1}"
        columns = {axis: where[axis][k] for axis in axes}
        columns[clock] = where[clock][k if own_time else 0]
        groups.append(Group("scene" if is_scene else "entity", label, columns))
    return tuple(groups)


def as_recordings(frame, groups):
    """Groups of bodies as recordings, where each has a clock of its own that is not the others'.

    Clocks that are no more than a step apart, and as long, are one.
    """
    clocks = [group.columns.get("t") for group in groups]
    is_each = len({*clocks}) == len(groups) > 1 and None not in clocks
    if not is_each or any(g.kind != "entity" or g.run for g in groups):
        return groups
    first, *others = (frame[k].dropna().to_numpy() for k in clocks)
    if any(v.dtype.kind not in "fiu" for v in (first, *others)):
        return groups
    step = float(np.median(np.diff(first))) if len(first) > 1 else 0.0
    is_one = all(
        len(first) == len(other) and np.abs(first - other).max() <= step for other in others
    )
    return groups if is_one else tuple(replace(group, kind="scene") for group in groups)


def stack(frame, groups, file):
    """One long table from groups side by side; what has no coordinates is absent there.

    The columns of `frame` are called by their positions.
    """
    pieces = []
    for group in groups:
        piece = frame[list(group.columns.values())].set_axis(list(group.columns), axis=1)
        axes = [axis for axis in "xyz" if axis in group.columns]
        piece = piece[~piece[axes].isna().all(axis=1)]
        told = {group.kind: group.label} if group.kind else {}
        pieces.append(piece.assign(**told, **({"scene": group.run} if group.run else {})))
    stacked = pd.concat(pieces)
    if stacked.empty:
        raise DataError("no mass has any coordinates", file=file)
    return stacked
