"""From the arguments of the command line to data sets, laws and values."""

import math
import re

from bsp_gp.errors import LawError, SettingsError


def read_dataset(args):
    """The data set with the options that stand in for dataset.toml."""
    from dataclasses import replace

    from bsp_gp.data.noise import declare_noise
    from bsp_gp.data.tables import load_dataset
    from bsp_gp.data.vertical import with_vertical

    dataset = load_dataset(
        args.data if len(args.data) > 1 else args.data[0],
        units=_mapping("--units", _units(args.units)), fps=args.fps, dt=args.dt,
        columns=columns_said(args), train=args.train, test=args.test,
        properties=_mapping("--property", args.property), sky=_mapping("--sky", args.sky),
        uses=_names_in_laws(args),
    )  # fmt: skip
    if args.up is not None:
        axes = "xyz"[: dataset.n_dims]
        if args.up[-1] not in axes:
            raise SettingsError(f"--up is {args.up}, but the data have the axes {', '.join(axes)}")
        dataset = replace(dataset, up=args.up)
    dataset = with_vertical(dataset, _names_in_laws(args))
    if args.command != "simulate" and args.noise is not None:
        if len(args.noise) not in (1, dataset.n_dims):
            raise SettingsError(
                f"--noise must be one number or one per axis ({dataset.n_dims}), "
                f"got {len(args.noise)}"
            )
        length = unit_of_length(dataset)
        if dataset.is_summed:  # of what is added up: what that adds to places in a step
            length *= dataset.typical_step**dataset.n_sums
        dataset = declare_noise(dataset, [sigma * length for sigma in args.noise])
    return dataset


def _names_in_laws(args):
    """What laws name, of this command."""
    said = " ".join(read_laws(args)) if hasattr(args, "declare") else ""
    return sorted(set(re.findall(r"[^\W\d]\w*", said)))


def columns_said(args):
    """What --columns says."""
    return _mapping("--columns", args.columns)


def _units(pairs):
    """Pairs of --units, those joined by commas taken apart: no unit has a comma."""
    out = []
    for key, value in pairs or ():
        for part in f"{key}={value}".split(","):
            kind, equals, unit = part.partition("=")
            if not (equals and kind.strip() and unit.strip()):
                raise SettingsError(
                    f"--units must be KIND=UNIT, got {part.strip()!r}; write length=m time=s or "
                    "length=m,time=s"
                )
            out.append((kind.strip(), unit.strip()))
    return out


def _mapping(option, pairs):
    out = {}
    for key, value in pairs or ():
        if out.setdefault(key, value) != value:
            raise SettingsError(f"{option} gives {key!r} twice: {out[key]!r} and {value!r}")
    return out or None


def unit_of_length(dataset):
    """How long the data's unit of length is, in the numbers of the data set."""
    from bsp_gp.data.conversion import Conversion

    declared = dict(dataset.units.declared)
    return Conversion(declared, declared).length("x")


def read_laws(args):
    """Texts of --declare, or those of the model file, and equations of --constrain."""
    if not args.model:
        return (*(args.declare or ()), *args.constrain)
    from bsp_gp.data.toml import TomlError, parse_toml

    try:
        with open(args.model, "rb") as file:
            content = parse_toml(file.read())
    except (TomlError, UnicodeDecodeError) as error:
        raise LawError(f"{args.model}: this is not valid TOML: {error}") from None
    unknown = sorted(set(content) - {"declare"})
    if unknown:
        raise LawError(f"{args.model}: unknown key {unknown[0]!r}; allowed is declare")
    laws = content.get("declare")
    if not isinstance(laws, list) or not laws or not all(isinstance(law, str) for law in laws):
        raise LawError(
            f'{args.model}: declare must be a list of laws: declare = ["9.81 [m/s^2] * m_i * down"]'
        )
    return (*laws, *args.constrain)


def read_constants(pairs, option="--set", factors=None):
    """Values of constants in SI; `factors` are those of numbers without a unit, by name."""
    values = {}
    for name, text in (_mapping(option, pairs) or {}).items():
        match = re.fullmatch(_WITH_UNIT, text)
        try:
            value = float(match[1]) * _scale(name, match[2], factors)
        except (TypeError, ValueError):
            raise LawError(
                f'{option} {name}={text}: expected a number, as in "c1=3 [g/s]"'
            ) from None
        if not abs(value) < float("inf"):
            raise LawError(f"{option} {name}={text}: the number must be finite")
        values[name] = value
    return values


def _scale(name, unit, factors):
    """Of a number with a unit, or without one in that in which the constant is told."""
    from bsp_gp.units import parse_unit

    return parse_unit(unit)[0] if unit else (factors or {}).get(name, 1.0)


_WITH_UNIT = r"([^\[\]]+?)\s*(?:\[([^\[\]]*)\])?"


def _read_bounds(pairs, factors=None):
    """Values of --bounds in SI, (low, high); an end that is not given is open."""
    bounds = {}
    for name, text in (_mapping("--bounds", pairs) or {}).items():
        match = re.fullmatch(_WITH_UNIT, text)
        low, dots, high = match[1].partition("..") if match else ("", "", "")
        try:
            ends = float(low or "-inf"), float(high or "inf")
        except ValueError:
            ends = (math.nan, math.nan)
        if not dots or not ends[0] <= ends[1] or ends[0] == math.inf or ends[1] == -math.inf:
            raise LawError(
                f'--bounds {name}={text}: expected LOW..HIGH, as in n=-4..0, c1=0.. or "k=1..3 '
                '[g/s]"'
            )
        scale = _scale(name, match[2], factors)
        bounds[name] = (ends[0] * scale, ends[1] * scale)
    return bounds


def read_fit_settings(args, factors=None):
    """--start, --bounds and --time-limit as the settings of `fit_law`.

    Parameters
    ----------
    factors : mapping of str to float, optional
        Constant -> what a unit of it, as it is told, is in SI.
    """
    return {
        "starts": read_constants(args.start, "--start", factors) or None,
        "bounds": _read_bounds(args.bounds, factors) or None,
        "time_limit": args.time_limit,
    }


def read_loop_settings(args):
    """The settings of `close_loop` but for what depends on the data."""
    names = ("alpha", "max_rounds", "max_levels", "search", "search_budget", "seed", "all_rows")
    settings = {name: getattr(args, name) for name in names} | read_fit_settings(args)
    return settings if args.bootstrap is None else {**settings, "n_bootstrap": args.bootstrap}


def refuse_fit_settings(args, *, is_loop):
    """SettingsError if one of them is given where it would do nothing; a loop has a time limit."""
    given = {"--start": args.start, "--bounds": args.bounds}
    if not is_loop:
        given["--time-limit"] = args.time_limit
    for option, value in given.items():
        if value:
            raise SettingsError(f"{option} is for the fit of a --law, without --latent")


def excluded_inputs(args, grammar, dataset):
    """Names of inputs that the search may not use, every spelling of each."""
    from bsp_gp.language.inputs import ALIASES, SHORT, property_of
    from bsp_gp.physics.bodies import dataset_types

    known = {*grammar.inputs, *dataset_types(dataset), *dataset.logged}
    names = [] if args.allow_time else ["t"]
    for name in args.exclude:
        if name not in known:
            raise SettingsError(
                f"--exclude {name}: there is no such input; present are {', '.join(sorted(known))}"
            )
        column, _, role = name.rpartition("_")
        column = ALIASES.get(column, column)
        spellings = (f"{SHORT.get(column, column)}_{role}", f"{column}_{role}")
        names += [s for s in (spellings if property_of(name) else (name,)) if s not in names]
    return tuple(names)


def masked_grammar(grammar, dataset):
    """The grammar as the loop masks it to a data set, and the inputs that are missing."""
    from bsp_gp.language.inputs import property_of
    from bsp_gp.physics.bodies import angles_of, dataset_types, input_types_of, signed_of

    types = dataset_types(dataset)
    columns = {property_of(n)[0]: t for n, t in types.items() if property_of(n)}
    inputs, kinds = input_types_of(dataset), (angles_of(dataset), signed_of(dataset))
    return grammar.for_properties(columns, inputs, *kinds).masked(types, dataset.n_dims)
