"""An unseen body whose strength may be nothing may be anywhere, and is no fact."""

from types import SimpleNamespace

import pytest

from bsp_gp.fitting.parts.hidden import HiddenSource
from bsp_gp.loop.writing_up import doubt_of_sources


def round_of(strength, error, kind="hidden_body", is_adopted=True):
    found = SimpleNamespace(
        parameters=(("h_x1", ""), ("M1", "")), values=(1.1, strength), errors=(0.3, error)
    )
    source = SimpleNamespace(parts=(HiddenSource(None, None, strength="M1"),))
    return SimpleNamespace(
        number=1, fits={2: found}, hypotheses={2: source},
        decision=SimpleNamespace(is_adopted=is_adopted, best=SimpleNamespace(id=2, kind=kind)),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (round_of(0.3, 0.25), "not_placed"), (round_of(-0.3, 0.25), "not_placed"),
        (round_of(0.3, 0.1), ""), (round_of(0.3, 0.25, kind="force"), ""),
        (round_of(0.3, 0.25, is_adopted=False), ""),
    ],
)  # fmt: skip
def test_a_source_is_doubted_where_its_strength_may_be_nothing(made, said):
    assert doubt_of_sources([made], ()) == said
    assert doubt_of_sources([made], {1}) == ""
