"""What is told of a fit: constants with intervals, errors on held-out data; as JSON can hold it."""

import math
from dataclasses import dataclass, field


@dataclass(frozen=True)
class ConstantEstimate:
    """A fitted constant.

    Attributes
    ----------
    entity : str
        The receiver that it belongs to; "" where it is one for all.
    unit : str
        "" if it cannot be said.
    state : str
        "undetermined" where the data allow any value (of a property: any that its prior does),
        "at_bound" where it lies at the end of what it may be; "unfinished" where the fit was not
        brought to an end, and the value is where it stood; else "".
    """

    name: str
    value: float
    low: float
    high: float
    unit: str = ""
    entity: str = ""
    state: str = ""


@dataclass(frozen=True)
class Errors:
    """Error of one model on held-out data.

    Attributes
    ----------
    residual_acceleration : float
        Root mean square, unit `acceleration_unit`.
    one_step_nrmse : float
        The paper's metric, in `unit`.
    rollout_rmse : float
        Root mean square position error of rollouts from fitted initial states, in `unit`.
    endpoint : float
        Median position error at the end-point row, in `unit`.
    intervals : dict of str to (float, float)
        90 % intervals of the errors, nan where there is none.
    """

    residual_acceleration: float
    one_step_nrmse: float
    rollout_rmse: float
    endpoint: float
    unit: str
    endpoint_mean: float = math.nan
    acceleration_unit: str = ""
    intervals: dict = field(default_factory=dict, compare=False, repr=False)


def plain(value):
    """Turn dataclasses, tuples and numpy numbers into what JSON can hold; nan and inf -> None."""
    if hasattr(value, "__dataclass_fields__"):
        return {name: plain(getattr(value, name)) for name in value.__dataclass_fields__}
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
