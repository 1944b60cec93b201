"""Commands that read a data set and are quick about it."""

from hypothesis import strategies as st

from tests.fuzz.pieces import mostly, numbers, units

GRAMMAR = b"""\
[grammar]
name = "small"
start = ["PairForce", "FieldForce"]
kind = ["pair", "field"]
[types]
Const = "scalar *"
Mass = "scalar kg"
Speed = "scalar m/s"
Coeff = "scalar *"
Line = "vector 1"
Unit = "vector 1"
PairForce = "vector *"
FieldForce = "vector *"
[inputs]
v_i = "vector m/s"
p_i = "point m"
p_j = "point m"
m_i = "scalar kg"
e_x = "vector 1"
e_y = "vector 1"
[constants]
c1 = "scalar *"
[rules]
Const = "c1"
Mass = "m_i"
Speed = "norm(v_i)"
Coeff = "Mass | Speed | mul(Mass, Speed)"
Line = "normalize(sub(p_j, p_i))"
Unit = "normalize(v_i) | e_x | e_y"
PairForce = "mul(Const, mul(Coeff, Line))"
FieldForce = "mul(Const, mul(Coeff, Unit))"
"""
"""A grammar of few laws, so that a search takes no time."""
_LAWS = ("-c * v_i", "9.81 [m/s^2] * m_i * down", "c * e_x", "-c * norm(v_i) * v_i",
         "k * (p_j - p_i)", "c * m_i * e_y")  # fmt: skip
_COMMANDS = "show show show fit fit simulate simulate compare infer".split()
_PRIORS = ("mass=uniform:0.1:9", "mass=log-uniform:0.1:9", "mass=normal:1:0.5", "mass=values:1,2",
           "mass=normal:1:0.2:0.1:3",
           "mass=uniform:9:1", "mass=normal:1:-1", "friction=uniform:0:1")  # fmt: skip


_RENAMES = ("x=X", "x=y", "t=frame", "velocity=measured", "y=x", "x=", "entity=note", "t=t")
_sizes = mostly(st.sampled_from(("0", "0.01", "1e-6")), numbers, 6)


@st.composite
def uses(draw, data):
    """Files beside the data, and a command that reads the data set at this path."""
    command = draw(st.sampled_from(_COMMANDS))
    law = draw(st.sampled_from(_LAWS))
    options = draw(data_options(simulates=command == "simulate"))
    if command == "show":
        name = draw(st.sampled_from(("newtonian", "physics", "grammar.toml")))
        return {"grammar.toml": GRAMMAR}, ("grammar", "show", name, "--data", data)
    if command == "fit":
        how = draw(st.sampled_from((("--out", "out"), ("--json",), ())))
        return {}, ("fit", data, f"--law={law}", *options, *how, "--quiet")
    if command == "simulate":
        values = ("--set", "c=0.1") * ("c *" in law) + ("--set", "k=1") * ("k *" in law)
        values += ("--substeps", "2", "--out", "out", "--quiet")
        return {}, ("simulate", data, f"--law={law}", *options, *values)
    if command == "compare":
        how = ("--grammar", "grammar.toml", "--laws", "20", "--seeds", "1", "--out", "out")
        return {"grammar.toml": GRAMMAR}, ("compare", data, *options, *how, "--quiet")
    prior = draw(st.sampled_from(_PRIORS))
    step = draw(st.sampled_from(("auto", "laplace", "importance", "enumeration")))
    how = ("--latent", "mass", "--prior", prior, "--e-step", step, "--n-eff", "10")
    few = ("--max-steps", "100", "--quiet")
    return {}, ("infer", data, f"--law={law}", *options, *how, *few)


@st.composite
def data_options(draw, simulates=False):
    """Options that stand in for dataset.toml."""
    out = []
    if draw(st.integers(0, 4)):
        out += ["--units", "length=m", "time=s", "mass=kg"]
    elif draw(st.integers(0, 1)) == 0:
        out += ["--units", f"length={draw(units)}", f"time={draw(units)}"]
    if draw(st.integers(0, 3)):
        out += ["--up", draw(mostly(st.just("y"), st.sampled_from(("x", "z", "-y", "q")), 20))]
    rare = st.integers(0, 25).map(lambda k: k == 0)
    if draw(rare):
        out += [draw(st.sampled_from(("--fps", "--dt"))), draw(mostly(st.just("20"), numbers, 3))]
    if draw(rare):
        out += ["--columns", draw(st.sampled_from(_RENAMES))]
    if draw(rare):
        out += ["--train", draw(st.sampled_from(("s1", "a", "*", "1..2", "zz", "[", "")))]
    if draw(rare):
        out += ["--test", draw(st.sampled_from(("s2", "b", "*", "2..1", "zz", "..")))]
    if draw(rare) and not simulates:
        out += ["--noise", *draw(st.lists(_sizes, min_size=1, max_size=3))]
    return tuple(out)
