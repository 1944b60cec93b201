"""What makes predictions worse is refused; what makes them better, or is needed, stays."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.loop.accounts import Accounts, Ratio
from bsp_gp.loop.criteria import Criteria
from bsp_gp.loop.decide import Decision
from bsp_gp.loop.foresight import Foresight, _is_surely_worse, is_refuted, that_foresee
from bsp_gp.loop.loop import Round
from bsp_gp.loop.table import HeldOut, HypothesisTable, Row
from tests.unit.test_response import GRAVITY, thrown

PUSH = "0.2 [m/s^2] * m_i * e_x"


@pytest.fixture(scope="module")
def world():
    return thrown(n_scenes=6, n_rows=40)


def round_of(number, dataset, before, after, kind="force", status="converged", code="law"):
    hypotheses = {k: Hypothesis.from_laws(dataset, laws) for k, laws in enumerate((before, after))}
    fits = {k: fit(hypothesis, dataset) for k, hypothesis in hypotheses.items()}
    fits[0] = replace(fits[0], status=status)
    best = SimpleNamespace(id=1, kind=kind, code=code, held_out=HeldOut())
    decision = Decision("effect adopted", "adopted", best, True)
    return Round(number, fits[0], None, decision, fits, hypotheses, ())


def foresight(world, test):
    streams = np.random.default_rng(0).spawn(5)
    return Foresight(lambda found, hypothesis: found, world, test, streams)


def looked_at(world, *steps, end=None):
    train, test = replace(world, scenes=world.scenes[:3]), world.scenes[3:]
    rounds = [round_of(k + 1, train, *laws) for k, laws in enumerate(steps)]
    if end is not None:
        rounds.append(replace(rounds[-1], number=len(rounds) + 1, decision=end))
    return that_foresee(rounds, foresight(world, test))


def test_a_cause_that_makes_predictions_worse_is_refused_and_ends_the_rounds(world):
    worse, more = ([GRAVITY], [GRAVITY, PUSH]), ([GRAVITY, PUSH], [GRAVITY, PUSH, PUSH])
    (done,) = looked_at(world, worse, more)
    assert not done.decision.is_adopted
    assert done.decision.reason == "predictions_worse"
    assert done.continuing is done.hypotheses[0]


def test_noise_is_told_whatever_it_makes_of_predictions(world):
    """As no cause: "seen, not adopted" was said of scenes of which one is noisier."""
    (done,) = looked_at(world, ([GRAVITY], [GRAVITY, PUSH], "noise"))
    assert done.decision.is_adopted


def test_what_was_not_fitted_foresees_nothing(world):
    (done,) = looked_at(world, ([GRAVITY], [GRAVITY, PUSH], "force", "unconverged"))
    assert done.decision.is_adopted


def test_a_cause_that_makes_them_better_stays(world):
    (done,) = looked_at(world, ([GRAVITY, PUSH], [GRAVITY]))
    assert done.decision.is_adopted


def test_a_kick_is_not_asked_to_foretell(world):
    same = [GRAVITY], [GRAVITY, "1e-9 [m/s^2] * m_i * e_x"]
    (done,) = looked_at(world, (*same, "force", "converged", "contact"))
    assert done.decision.is_adopted


def test_a_cause_that_changes_nothing_stays_where_nothing_is_left(world):
    same = [GRAVITY], [GRAVITY, "1e-9 [m/s^2] * m_i * e_x"]
    (done,) = looked_at(world, same)
    assert (done.decision.is_adopted, done.decision.reason) == (False, "predictions_no_better")
    first, second = looked_at(world, same, end=Decision("nothing missing", "not_significant"))
    assert first.decision.is_adopted and not second.decision.is_adopted


@pytest.mark.parametrize("is_fact", [True, False])
def test_a_fact_that_changes_nothing_stays_where_all_that_is_left_is_odd_noise(world, is_fact):
    """A drag, one of 150 laws that did as well, was told of oil drops beside such noise."""
    train, test = replace(world, scenes=world.scenes[:3]), world.scenes[3:]
    first = round_of(1, train, [GRAVITY], [GRAVITY, "1e-9 [m/s^2] * m_i * e_x"])
    first = replace(first, decision=replace(first.decision, is_fact=is_fact))
    left = Decision("the noise is not as assumed", "noise_explains")
    found = that_foresee(
        [first, replace(first, number=2, decision=left)], foresight(world, test)
    )
    assert found[0].decision.is_adopted == is_fact
    assert len(found) == 1 + is_fact


@pytest.mark.parametrize(
    ("gain", "is_kept"), [(98.0, True), (50.0, False)]
)  # of 100 that were promised
def test_what_held_out_rows_hardly_show_is_judged_by_scenes_left_out_in_turn(world, gain, is_kept):
    """Magnets on gliders that meet before the last rows were seen, and not adopted."""
    train, test = replace(world, scenes=world.scenes[:3]), world.scenes[3:]
    done = round_of(1, train, [GRAVITY], [GRAVITY, "1e-9 [m/s^2] * m_i * e_x"])
    done.decision.best.held_out = HeldOut(gain, 5.0, 100.0)
    (told,) = that_foresee([done], foresight(world, test))
    assert told.decision.is_adopted == is_kept


def test_what_came_before_a_cause_that_changes_nothing_stays(world):
    good, same = ([GRAVITY, PUSH], [GRAVITY]), ([GRAVITY], [GRAVITY, "1e-9 [m/s^2] * m_i * e_x"])
    first, second = looked_at(world, good, same)
    assert first.decision.is_adopted
    assert (second.decision.is_adopted, second.decision.reason) == (False, "predictions_no_better")


def with_another(world, adopted, other, kind="force", behind=30.0):
    """A round that adopts something, and has another law as its second, so many nats behind."""
    train, test = replace(world, scenes=world.scenes[:3]), world.scenes[3:]
    done = round_of(1, train, [GRAVITY, PUSH], adopted)
    third = Hypothesis.from_laws(train, other)
    rows = [
        Row(k, "law", f"law {k}", "laws", "converged", nats, 0.0, nats, 4, own)
        for k, nats, own in ((0, 0.0, "force"), (1, 90.0, kind), (2, 90.0 - behind, "force"))
    ]
    done = replace(
        done, table=HypothesisTable(tuple(rows), 1e-9),
        decision=replace(done.decision, best=rows[1], rivals=(rows[2],)),
        fits={**done.fits, 2: fit(third, train)}, hypotheses={**done.hypotheses, 2: third},
    )  # fmt: skip
    return done, foresight(world, test).instead(done, Criteria())


@pytest.mark.parametrize("adopted", [PUSH, "1e-9 [m/s^2] * m_i * e_x"])  # worse, and no better
@pytest.mark.parametrize("other, is_taken", [([GRAVITY], True), ([GRAVITY, PUSH, PUSH], False)])
def test_in_the_place_of_a_refused_cause_comes_one_that_predictions_bear_out(
    world, other, is_taken, adopted
):
    done, told = with_another(world, [GRAVITY, PUSH, adopted], other)
    assert (told is not done) == is_taken
    if is_taken:
        first, second = done.table.rows[1:]
        assert told.decision.best is second and told.decision.rivals == (first,)
        assert (told.decision.verdict, told.decision.reason) == (
            "effective law", "likelier_refused",
        )  # fmt: skip
        assert not told.decision.is_fact


@pytest.mark.parametrize("behind, is_taken", [(1.0, True), (30.0, False)])
def test_noise_foresees_nothing_and_gives_way_to_what_is_as_likely_and_does(
    world, behind, is_taken
):
    done, told = with_another(world, [GRAVITY, PUSH], [GRAVITY], "noise", behind)
    assert (told is not done) == is_taken
    assert told.decision.reason == ("noise_likelier" if is_taken else "adopted")


@pytest.mark.parametrize(
    ("worse_by", "reason"), [(8e-13, "predictions_no_better"), (0.5, "predictions_worse")]
)
def test_predictions_that_change_by_rounding_are_no_worse(world, monkeypatch, worse_by, reason):
    """A thrust that is over when predictions begin was refused for that, and surely."""
    ratio = Ratio(1 + worse_by, 1 + 0.9 * worse_by, 1 + 1.1 * worse_by, "parametric")
    monkeypatch.setattr(Accounts, "ratio", lambda self, before, after: ratio)
    (done,) = looked_at(world, ([GRAVITY], [GRAVITY, PUSH]))
    assert done.decision.reason == reason


def asked_of(dataset, laws, n_copies=40):
    """Whether what was held out follows laws that were fitted to the other scenes."""
    train, test = replace(dataset, scenes=dataset.scenes[:4]), dataset.scenes[4:]
    hypothesis = Hypothesis.from_laws(train, laws)
    found = fit(hypothesis, train)
    accounts = Accounts([found], dataset, test, np.random.default_rng(0), n_copies)
    return is_refuted(found, hypothesis, accounts, lambda: dataset)


def test_a_law_that_held_out_scenes_do_not_follow_is_refuted(world):
    laws = ["-c * m_i * e_y"]
    assert not asked_of(world, laws)
    times = world.scenes[-1].times
    pushed = np.array(world.scenes[-1].positions)
    pushed[..., 0] += 0.3 * np.square(times)[:, None]  # 0.6 m/s^2 in one of them alone
    other = replace(world, scenes=(*world.scenes[:-1], replace(world.scenes[-1], positions=pushed)))
    assert asked_of(other, laws)
    assert not asked_of(other, laws, n_copies=0)  # without a floor nothing is said


def accounts_of(ratio, error, noisiest, copies=("copy",), is_parametric=True):
    """What `_is_surely_worse` asks of accounts."""
    return SimpleNamespace(
        copies=copies, is_parametric=is_parametric,
        ratio=lambda before, after: ratio, noisiest=noisiest,
        errors=lambda k: SimpleNamespace(rollout_rmse=error),
    )  # fmt: skip


def test_worse_predictions_must_be_sure_at_one_in_a_hundred():
    sure, close = Ratio(1.5, 1.3, 1.7, "resampled"), Ratio(1.2, 1.01, 1.4, "resampled")
    assert _is_surely_worse(accounts_of(sure, 1.0, 0.5))
    assert not _is_surely_worse(accounts_of(close, 1.0, 0.5))
    assert not _is_surely_worse(accounts_of(Ratio(1.5), 1.0, 0.5))


def test_notably_worse_predictions_need_be_sure_at_their_interval_alone():
    """Of a telephone on a spring each cause more made what was held out several times worse."""
    wide, may_be = Ratio(5.5, 1.17, 20.9, "parametric"), Ratio(5.5, 0.9, 20.9, "parametric")
    assert _is_surely_worse(accounts_of(wide, 1.0, np.nan))
    assert not _is_surely_worse(accounts_of(may_be, 1.0, np.nan))


def test_a_law_that_cannot_follow_what_was_held_out_makes_predictions_worse():
    """An unseen body was a fact of a ball that had landed, though no copy could be made."""
    unknown = Ratio(3.8)
    assert _is_surely_worse(accounts_of(unknown, 1.0, np.nan, copies=()))
    assert not _is_surely_worse(accounts_of(unknown, 1.0, np.nan, (), is_parametric=False))


def test_predictions_that_noise_spoils_as_much_are_not_worse():
    """A close pass told an oblate planet, and where it ends depends on the first rows' noise."""
    sure = Ratio(1.5, 1.3, 1.7, "resampled")
    assert not _is_surely_worse(accounts_of(sure, 0.6, 0.7))
    assert _is_surely_worse(accounts_of(sure, 0.6, float("nan")))


@pytest.mark.slow
def test_a_cause_with_which_tracks_run_away_is_refused(world):
    away = "2 [1/s^2] * m_i * norm(p_i - origin)^4 / 1 [m^4] * (p_i - origin)"
    train, test = replace(world, scenes=world.scenes[:3]), world.scenes[3:]
    done = round_of(1, train, [GRAVITY], [GRAVITY])
    other = Hypothesis.from_laws(train, [GRAVITY, away])
    wild = replace(done.fits[1], law=other.law)
    fits, hypotheses = {0: done.fits[0], 1: wild}, {0: done.hypotheses[0], 1: other}
    done = replace(done, fits=fits, hypotheses=hypotheses)
    (done,) = that_foresee([done], foresight(world, test))
    assert done.decision.reason == "predictions_worse"


@pytest.mark.parametrize("is_judged", [True, False])
def test_what_was_judged_beside_forces_that_are_missing_is_asked_with_them(world, is_judged):
    """An origin that was off had made up for some of a drag: without that it foresaw worse."""
    train, test = replace(world, scenes=world.scenes[:3]), world.scenes[3:]
    some = "0.1 [m/s^2] * m_i * e_x"
    first = round_of(1, train, [GRAVITY, some], [GRAVITY, PUSH])
    proposal = SimpleNamespace(judged=first.hypotheses[1] if is_judged else None)
    rounds = [
        replace(first, proposals={1: proposal}), round_of(2, train, [GRAVITY, PUSH], [GRAVITY]),
    ]  # fmt: skip
    told = that_foresee(rounds, foresight(world, test))
    assert [done.decision.is_adopted for done in told] == ([True, True] if is_judged else [False])
