"""Laws that are the same on the data at hand are told once: one body, one mass, one direction."""

import re

from bsp_gp.language.inputs import SHORT

_TERM = re.compile(r"[A-Za-z]\w*(?:\[\w+\])? \* (.+)")
"""A constant, and what it multiplies."""
_TOWARDS = ("normalize(v_i)", "up", "down", "e_x", "e_y", "e_z")
MOST_PROPERTIES = 3
"""Properties that a phrase names."""


def told_once(law, others, dataset):
    """What is not told apart from a law, without what is the same law on these data.

    Parameters
    ----------
    others : sequence of str
        Laws in order of likelihood.
    dataset : mapping
        What a report says of its data: ``properties`` whose ``is_constant`` is true have one value,
        and along ``way``, an axis, everything moves, without turning back.

    Returns
    -------
    kept : tuple of str
    n_same : int
        How many were left out.
    why : str
        In what they differ: "powers of m_i, e_x for normalize(v_i)"; "" where none was left out.
    """
    properties = dataset.get("properties") or {}
    constant = [name for name, known in properties.items() if known.get("is_constant")]
    symbols = sorted({f"{short}_{role}" for name in constant for short in _spellings(name)
                      for role in "ij"})  # fmt: skip
    way = (dataset.get("way") or "").lstrip("-")
    towards = (*_TOWARDS[:3], f"e_{way}") if way else ()
    known, kept, reasons = {_key(law, symbols, towards)}, [], set()
    for other in others:
        key = _key(other, symbols, towards)
        if key not in known:
            known.add(key)
            kept.append(other)
            continue
        reasons |= {f"powers of {s}" for s in symbols if _count(s, other) != _count(s, law)}
        if any(_count(word, other) != _count(word, law) for word in towards):
            reasons.add(_turned(way))
    why = ", ".join([*sorted(reasons, reverse=True)[:MOST_PROPERTIES]])
    return tuple(kept), len(others) - len(kept), why


def _turned(way):
    return f"e_{way} for normalize(v_i)"


def other_way(effect, why, dataset):
    """What a force is as well where nothing turns back: friction or a push; "" if neither."""
    sign = -1 if (dataset.get("way") or "").startswith("-") else 1
    way = (dataset.get("way") or "").lstrip("-")
    terms = _split(effect.written or "", " + ", " - ")
    if not way or _turned(way) not in why or len(terms) != len(effect.constants):
        return ""
    cannot_tell = "nothing turns back, and these data cannot tell"
    for term, constant in zip(terms, effect.constants, strict=True):
        # No push grows with the speed, and none depends on the place.
        if any(_count(word, term) for word in ("norm(v_i)", "p_i", f"{way}_i")):
            continue
        if _count("normalize(v_i)", term) and len(terms) == 1:
            return f", or a push along {way}: {cannot_tell}"
        if _count(f"e_{way}", term) and constant.value * sign < 0:  # it brakes
            if len(terms) == 1:
                return f", or friction as large: {cannot_tell}"
            return f" (the push along {way} may be friction as large: {cannot_tell})"
    return ""


def rewritten(n_same, why):
    """Words for laws that were left out; "" for none."""
    if not n_same:
        return ""
    ways = "1 other that is" if n_same == 1 else f"{n_same} others that are"
    return f"{ways} the same on these data{f' ({why})' if why else ''}"


def dependence(law, others, tried, dataset):
    """Whether the data tell how a law depends on a property of which there are several values.

    Sentences; "" where no law with another power of a property was tried.

    Parameters
    ----------
    law : str
        Of one term.
    others : sequence of str
        What is not told apart from it.
    tried : sequence of str
        All that was fitted beside it.
    dataset : mapping
        What a report says of its data: ``properties`` whose ``is_constant`` is false.
    """
    if not law or len(_split(law, " + ", " - ")) > 1:
        return ""
    properties = dataset.get("properties") or {}
    several = [name for name, known in properties.items() if known.get("is_constant") is False]
    out = []
    for name in several:
        symbols = [f"{short}_i" for short in _spellings(name)]
        rivals, beaten = (
            [text for text in texts if _key(text, symbols, ()) == _key(law, symbols, ())
             and _power(text, symbols) != _power(law, symbols)] for texts in (others, tried)
        )  # fmt: skip
        if rivals:
            out.append(
                f"How the force depends on the {name} these data do not tell: {rivals[0]} does as "
                "well."
            )
        elif beaten:
            out.append(
                f"That the force {_grows(name, _power(law, symbols))} is told by these data: "
                f"{beaten[0]}, say, does worse."
            )
    return " ".join(out)


def _power(law, symbols):
    """The power of a property in a law of one term."""
    power = 0
    for factor in _factors(law, (), ()):
        match = re.fullmatch(r"(inverse\()?(\w+)(?:\^(-?\d+))?\)?", factor)
        if match and match[2] in symbols:
            power += (-1 if match[1] else 1) * int(match[3] or 1)
    return power


def _grows(name, power):
    if power == 0:
        return f"does not depend on the {name}"
    return f"is proportional to the {name}" + (f" to the {power}" if power != 1 else "")


def _spellings(name):
    return dict.fromkeys((name, SHORT.get(name, name)))


def _count(word, text):
    return len(re.findall(rf"(?<!\w){re.escape(word)}(?!\w)", text))


def _key(law, symbols, towards):
    """What a law is on these data: the set of its terms, each the sorted list of its factors."""
    terms = _split(law, " + ", " - ")
    return frozenset(tuple(sorted(_factors(term, symbols, towards))) for term in terms)


def _factors(term, symbols, towards):
    match = _TERM.fullmatch(term)
    product = _bare(match[1]) if match else term
    is_sum = len(_split(product, " + ", " - ")) > 1
    for factor in (product,) if is_sum else map(_bare, _split(product, " * ")):
        if any(re.fullmatch(_power_of(symbol), factor) for symbol in symbols):
            continue
        yield "along the motion" if factor in towards else factor


def _power_of(symbol):
    """A pattern of the powers of a symbol: ``m_i``, ``m_i^2``, ``inverse(m_i^2)``."""
    power = rf"{re.escape(symbol)}(?:\^-?\d+)?"
    return rf"{power}|inverse\({power}\)"


def _bare(text):
    """A product without brackets about all of it."""
    while text.startswith("(") and text.endswith(")") and _closes(text) == len(text) - 1:
        text = text[1:-1]
    return text


def _closes(text):
    """Where the bracket closes that a text begins with."""
    depth = 0
    for k, letter in enumerate(text):
        depth += (letter == "(") - (letter == ")")
        if not depth:
            return k
    return len(text)


def _split(text, *marks):
    """Parts of a text between marks outside of all brackets."""
    parts, depth, begin, k = [], 0, 0, 0
    while k < len(text):
        depth += (text[k] in "([") - (text[k] in ")]")
        mark = next((m for m in marks if not depth and text.startswith(m, k)), None)
        if mark:
            parts.append(text[begin:k])
            begin = k = k + len(mark)
        else:
            k += 1
    return [*parts, text[begin:]]
