"""The notebooks of examples/ run from top to bottom in a copy of their folder."""

import os
import shutil

import pytest

from tests.snippets import ROOT, command_folder

BOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def test_there_are_five_of_them():
    assert len(BOOKS) == 5


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # of the kernel's own machinery; cells run with their own
@pytest.mark.parametrize("book", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(book, tmp_path, monkeypatch):
    nbformat = pytest.importorskip("nbformat", reason="the extra [dev] is not installed")
    nbclient = pytest.importorskip("nbclient", reason="the extra [dev] is not installed")
    pytest.importorskip("ipykernel", reason="the extra [dev] is not installed")
    folder = tmp_path / "examples"
    shutil.copytree(ROOT / "examples", folder)
    with command_folder() as commands:
        monkeypatch.setenv("PATH", f"{commands}{os.pathsep}{os.environ['PATH']}")
        monkeypatch.setenv("PYTHONPATH", str(ROOT))
        content = nbformat.read(book, as_version=4)
        done = nbclient.NotebookClient(
            content, timeout=900, resources={"metadata": {"path": str(folder)}}
        ).execute()
    if keep := os.environ.get("BSP_GP_KEEP_NOTEBOOKS"):  # the outputs, to be shown
        nbformat.write(done, os.path.join(keep, book.name))
    for cell in done.cells:  # a command that fails after ! raises nothing
        said = "".join(o.get("text", "") for o in cell.get("outputs", ()))
        assert "bsp-gp: error" not in said, said
