"""What the loop says of a cause that it does not list, judged by codes, laws and directions."""

import re

import numpy as np
from causes import Judge, causes_of, is_adopted

from bsp_gp.errors import BspError
from bsp_gp.physics.force import ForceLaw

OUTCOMES = ("fact", "class", "effective", "open", "neighbour", "wrong", "missed")
ORDER = ("wrong", "neighbour", "fact", "class", "effective", "open")
"""In which rounds count."""
OUTCOMES_OF_NULL = ("right_null", "false_adoption", "false_alarm")
UNSETTLED = ("seen, not adopted", "cannot tell")
PARALLEL = 0.9
"""Mean cosine from which on two forces act along one line."""
NO_ROW = re.compile(r"\[(body|scene)\]")


class Referee:
    """Compares causes with the foreign force of one data set.

    Parameters
    ----------
    dataset : Dataset
        Exact.
    truth : Truth
    declared : tuple of str
    near : tuple of str
        Codes of causes that are near the truth whatever they say.
    """

    def __init__(self, dataset, truth, declared, near=()):
        self.judge, self.near = Judge(dataset, truth, declared), near
        self.n_dims = dataset.n_dims

    def is_right(self, cause):
        """Whether a cause has the form of the truth."""
        try:
            return self.judge.is_form(cause)
        except BspError:  # these data have no such direction
            return False

    def is_law(self, law):
        """Whether a whole law is the truth."""
        return self.judge.refitted(law) is not None

    def is_near(self, cause):
        """Whether a cause acts where the truth acts: along one line with it, at every instant."""
        if cause.code in self.near:
            return True
        if cause.code.startswith("constant_per_"):
            cause = type(cause)("law", NO_ROW.sub("", cause.text))
        terms, start = self.judge.terms(cause)
        return bool(terms) and all(self._is_parallel(term, start) for term in terms)

    def _is_parallel(self, term, start):
        known = {name: start[name] for name in term.formula.constants}
        with np.errstate(all="ignore"):
            try:
                own = self.judge.acceleration(ForceLaw((term,), known))
            except BspError:
                return False
        own, true = (a.reshape(-1, self.n_dims) for a in (own, self.judge.missing))
        sizes = (np.linalg.norm(own, axis=1) * np.linalg.norm(true, axis=1)).sum()
        return bool(np.abs((own * true).sum(axis=1)).sum() >= PARALLEL * sizes > 0)


def judge_foreign(report, referee, alpha):
    """Outcome of a set whose cause the loop does not list, and what it told of.

    A form is stated as fact where one is adopted that is told apart from all rivals. Of several
    rounds the worst counts, then the most definite; what a final law makes true is right.

    Parameters
    ----------
    report : LoopReport
    referee : Referee
    alpha : float
        What noise alone shows as often is not told of.

    Returns
    -------
    dict
        outcome, code, probability, told, right, n_class, is_class_without_truth: the probability,
        and whether it is right, of the first name that is told.
    """
    rounds = [done for done in report.rounds if causes_of(done) and done.missing.p_value <= alpha]
    adopted = [done for done in rounds if is_adopted(done)]
    is_law = bool(adopted) and referee.is_law(report.law)
    found = [_judged(done, referee, is_law) for done in rounds]
    outcome = next((name for name in ORDER if name in found), None)
    if outcome is None:
        outcome = "open" if _is_open(report, referee) else "missed"
    causes = causes_of(rounds[0]) if rounds else [None]
    first = causes[0]
    return {
        "outcome": outcome, "code": first.code if first else _code_of_noise(report),
        "probability": rounds[0].effect.probability if first else np.nan,
        "told": str(first) if first else "",
        "right": first is not None and (is_law or referee.is_right(first)),
        "n_class": len({str(cause) for cause in causes}) if first else 0,
        "is_class_without_truth": any(
            done.adopted and one == "open" for done, one in zip(rounds, found, strict=True)
        ),
    }  # fmt: skip


def _judged(done, referee, is_law):
    """Outcome of one round."""
    causes = causes_of(done)
    is_right = is_law and done.adopted
    is_right = is_right or any(map(referee.is_right, causes))
    is_fact = done.adopted and done.verdict == "effect adopted" and done.effect.is_fact
    if done.adopted and done.verdict == "effective law":
        return "effective"
    if is_fact and not is_right:
        return "neighbour" if referee.is_near(causes[0]) else "wrong"
    if is_right and (done.adopted or done.verdict == "cannot tell"):
        is_alone = is_fact and (is_law or referee.is_right(causes[0]))
        return "fact" if is_alone else "class"
    return "open"


def _is_open(report, referee):
    """Whether a report that tells of no cause leaves it open, or calls it noise where it may."""
    if any(done.effect and done.effect.code == "noise" and done.adopted for done in report.rounds):
        return "noise" in referee.near
    return report.verdict in UNSETTLED


def _code_of_noise(report):
    return next((done.effect.code for done in report.rounds if done.effect), "")


def judge_null(report, noise):
    """Outcome of a set that lacks nothing but white noise, and whether its noise is named.

    Parameters
    ----------
    report : LoopReport
    noise : Noise

    Returns
    -------
    dict
        outcome, code, probability, noise_named.
    """
    adopted = [done for done in report.rounds if is_adopted(done)]
    false = [done for done in adopted if done.effect.code not in noise.causes]
    if false:
        outcome = "false_adoption"
    elif any(done.verdict in UNSETTLED for done in report.rounds):
        outcome = "false_alarm"
    else:
        outcome = "right_null"
    findings = {finding["code"] for done in report.rounds for finding in done.noise_findings}
    first = (false or adopted or [None])[0]
    return {
        "outcome": outcome, "code": first.effect.code if first else _code_of_noise(report),
        "probability": first.effect.probability if first else np.nan,
        "told": first.effect.name if first else "", "right": bool(adopted) and not false,
        "noise_named": bool(findings & set(noise.codes)) or len(adopted) > len(false),
        "findings": " ".join(sorted(findings)),
    }  # fmt: skip
