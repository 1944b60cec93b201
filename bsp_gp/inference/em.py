"""EM over laws and latents (paper, section 3.3), with a profile beam.

E-step: posterior of the latents given the law. M-step: a search on the regression averaged over
posterior draws proposes laws; the beam refits latents and constants of the best of them jointly
and compares. Every start begins with zero force, under which the posterior is the prior: the
first M-step sees draws from the prior, never its mean (equal latents look like constants).
"""

import time
from dataclasses import dataclass, field, replace

import numpy as np

from bsp_gp.errors import FitError, SettingsError
from bsp_gp.inference.beam import Beam, Contender
from bsp_gp.inference.e_step import EStep, infer, prior_posterior, refine
from bsp_gp.inference.m_step import Exhaustive, averaged_regression
from bsp_gp.physics.force import ForceLaw
from bsp_gp.randomness import generator
from bsp_gp.threads import one_thread

CLASS_NATS = 3.0
"""Laws within this many nats of the best fit as well: the class that the data do not separate."""
NOTHING_TO_GAIN = 1e-3
"""A loss (nats) below which no other law can be better by anything that matters."""


@dataclass(frozen=True)
class EmSettings:
    """Settings of EM.

    Attributes
    ----------
    n_starts : int
        Different prior draws to begin from; fewer are used once nothing is left to gain.
    n_draws : int
        Posterior draws over which the M-step averages.
    max_iterations : int
        Per start.
    n_best, n_reserved : int
        Places of the beam, see `bsp_gp.inference.beam.Beam`.
    beta : float
        Weight of the complexity of a law, nats per nat. Next to nothing for exact data, where a
        likelihood's sigma is nominal; 1 (the prior of the grammar) where the noise is real:
        `for_noise`.
    use_beam : bool
        False is the ablation "EM alone": the best law of the M-step is taken as it is.
    e_step : EStep
        Between iterations.
    final : EStep or None
        After the last; None keeps the posterior of the best start's last iteration.
    refine : bool
        Whether constants and latents of the found law are sampled together at the end.
    tolerance : float
        EM stops when the expected log joint rises by less, nats.
    """

    n_starts: int = 3
    n_draws: int = 3
    max_iterations: int = 6
    n_best: int = 15
    n_reserved: int = 40
    beta: float = 1e-6
    use_beam: bool = True
    e_step: EStep = field(default_factory=lambda: EStep(n_eff=200, max_steps=1500))
    final: EStep | None = field(default_factory=lambda: EStep(n_eff=1000))
    refine: bool = True
    tolerance: float = 0.1

    @classmethod
    def for_noise(cls, likelihood, **changes):
        """Settings with the weight of the complexity that fits a likelihood."""
        return cls(beta=1.0 if likelihood.kind == "gls" else cls.beta, **changes)

    def __post_init__(self):
        for name in ("n_starts", "n_draws", "max_iterations", "n_best"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} must be at least 1, got {getattr(self, name)!r}")


@dataclass(frozen=True, eq=False)
class EmIteration:
    """One round of E and M, kept for the trace.

    Attributes
    ----------
    start, iteration : int
        Iteration 0 is the prior under zero force.
    loss : float
        Of the joint refit (or, for EM alone, the averaged loss of the M-step), nats.
    expected_log_joint : float
        Mean over the posterior of log p(data, latents | law) - beta * complexity, nats.
    n_scored : int
        Laws scored by the M-step.
    posterior : Posterior
    """

    start: int
    iteration: int
    law: ForceLaw
    law_text: str
    loss: float
    expected_log_joint: float
    n_scored: int
    posterior: object
    seconds: float


@dataclass(frozen=True, eq=False)
class EmResult:
    """Outcome of EM.

    Attributes
    ----------
    contenders : tuple of Contender
        All laws that were refitted, lowest cost first.
    posterior : Posterior
        Of the latents given the law.
    joint : Posterior or None
        Of latents and constants together.
    """

    law: ForceLaw
    best: Contender
    contenders: tuple[Contender, ...]
    posterior: object
    joint: object
    trace: tuple[EmIteration, ...]
    n_scored: int
    seconds: float
    notes: tuple[str, ...] = ()

    def equivalents(self):
        """Laws within `CLASS_NATS` of the best: the class that the data do not separate."""
        return tuple(c for c in self.contenders if c.loss <= self.contenders[0].loss + CLASS_NATS)

    def text(self, most=12):
        """Law, class and posterior as text for a terminal."""
        lines = [f"law: F_i = {self.law.text()}", f"loss: {self.best.loss:.6g} nats"]
        rivals = [c for c in self.equivalents() if c is not self.best]
        if rivals or self.best.ties:
            n_equal = len(rivals) + len(self.best.ties)
            lines.append(
                f"{n_equal} other law(s) fit as well ({CLASS_NATS:g} nats); with unknown "
                "properties these data do not separate them:"
            )
            equal = [f"    {t!r}"[:-1].replace("<", "", 1) for t in self.best.ties]
            lines += (equal + [f"    {c.law.text()}   (+{c.loss - self.best.loss:.2g})"
                               for c in rivals])[:most]  # fmt: skip
        table = self.posterior.summary().drop(columns="truth")
        lines += ["", table.to_string(float_format=lambda v: f"{v:.4g}")]
        lines += [f"Note: {note}" for note in self.notes]
        return "\n".join(lines)


def fit_em(
    scenes, latents, grammar, likelihood, *, rng=None, settings=None, m_step=None, base=None,
    kinds=None, progress=None,
):  # fmt: skip
    """Learn a law and the unknown properties together.

    Parameters
    ----------
    scenes : sequence of Scene
    latents : Latents
    grammar : Grammar
        Masked to the data.
    likelihood : Likelihood
        The M-step uses its one-step form.
    rng : numpy.random.Generator, int or None
    settings : EmSettings, optional
    m_step : object with ``candidates``, optional
        See `bsp_gp.inference.m_step`; exhaustive by default.
    base : ForceLaw, optional
        Terms that are there already; what is found is added to them.
    kinds : sequence of str, optional
        Kinds of law, by default all of the grammar.
    progress : callable, optional
        ``progress(text)``.

    Returns
    -------
    EmResult

    Raises
    ------
    FitError
        If no law of the grammar has a finite value on the data.
    """
    started = time.perf_counter()
    with one_thread():
        run = _Em(
            tuple(scenes), latents, grammar, likelihood, settings or EmSettings(),
            m_step or Exhaustive(), base or ForceLaw(), tuple(kinds or grammar.start),
            progress or (lambda text: None),
        )  # fmt: skip
        return run.result(generator(rng), started)


@dataclass(eq=False)
class _Em:
    """One run; fields are what `fit_em` takes, without defaults."""

    scenes: tuple
    latents: object
    grammar: object
    likelihood: object
    settings: EmSettings
    m_step: object
    base: ForceLaw
    kinds: tuple
    progress: object

    def __post_init__(self):
        self.latents, _ = self.latents.of_scenes([scene.name for scene in self.scenes])
        self.trace, self.n_scored, own = [], 0, self.settings
        self.beam = Beam(
            self.scenes, self.latents, self.likelihood, n_best=own.n_best,
            n_reserved=own.n_reserved, beta=own.beta, base=self.base,
        )  # fmt: skip

    def result(self, rng, started):
        final_rng, joint_rng, *start_rngs = rng.spawn(2 + self.settings.n_starts)
        bests = []
        for start, stream in enumerate(start_rngs):
            bests.append(self._run(start, stream))
            if self._is_settled(bests):
                break
        best = min(bests, key=lambda c: c.cost)
        posterior = self._final(best, final_rng)
        notes = list(posterior.notes)
        joint = self._joint(best, joint_rng, notes)
        ranked = self.beam.ranked() if self.settings.use_beam else sorted(
            bests, key=lambda c: c.cost
        )  # fmt: skip
        return EmResult(
            best.law, best, tuple(ranked), posterior, joint, tuple(self.trace), self.n_scored,
            time.perf_counter() - started, tuple(dict.fromkeys(notes)),
        )  # fmt: skip

    def _final(self, best, rng):
        mine = [step for step in self.trace if step.law is best.law]
        if self.settings.final is None and mine:
            return mine[-1].posterior
        self.progress("posterior under the found law")
        return infer(
            best.law, self.scenes, self.latents, self.likelihood.for_posterior, rng=rng,
            settings=self.settings.final,
        )  # fmt: skip

    def _joint(self, best, rng, notes):
        if not self.settings.refine or self.latents.is_discrete.any():
            return None
        self.progress("constants and latents together")
        try:
            joint = refine(
                best.profile, self.scenes, self.latents, self.likelihood.for_posterior, rng=rng,
                settings=self.settings.final,
            )  # fmt: skip  (None: the defaults)
        except FitError as error:
            notes.append(str(error))
            return None
        notes.extend(f"{note} (constants and latents together)" for note in joint.notes)
        return joint

    def _is_settled(self, bests):
        """Nothing left to gain, or two starts that agree on the best law."""
        best = min(bests, key=lambda c: c.cost)
        if self.settings.use_beam and best.loss < NOTHING_TO_GAIN:
            return True
        same = [c for c in bests if c.formula == best.formula]
        return len(same) >= 2

    def _run(self, start, rng):
        """One start: zero force first, then M and E in turn; its best contender."""
        settings = self.settings
        posterior = prior_posterior(self.latents, rng=rng)
        self.trace.append(EmIteration(start, 0, self.base, "0", np.nan, np.nan, 0, posterior, 0.0))
        best, joint_before = None, -np.inf
        for iteration, stream in enumerate(rng.spawn(settings.max_iterations), 1):
            began = time.perf_counter()
            draw_rng, m_rng, beam_rng, e_rng = stream.spawn(4)
            self.progress(f"start {start + 1}, iteration {iteration}: M-step")
            found, scored = self._m(posterior, draw_rng, m_rng, beam_rng)
            self.n_scored += scored
            settled = best is not None and found.formula == best.formula
            if best is None or found.cost < best.cost or not settings.use_beam:
                best = found
            if settings.use_beam and best.loss < NOTHING_TO_GAIN:
                settled = True
            self.progress(f"start {start + 1}, iteration {iteration}: E-step")
            posterior = infer(
                best.law, self.scenes, self.latents, self.likelihood, rng=e_rng,
                settings=settings.e_step, previous=posterior,
            )  # fmt: skip
            expected = float(posterior.weights @ posterior.log_prob)
            expected -= settings.beta * best.complexity
            self.trace.append(EmIteration(
                start, iteration, best.law, best.law.text(), float(best.loss), expected, scored,
                posterior, time.perf_counter() - began,
            ))  # fmt: skip
            if settled or (iteration > 1 and expected < joint_before + settings.tolerance):
                break
            joint_before = expected
        return best

    def _m(self, posterior, draw_rng, m_rng, beam_rng):
        """Best contender of one M-step."""
        draws, weights = posterior.thinned(self.settings.n_draws, rng=draw_rng)
        regression = averaged_regression(self.scenes, self.latents, draws, weights, self.likelihood)
        candidates, scored = self.m_step.candidates(
            regression, self.grammar, self.kinds, self.base, m_rng
        )
        if not candidates:
            raise FitError(
                f"no law of grammar {self.grammar.name} has a finite value on these data"
            )
        starts = np.concatenate([draws, posterior.draw(3, rng=draw_rng)])
        if not self.settings.use_beam:
            return self._plain(candidates, starts), scored
        ranked = self.beam.refit(self.beam.choose(candidates), starts, rng=beam_rng)
        if not ranked:
            raise FitError("no law of the beam has a finite value at any values of the latents")
        return ranked[0], scored

    def _plain(self, candidates, starts):
        """EM alone: the M-step's best law with the M-step's constants."""
        beta = self.settings.beta
        best = min(candidates, key=lambda c: c.loss + beta * c.complexity)
        self.beam.contenders.clear()
        self.beam.refit([best], starts, rng=np.random.default_rng(0))
        contender = self.beam.ranked()[0]
        law = self.beam.law_of(best)
        return replace(contender, law=law, cost=best.loss + beta * best.complexity)
