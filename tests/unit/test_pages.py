"""Every snippet of the README and the pages runs and prints what is shown; links lead somewhere."""

import re
import subprocess
import sys

import pytest

from tests.snippets import ROOT, Block, blocks, idle, is_slow, missing, pages, prepare, run_page

FENCED = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"!?\[[^\]]*\]\(<?([^)\s>]+)>?[^)]*\)")


def named(path):
    marks = [pytest.mark.slow] if is_slow(path) else []
    return pytest.param(path, id=path.relative_to(ROOT).as_posix(), marks=marks)


@pytest.mark.parametrize("path", [named(p) for p in pages() if blocks(p.read_text("utf-8"))])
def test_snippets_run_and_print_what_is_shown(path, tmp_path, monkeypatch):
    if missing(path):
        pytest.skip(f"the page needs {missing(path)}")
    prepare(tmp_path, path)
    monkeypatch.chdir(tmp_path)
    run_page(path)


def test_no_block_is_left_alone():
    assert not [where for path in pages() for where in idle(path)]


@pytest.mark.parametrize(
    ("text", "lines"),
    [
        ("```toml\na = 1\n```\n", ["page.md:1"]),
        ("```sh\nls\n```\n\n```text\na\n```\n\n```text\nb\n```\n", ["page.md:9"]),
        ("<!-- not run: no time -->\n```sh\nls\n```\n", ["page.md:2"]),
        ("<!-- not run: tests/none.py does -->\n```sh\nls\n```\n", ["page.md:2"]),
        ("<!-- not run: it installs; tests/wheel.sh does -->\n```sh\nls\n```\n", ["page.md:2"]),
        ("<!-- not run: .ci/run does -->\n```sh\nmake lint  # twice\nbash .ci/run\n```\n", []),
        ("<!-- not run: .ci/run does -->\n```sh\nmake lint\nmake hay\n```\n", ["page.md:2"]),
        ("<!-- file: a.toml -->\n```toml\na = 1\n```\n", []),
    ],
)  # fmt: skip
def test_a_block_that_is_left_alone_is_named(tmp_path, text, lines):
    page = tmp_path / "page.md"
    page.write_text(text, "utf-8")
    assert idle(page) == lines


def anchors(path):
    """Names of a page's headings, as GitHub and MyST make them."""
    text = FENCED.sub("", path.read_text("utf-8"))
    heads = re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", h.lower()).strip().replace(" ", "-") for h in heads}


@pytest.mark.parametrize("path", pages(), ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(path):
    lost = []
    text = re.sub(r"`[^`\n]*`", "", FENCED.sub("", path.read_text("utf-8")))
    for link in LINK.findall(text):
        if re.match(r"[a-z]+:", link):
            assert link.startswith(("https://", "mailto:")), link
            continue
        name, _, anchor = link.partition("#")
        target = (path.parent / name).resolve() if name else path
        if not target.exists() or (anchor and anchor not in anchors(target)):
            lost.append(link)
    assert not lost


def test_readme_is_short():
    assert len((ROOT / "README.md").read_text("utf-8").splitlines()) <= 150


def test_blocks_and_their_marks_are_found():
    text = (
        "a\n\n<!-- file: x.csv -->\n```csv\nt,x\n```\n\n"
        "```sh\nbsp-gp --version\n```\n```text\nbsp\n```\n"
    )
    assert blocks(text) == [
        Block("csv", "t,x\n", 4, "file", "x.csv"), Block("sh", "bsp-gp --version\n", 8),
        Block("text", "bsp\n", 11),
    ]  # fmt: skip


def test_a_command_that_fails_is_seen_unless_its_error_is_shown(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.md"
    page.write_text("```sh\nbsp-gp check nothing.csv\n```\n", "utf-8")
    with pytest.raises(AssertionError, match="page.md:1: bsp-gp check nothing.csv"):
        run_page(page)
    page.write_text(page.read_text("utf-8") + "```text\nbsp-gp: error: ...\n```\n", "utf-8")
    run_page(page)


@pytest.mark.parametrize("shown", ["bsp-gp 9.9", "nothing of the kind"])
def test_what_is_not_printed_is_not_shown(shown, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = tmp_path / "page.md"
    page.write_text(f"```sh\nbsp-gp --version\n```\n\n```text\n{shown}\n```\n", "utf-8")
    with pytest.raises(AssertionError, match="page.md:5 shows"):
        run_page(page)
    page.write_text("```sh\nbsp-gp --version\n```\n\n```text\nbsp-gp ...\n```\n", "utf-8")
    run_page(page)


@pytest.mark.slow
def test_the_site_is_built_without_a_warning_and_needs_no_network(tmp_path):
    pytest.importorskip("furo", reason="the extra [docs] is not installed")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html"]
    run = subprocess.run([*command, ROOT / "docs", tmp_path], capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    lost, strayed = [], []
    for page in tmp_path.rglob("*.html"):
        text = page.read_text("utf-8")
        strayed += re.findall(r"<(?:script|img|iframe)[^>]* src=\"(?:https?:)?//[^\"]*", text)
        strayed += re.findall(r"<link[^>]* rel=\"stylesheet\"[^>]*href=\"http[^\"]*", text)
        for link in re.findall(r"(?:href|src)=\"([^\"#:]+)(?:#[^\"]*)?\"", text):
            target = page.parent / link.partition("?")[0]
            if not target.exists():
                lost.append(f"{page.name}: {link}")
        for anchor in re.findall(r"href=\"#([^\"]+)\"", text):
            if f'id="{anchor}"' not in text:
                lost.append(f"{page.name}: #{anchor}")
    assert not strayed
    assert not lost
    named = (tmp_path / "index.html").read_text("utf-8")
    found = {path.stem for path in (ROOT / "docs").glob("*.md")} - {"index"}
    assert {stem for stem in found if f'href="{stem}.html"' not in named} == set()
