"""The page of ``bsp-gp serve`` in Chromium: drop, mend, declare, run, read, download."""

import io
import re
import shutil
import zipfile

import pytest

from tests.snippets import ROOT

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("uvicorn", reason="the extra [web] is not installed")

from tests.unit.test_serve import FALLS, WEIGHT, Server  # noqa: E402  (skips without the extra)

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="no Chromium here: apt-get install chromium"),
]
LONG = 300_000  # ms
sync_api.expect.set_options(timeout=60_000)  # a busy machine answers late

A_STAGE = re.compile(r"^\d+ s: (?!starting$).+")
"""What a run says it is doing; which of its stages is seen is a matter of the machine's pace."""


@pytest.fixture(scope="module")
def server():
    server = Server()
    yield server
    assert server.close() == 0


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture
def page(server, browser):
    """The page; whatever it asks of another machine, and every complaint of its script, fails."""
    context = browser.new_context(accept_downloads=True)
    page = context.new_page()
    page.set_default_timeout(60_000)
    strayed, complaints = [], []
    page.on("request", lambda r: strayed.append(r.url) if not r.url.startswith(
        (server.address, "data:", "blob:")) else None)  # fmt: skip
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(server.address)
    yield page
    context.close()
    assert not strayed
    assert not complaints


def drop(page, name, content, mime="text/csv"):
    """Drop a file on the page, as a hand would."""
    page.evaluate(
        """([name, bytes, mime]) => {
            const transfer = new DataTransfer();
            transfer.items.add(new File([new Uint8Array(bytes)], name, {type: mime}));
            for (const kind of ["dragenter", "dragover", "drop"])
                document.getElementById("drop").dispatchEvent(
                    new DragEvent(kind, {dataTransfer: transfer, bubbles: true, cancelable: true}));
        }""",
        [name, list(content), mime],
    )
    card = page.locator(".card", has=page.locator("h2", has_text=name)).first
    card.wait_for()
    return card


def wrong_columns():
    """The falls under headings that say nothing right: height and time have each other's names."""
    rows = FALLS.read_text("utf-8").splitlines()[1:]
    return ("\n".join(["run,height,t", *rows]) + "\n").encode()


def test_a_table_with_wrong_columns_is_mended_a_slip_told_and_the_report_downloaded(page):
    card = drop(page, "cups.csv", wrong_columns())
    card.locator(".columns").wait_for()
    card.get_by_label("Meaning of height").select_option("t")
    card.get_by_label("Meaning of t", exact=True).select_option("y")
    card.get_by_label("Unit of height").select_option("s")
    card.get_by_label("Unit of t", exact=True).select_option("cm")
    card.locator(".up").select_option("y")
    text = card.locator(".text")
    sync_api.expect(text).to_contain_text("Axis y: from 57.50 to 219.9 cm", timeout=60_000)
    sync_api.expect(card.locator(":scope > .error")).to_be_hidden()
    sync_api.expect(card.locator("img.picture")).to_be_visible()

    run = card.locator("button.run")
    card.locator("button.own").click()
    law = card.locator(".formula")
    law.fill("9.81 * m_i * down")
    sync_api.expect(card.locator(".verdict")).to_contain_text("give its number a unit")
    sync_api.expect(run).to_be_disabled()
    law.fill(WEIGHT)
    sync_api.expect(card.locator(".verdict")).to_contain_text("a force")

    # A second file, asked for while the first one runs.
    other = drop(page, "falls.csv", FALLS.read_bytes())
    other.locator(".known").select_option(WEIGHT)
    sync_api.expect(other.locator(".text")).to_contain_text("4 scenes, 1 body", timeout=60_000)
    run.click()
    other.locator("button.run").click()
    sync_api.expect(other.locator(".running .progress")).to_contain_text("waiting")
    other.locator("button.stop").click()
    progress = card.locator(".running .progress")
    sync_api.expect(progress).to_have_text(A_STAGE, timeout=LONG)
    third = drop(page, "more.csv", FALLS.read_bytes())  # files are looked at all the while
    sync_api.expect(third.locator(".text")).to_contain_text("4 scenes, 1 body", timeout=60_000)
    sync_api.expect(progress).to_contain_text("done", timeout=LONG)
    sync_api.expect(other.locator(".running .progress")).to_contain_text("stopped")
    sync_api.expect(card.locator(".told")).to_contain_text("drag, quadratic in speed")
    report = card.frame_locator("iframe.report").locator("header").first
    sync_api.expect(report).to_contain_text("quadratic")
    with page.expect_download() as waiting:
        card.locator("a.download").click()
    with zipfile.ZipFile(io.BytesIO(waiting.value.path().read_bytes())) as archive:
        names = archive.namelist()
    assert {"report/report.html", "report/report.json", "report/law.tex"} <= set(names)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("<img src=x onerror=alert(1)>.csv", b"t,x\n0,1\n"),
        ("cell.csv", b"t,<script>alert(1)</script>,y\n0,1,2\n1,2,3\n2,4,5\n3,5,6\n4,5,7\n"),
        ("binary.csv", bytes(range(256)) * 100),
        ("bomb.xlsx", b"PK\x03\x04" + bytes(3000)),
    ],
)
def test_a_hostile_file_does_no_harm(page, name, content):
    page.on("dialog", lambda dialog: pytest.fail("a script of the file ran"))
    page.evaluate("name => 0", name)
    if "<" in name:
        with pytest.raises(sync_api.TimeoutError):
            page.set_default_timeout(3_000)
            drop(page, name, content)
        sync_api.expect(page.locator("#message")).to_contain_text("may not be called")
        return
    card = drop(page, name, content)
    sync_api.expect(card.locator(".checking")).to_have_text("", timeout=60_000)
    if name != "cell.csv":
        sync_api.expect(card.locator(":scope > .error")).to_be_visible()
        sync_api.expect(card.locator("button.run")).to_be_hidden()
    assert page.locator(".card script, .card img[src=x]").count() == 0
    drop(page, "falls.csv", FALLS.read_bytes()).locator("img.picture").wait_for()


def test_a_film_is_followed_by_clicks(page):
    film = ROOT / "examples" / "pendulum.mp4"
    page.locator("#file").set_input_files(film)
    card = page.locator(".card").first
    canvas = card.locator("canvas")
    canvas.wait_for()
    sync_api.expect(canvas).to_have_js_property("width", 480)
    zoom = canvas.bounding_box()["width"] / 480

    def click(x, y):
        canvas.click(position={"x": x * zoom, "y": y * zoom})

    click(442.3, 200.4)  # the bob, then the pivot and half a metre below it
    click(240.3, 70.7)
    click(240.3, 310.7)
    card.locator(".distance").fill("0,5")
    card.locator("button.follow").click()
    sync_api.expect(card.locator(".film .progress")).to_contain_text("240 of 240", timeout=LONG)
    sync_api.expect(card.locator(".text")).to_contain_text(
        "1 scene, 1 body, 240 rows", timeout=60_000
    )


def test_without_the_token_the_page_is_refused(server, browser):
    page = browser.new_page()
    answer = page.goto(f"http://127.0.0.1:{server.port}/")
    assert answer.status == 403
    page.close()


@pytest.mark.parametrize("width", [390, 1280])
def test_nothing_overflows_and_all_is_named(page, width):
    page.set_viewport_size({"width": width, "height": 800})
    card = drop(page, "falls.csv", FALLS.read_bytes())
    card.locator("img.picture").wait_for()
    card.locator(".known").select_option(WEIGHT)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    unnamed = page.evaluate(
        """[...document.querySelectorAll("input, select, button, img, iframe")].filter(n =>
            !(n.labels && n.labels.length) && !n.getAttribute("aria-label") && !n.textContent.trim()
            && !n.alt && !n.title).length"""
    )
    assert unnamed == 0
