"""One class with the habits of scikit-learn: fit, predict, score, get_params."""

import inspect

import numpy as np

from bsp_gp.errors import SettingsError
from bsp_gp.fitting.law_fit import fit_law
from bsp_gp.fitting.simulation import simulate_law
from bsp_gp.loop.close import close_loop


class LawRegressor:
    """A force law learned from tracks.

    Parameters
    ----------
    declared : str or sequence of str
        Forces that are believed; their named constants are fitted.
    search : bool
        Whether to look for what they lack; without, the constants are all that is fitted.
    grammar, max_rounds, max_levels, time_limit
        As for `close_loop`.
    rng : numpy.random.Generator, int or None

    Attributes
    ----------
    law_ : ForceLaw
        With its constants; after `fit`, as all that ends in an underscore.
    constants_ : dict of str to float
        Those that all bodies share.
    result_ : LoopReport or LawFit

    Examples
    --------
    >>> model = LawRegressor(["9.81 [m/s^2] * m_i * down"])
    >>> model.fit(data).score(new_data)  # doctest: +SKIP
    0.9998
    """

    def __init__(self, declared=(), *, search=True, grammar="physics", max_rounds=5, max_levels=8,
                 time_limit=None, rng=None):  # fmt: skip
        self.declared = declared
        self.search = search
        self.grammar = grammar
        self.max_rounds = max_rounds
        self.max_levels = max_levels
        self.time_limit = time_limit
        self.rng = rng

    def fit(self, X, y=None):
        """Learn the law of a data set `X`; `y` is not used.

        Returns
        -------
        LawRegressor
            Itself.
        """
        if self.search:
            self.result_ = close_loop(
                X, self.declared, rng=self.rng, grammar=self.grammar, max_rounds=self.max_rounds,
                max_levels=self.max_levels, time_limit=self.time_limit,
            )  # fmt: skip
        else:
            self.result_ = fit_law(X, self.declared, rng=self.rng, time_limit=self.time_limit)
        self.law_ = self.result_.law
        self.constants_ = {c.name: c.value for c in self.result_.constants if not c.entity}
        return self

    def predict(self, X):
        """Positions that the law foresees from the first rows of every scene.

        Returns
        -------
        list of ndarray, shape (T, N, d)
        """
        if not hasattr(self, "law_"):
            raise SettingsError("the law is not learned yet; call fit first")
        return [scene.positions for scene in simulate_law(X, self.law_).scenes]

    def score(self, X, y=None):
        """Part of the variance of the positions of moving bodies that is foreseen (R squared)."""
        left = total = 0.0
        for scene, foreseen in zip(X.scenes, self.predict(X), strict=True):
            seen = scene.positions[:, scene.dynamic]
            left += float(np.nansum(np.square(seen - foreseen[:, scene.dynamic])))
            total += float(np.nansum(np.square(seen - np.nanmean(seen, axis=0))))
        return 1.0 - left / total if total else float("nan")

    def get_params(self, deep=True):
        """The settings by name."""
        names = inspect.signature(type(self).__init__).parameters
        return {name: getattr(self, name) for name in names if name != "self"}

    def set_params(self, **params):
        """Change settings; returns itself."""
        unknown = sorted(set(params) - set(self.get_params()))
        if unknown:
            raise SettingsError(
                f"there is no setting {unknown[0]!r}; allowed are {', '.join(self.get_params())}"
            )
        for name, value in params.items():
            setattr(self, name, value)
        return self

    def __repr__(self):
        defaults = inspect.signature(type(self).__init__).parameters
        told = [f"{k}={v!r}" for k, v in self.get_params().items() if v != defaults[k].default]
        return f"LawRegressor({', '.join(told)})"
