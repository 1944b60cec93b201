"""The whole loop on a few rows with a grammar of few laws."""

from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.commands import GRAMMAR, data_options
from tests.fuzz.pieces import damaged, mostly
from tests.fuzz.recordings import declarations, grids, rosters
from tests.fuzz.tables import plain

_LAWS = ("-c * v_i", "9.81 [m/s^2] * m_i * down", "c * e_x", "0 [N] * e_x", "-c * norm(v_i) * v_i",
         "k * (p_j - p_i)", "c * norm(v_i)^n * e_x", "0.1 [kg/s] * v_i")  # fmt: skip


@st.composite
def cases(draw):
    """``close`` or ``fit`` without a law."""
    bodies = draw(st.sampled_from((("ball",), ("ball",), ("a", "b"))))
    grid = draw(grids(bodies))
    files = {"data/trajectories.csv": plain(grid), "g.toml": GRAMMAR}
    files["data/entities.csv"] = draw(
        mostly(st.just("\n".join(("entity,mass", *(f"{b},1" for b in bodies), ""))),
               rosters(bodies), 5)
    ).encode("utf-8", "replace")  # fmt: skip
    toml = '[units]\nlength = "m"\ntime = "s"\nmass = "kg"\n[axes]\nup = "y"\n'
    toml = draw(mostly(st.just(toml), declarations(), 5)).encode("utf-8", "replace")
    files["data/dataset.toml"] = draw(damaged(toml, 20))
    argv = ["close", "data", f"--declare={draw(st.sampled_from(_LAWS))}"]
    if draw(st.integers(0, 5)) == 0:
        argv = ["fit", "data"]
    argv += draw(data_options()) if draw(st.integers(0, 9)) == 0 else ()
    argv += ["--grammar", "g.toml", "--max-levels", draw(st.sampled_from(("2", "3", "8")))]
    argv += ["--max-rounds", draw(st.sampled_from(("1", "2"))), "--bootstrap", "0"]
    argv += ["--alpha", draw(st.sampled_from(("0.01", "0.2")))]
    return Case("closing", (*argv, "--out", "out", "--quiet"), files)
