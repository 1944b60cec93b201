"""Results are written whole, over nothing but older results, and by one process at a time."""

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from bsp_gp.cli import main
from bsp_gp.data.tables import load_dataset, save_dataset
from bsp_gp.errors import OutputError
from bsp_gp.output import journal, replacing
from bsp_gp.output import lock as lock_module
from bsp_gp.output.group import claim_group
from bsp_gp.output.mark import MARK, read_mark
from bsp_gp.output.place import claim, whole_file
from tests.throws import DRAG, GRAVITY, throws, throws_folder

ROOT = Path(__file__).resolve().parents[2]


def write(folder, kind="table", overwrite=True, **files):
    with claim(folder, kind, overwrite=overwrite) as place:
        with place.fill(kind, overwrite) as fresh:
            for name, text in files.items():
                path = fresh / name.replace("__", "/").replace("_", ".")
                path.parent.mkdir(exist_ok=True)
                path.write_text(text)
    return place


def tree(folder):
    """Every file and its content; of a folder without any, None."""
    return {
        p.relative_to(folder).as_posix(): p.read_text() if p.is_file() else None
        for p in sorted(folder.rglob("*"))
        if p.name != MARK and (not p.is_dir() or not any(p.iterdir()))
    }


def one_line(capsys):
    out, err = capsys.readouterr()
    assert not out and err.startswith("bsp-gp: error: ") and err.count("\n") == 1
    return err


@pytest.fixture(params=["exchange", "two renames"])
def way(request, monkeypatch):
    """With the system's exchange of names, and without it."""
    if request.param == "two renames":
        monkeypatch.setattr(replacing, "exchange", lambda one, other: False)
    return request.param


# --- what is not ours is kept ---------------------------------------------------------------------


def test_an_older_result_gives_way_and_what_is_not_ours_stays(tmp_path, way):
    target = tmp_path / "r"
    write(target, a_txt="old", b_txt="old", figures__c_txt="old")
    (target / "notes.md").write_text("mine")
    (target / "figures" / "mine.txt").write_text("mine too")
    (target / "drafts" / "empty").mkdir(parents=True)
    (target / "link").symlink_to("nowhere")
    (target / "b.txt").write_text("corrected by hand")
    place = write(target, a_txt="new", b_txt="new")
    assert tree(target) == {
        "a.txt": "new", "b.txt": "new", "b.txt.kept": "corrected by hand", "notes.md": "mine",
        "figures/mine.txt": "mine too", "drafts/empty": None, "link": None,
    }  # fmt: skip
    assert os.readlink(target / "link") == "nowhere"
    assert sorted(place.kept) == [
        "b.txt.kept", "drafts/empty/", "figures/mine.txt", "link", "notes.md"
    ]  # fmt: skip
    write(target, a_txt="newer", notes_md="ours")
    assert tree(target)["notes.md"] == "ours" and tree(target)["notes.md.kept"] == "mine"
    assert os.listdir(tmp_path) == ["r"]


def test_files_are_kept_where_the_file_system_has_no_links(tmp_path, monkeypatch):
    def refuse(*args, **kwargs):
        raise OSError(errno.EPERM, "Operation not permitted")

    write(tmp_path / "r", a_txt="old")
    (tmp_path / "r" / "notes.md").write_text("mine")
    monkeypatch.setattr(os, "link", refuse)
    write(tmp_path / "r", a_txt="new")
    assert tree(tmp_path / "r") == {"a.txt": "new", "notes.md": "mine"}


def test_only_folders_with_our_mark_give_way(tmp_path):
    for name, content in (("thesis", "years of work"), (MARK, "{}"), (MARK, '{"schema": 1}')):
        target = tmp_path / name
        target.mkdir()
        (target / name).write_text(content)
        with pytest.raises(OutputError, match=f"holds other files .{name}.*never overwritten"):
            write(target, a_txt="new")
        assert (target / name).read_text() == content
        (target / name).unlink()
        target.rmdir()
    save_dataset(throws(), tmp_path / "d")
    (tmp_path / "d" / MARK).unlink()  # as if it was measured
    with pytest.raises(OutputError, match="entities.csv"):
        save_dataset(throws(), tmp_path / "d", overwrite=True)


def test_a_result_of_another_kind_does_not_give_way(tmp_path):
    write(tmp_path / "r", a_txt="old")
    with pytest.raises(OutputError, match="holds a table and not a report"):
        write(tmp_path / "r", "report", a_txt="new")
    with pytest.raises(OutputError, match="pass overwrite=True"):
        write(tmp_path / "r", overwrite=False, a_txt="new")
    assert tree(tmp_path / "r") == {"a.txt": "old"}


def test_a_mark_cannot_point_out_of_its_folder(tmp_path):
    write(tmp_path / "r", a_txt="old")
    (tmp_path / "mine.txt").write_text("mine")
    mark = json.loads((tmp_path / "r" / MARK).read_text())
    mark["files"]["../mine.txt"] = mark["beside"]["../mine.txt"] = ""
    (tmp_path / "r" / MARK).write_text(json.dumps(mark))
    write(tmp_path / "r", a_txt="new")
    assert (tmp_path / "mine.txt").read_text() == "mine"


def test_a_folder_filled_during_the_work_is_not_replaced(tmp_path):
    with pytest.raises(OutputError, match=r"holds other files \(mine"):
        with claim(tmp_path / "r", "table", overwrite=True) as place:
            with place.fill("table", True) as fresh:
                (fresh / "a").write_text("new")
                (tmp_path / "r").mkdir()
                (tmp_path / "r" / "mine").write_text("mine")
    assert tree(tmp_path) == {"r/mine": "mine"}


# --- places that cannot be ------------------------------------------------------------------------


def test_places_that_cannot_hold_a_result(tmp_path, monkeypatch):
    file = tmp_path / "file"
    file.write_text("")
    for target in (file, file / "below", file / "far" / "below"):
        with pytest.raises(OutputError, match="is a file"):
            write(target)
    monkeypatch.chdir(tmp_path)
    for target in (".", "..", tmp_path):
        with pytest.raises(OutputError, match="folder of its own"):
            write(target)
    (tmp_path / "one").symlink_to("two")
    (tmp_path / "two").symlink_to("one")
    for target in ("one", "one/below", "one/far/below"):
        with pytest.raises(OutputError, match=r"choose another folder"):
            write(target)
    with pytest.raises(OutputError, match="File name too long"):
        write("x" * 300)
    assert sorted(os.listdir(tmp_path)) == ["file", "one", "two"]
    monkeypatch.setattr(os, "access", lambda *args: False)
    with pytest.raises(OutputError, match="not writable"):
        write(tmp_path / "new" / "deep")


def test_an_unreadable_place_is_said_in_one_line(tmp_path, monkeypatch, capsys):
    def refuse(path="."):
        raise PermissionError(errno.EACCES, "Permission denied", os.fspath(path))

    (tmp_path / "r").mkdir()
    data = str(throws_folder(tmp_path / "d"))
    monkeypatch.setattr(os, "listdir", refuse)
    words = ["simulate", data, "--law", GRAVITY, "--out", str(tmp_path / "r"), "--overwrite"]
    assert main(words) == 2
    assert "Permission denied" in one_line(capsys)


@pytest.mark.parametrize("where", ["is", "holds", "lies in", "is, by a link", "is linked to"])
@pytest.mark.parametrize("command", ["simulate", "close", "fit", "infer", "compare"])
def test_an_input_is_never_written_to(tmp_path, capsys, command, where):
    data = throws_folder(tmp_path / "in" / "d")
    before = tree(tmp_path)
    out = {"is": data, "holds": tmp_path / "in", "lies in": data / "new"}.get(where)
    if where == "is, by a link":
        out = tmp_path / "other"
        out.symlink_to(data)
    elif where == "is linked to":  # a data set of links to where the files are
        out, data = data, tmp_path / "links"
        data.mkdir()
        for name in ("trajectories.csv", "entities.csv", "dataset.toml"):
            (data / name).symlink_to(out / name)
    law = "--declare" if command in ("close", "compare") else "--law"
    words = [command, str(data), law, GRAVITY, "--out", str(out), "--overwrite"]
    assert main(words) == 2
    assert "the input" in one_line(capsys)
    assert {k: v for k, v in tree(tmp_path).items() if k.startswith("in/")} == before


def test_models_grammars_and_videos_are_inputs_too(tmp_path, capsys):
    data = str(throws_folder(tmp_path / "d"))
    folder = tmp_path / "mine"
    folder.mkdir()
    for name in ("model.toml", "grammar.toml", "film.mp4"):
        (folder / name).write_text("")
    for words in (
        ["close", data, "--model", folder / "model.toml"],
        ["close", data, "--declare", GRAVITY, "--grammar", folder / "grammar.toml"],
        ["compare", data, "--grammar", folder / "grammar.toml"],
        ["track", folder / "film.mp4", "--object", "ball=disc:red"],
    ):
        assert main([*map(str, words), "--out", str(folder), "--overwrite"]) == 2
        assert "holds the input" in one_line(capsys)


# --- one process at a time ------------------------------------------------------------------------

HOLD = (
    "import sys, time\n"
    "from bsp_gp.output.place import claim\n"
    "with claim(sys.argv[1], 'fit', overwrite=True) as place:\n"
    "    print('held', flush=True)\n"
    "    time.sleep(60)\n"
)


@pytest.fixture
def holder(tmp_path):
    """Another process that writes to `out`."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path / "out")], stdout=subprocess.PIPE, cwd=ROOT
    )
    assert process.stdout.readline() == b"held\n"
    yield process
    process.kill()
    process.communicate()


def test_the_second_process_is_refused_at_once(tmp_path, capsys, holder, monkeypatch):
    data = str(throws_folder(tmp_path / "d"))
    out = tmp_path / "out"
    words = ["fit", data, "--law", GRAVITY, "--out", str(out)]
    with monkeypatch.context() as patch:
        patch.setattr("bsp_gp.cli.read_dataset", None)  # not even the data are read
        assert main(words) == 2
    assert "another process is writing there" in one_line(capsys)
    (tmp_path / "same").symlink_to(out)
    assert main([*words[:-1], str(tmp_path / "same")]) == 2
    assert "another process" in one_line(capsys)
    holder.kill()  # the lock goes with its process
    holder.wait()
    assert main([*words, "--quiet"]) == 0
    assert sorted(os.listdir(tmp_path)) == ["d", "out", "same"]


def test_a_lock_that_is_given_up_while_waiting_is_taken_anew(tmp_path, monkeypatch):
    path = tmp_path / "lock"
    real, calls = lock_module._lock_now, []

    def late(handle):
        calls.append(handle)
        if len(calls) == 1:
            path.unlink()  # its holder ended between opening and locking
        return real(handle)

    monkeypatch.setattr(lock_module, "_lock_now", late)
    lock = lock_module.take_lock(path, path)
    assert len(calls) == 2 and path.exists()
    lock.release()
    assert not path.exists()


def test_work_goes_on_where_there_are_no_locks(tmp_path, monkeypatch):
    monkeypatch.setattr(lock_module, "_lock_now", lambda handle: False)
    (tmp_path / ".r.bsp-gp-new-1").mkdir()  # perhaps of a process that is alive
    write(tmp_path / "r", a_txt="new")
    assert tree(tmp_path / "r") == {"a.txt": "new"}
    assert (tmp_path / ".r.bsp-gp-new-1").is_dir()


def test_a_claim_is_held_until_its_end_and_may_be_repeated_inside(tmp_path):
    with claim(tmp_path / "far" / "r", "table"):
        with claim(tmp_path / "far" / "r", "table"):
            pass
        assert (tmp_path / "far" / ".r.bsp-gp-lock").exists()
    assert os.listdir(tmp_path) == []


# --- after a killed run ---------------------------------------------------------------------------


def test_a_file_is_whole(tmp_path):
    path = tmp_path / "a.txt"
    (tmp_path / ".a.bsp-gp-part.txt").write_text("half of what a killed run wr")
    with whole_file(path) as part:
        part.write_text("one")
    with pytest.raises(OutputError, match="No space left"):
        with whole_file(path) as part:
            part.write_text("tw")
            raise OSError(errno.ENOSPC, "No space left on device")
    assert tree(tmp_path) == {"a.txt": "one"}


def test_what_a_killed_run_left_is_cleared_away(tmp_path):
    target = tmp_path / "r"
    write(target, a_txt="old")
    (target / "notes.md").write_text("mine")
    half = replacing.new_folder(target)  # killed while it was filled
    (half / "a.txt").write_text("ne")
    raw = tmp_path / ".r.bsp-gp-new-p1234"  # killed before it had its name
    raw.mkdir()
    (tmp_path / ".r.bsp-gp-lock").write_text("")
    (tmp_path / ".rr.bsp-gp-new-1").mkdir()  # of another result
    with claim(target, "table", overwrite=True):
        pass
    assert sorted(os.listdir(tmp_path)) == [".rr.bsp-gp-new-1", "r"]
    assert tree(target) == {"a.txt": "old", "notes.md": "mine"}


def test_the_older_one_returns_after_a_kill_between_two_renames(tmp_path):
    target = tmp_path / "r"
    write(target, a_txt="old")
    (target / "notes.md").write_text("mine")
    aside = tmp_path / f".r.bsp-gp-old-{target.stat().st_ino}"
    target.rename(aside)
    with pytest.raises(OutputError, match="exists already"):  # any next run brings it back
        write(target, overwrite=False, a_txt="new")
    assert tree(tmp_path) == {"r/a.txt": "old", "r/notes.md": "mine"}


def test_the_older_one_returns_if_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    target = tmp_path / "r"
    write(target, a_txt="old")
    rename = os.rename

    def refuse(source, to):
        if to == target and "-new-" in source.name:
            raise PermissionError(errno.EACCES, "Permission denied")
        return rename(source, to)

    monkeypatch.setattr(replacing, "exchange", lambda one, other: False)
    monkeypatch.setattr(os, "rename", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        write(target, a_txt="new")
    assert tree(tmp_path) == {"r/a.txt": "old"} and os.listdir(tmp_path) == ["r"]


def test_what_came_into_the_older_one_at_the_last_moment_is_not_lost(tmp_path, way, monkeypatch):
    target = tmp_path / "r"
    write(target, a_txt="old")
    swap = replacing._swap

    def late(fresh, place):
        (place / "late.md").write_text("mine")
        old = swap(fresh, place)
        (old / "later.md").write_text("mine too")  # whoever had the folder open
        return old

    monkeypatch.setattr(replacing, "_swap", late)
    write(target, a_txt="new")
    assert tree(tmp_path) == {"r/a.txt": "new", "r/late.md": "mine", "r/later.md": "mine too"}


# --- results that belong together -----------------------------------------------------------------

FOLDERS, FILES = {"": "data", "-truth": "truth"}, ("-m.toml", "-p.png")


def write_group(folder, text, names=("", "-truth", "-m.toml", "-p.png")):
    with claim_group(folder, FOLDERS, FILES, overwrite=True) as group:
        with group.fill() as paths:
            for name in names:
                path = paths[name] / "a.txt" if name in FOLDERS else paths[name]
                path.write_text(text)


def test_a_group_is_written_and_replaced_together(tmp_path):
    write_group(tmp_path / "g", "1")
    (tmp_path / "g-truth" / "notes.md").write_text("mine")
    write_group(tmp_path / "g", "2", ("", "-p.png"))
    assert tree(tmp_path) == {"g/a.txt": "2", "g-p.png": "2", "g-truth/notes.md": "mine"}
    with pytest.raises(OutputError, match="g-truth: holds other files"):
        write_group(tmp_path / "g", "3")
    (tmp_path / "g-truth" / "notes.md").unlink()
    write_group(tmp_path / "g", "3")
    (tmp_path / "g-m.toml").write_text("corrected by hand")
    with pytest.raises(OutputError, match=r"g-m\.toml: exists already"):
        write_group(tmp_path / "g", "4")
    assert {v for k, v in tree(tmp_path).items() if k != "g-m.toml"} == {"3"}
    assert sorted(os.listdir(tmp_path)) == ["g", "g-m.toml", "g-p.png", "g-truth"]


@pytest.mark.parametrize("number", range(1, 6))
def test_a_group_stays_as_it_was_if_the_system_refuses_a_step(tmp_path, way, monkeypatch, number):
    write_group(tmp_path / "g", "old")
    (tmp_path / "g-truth" / "notes.md").write_text("mine")
    before, real, calls = tree(tmp_path), journal._change, []

    def refuse(*args):
        calls.append(args)
        if len(calls) == number:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(*args)

    monkeypatch.setattr(journal, "_change", refuse)
    if number < 5:
        with pytest.raises(OutputError, match="No space left"):
            write_group(tmp_path / "g", "new")
    else:
        write_group(tmp_path / "g", "new")
        before = {k: v if v == "mine" else "new" for k, v in before.items()}
    assert tree(tmp_path) == before
    assert sorted(os.listdir(tmp_path)) == ["g", "g-m.toml", "g-p.png", "g-truth"]


def test_the_command_line_says_what_it_kept(tmp_path, capsys):
    data = str(throws_folder(tmp_path / "d"))
    words = ["simulate", data, "--law", GRAVITY, "--out", str(tmp_path / "r"), "--quiet"]
    assert main(words) == 0
    (tmp_path / "r" / "notes.md").write_text("mine")
    with open(tmp_path / "r" / "entities.csv", "a") as file:
        file.write("\n")
    capsys.readouterr()
    assert main([*words, "--law", DRAG, "--set", "c1=0.1", "--overwrite"]) == 0
    err = capsys.readouterr().err
    assert err == (
        f"bsp-gp: {tmp_path / 'r'}: kept what is not of bsp-gp or was altered: "
        "entities.csv.kept, notes.md\n"
    )
    assert (tmp_path / "r" / "notes.md").read_text() == "mine"
    assert load_dataset(tmp_path / "r")
    assert read_mark(tmp_path / "r").kind == "simulated data set"
