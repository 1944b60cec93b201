"""Combinations of options of every command, on sound data."""

from hypothesis import strategies as st

from tests.fuzz.case import Case
from tests.fuzz.commands import GRAMMAR, data_options
from tests.fuzz.pieces import PLANTED, mostly, numbers, odd_names, odd_numbers
from tests.fuzz.recordings import PLAIN, plain_recording

_COMMANDS = ("close", "fit", "infer", "simulate", "compare", "grammar", "make", "track", "demo")
_LAW = "-c * v_i"


def _few(*texts):
    return st.sampled_from(texts)


_counts = mostly(_few("1", "2", "3"), odd_numbers, 3)
_seeds = mostly(_few("0", "1", "7"), odd_numbers, 3)
_OPTIONS = {
    "--alpha": mostly(_few("0.01", "0.05"), odd_numbers, 3), "--max-levels": _counts,
    "--max-rounds": _counts, "--bootstrap": _few("0", "-1", "x"), "--seed": _seeds,
    "--exclude": _few("v_i", "m_i", "t", "zz", ""),
    "--time-limit": _few("9s", "0", "x"), "--search": _few("exhaustive", "auto", "genetic"),
    "--grammar": _few("g.toml", "g.toml", "missing", "data", "/dev/null", "../g.toml", "a" * 300),
    "--latent": _few("mass", "friction", "zz", "radius"),
    "--entities": _few("mass=ball", "mass=zz"),
    "--prior": _few("mass=uniform:0.1:2", "mass=normal:1:1", "mass=values:1,2", "mass=uniform:a:b",
                    "mass=uniform:0:inf", "mass=values:", "mass=log-uniform:-1:1", "mass=zz:1"),
    "--share": _few("mass=all", "mass=entity", "mass=charge", "mass=zz"),
    "--likelihood": _few("auto", "one-step", "gls", "weak", "propagated", "ahead", "x"),
    "--e-step": _few("auto", "laplace", "importance", "enumeration", "tempered", "x"),
    "--n-eff": _few("10", "9", "x"), "--max-steps": _few("100", "1"), "--starts": _few("1", "0"),
    "--set": st.builds("{}={}".format, _few("c", "k", "zz", "", "c1"), numbers),
    "--noise": numbers, "--integrator": _few("euler", "leapfrog", "rk4", "x"),
    "--substeps": mostly(_few("1", "2"), odd_numbers, 3), "--kind": _few("pair", "field", "x"),
    "--searches": _few("random", "genetic", "cross_entropy", "zz", ""), "--seeds": _few("1", "0"),
    "--laws": _few("5", "1", "0", "-3"), "--levels": mostly(_few("1", "5"), odd_numbers, 3),
    "--data": _few("data", "missing", "g.toml", "."), "--what": numbers,
    "--declare": _few(_LAW, "c * e_x", "nothing", *PLANTED[:2]),
    "--model": _few("model.toml", "missing.toml", "g.toml"),
    "--law": _few(_LAW, "c * e_x", "9.81 [m/s^2] * m_i * down", *PLANTED[:2]),
    "--out": _few("out", "out", "old", "data", ".", "", "/", "no/such", "g.toml", "out\x00",
                  "a" * 300),
}  # fmt: skip
_FLAGS = ("--json", "--overwrite", "--allow-time", "--help", "--version", "--", "-x", "--quie")
_OF = {
    "close": "--alpha --max-levels --max-rounds --exclude --time-limit --search "
    "--seed --declare --model --latent --prior --out",
    "fit": "--law --model --seed --out --alpha --grammar",
    "infer": "--law --latent --prior --entities --share --likelihood --e-step --starts --out",
    "simulate": "--law --set --noise --integrator --substeps --seed --out",
    "compare": "--declare --kind --searches --seeds --exclude --likelihood --out --grammar",
    "grammar": "--levels --data",
    "make": "--seed --out", "track": "--out", "demo": "--seed --out",
}
_NEEDED = {
    "close": ("data", "--grammar", "g.toml", "--max-rounds", "1", "--bootstrap", "0",
              "--max-levels", "2", "--declare", _LAW),
    "fit": ("data", "--law", _LAW),
    "infer": ("data", "--law", _LAW, "--latent", "mass", "--prior", "mass=uniform:0.1:2",
              "--e-step", "laplace", "--n-eff", "10", "--max-steps", "100"),
    "simulate": ("data", "--law", _LAW, "--out", "out", "--set", "c=0.1"),
    "compare": ("data", "--grammar", "g.toml", "--laws", "5", "--seeds", "1"),
    "grammar": ("show", "g.toml"), "make": ("fall", "--out", "out", "--frames", "4"),
    "track": ("missing.mp4", "--object", "b=disc:red"), "demo": ("--what",),
}  # fmt: skip


@st.composite
def cases(draw):
    """A command with options that it has, that others have, and that nobody has."""
    known, others = st.sampled_from(_COMMANDS[:7]), st.sampled_from((*_COMMANDS, "zz", ""))
    command = draw(mostly(known, others, 8))
    files = {**plain_recording(draw(st.sampled_from(PLAIN))), "g.toml": GRAMMAR}
    files["model.toml"] = b'declare = ["-c * v_i"]\n'
    files |= {f"old/{name}": b"old\n" for name in draw(st.sampled_from(_OLD))}
    argv = [command, *_NEEDED.get(command, ())]
    if draw(st.integers(0, 9)) == 0:
        argv.pop(draw(st.integers(0, len(argv) - 1)))
    own = _OF.get(command, "--out").split()
    for _ in range(draw(st.integers(0, 3))):
        option = draw(mostly(st.sampled_from(own), st.sampled_from(sorted(_OPTIONS)), 16))
        if command == "demo" and option == "--out":
            continue
        value = draw(mostly(_OPTIONS[option], odd_names, 15))
        argv += [f"{option}={value}"] if draw(st.booleans()) else [option, value]
    if command in ("close", "fit", "infer", "simulate", "compare") and draw(st.booleans()):
        argv += draw(data_options(simulates=command == "simulate"))
    if draw(st.integers(0, 2)) == 0:
        argv.append(draw(mostly(st.sampled_from(_FLAGS[:2]), st.sampled_from(_FLAGS), 4)))
    if command != "grammar":
        argv.append("--quiet")
    if command == "close" and not any(a.startswith("--out") for a in argv):
        argv += ["--out", "out"]
    return Case("options", tuple(argv), files)


_OLD = (
    (), (), ("fit.json", "fit.txt"), ("trajectories.csv", "entities.csv", "dataset.toml"),
    ("report.json", "report.html", "notes.txt"), ("results.csv", "certificate.txt"), ("notes.txt",),
)  # fmt: skip
