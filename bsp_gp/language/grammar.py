"""Grammar files: TOML text -> a checked, immutable grammar. The single source of what may be said.

A file has ``[grammar]`` (name, start, kind), ``[types]`` (nonterminal = "shape unit", where ``*``
is open), ``[inputs]``, ``[constants]`` and ``[rules]`` (alternatives separated by ``|``, written
as calls); optionally ``[operators]`` (which version of an operator a name means),
``[each_property]`` (rules that are repeated for every property column of a data set), ``[inside]``
(forms with constants inside, and the ranges of these), ``[beyond]`` (rules with such constants,
for searches that draw laws) and ``[shapes]`` (functions of one variable, which are bred). Rule
bodies are read with `ast` from whitelisted nodes and never evaluated.
"""

import ast
import functools
import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

from bsp_gp.data.toml import TomlError, parse_toml
from bsp_gp.errors import GrammarError, UnitError
from bsp_gp.language.formula import Call, Constant, Input, Number
from bsp_gp.language.inputs import property_of
from bsp_gp.language.operators import OPERATORS, SHAPES, Type
from bsp_gp.units import SPEED, parse_unit

KINDS = ("pair", "field")
PLACED = ("origin", "middle", "centre")
"""Points that rules ``[beyond]`` may name: zero, the middle of the data, one that is sought."""


@dataclass(frozen=True)
class Slot:
    """A place in a rule body that a nonterminal's derivation fills."""

    nonterminal: str
    position: int


@dataclass(frozen=True)
class Rule:
    """One production rule: ``nonterminal -> body``.

    Attributes
    ----------
    index : int
        Its number in the grammar; derivation trees store these.
    body : nested tuple, Slot or Formula
        ``(operator, *arguments)`` with slots at the nonterminals.
    children : tuple of str
        The nonterminals in the body, left to right.
    inputs : frozenset of str
        Inputs named in the body; a data set that lacks one masks the rule.
    operators : frozenset of str
        Operators in the body; `perp` exists in 2-D only, `cross` in 3-D only.
    """

    index: int
    nonterminal: str
    text: str
    body: object
    children: tuple[str, ...]
    inputs: frozenset
    operators: frozenset


@dataclass(frozen=True, eq=False)
class Grammar:
    """A checked grammar.

    Attributes
    ----------
    start : mapping of str to str
        Kind of law ("pair", "field") -> start symbol.
    operators : mapping of str to str
        What the names in bodies mean (``div`` -> ``div_guarded``).
    enabled : tuple of bool, one per rule
        False for rules masked because the data lack an input.
    fingerprint : str
        SHA-256 of the meaning of the file; rule indices mean nothing without it.
    """

    name: str
    start: Mapping
    types: Mapping
    inputs: Mapping
    constants: tuple[str, ...]
    rules: tuple[Rule, ...]
    operators: Mapping
    fingerprint: str
    source: Mapping = field(repr=False)
    enabled: tuple[bool, ...] = ()

    def __post_init__(self):
        if not self.enabled:
            object.__setattr__(self, "enabled", (True,) * len(self.rules))

    def __reduce__(self):
        return (_rebuild, (dict(self.source), self.enabled))

    @functools.cached_property
    def common(self):
        """Laws of textbooks, as typed: likelier beforehand than their length says."""
        return tuple(self.source.get("common", {}).get("laws", ()))

    @functools.cached_property
    def common_of_planes(self):
        """Those of them that are asked where not all motion is on one line."""
        return tuple(self.source.get("common", {}).get("planes", ()))

    @functools.cached_property
    def inside(self):
        """Forms with constants inside: texts, lists of what their braces stand for, ranges."""
        return self.source.get("inside", {})

    @functools.cached_property
    def beyond(self):
        """The grammar with its rules ``[beyond]`` as well; nothing is masked in it."""
        if "beyond" not in self.source:
            return self
        source = json.loads(json.dumps(dict(self.source)))
        more = source.pop("beyond")
        source["types"] |= more.get("types", {})
        for name in PLACED:
            source["inputs"].setdefault(name, "point m")
        source["constants"] |= dict.fromkeys(self.inside.get("ranges", {}), "scalar *")
        for nonterminal, bodies in more.get("rules", {}).items():
            known = source["rules"].get(nonterminal)
            source["rules"][nonterminal] = f"{known} | {bodies}" if known else bodies
        return read_grammar(source)

    @functools.cached_property
    def shapes(self):
        """The grammar of shapes, functions of a number ``x`` and its size ``z``; None without."""
        table = self.source.get("shapes", {})
        if not table:
            return None
        names = dict.fromkeys(self.inside.get("ranges", {}), "scalar *")
        return read_grammar({
            "grammar": {"name": f"{self.name}, shapes", "start": "Shape", "kind": "field"},
            "types": dict.fromkeys(table["rules"], "scalar 1"),
            "inputs": {"x": "scalar 1", "z": "scalar 1"}, "constants": names,
            "rules": table["rules"],
        })  # fmt: skip

    @functools.cached_property
    def rules_of(self):
        """Nonterminal -> tuple of its enabled rules."""
        table = {nonterminal: [] for nonterminal in self.types}
        for rule in self.rules:
            if self.enabled[rule.index]:
                table[rule.nonterminal].append(rule)
        return MappingProxyType({k: tuple(v) for k, v in table.items()})

    def is_constant(self, nonterminal):
        """Whether a nonterminal stands for a free constant."""
        rules = self.rules_of[nonterminal]
        return bool(rules) and all(isinstance(rule.body, Constant) for rule in rules)

    @functools.cached_property
    def min_levels(self):
        """Nonterminal -> least number of levels of a finished derivation; inf if there is none.

        A rule without nonterminals is one level.
        """
        least = dict.fromkeys(self.types, float("inf"))
        changed = True
        while changed:
            changed = False
            for rules in self.rules_of.values():
                for rule in rules:
                    levels = 1 + max((least[c] for c in rule.children), default=0)
                    if levels < least[rule.nonterminal]:
                        least[rule.nonterminal] = levels
                        changed = True
        return MappingProxyType(least)

    def count(self, nonterminal, levels):
        """Number of derivations of `nonterminal` with at most `levels` levels (an exact int)."""
        counts = dict.fromkeys(self.types, 0)
        for _ in range(levels):
            nexts = {}
            for name, rules in self.rules_of.items():
                total = 0
                for rule in rules:
                    ways = 1
                    for child in rule.children:
                        ways *= counts[child]
                    total += ways
                nexts[name] = total
            counts = nexts
        return counts[nonterminal]

    def masked(self, available, n_dims=None):
        """The grammar without the rules that need an input outside of `available`.

        Rules that can then no longer be finished are masked as well.

        Parameters
        ----------
        n_dims : int, optional
            2 masks rules that use `cross`, 3 those that use `perp`.

        Returns
        -------
        grammar : Grammar
        missing : tuple of str
            Inputs of the grammar that the data lack.
        """
        available = set(available)
        absent = {2: {"cross"}, 3: {"perp"}, None: set()}[n_dims]
        enabled = [
            on and rule.inputs <= available and not rule.operators & absent
            for rule, on in zip(self.rules, self.enabled, strict=True)
        ]
        grammar = self._with_enabled(enabled)
        dead = {name for name, least in grammar.min_levels.items() if least == float("inf")}
        enabled = [
            on and not dead.intersection(rule.children)
            for rule, on in zip(self.rules, enabled, strict=True)
        ]
        return self._with_enabled(enabled), tuple(sorted(set(self.inputs) - available))

    def without_inputs(self, names):
        """The grammar with every rule that names one of these inputs masked."""
        return self.masked(set(self.inputs) - set(names))[0]

    def _with_enabled(self, enabled):
        return replace(self, enabled=tuple(enabled))

    def for_properties(self, columns, inputs=None, angles=(), signed=(), alone=()):
        """Repeat rules for further property columns of a data set.

        Those of ``[each_property]`` for every scalar, of ``[each_vector]`` for every vector, of
        ``[each_velocity]`` for every vector that is a velocity, of ``[each_signed]`` for every
        input that takes both signs, and of ``[each_angle]`` alone for every angle.

        Parameters
        ----------
        columns : mapping of str to Type
            Columns that no input of the grammar names are added as ``<column>_i``, ``_j``.
        inputs : mapping of str to Type, optional
            Measured inputs: the same rules for the receiver, under their own names.
        angles, signed : collection of str, optional
            Inputs that are angles, and scalars that are both above and below zero.
        alone : collection of str, optional
            Inputs of which laws on one body alone may be.
        """
        known = {property_of(name)[0] for name in self.inputs if property_of(name)}
        inputs = inputs or {}
        source = json.loads(json.dumps(dict(self.source)))
        own = {*source.get("constants", {}), *source.get("inside", {}).get("ranges", {})}
        taken = sorted(own & set(inputs))
        for name in taken:  # the grammar's constant gives way to what was measured
            source = _with_other_name(source, name, f"{name}_own")
        is_changed = bool(taken)
        for column in [*sorted(set(columns) - known), *sorted(inputs)]:
            type_ = inputs.get(column) or columns[column]
            is_velocity = type_ == Type("vector", SPEED)
            tables = ["each_property"] if type_.shape == "scalar" else ["each_vector"]
            tables += ["each_velocity"] if is_velocity else []
            tables += ["each_signed"] if column in signed else []
            tables = ["each_angle"] if column in angles else tables
            rules = [pair for t in tables for pair in self.source.get(t, {}).items()
                     if column not in alone or "{name}_j" not in pair[1]]  # fmt: skip
            if not rules:
                continue
            is_changed = True
            roles = [""] if column in inputs else ["_i", "_j"]
            for role in roles:
                source["inputs"][f"{column}{role}"] = f"{type_.shape} {type_.unit.text()}"
            for nonterminal, bodies in rules:
                if column in inputs:
                    own = [b for b in bodies.split("|") if "{name}_j" not in b]
                    bodies = "|".join(own).replace("{name}_i", "{name}")
                source["rules"][nonterminal] += " | " + bodies.replace("{name}", column)
        return read_grammar(source) if is_changed else self


def _with_other_name(source, name, other):
    """A source, or a part of it, with another name of a constant."""
    if isinstance(source, dict):
        return {_with_other_name(key, name, other): _with_other_name(value, name, other)
                for key, value in source.items()}  # fmt: skip
    if isinstance(source, list):
        return [_with_other_name(part, name, other) for part in source]
    if isinstance(source, str):
        return re.sub(rf"(?<![\w{{]){name}(?![\w}}])", other, source)
    return source


def _rebuild(source, enabled):
    return read_grammar(source)._with_enabled(enabled)


def grammar_directory():
    """Folder of the grammar files, wherever the package is installed."""
    here = Path(__file__).resolve().parent.parent
    for folder in (here / "grammars", here.parent / "grammars"):
        if folder.is_dir():
            return folder
    raise GrammarError("the folder of grammar files is missing from this installation")


def load_grammar(name):
    """Load a grammar by name (``newtonian``, ``physics``) or by the path of a TOML file.

    Raises
    ------
    GrammarError
        If there is no such grammar, or it contradicts itself.
    """
    path = Path(name)
    if path.suffix != ".toml":
        path = grammar_directory() / f"{name}.toml"
    if not path.is_file():
        known = sorted(p.stem for p in grammar_directory().glob("*.toml"))
        raise GrammarError(
            f"unknown grammar {str(name)!r}; known are {', '.join(known)}, or give a .toml file"
        )
    try:
        source = parse_toml(path.read_bytes())
    except (TomlError, UnicodeDecodeError) as error:
        raise GrammarError(f"{path.name}: not readable as TOML: {error}") from None
    try:
        return read_grammar(source)
    except GrammarError as error:
        raise GrammarError(f"{path.name}: {error}") from None


def read_grammar(source):
    """Build a grammar from the parsed TOML tables and check it.

    Raises
    ------
    GrammarError
        Unknown names, wrong arity, a body whose unit or shape differs from its nonterminal's,
        nonterminals that cannot be reached or finished; the message names the rule.
    """
    return _Reader(source).read()


class _Reader:
    tables = {
        "grammar", "types", "inputs", "constants", "rules", "operators", "each_property",
        "each_vector", "each_velocity", "each_signed", "each_angle", "common", "inside", "beyond",
        "shapes",
    }  # fmt: skip

    def __init__(self, source):
        self.source = source
        unknown = sorted(set(source) - self.tables)
        if unknown:
            raise GrammarError(f"unknown table(s) {unknown}; allowed are {sorted(self.tables)}")
        for table in ("grammar", "types", "inputs", "rules"):
            if table not in source:
                raise GrammarError(f"the table [{table}] is missing")

    def read(self):
        head = self.source["grammar"]
        self.types = {k: self.type(k, v) for k, v in self.source["types"].items()}
        self.inputs = {k: self.type(k, v) for k, v in self.source["inputs"].items()}
        self.constants = tuple(self.source.get("constants", {}))
        self.operators = dict(self.source.get("operators", {}))
        for name, meaning in self.operators.items():
            if not isinstance(meaning, str) or meaning not in OPERATORS:
                raise GrammarError(f"[operators] {name} = {meaning!r}: no such operator")
        common = self.source.get("common", {})
        lists = [common.get(n, []) for n in ("laws", "planes")] if isinstance(common, dict) else [0]
        for laws in lists:
            if not isinstance(laws, list) or not all(isinstance(law, str) for law in laws):
                raise GrammarError("[common] needs laws, and may have planes, lists of texts")
        _check_inside(self.source.get("inside", {}))
        _check_beyond(self.source)
        _check_shapes(self.source)
        rules = self.rules()
        grammar = Grammar(
            name=head.get("name", "unnamed"), start=MappingProxyType(self.start(head)),
            types=MappingProxyType(self.types), inputs=MappingProxyType(self.inputs),
            constants=self.constants, rules=rules, operators=MappingProxyType(self.operators),
            fingerprint=_fingerprint(self.source), source=MappingProxyType(self.source),
        )  # fmt: skip
        self.check(grammar)
        for part in ("beyond", "shapes"):
            try:
                getattr(grammar, part)
            except GrammarError as error:
                raise GrammarError(f"with its rules [{part}]: {error}") from None
        return grammar

    def start(self, head):
        symbols, kinds = head.get("start"), head.get("kind", "pair")
        symbols = [symbols] if isinstance(symbols, str) else symbols
        kinds = [kinds] if isinstance(kinds, str) else kinds
        are_texts = all(
            isinstance(each, list) and all(isinstance(item, str) for item in each)
            for each in (symbols, kinds)
        )
        if not are_texts or not symbols or len(symbols) != len(kinds):
            raise GrammarError("[grammar] needs one kind (pair or field) for each start symbol")
        for kind in kinds:
            if kind not in KINDS:
                raise GrammarError(f"[grammar] kind must be one of {KINDS}, got {kind!r}")
        for symbol in symbols:
            if symbol not in self.types:
                raise GrammarError(f"[grammar] start symbol {symbol!r} has no type")
        return dict(zip(kinds, symbols, strict=True))

    def type(self, name, text):
        shape, _, unit = str(text).strip().partition(" ")
        if shape not in SHAPES:
            raise GrammarError(f"type of {name}: shape must be one of {SHAPES}, got {shape!r}")
        if unit.strip() == "*":
            return Type(shape, None)
        try:
            scale, parsed = parse_unit(unit.strip() or "1")
        except UnitError as error:
            raise GrammarError(f"type of {name}: {error}") from None
        if scale != 1.0:
            raise GrammarError(
                f"type of {name}: unit must be SI, got {unit.strip()!r}; write {str(parsed)!r}, "
                "values of the data are converted to it"
            )
        return Type(shape, parsed)

    def rules(self):
        rules = []
        for nonterminal, bodies in self.source["rules"].items():
            if nonterminal not in self.types:
                raise GrammarError(f"rule for {nonterminal!r}, which has no type")
            for text in _alternatives(bodies):
                body, children = self.body(nonterminal, text)
                inputs = frozenset(part.name for part in _parts(body) if isinstance(part, Input))
                operators = frozenset(part[0] for part in _parts(body) if isinstance(part, tuple))
                rules.append(
                    Rule(len(rules), nonterminal, text, body, children, inputs, operators)
                )
        return tuple(rules)

    def body(self, nonterminal, text):
        where = f"rule {nonterminal} -> {text if len(text) <= 120 else text[:117] + '...'}"
        try:
            tree = ast.parse(text, mode="eval").body
        except SyntaxError:
            raise GrammarError(f"{where}: not a call, a name or a number") from None
        children = []
        body = self.node(tree, children, where)
        inferred = _infer(body, self.types, where)
        expected = self.types[nonterminal]
        same_shape = inferred.shape == expected.shape
        same_unit = expected.unit is None or inferred.unit == expected.unit
        if not same_shape or not same_unit:
            raise GrammarError(
                f"{where}: the body is a {inferred}, but {nonterminal} is a {expected}"
            )
        return body, tuple(children)

    def node(self, tree, children, where):
        if isinstance(tree, ast.Name):
            return self.leaf(tree.id, children, where)
        if isinstance(tree, ast.Constant) and isinstance(tree.value, int | float):
            return Number(tree.value)
        if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
            if isinstance(tree.operand, ast.Constant):
                return Number(-tree.operand.value)
        if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) and not tree.keywords:
            name = self.operators.get(tree.func.id, tree.func.id)
            if name not in OPERATORS:
                raise GrammarError(
                    f"{where}: unknown operator {tree.func.id!r}; one of your own has to be "
                    "registered first: bsp_gp.register_operator, or the entry point of a package"
                )
            if len(tree.args) != OPERATORS[name].arity:
                raise GrammarError(
                    f"{where}: {tree.func.id} takes {OPERATORS[name].arity} argument(s), "
                    f"got {len(tree.args)}"
                )
            return (name, *(self.node(arg, children, where) for arg in tree.args))
        raise GrammarError(f"{where}: only calls, names and numbers are allowed")

    def leaf(self, name, children, where):
        if name in self.types:
            children.append(name)
            return Slot(name, len(children) - 1)
        if name in self.inputs:
            return Input(name, self.inputs[name])
        if name in self.constants:
            return Constant(name)
        raise GrammarError(f"{where}: unknown name {name!r}")

    def check(self, grammar):
        least = grammar.min_levels
        endless = [name for name in grammar.types if least[name] == float("inf")]
        if endless:
            raise GrammarError(f"nonterminal(s) {endless} have no finite derivation")
        reached, stack = set(), list(grammar.start.values())
        while stack:
            nonterminal = stack.pop()
            if nonterminal not in reached:
                reached.add(nonterminal)
                stack.extend(c for r in grammar.rules_of[nonterminal] for c in r.children)
        lost = sorted(set(grammar.types) - reached)
        if lost:
            raise GrammarError(f"nonterminal(s) {lost} cannot be reached from the start symbol")


def _check_inside(table):
    """Forms with constants inside are lists of texts, ranges texts."""
    ranges = table.get("ranges", {}) if isinstance(table, dict) else None
    lists = [] if ranges is None else [v for k, v in table.items() if k != "ranges"]
    are_texts = isinstance(ranges, dict) and all(isinstance(t, str) for t in ranges.values())
    are_texts &= all(isinstance(v, list) and all(isinstance(t, str) for t in v) for v in lists)
    if not are_texts:
        raise GrammarError("[inside] needs lists of texts, and [inside.ranges] texts")
    for name, text in ranges.items():
        low, is_pair, high = text.partition("..")
        try:
            is_good = not is_pair or float(low) < float(high)
        except ValueError:
            is_good = False
        if not is_good:
            raise GrammarError(
                f"[inside.ranges] {name} = {text!r}: give numbers as in '-4 .. 4', or a formula"
            )


def _check_beyond(source):
    """Rules for searches that draw are texts, as are the types of their nonterminals."""
    table = source.get("beyond", {})
    parts = table.values() if isinstance(table, dict) and set(table) <= {"types", "rules"} else [0]
    are_texts = all(
        isinstance(part, dict) and all(isinstance(text, str) for text in part.values())
        for part in parts
    )
    if not are_texts or not isinstance(source.get("constants", {}), dict):
        raise GrammarError("[beyond] has [beyond.types] and [beyond.rules], texts as in the others")


def _check_shapes(source):
    """Functions of one variable: of what, times what, with which constants; and their rules."""
    table = source.get("shapes", {})
    if not table:
        return
    if not isinstance(table, dict) or set(table) != {"of", "rules"}:
        raise GrammarError("[shapes] has a list, of, and [shapes.rules]")
    rules, of = table["rules"], table["of"]
    are_texts = isinstance(rules, dict) and all(isinstance(text, str) for text in rules.values())
    if not are_texts or "Shape" not in rules:
        raise GrammarError("[shapes.rules] needs texts as [rules] does, among them Shape")
    ranges = source.get("inside", {}).get("ranges", {})
    for one in of if of and isinstance(of, list) else [None]:
        is_good = isinstance(one, dict) and {"variable", "scale", "times"} <= set(one)
        is_good = is_good and set(one) <= {"variable", "scale", "times", "offset"}
        is_good = is_good and isinstance(one["variable"], str) and isinstance(one["times"], list)
        if not is_good or not all(isinstance(text, str) for text in one["times"]):
            raise GrammarError(
                "[shapes] of: each needs a variable, a scale and a list times, and may have an "
                f"offset; got {one!r}"
            )
        for name in (one["scale"], one.get("offset", one["scale"])):
            if name not in ranges:
                raise GrammarError(
                    f"[shapes] of {one['variable']!r}: constant {name!r} has no range; give it "
                    "under [inside.ranges]"
                )


def _alternatives(bodies):
    lines = [line.partition("#")[0] for line in str(bodies).splitlines()]
    return [" ".join(part.split()) for part in " ".join(lines).split("|") if part.strip()]


def _parts(body):
    """Every part of a rule body, the whole first."""
    yield body
    for part in body[1:] if isinstance(body, tuple) else ():
        yield from _parts(part)


def joined_slots(body, operator):
    """The slots of a body that is nothing but slots joined by one operator; None for others."""
    if isinstance(body, Slot):
        return [body]
    if not isinstance(body, tuple) or body[0] != operator:
        return None
    found = [joined_slots(part, operator) for part in body[1:]]
    return None if None in found else [slot for part in found for slot in part]


def _infer(body, types, where):
    """Type of a rule body whose slots have the types of their nonterminals."""
    if isinstance(body, Slot):
        return types[body.nonterminal]
    if not isinstance(body, tuple):
        return body.type
    inferred = [_infer(part, types, where) for part in body[1:]]
    try:
        if body[0] == "pow" and isinstance(body[2], Number) and inferred[0].unit is not None:
            OPERATORS["pow"].infer(*inferred)
            return Type("scalar", inferred[0].unit ** body[2].value)
        return OPERATORS[body[0]].infer(*inferred)
    except UnitError as error:
        raise GrammarError(f"{where}: {error}") from None


def fill(body, children):
    """Put formulas into the slots of a rule body."""
    if isinstance(body, Slot):
        return children[body.position]
    if isinstance(body, tuple):
        return Call(body[0], *(fill(part, children) for part in body[1:]))
    return body


def _fingerprint(source):
    meaning = {
        table: (
            {k: _alternatives(v) for k, v in content.items()}
            if table == "rules" or table.startswith("each_")
            else content
        )
        for table, content in source.items()
    }
    text = json.dumps(meaning, sort_keys=False, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()
