"""Memory that an exhaustive search will take, foreseen before its banks and blocks are built."""

import os

from bsp_gp.errors import ResourceError
from bsp_gp.search.factoring import plan_of

SHARE = 0.75
"""Of the memory that is available, what one search may take."""
ENTRY_BYTES = 4096
"""Of an entry of a bank beside its values: trees, formulas, fingerprints, ties."""
WORK_ARRAYS = 10
"""Arrays of the size of a block at work at a time, beside those of every target."""
_CGROUP = "/sys/fs/cgroup"


def available_bytes():
    """Memory that this process may still take.

    Returns
    -------
    float
        The least of what the system has left, the limits of the process, and those of its group
        (a container, say); infinite where none can be read.
    """
    return min(_left_of_system(), _left_of_process(), _left_of_group())


def require_room(search, n_targets):
    """Refuse a search that would not fit into memory, before it is built.

    Banks are built level by level, as the search would build them, and before each level the next
    is counted: no more entries than the grammar has derivations, and none but of what the lower
    levels hold. Blocks of laws follow from the banks.

    Parameters
    ----------
    n_targets : int
        Targets that are searched at a time, simulated ones included.

    Raises
    ------
    ResourceError
        Proposing a bound on the levels that fits.
    """
    room = SHARE * available_bytes()
    banks, built, held = search.banks, {}, 0
    for levels in range(1, search.max_levels + 1):
        plans = plan_of(search.grammar, search.kind, levels)
        for level, name in _still_to_build(search.grammar, plans, built):
            if held + _bank_bytes(banks, name, level) > room:
                raise _refusal(search, held + _bank_bytes(banks, name, level), room, levels - 1)
            held += len(banks.level(name, level)) * _entry_bytes(banks, name)
            built[name] = level
        taken = held + _block_bytes(search, plans, n_targets, room - held)
        if taken > room:
            raise _refusal(search, taken, room, levels - 1)


def _refusal(search, foreseen, room, fitting):
    least = search.grammar.min_levels[search.grammar.start[search.kind]]
    remedy = (
        f"choose --max-levels {fitting} or fewer"
        if fitting >= least
        else "choose fewer scenes or rows, or a smaller grammar"
    )
    return ResourceError(
        f"the {search.kind} laws of grammar {search.grammar.name} with at most "
        f"{search.max_levels} levels need more than {_gigabytes(foreseen)} of memory on "
        f"{search.rows.n_rows:,} rows, and {_gigabytes(room)} may be used; {remedy}"
    )


def _gigabytes(n_bytes):
    return f"{n_bytes / 2**30:.3g} GB"


def _still_to_build(grammar, plans, built):
    """The levels of banks that these plans need beyond those that are built, lower ones first."""
    needs = {}
    todo = [
        part
        for plan in plans
        for part in (plan.left, plan.right, plan.direction, plan.condition)
        if part is not None
    ]
    while todo:
        name, levels = todo.pop()
        if levels > needs.get(name, 0):
            needs[name] = levels
            todo.extend((c, levels - 1) for rule in grammar.rules_of[name] for c in rule.children)
    return sorted(
        (level, name)
        for name, most in needs.items()
        for level in range(built.get(name, 0) + 1, most + 1)
    )


def _entry_bytes(banks, name):
    shape = banks.grammar.types[name].shape
    n_dims = banks.rows.n_dims if shape in ("vector", "point") else 1
    return 8 * banks.rows.n_rows * n_dims + ENTRY_BYTES


def _bank_bytes(banks, name, level):
    """At most so many bytes will the entries of this level take that are not built yet."""
    grammar = banks.grammar
    tuples = sum(_n_tuples(banks, rule, level) for rule in grammar.rules_of[name])
    counted = grammar.count(name, level) - grammar.count(name, level - 1)
    return min(tuples, counted) * _entry_bytes(banks, name)


def _n_tuples(banks, rule, level):
    """Number of combinations of lower entries of which at least one has the level below."""
    if not rule.children or level == 1:
        return int(not rule.children and level == 1)
    up_to, below = 1, 1
    for child in rule.children:
        sizes = [len(banks.level(child, lower)) for lower in range(1, level)]
        up_to *= sum(sizes)
        below *= sum(sizes[:-1])
    return up_to - below


def _block_bytes(search, plans, n_targets, room):
    """Work of the greatest block of laws of these plans, and all directions."""
    banks, rows = search.banks, search.rows

    def size(part, exact=False):
        if part is None:
            return 1
        entries = banks.bank(*part)
        return len(search.side(entries).entries if exact and entries else entries) + 1

    vectors = {(plan.direction, plan.condition) for plan in plans}
    directed = sum(size(d) * (size(c) if c is not None else 1) for d, c in vectors)
    fixed = 16 * directed * rows.n_rows * rows.n_dims

    def work(exact):
        greatest = 0
        for left, right, is_square in {(p.left, p.right, p.left == p.right) for p in plans}:
            n_left, n_right = size(left, exact), size(right, exact) * (2 if is_square else 1)
            n_right = 1 if left is None else n_right
            arrays = n_left * n_right * (n_targets + WORK_ARRAYS)
            greatest = max(greatest, arrays + 3 * (n_left + n_right) * rows.n_rows)
        return 8 * greatest

    # Factors that are proportional are merged in a block; that is looked at where it matters.
    found = work(exact=False)
    return fixed + (found if fixed + found <= room else work(exact=True))


# --- what is available ------------------------------------------------------------------------


def _left_of_system():
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemAvailable:"):
            return 1024.0 * int(line.split()[1])
    try:  # where the system does not tell what is free, all that it has
        return float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return float("inf")


def _left_of_process():
    try:
        import resource
    except ImportError:  # no such limits on this system
        return float("inf")
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return float("inf")
    pages = [int(line.split()[0]) for line in _lines("/proc/self/statm")]
    return max(limit - sum(pages) * float(os.sysconf("SC_PAGE_SIZE")), 0.0)


def _left_of_group():
    """Of the process's control group and those above it, in either version of them."""
    least = float("inf")
    for line in _lines("/proc/self/cgroup"):
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            root, names = _CGROUP, ("memory.max", "memory.current", "inactive_file")
        elif "memory" in controllers.split(","):
            root = f"{_CGROUP}/memory"
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        else:
            continue
        parts = [part for part in path.split("/") if part]
        for n in range(len(parts) + 1):
            least = min(least, _left_in("/".join([root, *parts[:n]]), *names))
    return least


def _left_in(folder, limit_name, used_name, cache_name):
    limit, used = _lines(f"{folder}/{limit_name}"), _lines(f"{folder}/{used_name}")
    if not (limit and used and limit[0].isdecimal() and used[0].isdecimal()):
        return float("inf")
    words = [line.split() for line in _lines(f"{folder}/memory.stat")]
    cache = sum(int(w[1]) for w in words if w[0] == cache_name)
    return max(float(int(limit[0]) - int(used[0]) + cache), 0.0)


def _lines(path):
    """Lines of a file of the system; none where there is no such file."""
    try:
        with open(path, encoding="ascii") as file:
            return file.read().splitlines()
    except (OSError, UnicodeDecodeError):
        return []
