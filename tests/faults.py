"""Commands with a fault at every write: kill -9, or a disk that is full from then on.

Run as a script, in a process of its own that has no threads: it does the work of a command once
with each of two seeds, keeps it, and then forks one child per fault, in which only the writing is
done again over the older result.

    python -m tests.faults close kill|plain|full|random [HOW_MANY]

"plain" is "kill" on a system that cannot exchange two names in one step.
"""

import contextlib
import errno
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path

WRITES = ("os.rename", "os.mkdir", "os.rmdir", "os.remove", "os.link", "os.chmod", "exchange")
GROWS = ("open", "os.rename", "os.mkdir", "os.link")
"""What may need place on a disk; to delete or to exchange names does not."""
ROUNDS = "out.rounds.json"
"""What a killed `close` keeps beside its place, for --resume: no part of a result."""
GRAVITY = "9.81 [m/s^2] * m_i * down"


def commands():
    """Words of the commands, with OUT for the result; with what of each is done only once."""
    close = ["close", "DATA", "--declare", GRAVITY, "--max-levels", "2", "--max-rounds", "1"]
    learn = ["fit", "PULLS", "--latent", "mass", "--grammar", "GRAMMAR", "--train", "s0", "s1",
             "--noise", "0.002", "--likelihood", "one-step", "--starts", "1", "--n-eff", "60",
             "--max-steps", "400"]  # fmt: skip
    law = "c1 * m_i * m_j / norm(p_i - p_j)^2 * normalize(p_j - p_i)"
    infer = ["infer", "PULLS", "--law", law, "--train", "s0", "s1", "--noise", "0.01",
             "--likelihood", "one-step", "--n-eff", "60", "--max-steps", "400"]  # fmt: skip
    film = ["--film", "--size", "96x96", "--frames", "6", "--png"]
    return {
        "simulate": (["simulate", "DATA", "--law", GRAVITY, "--noise", "0.1"], ()),
        "fit": (["fit", "DATA", "--law", GRAVITY, "--law=-c1 * v_i"], ()),
        "close": (close, ("bsp_gp.loop.close.close_loop", "bsp_gp.report.folder._contents")),
        "compare": (["compare", "DATA", "--declare", GRAVITY, "--laws", "200", "--seeds", "1"],
                    ("bsp_gp.search.comparison.compare_searches",)),
        "infer": (infer, ("bsp_gp.cli_latents.run_infer",)),
        "learn": (learn, ("bsp_gp.cli_latents.run_learn",)),
        "make": (["make", "spring", *film], ()),
        "demo": (["demo"], ("bsp_gp.demo._demo_report", "bsp_gp.report.folder._contents")),
        "track": (["track", "VIDEO", "--object", "ball=disc:red", "--scale", "100"], ()),
        "study": (["--quick"], ("null_data.work",)),
    }  # fmt: skip


class Bench:
    """One command, its older result and its newer one."""

    def __init__(self, name, folder):
        self.name, self.folder = name, folder
        self.place = folder / "place"
        self.old = folder / "old"
        self.pipe = os.pipe()
        os.set_blocking(self.pipe[0], False)
        self.place.mkdir()
        words, self.once = commands()[name]
        self.words = [self._input(word) for word in words]
        self.kept = {}

    def _input(self, word):
        makers = {"DATA": throws, "PULLS": pulls, "GRAMMAR": grammar, "VIDEO": video}
        return str(makers[word](self.folder)) if word in makers else word

    def prepare(self, is_kept=True):
        """Do the work with both seeds; what is there with the older result, and with the newer."""
        if is_kept:
            self._keep()
        assert self.run(1) == 0, self.errors()
        (self.place / "out" / "notes.md").write_text("mine")
        if self.name == "study":  # as after half of its time
            table = self.place / "out" / "results.csv"
            lines = table.read_text().splitlines(keepends=True)
            table.write_text("".join(lines[: len(lines) // 2]))
            (self.place / "out" / "summary.md").unlink()
        shutil.copytree(self.place, self.old, symlinks=True)
        before = snapshot(self.place)
        started = time.perf_counter()
        assert self.run(2) == 0, self.errors()
        return before, snapshot(self.place), time.perf_counter() - started

    def _keep(self):
        """From now on the dear functions are called once per seed."""
        import importlib

        for path in self.once:
            module, _, name = path.rpartition(".")
            module = importlib.import_module(module)
            setattr(module, name, self._kept(getattr(module, name)))

    def _kept(self, function):
        def call(*args, **kwargs):
            key = (function.__name__, args if self.name == "study" else self.seed)
            if key not in self.kept:
                self.kept[key] = function(*args, **kwargs)
            return self.kept[key]

        return call

    def restore(self):
        shutil.rmtree(self.place)
        shutil.copytree(self.old, self.place, symlinks=True)

    def run(self, seed, *more):
        """The command in this process."""
        self.seed = seed
        streams, silent = [os.dup(1), os.dup(2)], os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1), os.dup2(self.pipe[1], 2)  # a pipe can be written to on a full disk
        try:
            words = [*self.words, "--out", str(self.place / "out"), "--seed", str(seed), *more]
            return self._study(words) if self.name == "study" else self._command(words)
        finally:
            sys.stdout.flush(), sys.stderr.flush()
            os.dup2(streams[0], 1), os.dup2(streams[1], 2)
            for each in (silent, *streams):
                os.close(each)

    def errors(self):
        """What was written to stderr since the last time."""
        try:
            return os.read(self.pipe[0], 2**16).decode()
        except BlockingIOError:
            return ""

    def _command(self, words):
        from bsp_gp.cli import main

        if self.name != "track":
            return main([*words, "--overwrite", "--quiet"])
        at = words.index("--seed")
        scale = ["--scale", f"{100 + int(words[at + 1])}"]
        return main([*words[:at], *scale, "--overwrite", "--quiet"])

    def _study(self, words):
        import common
        import null_data

        jobs = null_data.jobs_of
        null_data.jobs_of = lambda *args: jobs(*args)[:2]
        sys.argv = ["null_data.py", *words[:-1], "1"]
        try:
            null_data.main()
        finally:
            common._HELD.close()  # as at the end of the process
            null_data.jobs_of = jobs
        return 0

    def child(self, act, *more):
        """Run the newer one in a child after `act`, with more words; its process."""
        child = os.fork()
        if child == 0:
            code = 99
            try:
                act()
                code = self.run(2, *more)
            except SystemExit as stop:
                code = stop.code if isinstance(stop.code, int) else 1
            finally:
                os._exit(code)
        return child

    def recover(self):
        """What any next run does before its work, though it is refused."""
        from bsp_gp.errors import OutputError
        from bsp_gp.output.place import claim

        for name in ("out", "out-truth", "out-film") if self.name == "make" else ("out",):
            with contextlib.suppress(OutputError), claim(self.place / name, "of no kind"):
                pass


def throws(folder):
    from tests.throws import throws_folder

    return throws_folder(folder / "throws", n_scenes=4, n_times=20, sigma=0.001)


def pulls(folder):
    from bsp_gp.data.scene import LatentDeclaration
    from bsp_gp.data.tables import save_dataset
    from tests.latent_worlds import dataset

    declared = LatentDeclaration("mass", low=0.2, high=9.0, entities=("b1", "b2"))
    return save_dataset(dataset(4, (declared,), noise=(0.0,)), folder / "pulls")


def grammar(folder):
    from tests.latent_worlds import grammar_file

    return grammar_file(folder)


def video(folder):
    from tests.renders import frame, write_video

    images = [frame((90, 140), [("red", (30 + 6.25 * k, 40))]) for k in range(8)]
    return write_video(folder / "ball.mkv", images, fps=25.0)


def snapshot(place):
    """What a user sees: every file but those of work under way, and its content."""
    return {
        path.relative_to(place).as_posix(): path.read_bytes()
        for path in place.rglob("*")
        if path.is_file() and ".bsp-gp-" not in path.relative_to(place).as_posix()
    }


def debris(place):
    return sorted(p.name for p in place.rglob(".*bsp-gp*"))


def arm(place, number, fault, is_plain=False):
    """Have `fault(event, path)` called before the write of this number, from 1 on."""
    from bsp_gp.output import replacing

    real, count, is_busy = replacing.exchange, 0, False

    def exchange(one, other):
        sys.audit("exchange", one)
        return False if is_plain else real(one, other)

    def hook(event, args):
        nonlocal count, is_busy
        if is_busy or not (event in WRITES or (event == "open" and is_write(args))):
            return
        path = os.fspath(args[0]) if not isinstance(args[0], int) else ""
        path = path.decode() if isinstance(path, bytes) else path
        if os.path.isabs(path) and not path.startswith(str(place)):
            return
        is_busy, count = True, count + 1
        try:
            if count >= number:
                fault(event, path)
        finally:
            is_busy = False

    replacing.exchange = exchange
    sys.addaudithook(hook)


def is_write(args):
    return bool((args[2] or 0) & (os.O_WRONLY | os.O_RDWR | os.O_CREAT))


def kill(event, path):
    if (
        event == "open" and os.path.isabs(path) and not path.endswith("-lock")
    ):  # the first bytes may be there
        with open(path, "ab") as file:
            file.write(b"torn")
    os.kill(os.getpid(), signal.SIGKILL)


def fill_disk(event, path):
    """Nothing can be made any more, nor can a file grow, whoever writes it."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (0, resource.RLIM_INFINITY))
    if event in GROWS and event != "open":
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)


def every_write(bench, mode):
    """One child per write: what it left, and what the next run made of that."""
    before, after, _ = bench.prepare()
    result = {"points": 0, "old": 0, "new": 0, "bad": []}
    while True:
        number = result["points"] + 1
        bench.restore()
        bench.errors()
        child = bench.child(
            lambda n=number: arm(
                bench.place, n, fill_disk if mode == "full" else kill, mode == "plain"
            )
        )
        status = os.waitpid(child, 0)[1]
        seen = snapshot(bench.place)
        left = debris(bench.place)
        if os.waitstatus_to_exitcode(status) == 0 and seen == after and not left:
            return result  # there is no write of this number, or it did not matter
        result["points"] = number
        judge(bench, result, before, after, seen if mode != "plain" else None)
        if mode == "full" and not left:
            error = bench.errors()
            if os.waitstatus_to_exitcode(status) != 2 or error.count("\n") != 1:
                result["bad"].append([number, os.waitstatus_to_exitcode(status), error[-500:]])
        elif mode == "full":
            result["bad"].append([number, "left", left])


def judge(bench, result, before, after, seen):
    """Whole as it is, and after the next run, which also clears away what was left."""
    if bench.name == "study":
        judge_study(bench, result, before, after, seen)
        return
    torn = [] if seen is None else torn_parts(before, after, seen)
    bench.recover()
    then = snapshot(bench.place)
    if torn or then not in (before, after) or debris(bench.place):
        result["bad"].append([result["points"], torn, debris(bench.place)])
    result["new" if then == after else "old"] += 1


def torn_parts(before, after, seen):
    """What is not as it was before or is to be after: files, and folders as a whole."""
    parts = {name: before.get(name) for name in before.keys() | after.keys()}
    torn = [n for n, b in parts.items() if seen.get(n) not in (b, after.get(n))]
    torn += sorted(set(seen) - set(parts))
    for top in {name.split("/")[0] for name in parts}:  # each folder is one of the two
        mine = {n: v for n, v in seen.items() if n.split("/")[0] == top}
        if mine not in [{n: v for n, v in x.items() if n.split("/")[0] == top}
                        for x in (before, after)]:  # fmt: skip
            torn.append(top)
    return torn


def judge_study(bench, result, before, after, seen):
    """Its table grows row by row; the next run goes on from it, to the same end."""
    table, mark = "out/results.csv", "out/.bsp_gp"
    torn = [n for n in seen if n not in (table, mark) and seen[n] not in (before.get(n), after[n])]
    rows = seen[table].splitlines(keepends=True)
    if torn or not set(rows) <= set(after[table].splitlines(keepends=True)):
        result["bad"].append([result["points"], torn])
    result["new" if seen == after else "old"] += 1
    status = os.waitpid(bench.child(int), 0)[1]
    if status or snapshot(bench.place) != after or debris(bench.place):
        result["bad"].append([result["points"], "not resumed", debris(bench.place)])


def random_times(bench, how_many):
    """The whole command, killed at times that are drawn evenly."""
    before, after, seconds = bench.prepare(is_kept=False)
    rng = random.Random(1)
    result = {"points": 0, "old": 0, "new": 0, "bad": [], "kept": 0}
    result["seconds"] = round(seconds, 2)
    for _ in range(how_many):
        bench.restore()
        child = bench.child(int)
        time.sleep(rng.uniform(0, 1.5 * seconds))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        result["points"] += 1
        bench.recover()
        then = snapshot(bench.place)
        is_kept = then.pop(ROUNDS, None) is not None
        is_new = then != before
        result["new" if is_new else "old"] += 1
        is_study = bench.name == "study"  # goes on, and clears its folder itself
        left = [] if is_study else debris(bench.place)
        if left or ((is_new or is_study) and not is_whole_result(bench, then, after)):
            result["bad"].append([result["points"], debris(bench.place)])
        if is_kept:
            result["kept"] += 1
            status = os.waitpid(bench.child(int, "--resume"), 0)[1]
            if status or not is_whole_result(bench, snapshot(bench.place), after):
                result["bad"].append([result["points"], "not resumed"])
    return result


def is_whole_result(bench, then, after):
    """Times are in some results, so that no two are the same: the marks tell what is whole.

    A study is gone on with, to the same end.
    """
    from bsp_gp.output.mark import read_mark, strangers

    if bench.name == "study":
        status = os.waitpid(bench.child(int), 0)[1]
        return status == 0 and snapshot(bench.place) == after and not debris(bench.place)
    foreign = {"out": ["notes.md"]}
    folders = {name.split("/")[0] for name in after if "/" in name}
    return set(then) == set(after) and all(
        strangers(bench.place / f, read_mark(bench.place / f)) == foreign.get(f, [])
        for f in folders
    )


def main(name, mode, how_many="100"):
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "experiments"))
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(name, Path(folder).resolve())
        if mode == "random":
            result = random_times(bench, int(how_many))
        else:
            result = every_write(bench, mode)
    print(json.dumps(result))


if __name__ == "__main__":
    main(*sys.argv[1:])
