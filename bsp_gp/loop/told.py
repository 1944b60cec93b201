"""Results in the units in which the data were declared; what is stored stays SI."""

import re
from dataclasses import replace

import numpy as np

from bsp_gp.errors import UnitError
from bsp_gp.units import BASE, FORCE, Unit, parse_unit

_ASTRONOMICAL = 1e10
"""Metres of a unit of length from which on kilograms are told as masses of the Sun."""
_SUN = "Msun"
_LEAST_TIME = 60.0
"""Seconds of a unit of time that rates are told in: nobody reads metres per square millisecond."""
_WITHOUT_UNIT = "a constant without a unit is a pure number, or it is in SI"
_KINDS = {"m": "length", "s": "time", "kg": "mass"}
_NUMBER = re.compile(r"(?<![\w.])([+-]?\d+\.?\d*(?:[eE][+-]?\d+)?) \[([^\]]*)\]")
_WHOLE = "§"
"""Before a base unit that stands for a unit of several."""
_COUNT = re.compile(r"^\s*[\d.][\d.eE+-]*\s*")
_FACTOR = re.compile(r"([^\s^/()]+)(?:\^(?:(-?\d+)|\((-?\d+(?:/\d+)?)\)))?")


class Told:
    """Units of a data set in place of SI.

    Parameters
    ----------
    declared : mapping of str to str
        As ``[units]`` has them.
    symbols : mapping of str to str
        Base units that are not calibrated, and what is printed in their place.
    """

    def __init__(self, declared, symbols):
        self.symbols = dict(symbols)
        self.own = {}
        for base, kind in _KINDS.items():
            found = None if base in self.symbols else _read(declared.get(kind, ""), base)
            if found is not None and (base != "s" or found[0] >= _LEAST_TIME):
                self.own[base] = found
        self.is_astronomical = self.own.get("m", (0.0, ""))[0] >= _ASTRONOMICAL

    def unit(self, text):
        """Factor of numbers in a unit, and how that unit is told.

        Parameters
        ----------
        text : str
            As `Unit.text` writes it.

        Returns
        -------
        (float, str)
        """
        head, per, tail = text.partition(" per ")
        exponents = self._exponents(head)
        own = dict(self.own)
        if self.is_astronomical and "kg" in head:  # also where masses of bodies are not calibrated
            own["kg"] = self.own.get("kg", (parse_unit(_SUN)[0], _SUN))
        if exponents is None or not any(exponents.get(base) for base in own):
            return 1.0, text
        factor, names = 1.0, dict(self.symbols)
        for base, (scale, name) in own.items():
            factor /= scale ** float(exponents.get(base, 0))
            names[base] = name
        return factor, Unit.of(**exponents).text(names) + per + tail

    def force(self, text):
        """The same of a force, of which newtons stay newtons on Earth: not kg cm/s^2."""
        is_newton = text == FORCE.text() and not self.is_astronomical
        return (1.0, text) if is_newton else self.unit(text)

    def constant(self, constant):
        """A `ConstantEstimate` in them."""
        factor, unit = self.unit(constant.unit)
        return replace(
            constant, unit=unit, **{n: getattr(constant, n) * factor for n in _VALUES}
        )

    def errors(self, errors):
        """`Errors` in them; None stays None."""
        if errors is None:
            return None
        (place, unit), (push, of) = self.unit(errors.unit), self.unit(errors.acceleration_unit)
        factors = dict.fromkeys(
            ("one_step_nrmse", "rollout_rmse", "endpoint", "endpoint_mean"), place
        ) | {"residual_acceleration": push}  # fmt: skip
        return replace(
            errors, unit=unit, acceleration_unit=of,
            **{name: getattr(errors, name) * factor for name, factor in factors.items()},
            intervals={
                name: tuple(end * factors.get(name, 1.0) for end in ends)
                for name, ends in errors.intervals.items()
            },
        )  # fmt: skip

    def bound(self, bound):
        """Put what may still be hidden, as pages read it, into them."""
        if bound is not None and bound.force is not None:
            factor, bound.unit = self.force(bound.unit)
            bound.force *= factor

    def overlay(self, overlay):
        """Tracks in them."""
        place, time = self.factor("m"), self.factor("s")
        parts = {n: place * np.asarray(getattr(overlay, n), dtype=float)
                 for n in ("observed", "declared", "adopted")}  # fmt: skip
        return replace(overlay, times=time * np.asarray(overlay.times, dtype=float), **parts)

    def residuals(self, table):
        """A table of residual accelerations in them; None stays None."""
        if table is None:
            return None
        place, time = self.factor("m"), self.factor("s")
        factors = {"t": time, "distance": place, "speed": place / time}
        changed = {
            name: table[name] * factors.get(name, place / time**2)
            for name in table.columns if name not in ("scene", "entity", "split")
        }  # fmt: skip
        return table.assign(**changed)

    def trace(self, trace):
        """Where a residual force is, in them; None stays None."""
        if trace is None or not trace.channels:
            return trace
        place, time = self.factor("m"), self.factor("s")
        variable, push = trace.channels[0].variable, place / time**2
        at = {"time": time, "speed": place / time}.get(variable, place)
        return replace(
            trace, values=tuple(push * v for v in trace.values),
            errors=tuple(push * e for e in trace.errors),
            at=trace.at if variable in ("body", "scene") else tuple(at * x for x in trace.at),
        )  # fmt: skip

    def scenes(self, rows):
        """Position errors of scenes in them."""
        place = self.factor("m")
        return [{k: place * v if k in ("before", "after") and v is not None else v
                 for k, v in row.items()} for row in rows]  # fmt: skip

    def noise(self, noise):
        """What is said of the noise in them."""
        factor, unit = self.unit(noise.get("unit") or "")
        size = noise.get("sigma")
        if factor == 1.0 or size is None:
            return noise
        many = isinstance(size, list | tuple)
        size = [None if x is None else x * factor for x in (size if many else [size])]
        return {**noise, "sigma": size if many else size[0], "unit": unit}

    def details(self, details):
        """Draws of an unseen body, and the map of it, in them."""
        if "draws" not in details:
            return details
        place, strength = self.factor("m"), self.unit(details["unit"])
        units = [self.unit(details.get("units", {}).get(name, "")) for name in details["names"]]
        factors = np.array([factor for factor, _ in units[:-1]] + [strength[0]])
        of_places = {name: (place * np.asarray(details[name], dtype=float)).tolist()
                     for name in ("centre", "radius_90", "track", "seen_at")
                     if name in details}  # fmt: skip
        visible = {
            name: (place * np.array(track, dtype=float)).tolist()
            for name, track in details["visible"].items()
        }
        return {
            **details, **of_places, "visible": visible, "unit": strength[1],
            "draws": (factors * np.asarray(details["draws"])).tolist(),
            "best": (factors * np.asarray(details["best"])).tolist(),
            "length_unit": self.unit(details["length_unit"])[1],
            "epoch": details.get("epoch", 0.0) * self.factor("s"),
            "time_unit": self.unit("s")[1],
        }  # fmt: skip

    def factor(self, base):
        """Of numbers in a base unit."""
        return 1.0 / self.own[base][0] if base in self.own else 1.0

    def text(self, law):
        """A law with the numbers that carry a unit in them."""

        def told(match):
            factor, unit = self.unit(match[2])
            return f"{float(match[1]) * factor:.6g} [{unit}]" if factor != 1.0 else match[0]

        return _NUMBER.sub(told, law) if self.own else law

    def _exponents(self, text):
        """Powers of base units of a unit that is written out; None if it is no such."""
        names = {base: base for base in BASE} | {s: base for base, s in self.symbols.items()}
        for base, symbol in self.symbols.items():
            if "/" in symbol:  # a velocity in the place of a length is one word
                names[_WHOLE + base] = base
                text = text.replace(symbol, _WHOLE + base)
        out, (above, _, below) = {}, text.partition("/")
        for sign, part in ((1, above), (-1, below.strip("()"))):
            for name, power, fraction in _FACTOR.findall(part):
                if name == "1":
                    continue
                if name not in names or "/" in fraction:
                    return None
                out[names[name]] = out.get(names[name], 0) + sign * int(power or fraction or 1)
        return out


_VALUES = ("value", "low", "high")


def _read(text, base):
    """Scale and name of a unit of a base dimension; None if it is SI or none.

    Of counts of so many micrometres each, what they count: 0.16 um are told in um.
    """
    text = _COUNT.sub("", text).strip()
    if not text or text == base:
        return None
    try:
        scale, unit = parse_unit(text)
    except UnitError:
        return None
    return (scale, text) if unit == Unit.of(**{base: 1}) and scale != 1.0 else None


def fit_retold(found, units):
    """A fitted law as people read it, in the units of the data."""
    told = Told(units.declared, units.symbols)
    is_open = bool(told.own) and any(not constant.unit for constant in found.constants)
    return replace(
        found, notes=(*found.notes, _WITHOUT_UNIT) if is_open else found.notes,
        constants=tuple(map(told.constant, found.constants)),
        errors=told.errors(found.errors), noise=told.noise(found.noise),
    )  # fmt: skip


def factors_of(law, units):
    """What one unit of a constant of a law, as it is told, is in SI, by name."""
    told = Told(units.declared, units.symbols)
    return {
        name: 1.0 / told.unit(units.text(unit))[0] for name, unit in law.constant_units.items()
    }


def retold(report):
    """A report as pages read it, told in the units of the data.

    Parameters
    ----------
    report : SimpleNamespace
        Of `page_of`.
    """
    told = Told(report.dataset.get("units") or {}, report.dataset.get("symbols") or {})
    if not told.own and not told.is_astronomical:
        return report
    told.bound(report.bound)
    for r in report.rounds:
        r.before, r.after, r.floor = map(told.errors, (r.before, r.after, r.floor))
        r.held_out, r.trace = told.scenes(r.held_out), told.trace(r.trace)
        r.time_unit = told.unit("s")[1]
        factor, unit = told.unit(r.missing.unit)
        r.missing = replace(r.missing, detectable=r.missing.detectable * factor, unit=unit)
        told.bound(r.bound)
        if r.effect is not None:
            r.effect.constants = tuple(map(told.constant, r.effect.constants))
            r.effect.law = told.text(r.effect.law)
            if details := r.effect.details:
                r.effect.details = told.details(details)
    report.constants = tuple(map(told.constant, report.constants))
    report.overlays = tuple(map(told.overlay, report.overlays))
    report.residuals = told.residuals(report.residuals)
    report.noise = told.noise(report.noise)
    report.law_text = told.text(report.law_text)
    report.total = {
        **report.total,
        **{name: told.errors(report.total[name]) for name in ("before", "after", "floor")},
    }
    return report
