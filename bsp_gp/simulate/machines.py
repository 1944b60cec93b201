"""Made-up machines: pendulums, an arm, a driven cart, a turntable, a craft with a rotor, by scipy.

Each has an equation of motion of its own, never that of our engine, columns as a logger would write
them, a declared model, and effects that the model may lack.
"""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.integrate import solve_ivp

from bsp_gp.errors import SettingsError

G = 9.81
CREEP = 1e-4
"""Rate below which dry friction fades, so that an integrator can stop a body."""
EXACT = {"rtol": 1e-9, "atol": 1e-11}


def _dry(rate):
    return np.tanh(rate / CREEP)


@dataclass(frozen=True)
class Machine:
    """What a preset of a machine is.

    Attributes
    ----------
    numbers : dict of str to float
        That ``--set`` changes.
    effects : dict of str to (float, tuple of str)
        Name -> usual strength, and the laws that say it, with {} for the strength.
    declared : tuple of str
        Laws that all worlds follow.
    units : dict of str to str
        ``[units]`` of the table.
    start : callable
        ``start(rng, numbers)``, the state at first.
    rate : callable
        ``rate(t, state, numbers, effects, log)``.
    shown : callable
        ``shown(states, numbers)``, columns that are measured.
    logged : callable
        ``logged(rng, span, numbers)``, inputs as functions of the time.
    """

    numbers: dict
    effects: dict
    declared: tuple
    units: dict
    start: object
    rate: object
    shown: object
    logged: object = lambda rng, span, n: {}
    up: str = ""
    seconds: float = 8.0
    dt: float = 0.02
    noise: float = 1e-3


def _smooth(rng, span, middle, size, n=4):
    """An input that swings about its middle."""
    rates, phases = rng.uniform(2, 9, n) / span * np.pi, rng.uniform(0, 2 * np.pi, n)

    def at(t):
        return middle + size / np.sqrt(n) * np.sin(np.multiply.outer(t, rates) + phases).sum(-1)

    return at


def _pendulum(t, z, n, e, log):
    w = z[1]
    speed = n["length"] * w
    slow = e.get("drag", 0) * w + e.get("quadratic_drag", 0) * abs(speed) * w
    slow += e.get("friction", 0) / n["length"] * _dry(w)
    return [w, -G / n["length"] * np.sin(z[0]) - slow]


def _on_rod(z, n):
    x, y = n["length"] * np.sin(z[0]), -n["length"] * np.cos(z[0])
    return {"x": n["pivot_x"] + x, "y": n["pivot_y"] + y}


def _arm(t, z, n, e, log):
    w = z[1]
    slow = e.get("viscous", 0) * w + e.get("quadratic", 0) * abs(w) * w + e.get("dry", 0) * _dry(w)
    return [w, -n["rate"] ** 2 * np.sin(z[0]) - slow]


def _double(t, z, n, e, log):
    q, w = z[:2], z[2:]
    l1, l2, m1, m2 = (n[k] for k in ("length1", "length2", "mass1", "mass2"))
    gap, c, both = q[0] - q[1], m2 * l1 * l2, m1 + m2
    inertia = np.array([both * l1**2, m2 * l2**2])
    coupled = c * np.cos(gap)
    mass = np.array([[inertia[0], coupled], [coupled, inertia[1]]])
    push = -G * np.array([both * l1, m2 * l2]) * np.sin(q)
    push += c * np.sin(gap) * np.array([-(w[1] ** 2), w[0] ** 2])
    push -= inertia * (e.get("viscous", 0) * w + e.get("dry", 0) * _dry(w))
    return [*w, *np.linalg.solve(mass, push)]


def _cart(t, z, n, e, log):
    v = z[1]
    slow = e.get("drag", 0) * v + e.get("quadratic_drag", 0) * abs(v) * v
    slow += e.get("friction", 0) * n["mass"] * _dry(v) + e.get("spring", 0) * z[0]
    return [v, (log["motor"](t) - slow) / n["mass"]]


def _turntable(t, z, n, e, log):
    (x, y), (vx, vy), w = z[:2], z[2:], e.get("rotation", 0)
    stiff, drag = n["stiffness"], e.get("drag", 0)
    return [
        vx, vy, -stiff * x - drag * vx + 2 * w * vy + w * w * x,
        -stiff * y - drag * vy - 2 * w * vx + w * w * y,
    ]  # fmt: skip


def _craft(t, z, n, e, log):
    wind = np.array([log["wind_x"](t), log["wind_y"](t)])
    push = log["thrust"](t) * np.array([-np.sin(log["tilt"](t)), np.cos(log["tilt"](t))])
    air = np.asarray(z[2:]) - wind
    push = push - e.get("drag", 0) * air
    push = push - e.get("quadratic_drag", 0) * np.linalg.norm(air) * air
    return [*z[2:], *(push / n["mass"] - np.array([0.0, G]))]


def _flight(rng, span, n):
    logs = {"thrust": _smooth(rng, span, G * n["mass"], 0.1 * G * n["mass"]),
            "tilt": _smooth(rng, span, 0.0, 0.15)}  # fmt: skip
    return logs | {f"wind_{axis}": _smooth(rng, span, rng.normal(0, 1), 1.0) for axis in "xy"}


def _swing(rng, n, size=(0.5, 1.2)):
    return [rng.choice([-1, 1]) * rng.uniform(*size), rng.normal(0, 0.3)]


_XY = {"length": "m", "time": "s", "mass": "kg"}
MACHINES = {
    "pendulum": Machine(
        {"length": 0.8, "pivot_x": 0.1, "pivot_y": 1.5},
        {"drag": (0.05, ("-{} [1/s] * m_i * v_i",)),
         "quadratic_drag": (0.08, ("-{} [1/m] * m_i * norm(v_i) * v_i",)),
         "friction": (0.05, ("-{} [m/s^2] * m_i * normalize(v_i)",))},
        ("9.81 [m/s^2] * m_i * down", "norm(p_i - ({pivot_x}, {pivot_y})) = {length}"), _XY,
        _swing, _pendulum, _on_rod, up="y",
    ),
    "arm": Machine(
        {"rate": 7.0},
        {"viscous": (0.06, ("-{} [1/s] * m_i * omega_i",)),
         "quadratic": (0.04, ("-{} * m_i * abs(omega_i) * omega_i",)),
         "dry": (0.08, ("-{} [1/s^2] * m_i * sign(omega_i)",))},
        ("-k * m_i * sin(theta_i)",), {"theta": "rad", "t": "s"},
        _swing, _arm, lambda z, n: {"theta": z[0]},
    ),
    "double_pendulum": Machine(
        {"length1": 0.3, "length2": 0.25, "mass1": 0.2, "mass2": 0.1},
        {"viscous": (0.06, ("-{} [1/s] * m_i * omega_i",)),
         "dry": (0.1, ("-{} [1/s^2] * m_i * sign(omega_i)",))},
        ("-k[body] * m_i * sin(theta_i)", "linked(theta1, theta2)"),
        {"theta1": "rad", "theta2": "rad", "t": "s"},
        lambda rng, n: [*rng.uniform(-0.9, 0.9, 2), *rng.normal(0, 0.5, 2)], _double,
        lambda z, n: {"theta1": z[0], "theta2": z[1]}, seconds=4.0, dt=0.01,
    ),
    "driven_cart": Machine(
        {"mass": 0.5},
        {"drag": (0.2, ("-{} [kg/s] * v_i",)),
         "quadratic_drag": (0.4, ("-{} [kg/m] * norm(v_i) * v_i",)),
         "friction": (0.1, ("-{} [m/s^2] * m_i * normalize(v_i)",)),
         "spring": (0.5, ("-{} [N/m] * (p_i - origin)",))},
        ("motor * e_x",), {"x": "m", "t": "s", "motor": "N", "mass": "kg"},
        lambda rng, n: [0.0, rng.normal(0, 0.2)], _cart, lambda z, n: {"x": z[0]},
        lambda rng, span, n: {"motor": _smooth(rng, span, 0.0, 0.5)},
    ),
    "turntable": Machine(
        {"stiffness": 4.0},
        {"rotation": (0.3, ("rotating({} [1/s])",)), "drag": (0.1, ("-{} [1/s] * m_i * v_i",))},
        ("-k * m_i * (p_i - origin)",), {"length": "m", "time": "s"},
        lambda rng, n: [*rng.normal(0, 0.4, 2), *rng.normal(0, 0.6, 2)], _turntable,
        lambda z, n: {"x": z[0], "y": z[1]},
    ),
    "quadrotor_lite": Machine(
        {"mass": 0.6},
        {"drag": (0.1, ("-{} [kg/s] * (v_i - wind)",)),
         "quadratic_drag": (0.08, ("-{} [kg/m] * norm(v_i - wind) * (v_i - wind)",))},
        ("9.81 [m/s^2] * m_i * down", "thrust"),
        {**_XY, "thrust_x": "N", "thrust_y": "N", "wind_x": "m/s", "wind_y": "m/s"},
        lambda rng, n: [0.0, 2.0, *rng.normal(0, 0.3, 2)], _craft,
        lambda z, n: {"x": z[0], "y": z[1]}, _flight, up="y", noise=0.005,
    ),
}  # fmt: skip
"""Presets of machines by name."""


@dataclass(frozen=True)
class Made:
    """What was made of a machine: a table, what goes with it, and what really happened."""

    table: pd.DataFrame
    truth: pd.DataFrame
    units: dict
    up: str
    mass: float
    declared: tuple
    acting: tuple
    numbers: dict
    effects: dict


def made_machine(name, rng, *, n_scenes=1, n_frames=None, dt=None, noise=None, numbers=None,
                 effects=None, undeclared=()):  # fmt: skip
    """Make recordings of a machine.

    Parameters
    ----------
    name : str
        One of `MACHINES`.
    dt, noise : float
        Seconds per row; standard deviation of what is measured.
    effects : mapping of str to float or None, optional
        What acts beside the preset; None = at its usual strength.
    undeclared : collection of str
        Those of them that the declared model lacks.

    Raises
    ------
    SettingsError
    """
    machine = MACHINES[name]
    numbers = {**machine.numbers, **_known(name, "number", numbers or {}, machine.numbers)}
    effects = _known(name, "effect", effects or {}, machine.effects)
    effects = {k: machine.effects[k][0] if v is None else v for k, v in effects.items()}
    dt = dt or machine.dt
    t = np.arange(n_frames or round(machine.seconds / dt) + 1) * dt
    noise = machine.noise if noise is None else noise
    tables, truths = [], []
    for k, stream in enumerate(rng.spawn(n_scenes)):
        first, log_rng, errors = stream.spawn(3)
        logs = machine.logged(log_rng, max(t[-1], dt), numbers)
        z = solve_ivp(
            machine.rate, (0, t[-1]), machine.start(first, numbers), t_eval=t, method="LSODA",
            args=(numbers, effects, logs), max_step=dt, **EXACT,
        ).y  # fmt: skip
        shown = machine.shown(z, numbers)
        seen = {c: v + noise * errors.standard_normal(len(t)) for c, v in shown.items()}
        head = {"scene": str(k + 1), "t": t}
        tables.append(pd.DataFrame({**head, **seen, **_columns(logs, t)}))
        truths.append(pd.DataFrame({**head, **shown}))
    laws = {k: tuple(law.format(f"{v:g}") for law in machine.effects[k][1])
            for k, v in effects.items()}  # fmt: skip
    base = tuple(_filled(law, numbers) for law in machine.declared)
    declared = base + sum((laws[k] for k in effects if k not in undeclared), ())
    acting = base + sum(laws.values(), ())
    return Made(
        pd.concat(tables, ignore_index=True), pd.concat(truths, ignore_index=True), machine.units,
        machine.up, numbers.get("mass", np.nan), declared, acting, numbers, effects,
    )  # fmt: skip


def _filled(law, numbers):
    return law.format(**{k: f"{v:g}" for k, v in numbers.items()}) if "{" in law else law


def _columns(logs, t):
    """Inputs as they are logged: a thrust that tilts is a vector."""
    out = {name: log(t) for name, log in logs.items()}
    if "tilt" in out:
        tilt, thrust = out.pop("tilt"), out.pop("thrust")
        out = {"thrust_x": -thrust * np.sin(tilt), "thrust_y": thrust * np.cos(tilt), **out}
    return out


def _known(name, what, given, known):
    for key, value in given.items():
        if key not in known:
            raise SettingsError(f"{name} has no {what} {key!r}; there are {', '.join(known)}")
        if value is not None and not np.isfinite(value):
            raise SettingsError(f"{what} {key} must be a finite number, got {value}")
    return dict(given)
