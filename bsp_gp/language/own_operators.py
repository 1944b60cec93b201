"""Operators of a user's own, beside those that every law may use.

They take one or two numbers and give one, such as a window, a saturation or a drag coefficient
that was measured. `register_operator` tests one before any law may name it. A package that is
installed offers some through the entry points ``bsp_gp.operators``: each a function without
arguments that calls `register_operator`, under the name of the operator.
"""

import keyword

import numpy as np

from bsp_gp.errors import SettingsError, UnitError
from bsp_gp.language.inputs import STATE_INPUTS, property_of
from bsp_gp.language.operators import OPERATORS, Operator, Type
from bsp_gp.units import DIMENSIONLESS, METRE, Unit

N_TRIED, LEAST_FINITE = 200, 0.9
"""Values at which an operator is tested, and the part of results that must be finite numbers."""
STEP, AGREES = 1e-6, 1e-4
"""Of differences, and part by which derivatives may be off them."""


def register_operator(name, function, derivative, units="1", *, domain=(0.1, 10.0), latex=""):
    """Let laws and grammars use an operator.

    Parameters
    ----------
    name : str
        By which laws call it.
    function : callable
        ``function(a)`` or ``function(a, b)`` of arrays of one shape, element by element.
    derivative : callable or tuple of callable
        By its argument; of two arguments one for each.
    units : str, int, float or callable
        "1": of pure numbers, and one itself; "same": of the unit of its arguments, which have one;
        a number n: of the unit of its only argument to this power; or ``units(*units) -> Unit``,
        which raises `UnitError` where they do not fit.
    domain : (float, float), or one for each argument
        Values for which it is made. It is tested there; laws may leave it, and count as having no
        value where it has none.
    latex : str
        Template with ``{0}`` and ``{1}``; by default its name.

    Returns
    -------
    Operator

    Raises
    ------
    SettingsError
        If it fails the test: name, number of arguments, values element by element and finite in
        the domain, derivatives as differences have them, units. It says what, where, and how far.
    """
    partials = tuple(derivative) if isinstance(derivative, tuple | list) else (derivative,)
    _check_name(name, latex)
    if not callable(function) or not all(map(callable, partials)):
        raise SettingsError(f"operator {name}: function and derivative must be callable")
    if len(partials) not in (1, 2):
        raise SettingsError(f"operator {name}: takes one or two numbers, one derivative for each")
    operator = Operator(
        name, len(partials), _rule(name, units), lambda types, *values: function(*values),
        _differential(partials), latex or _latex_of(name, len(partials)), function, partials,
    )  # fmt: skip
    _test(operator, _domains(operator, domain))
    OPERATORS[name] = operator
    return operator


def _check_name(name, latex):
    if not isinstance(name, str) or not name.isidentifier() or keyword.iskeyword(name):
        raise SettingsError(f"an operator needs a name such as soft_step, got {name!r}")
    known = OPERATORS.get(name)
    if name in STATE_INPUTS or property_of(name) or (known is not None and not known.partials):
        raise SettingsError(f"operator {name}: laws use this name for something else")
    try:
        latex.format("a", "b")
    except (IndexError, KeyError, ValueError, AttributeError):
        raise SettingsError(
            f"operator {name}: latex must be a template with {{0}} and {{1}}, got {latex!r}"
        ) from None


def _latex_of(name, arity):
    written = name.replace("_", r"\_")
    inner = "{0}" if arity == 1 else r"{0},\,{1}"
    return rf"\operatorname{{{{{written}}}}}\left({inner}\right)"


def _rule(name, units):
    """The type of its value from those of its arguments."""

    def infer(*types):
        for type_ in types:
            if type_.shape not in ("scalar", "bool"):
                raise UnitError(f"{name} takes numbers, got a {type_.shape}")
        known = [t.unit for t in types]
        if callable(units):
            return Type("scalar", None if None in known else units(*known))
        if units == "1":
            wrong = next((u for u in known if u not in (None, DIMENSIONLESS)), None)
            if wrong is not None:
                raise UnitError(f"{name} takes pure numbers, got {wrong}")
            return Type("scalar", DIMENSIONLESS)
        said = [u for u in known if u is not None]
        if units == "same":
            if any(u != said[0] for u in said):
                raise UnitError(f"{name} takes {said[0]} and {said[1]}, which are different units")
            return Type("scalar", said[0] if said else None)
        return Type("scalar", None if None in known else known[0] ** units)

    is_power = isinstance(units, int | float) and not isinstance(units, bool)
    if not (callable(units) or units in ("1", "same") or is_power):
        raise SettingsError(
            f'operator {name}: units must be "1", "same", a power or a function, got {units!r}'
        )
    return infer


def _differential(partials):
    """The change of its value with changes of its arguments, None being no change."""

    def derivative(types, values, tangents):
        parts = [p(*values) * t for p, t in zip(partials, tangents, strict=True) if t is not None]
        return parts[0] if len(parts) == 1 else parts[0] + parts[1]

    return derivative


def _domains(operator, domain):
    """One range for each argument."""
    try:
        pairs = np.array(domain, dtype=float)
        pairs = np.broadcast_to(pairs, (operator.arity, 2))
        is_good = bool(np.isfinite(pairs).all() and (pairs[:, 0] < pairs[:, 1]).all())
    except (TypeError, ValueError):
        is_good = False
    if not is_good:
        raise SettingsError(
            f"operator {operator.name}: domain must be (low, high), or one for each of its "
            f"{operator.arity} argument(s), got {domain!r}"
        )
    return pairs


def _test(operator, domains):
    """Refuse an operator whose parts contradict each other."""
    name, rng = operator.name, np.random.default_rng(0)
    low, high = domains.T
    values = list(rng.uniform(low, high, (N_TRIED, operator.arity)).T)
    found = _called(name, "function", operator.function, values)
    if np.mean(np.isfinite(found)) < LEAST_FINITE:
        k = int(np.flatnonzero(~np.isfinite(found))[0])
        at = ", ".join(f"{v[k]:.4g}" for v in values)
        raise SettingsError(
            f"operator {name}: has no finite value at ({at}), which is in its domain; "
            "give the domain for which it is made"
        )
    for position, partial in enumerate(operator.partials):
        own = _called(name, f"derivative {position + 1}", partial, values)
        step = STEP * (high - low)[position]
        above, below = ([*values] for _ in range(2))
        above[position], below[position] = values[position] + step, values[position] - step
        with np.errstate(all="ignore"):
            rise = (operator.function(*above) - operator.function(*below)) / (2 * step)
        off = np.abs(own - rise) > AGREES * (np.abs(own) + np.nanmax(np.abs(rise), initial=1e-12))
        off &= np.isfinite(rise) & np.isfinite(found)
        if np.mean(off) > 1 - LEAST_FINITE:  # at kinks differences are wrong themselves
            k = int(np.flatnonzero(off)[0])
            at = ", ".join(f"{v[k]:.4g}" for v in values)
            raise SettingsError(
                f"operator {name}: its derivative by argument {position + 1} is {own[k]:.6g} at "
                f"({at}), differences of its values say {rise[k]:.6g}"
            )
    _check_units(operator)


def _called(name, what, function, values):
    """Its values, of the shape that came in whatever that is."""
    with np.errstate(all="ignore"):
        try:
            found = np.asarray(function(*values), dtype=float)
            square = np.asarray(function(*(v.reshape(20, -1) for v in values)), dtype=float)
            alone = np.asarray(function(*(v[0] for v in values)), dtype=float)
        except Exception as error:  # whatever a user's function may raise, it is told
            raise SettingsError(
                f"operator {name}: {what} does not take arrays of numbers: {error!r}"
            ) from error
    shape = values[0].shape
    is_one = found.shape == shape and square.shape == (20, shape[0] // 20) and alone.shape == ()
    if is_one:
        same = {"equal_nan": True, "rtol": 1e-12}
        is_one = np.allclose(square.ravel(), found, **same) and np.allclose(alone, found[0], **same)
    if not is_one:
        raise SettingsError(
            f"operator {name}: {what} must work element by element on arrays of any shape (numpy)"
        )
    return found


def _check_units(operator):
    """The rule of units gives a unit for pure numbers, and none that is not one."""
    for units in (DIMENSIONLESS, METRE):
        try:
            found = operator.infer(*(Type("scalar", units),) * operator.arity)
        except UnitError:  # it refuses them, which is a rule as well
            continue
        except Exception as error:
            raise SettingsError(
                f"operator {operator.name}: its rule of units fails: {error!r}"
            ) from error
        if not isinstance(found.unit, Unit):
            raise SettingsError(
                f"operator {operator.name}: its rule of units gives {found.unit!r}, not a Unit"
            )
