"""Verdicts follow from tables alone; the evidence knows no units."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from bsp_gp.fitting.fit import fit
from bsp_gp.fitting.hypothesis import Hypothesis
from bsp_gp.fitting.parts.contacts import Kick
from bsp_gp.language.inputs import STATE_INPUTS
from bsp_gp.language.parse import parse_formula
from bsp_gp.loop.criteria import CAUSES, REASONS, VERDICTS, Criteria
from bsp_gp.loop.decide import decide
from bsp_gp.loop.evidence import log_evidence
from bsp_gp.loop.table import HeldOut, HypothesisTable, Row
from bsp_gp.loop.writing_up import is_many
from bsp_gp.physics.force import ForceLaw
from tests.unit.test_response import thrown

BASE = Row(0, "base", "", "", "converged", 0.0, 0.0, -250.0, 4)


def row(number, code="law", kind="force", gain=100.0, prior=-4.0, status="converged", **changes):
    made = Row(
        number, code, f"cause {number}", code, status, 0.5 * gain - 5.0, prior,
        0.5 * gain - 250, 5, kind,
        key=(code, str(number)),
    )  # fmt: skip
    return replace(made, **changes)


def decided(*rows, p=1e-6, base=BASE, criteria=None, noise_p=1.0, forced=-np.inf):
    table = HypothesisTable((base, *rows), p, noise_p, forced)
    return decide(table.with_probabilities(), criteria)


def test_codes_are_those_of_the_closed_lists():
    shown = [
        decided(), decided(row(1)), decided(row(1), p=0.5), decided(row(1, "noise", "noise")),
        decided(row(1), base=replace(BASE, status="unconverged")), decided(row(1, gain=5.0)),
        decided(row(1), row(2, "tilt", "measurement")), decided(row(1, status="nonfinite")),
    ]  # fmt: skip
    assert {d.verdict for d in shown} <= set(VERDICTS)
    assert {d.reason for d in shown} <= set(REASONS)
    assert all(d.best is None or d.best.code in CAUSES for d in shown)


def test_nothing_is_missing_where_chance_shows_as_much():
    said = decided(row(1), p=0.02)
    assert (said.verdict, said.is_adopted) == ("nothing missing", False)
    assert decided(row(1), p=0.02, criteria=Criteria(alpha=0.05)).is_adopted


def test_of_a_sum_a_part_is_taken_that_is_about_as_likely():
    both = row(1, key=("law", "a", "b"), n_terms=2)
    part = row(2, gain=100.0 - 2 * 1.9, key=("law", "b"), n_terms=1)
    other = row(3, gain=100.0 - 2 * 1.9, key=("law", "c"), n_terms=1)
    assert decided(both, part).best.id == 2
    assert decided(both, other).best.id == 1
    assert decided(both, replace(part, log_evidence=part.log_evidence - 0.2)).best.id == 1


def test_a_hand_alone_is_told_only_where_no_force_does_nearly_as_well():
    hand = row(1, "untrimmed", "measurement", gain=105.0)
    assert decided(hand, row(2, gain=100.0)).reason == "kinds_tie"
    assert decided(hand, row(2, gain=60.0)).reason == "adopted"
    kick = row(1, "contact", gain=105.0)
    assert decided(kick, row(2, gain=100.0)).reason == "kinds_tie"
    tilt = row(1, "tilt", "measurement", gain=105.0)
    assert decided(tilt, row(2, gain=100.0)).reason == "adopted"


def test_weight_comes_before_what_fits_as_well_without_it():
    base = replace(BASE, left=1.0)
    weight = row(1, gain=500.0, n_pushes=1, n_terms=1, left=0.04)
    better = row(2, gain=700.0, n_terms=2, left=0.01)
    beside = row(3, gain=700.0, n_pushes=1, n_terms=2, left=0.01)
    several = row(4, gain=700.0, n_pushes=1, n_terms=4, left=0.01)
    assert decided(weight, better, base=base).best.id == 1
    assert decided(weight, several, base=base).best.id == 1
    assert decided(weight, beside, base=base).best.id == 3
    assert decided(replace(weight, left=0.3), better, base=base).best.id == 2
    assert decided(weight, replace(better, is_of_pairs=True), base=base).best.id == 2
    number = replace(better, code="number", n_terms=0)
    assert decided(weight, number, base=base).best.id == 2
    by_scene = replace(weight, code="law_by_scene")
    assert decided(by_scene, better, base=base).best.id == 2
    rod = replace(better, code="constraint", kind="constraint")
    assert decided(weight, rod, base=base).best.id == 2
    said = decided(weight, better, base=base)
    assert said.is_adopted and not said.rivals


def test_a_planet_comes_before_many_kicks_that_leave_hardly_less():
    """Of a comet that passes Jupiter six kicks were told, of 13 to 25 m/s."""
    base = replace(BASE, left=1.0)
    kicks = row(1, "contact", gain=900.0, n_kicks=6, left=0.01)
    planet = row(2, "hidden_body", "hidden_body", gain=700.0, left=0.015)
    said = decided(kicks, planet, base=base)
    assert said.best.id == 2 and said.is_adopted and not said.is_fact
    assert decided(replace(kicks, n_kicks=3), planet, base=base).best.id == 1
    assert decided(kicks, replace(planet, left=0.03), base=base).best.id == 1
    lens = replace(planet, code="lens", kind="measurement")
    assert decided(kicks, lens, base=base).best.id == 1


def test_forces_come_before_a_push_that_has_the_period_of_the_swing():
    """Dry friction of a pendulum was told as a push at its own rate, with seven numbers."""
    base = replace(BASE, left=1.0)
    echo = row(1, gain=900.0, n_terms=3, left=0.005, is_echo=True)
    friction = row(2, gain=700.0, n_terms=2, left=0.04)
    said = decided(echo, friction, base=base)
    assert said.best.id == 2 and said.is_adopted and not said.is_fact
    assert decided(replace(echo, is_echo=False), friction, base=base).best.id == 1
    assert decided(echo, replace(friction, left=0.3), base=base).best.id == 1
    assert decided(echo, replace(friction, is_echo=True), base=base).best.id == 1


@pytest.mark.parametrize(
    ("p", "noise_p", "verdict"),
    [(0.5, 1.0, "nothing missing"), (1e-6, 1e-6, "the noise is not as assumed")],
)
def test_noise_as_large_as_the_motion_is_none(p, noise_p, verdict):
    for swamped, told in ((0.02, verdict), (0.4, "cannot tell")):
        table = HypothesisTable((BASE,), p, noise_p, swamped=swamped)
        rows = HypothesisTable((BASE, row(1, gain=5.0)), p, noise_p, swamped=swamped)
        for each in (table, rows):
            said = decide(each.with_probabilities())
            assert said.verdict == told
            assert (said.reason == "swamped") == (told == "cannot tell")


def test_a_cause_as_likely_as_noise_that_is_as_large_as_the_motion_is_named():
    for gain, reason in ((16.0, "kinds_tie"), (5.0, "swamped")):
        table = HypothesisTable((BASE, row(1, gain=gain)), 0.5, 1.0, swamped=0.4)
        said = decide(table.with_probabilities())
        assert (said.verdict, said.reason, said.is_adopted) == ("cannot tell", reason, False)
        assert (said.best is None) == (reason == "swamped")
    small = HypothesisTable((BASE, row(1, gain=16.0)), 0.5, 1.0, swamped=0.02)
    assert decide(small.with_probabilities()).verdict == "nothing missing"


def test_a_failed_fit_is_never_nothing_missing():
    for status in ("nonfinite", "unconverged", "aliased"):
        said = decided(base=replace(BASE, status=status), p=np.nan)
        assert (said.verdict, said.reason) == ("cannot tell", "declared_model_not_fitted")
    assert decided(row(1), p=np.nan).reason == "not_tested"
    assert decided(row(1, status="unconverged")).verdict == "seen, not adopted"


def test_odd_noise_is_told_where_nothing_else_can_be_fitted():
    lost = row(1, status="unconverged")
    said = decided(lost, noise_p=1e-5)
    assert (said.verdict, said.reason) == ("the noise is not as assumed", "noise_explains")
    assert decided(lost, noise_p=0.3).reason == "no_candidate_fits"


@pytest.mark.parametrize(("n_laws", "is_said"), [(3, False), (4, True)])
def test_many_forces_only_describe(n_laws, is_said):
    """As many terms as of a series: rather one force of another form."""
    first, second = (
        tuple(parse_formula(text, STATE_INPUTS) for text in texts)
        for texts in (("c1 * v_i", "c2 * (norm(v_i) * v_i)"), ("c3 * e_x", "c4 * e_y"))
    )
    best = row(1)
    rounds = [
        SimpleNamespace(
            number=k, proposals={1: SimpleNamespace(formulas=own, is_series=False)},
            decision=SimpleNamespace(is_adopted=True, best=best),
        )
        for k, own in enumerate([first, second[: n_laws - 2]], 1)
    ]  # fmt: skip
    assert is_many(rounds, ()) is is_said
    assert not is_many(rounds, {2})


def test_powers_of_a_coordinate_along_its_axis_are_one_force():
    texts = "c1 * (x_i * e_x)", "c2 * (x_i^3 * e_x)", "c3 * e_x", "c4 * v_i", "c5 * (x_i * e_y)"
    formulas = tuple(parse_formula(text, STATE_INPUTS) for text in texts)
    done = SimpleNamespace(
        number=1, proposals={1: SimpleNamespace(formulas=formulas, is_series=False)},
        decision=SimpleNamespace(is_adopted=True, best=row(1)),
    )  # fmt: skip
    assert not is_many([done], ())
    done.proposals[1].is_series = True
    assert is_many([done], ())


@pytest.mark.parametrize(("bodies", "is_said"), [("aaa", False), ("aaab", False), ("aaaab", True)])
def test_a_body_that_is_kicked_all_the_time_is_pushed(bodies, is_said):
    """Six kicks to and fro were the cause of a swing."""
    kicks = tuple(
        Kick(ForceLaw(()), scene="1", entity=body, mark=f"kicked{k}")
        for k, body in enumerate(bodies)
    )
    done = SimpleNamespace(
        number=1, proposals={1: SimpleNamespace(formulas=(), is_series=False)},
        hypotheses={1: SimpleNamespace(parts=kicks)},
        decision=SimpleNamespace(is_adopted=True, best=row(1, "contact")),
    )  # fmt: skip
    assert is_many([done], ()) is is_said


@pytest.mark.parametrize(("nats", "is_told"), [(1.0, False), (4.0, True)])
def test_a_cause_must_be_likelier_than_odd_noise_that_the_base_has_too(nats, is_told):
    law = row(1, gain=2 * (nats + 5.0 + 4.0))
    same = row(2, "noise", "noise", gain=10.0 + 1e-6, prior=0.0)
    for rows in ((law,), (law, same)):
        said = decided(*rows, noise_p=1e-9)
        assert said.is_adopted == is_told
        assert said.verdict == ("effect adopted" if is_told else "the noise is not as assumed")
    assert decided(law).is_adopted


def test_what_fits_in_place_of_a_law_that_does_not_is_adopted():
    lost = replace(BASE, status="unconverged", log_evidence=-np.inf)
    assert decided(row(1), base=lost).verdict == "effect adopted"
    for said in (decided(row(1), base=lost, p=0.5), decided(row(1, status="refuted"), base=lost,
                 p=np.nan), decided(row(1, status="unconverged"), base=lost)):  # fmt: skip
        assert (said.verdict, said.reason) == ("cannot tell", "declared_model_not_fitted")


def test_a_form_is_a_fact_only_without_near_rivals():
    assert decided(row(1), row(2, gain=60.0)).is_fact
    near = decided(row(1), row(2, gain=92.0))
    assert not near.is_fact
    assert [r.id for r in near.rivals] == [2]


def test_what_is_unlikely_beforehand_is_told_where_it_explains_as_well():
    said = decided(row(1), row(2, gain=101.0, prior=-16.0))
    assert said.best.id == 1
    assert [r.id for r in said.rivals] == [2]


def test_a_measurement_and_a_force_that_tie_cannot_be_told():
    said = decided(row(1), row(2, "tilt", "measurement", gain=99.0))
    assert (said.verdict, said.reason) == ("cannot tell", "kinds_tie")
    assert decided(row(1), row(2, "tilt", "measurement", gain=90.0)).verdict == "effect adopted"
    assert decided(row(1), row(2, gain=99.9)).verdict == "effect adopted"  # both are forces


def test_noise_goes_before_causes():
    said = decided(row(1), row(2, "noise", "noise", gain=95.0))
    assert (said.verdict, said.best.code) == ("the noise is not as assumed", "noise")
    assert decided(row(1), row(2, "noise", "noise", gain=60.0)).verdict == "effect adopted"


def test_noise_explains_only_what_it_makes_likelier():
    said = decided(row(1, gain=-3.0), row(2, "noise", "noise", gain=-2.0))
    assert (said.verdict, said.reason) == ("seen, not adopted", "no_better_than_before")


def test_noise_that_is_there_already_is_not_adopted_again():
    same = row(1, "noise", "noise", log_evidence=1e-9, prior=0.0, log_likelihood=-250.0, n_free=4)
    said = decided(same, noise_p=1.0)
    assert not said.is_adopted and said.reason == "no_better_than_before"


@pytest.mark.parametrize("rows", [(), (row(1, gain=1.0),)])
def test_what_forces_do_and_no_noise_does_is_not_called_noise(rows):
    """A liquid that sloshes in a cart: no law is found, and a memory of the noise is no name."""
    assert decided(*rows, noise_p=0.0, forced=5.0).verdict == "the noise is not as assumed"
    assert decided(*rows, noise_p=0.0, forced=500.0).verdict == "seen, not adopted"


def test_left_out_scenes_can_refuse_and_never_confirm_alone():
    refused = row(1, held_out=HeldOut(-3.0, 1.0, 45.0))
    assert decided(refused).reason == "held_out_refuses"
    assert decided(row(1, held_out=HeldOut(20.0, 15.0, 45.0))).is_adopted
    assert not decided(row(1, gain=8.0, held_out=HeldOut(30.0, 1.0, 4.0))).is_adopted


def test_odd_noise_that_no_cause_beats_is_told_as_such():
    for noise_p, verdict in ((1e-6, "the noise is not as assumed"), (0.5, "seen, not adopted")):
        table = HypothesisTable((BASE, row(1, gain=5.0)), 1e-6, noise_p).with_probabilities()
        assert decide(table).verdict == verdict
    likely = HypothesisTable((BASE, row(1)), 1e-6, 1e-6).with_probabilities()
    assert decide(likely).verdict == "effect adopted"


def test_probabilities_add_up():
    table = HypothesisTable((BASE, row(1), row(2, gain=90.0)), 0.0).with_probabilities()
    assert sum(r.probability for r in table.rows) == pytest.approx(1.0)
    assert table.rows[1].probability > table.rows[2].probability > table.rows[0].probability


def test_one_hypothesis_has_one_row():
    worse = row(2, gain=80.0, key=("law", "1"))
    table = HypothesisTable((BASE, row(1), worse), 0.0).without_repeats()
    assert [r.id for r in table.rows] == [0, 1]


@pytest.mark.parametrize("ahead", [1e-11, -1e-11])
def test_of_two_that_say_the_same_the_simpler_is_named_whatever_rounding_says(ahead):
    push = row(1, text="a push of constant size, forward")
    weight = row(2, gain=100.0 - ahead, text="c1 * e_y")
    for rows in ((push, weight), (weight, push)):
        assert decided(*rows).best is not None
        assert decided(*rows).best.text == "c1 * e_y"
    fewer = replace(push, n_free=4)
    assert decided(fewer, weight).best.text == push.text


def test_criteria_are_few_and_each_has_its_reason():
    names = [field.name for field in fields(Criteria)]
    assert len(names) <= 15
    assert all(name in Criteria.__doc__ for name in names)


# --- evidence -------------------------------------------------------------------------------------


def in_feet(dataset):
    """The same recording told in units of length 0.3048 times as long."""
    scenes = tuple(replace(s, positions=s.positions / 0.3048) for s in dataset.scenes)
    return replace(dataset, scenes=scenes, noise=tuple(x / 0.3048 for x in dataset.noise))


def test_evidence_gained_does_not_depend_on_units():
    gains = []
    for data in (thrown(0.05), in_feet(thrown(0.05))):
        heights = []
        for laws in (["-g * m_i * e_y"], ["-g * m_i * e_y", "-c * v_i"]):
            hypothesis = Hypothesis.from_laws(data, laws)
            heights.append(log_evidence(fit(hypothesis, data), hypothesis))
        gains.append(heights[1] - heights[0])
    assert gains[0] == pytest.approx(gains[1], abs=1e-4)


def test_a_failed_fit_has_no_evidence():
    data = thrown(0.0)
    hypothesis = Hypothesis.from_laws(data, ["-g * m_i * e_y"])
    failed = replace(fit(hypothesis, data), status="unconverged")
    assert log_evidence(failed, hypothesis) == -np.inf


def test_numbers_that_the_data_do_not_tell_apart_cost_what_their_sum_does():
    data = thrown(0.05)
    laws = ["-c1 * v_i"], ["-c1 * v_i", "-c2 * v_i"]
    one, two = (Hypothesis.from_laws(data, ["-g * m_i * e_y", *law]) for law in laws)
    heights = [log_evidence(fit(h, data), h) for h in (one, two)]
    assert np.isinf(np.diag(fit(two, data).covariance)).sum() == 2
    assert heights[1] == pytest.approx(heights[0], abs=1.5), "no number is free of charge"


def test_what_is_kicked_in_a_trap_wanders_as_noise_with_a_memory_does():
    kicks = row(1, "kicks", "kicks", gain=12.0, prior=-3.0)
    said = decided(kicks, noise_p=1e-9)
    assert (said.verdict, said.reason, said.best.code) == ("cannot tell", "kinds_tie", "kicks")
    less = replace(kicks, log_evidence=-5.0)
    assert decided(less, noise_p=1e-9).verdict == "the noise is not as assumed"


def test_of_causes_that_tie_none_is_missing_for_sure_where_none_at_all_is_nearly_as_likely():
    """Rounded readings of a fall showed "something": a kick, perspective, or an unseen body."""
    tilt, base = row(2, "tilt", "measurement", gain=19.9), BASE
    said = decided(row(1, gain=20.0), tilt, base=base)  # 10 - 5 - 4 nats: one more than none
    assert (said.verdict, said.is_adopted) == ("seen, not adopted", False)
    assert decided(row(1, gain=20.0)).is_adopted
    likelier = row(2, "tilt", "measurement", gain=39.9)
    assert decided(row(1, gain=40.0), likelier).reason == "kinds_tie"


def test_who_goes_round_evenly_is_held_or_drawn():
    rod = row(1, "rod", "constraint", gain=900.0, is_alike=True, left=1.0)
    spring = row(2, gain=800.0, left=1.05)
    said = decided(rod, spring)
    assert (said.verdict, said.reason) == ("cannot tell", "kinds_tie")
    assert [rival.id for rival in said.rivals] == [spring.id]
    assert decided(rod, replace(spring, left=2.0)).verdict == "effect adopted"
    assert decided(replace(rod, is_alike=False), spring).verdict == "effect adopted"


def test_more_of_a_memory_that_the_base_has_is_another_noise_only_where_it_is_likelier():
    """A bead that sinks was noise with a memory, which the base had and was as likely with."""
    kicks = row(1, "kicks", "kicks", gain=40.0)
    for gain, forced, said in ((35.0, -np.inf, "noise_explains"), (35.0, -40.0, "noise_explains"),
                               (31.0, -40.0, "adopted")):  # fmt: skip
        noise = row(2, "noise", "noise", gain=gain + 1.0)
        base = replace(BASE, log_evidence=0.5 * 30.0 - 5.0 - 4.0)
        assert decided(kicks, noise, base=base, forced=forced).reason == said
