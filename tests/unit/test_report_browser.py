"""The page of a report in a browser: nothing overflows, folds and controls work, text is legible.

The browser is the system's Chromium; it runs a page that holds the report in frames of three
widths, looks into them, and prints what it finds.
"""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from bsp_gp.report.html import render_html
from tests.unit import report_sample as sample

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "chrome"))), None)
WIDTHS = (390, 768, 1280)
PAGES = (
    "adopted", "cannot_tell", *(pytest.param(n, marks=pytest.mark.slow) for n in
                                ("orbit", "hostile")),
)  # fmt: skip
PROBE = """<!DOCTYPE html><meta charset="utf-8"><body><pre id="out"></pre><script>
const widths = WIDTHS_HERE;
const channel = v => (v /= 255) <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4;
const luminance = c => 0.2126 * channel(c[0]) + 0.7152 * channel(c[1]) + 0.0722 * channel(c[2]);
const numbers = text => (text.match(/[\\d.]+/g) || []).map(Number);
function behind(node, view) {
  for (; node && node.nodeType === 1; node = node.parentNode) {
    const c = numbers(view.getComputedStyle(node).backgroundColor);
    if (c.length === 3 || c[3] === 1) return c;
  }
  return [255, 255, 255];
}
function faint(doc, view) {
  const found = [];
  for (const node of doc.querySelectorAll("main *")) {
    const own = [...node.childNodes].some(n => n.nodeType === 3 && n.textContent.trim());
    if (!own || node.closest("svg")) continue;
    const pair = [numbers(view.getComputedStyle(node).color), behind(node, view)].map(luminance);
    const ratio = (Math.max(...pair) + 0.05) / (Math.min(...pair) + 0.05);
    if (ratio < 4.5) found.push(node.tagName + ": " + node.textContent.trim().slice(0, 30));
  }
  return found;
}
function explored(doc, view) {
  const out = {}, at = id => doc.getElementById("explore-" + id);
  if (!at("path")) return null;
  out.drawn = doc.getElementById("explore").offsetHeight > 300;
  const change = (id, event, set, of) => {
    const drawing = at(of), before = drawing.innerHTML;
    set(at(id)); at(id).dispatchEvent(new view.Event(event));
    out[id] = drawing.innerHTML !== before;
  };
  change("time", "input", node => { node.value = 3; }, "errors");
  out.said = at("now").textContent;
  change("track", "change", node => { node.selectedIndex = node.options.length - 1; }, "path");
  if (at("before")) change("before", "change", node => { node.checked = false; }, "path");
  if (at("left")) {
    for (const id of ["against", "size"])
      change(id, "change", node => { node.selectedIndex = 1; }, "left");
  }
  return out;
}
function look(frame, width) {
  const doc = frame.contentDocument, view = frame.contentWindow, out = {width};
  const wide = () => doc.documentElement.scrollWidth;
  out.closed = wide();
  const first = doc.querySelector("header");
  out.first = first.innerText.split(/\\s+/).filter(Boolean).length;
  out.open_words = doc.body.innerText.split(/\\s+/).filter(Boolean).length;
  out.folds = 0;
  for (const fold of doc.querySelectorAll("details:not([open])")) {
    const before = fold.offsetHeight;
    fold.querySelector("summary").click();
    out.folds += fold.open && fold.offsetHeight > before ? 0 : 1;
  }
  out.opened = wide();
  out.faint = faint(doc, view);
  out.controls = [];
  for (const box of doc.querySelectorAll(".picture input")) {
    const line = doc.getElementById(box.id.slice("show-".length));
    const shown = () => view.getComputedStyle(line).display !== "none";
    const was = shown(); box.click(); const hidden = !shown(); box.click();
    out.controls.push(was && hidden && shown());
  }
  out.explored = explored(doc, view);
  out.unnamed = [...doc.querySelectorAll("img:not([alt]), svg:not([aria-label])")].length;
  out.unscoped = doc.querySelectorAll("th:not([scope])").length;
  out.unlabelled = [...doc.querySelectorAll("input")].filter(i => !i.labels.length).length;
  out.lost = [...doc.querySelectorAll("nav a")].filter(
    a => !doc.getElementById(a.getAttribute("href").slice(1))).length;
  out.broken = [...doc.images].filter(i => !i.complete || !i.naturalWidth).length;
  return out;
}
let left = widths.length; const found = [];
for (const width of widths) {
  const frame = document.createElement("iframe");
  frame.style.cssText = `width:${width}px;height:800px;border:0`;
  frame.onload = () => { found.push(look(frame, width)); if (!--left)
    document.getElementById("out").textContent = JSON.stringify(found); };
  frame.src = "report.html"; document.body.append(frame);
}
</script>"""


AXE = """<script src="axe.min.js"></script><script>
addEventListener("load", async () => {
  for (const fold of document.querySelectorAll("details")) fold.open = true;
  const found = await axe.run(document);
  const told = found.violations.map(v => [v.impact, v.id, v.nodes[0].html.slice(0, 200)]);
  document.body.innerHTML = '<pre id="out"></pre>';
  document.getElementById("out").textContent = JSON.stringify(told);
});
</script></body>"""
needs_browser = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium here: apt-get install chromium"
)


def dumped(file, *options):
    """What a page has written into its element `out`, and what the console says."""
    run = subprocess.run(
        [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr",
         "--allow-file-access-from-files", "--window-size=1400,900", "--virtual-time-budget=20000",
         f"--user-data-dir={file.parent / 'profile'}", *options, "--dump-dom", file.as_uri()],
        capture_output=True, text=True, timeout=240, check=True,
    )  # fmt: skip
    text = re.search(r'<pre id="out">(.*?)</pre>', run.stdout, re.DOTALL)[1]
    return json.loads(html.unescape(text)), re.findall(r"CONSOLE.*", run.stderr)


def looked_at(folder, *options):
    """What the probe finds in `report.html` of a folder, and what the console says."""
    (folder / "probe.html").write_text(PROBE.replace("WIDTHS_HERE", str(list(WIDTHS))), "utf-8")
    return dumped(folder / "probe.html", *options)


def axe_finds(folder, page, *options):
    """What axe-core finds in a page whose folds are all open: impact, rule, the first element."""
    axe = pytest.importorskip("axe_core_python", reason="pip install axe-core-python")
    shutil.copy(Path(axe.__file__).parent / "axe.min.js", folder)
    page = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page)
    (folder / "axe.html").write_text(page.replace("</body>", AXE), "utf-8")
    return dumped(folder / "axe.html", *options)[0]


@needs_browser
@pytest.mark.parametrize("options", [
    (), pytest.param(("--force-dark-mode",), marks=pytest.mark.slow)
], ids=["light", "dark"])  # fmt: skip
@pytest.mark.parametrize("name", [
    "adopted", pytest.param("cannot_tell", marks=pytest.mark.slow), *PAGES[2:]
])  # fmt: skip
def test_axe_finds_nothing_to_mend(tmp_path, name, options):
    assert axe_finds(tmp_path, render_html(sample.ALL[name]()), *options) == []


@needs_browser
@pytest.mark.slow
def test_axe_would_find_what_is_wrong(tmp_path):
    page = render_html(sample.adopted()).replace("</main>", '<img src="x.png"></main>')
    assert [told[:2] for told in axe_finds(tmp_path, page)] == [["critical", "image-alt"]]


@pytest.mark.slow
@needs_browser
@pytest.mark.parametrize("options", [(), ("--force-dark-mode",)], ids=["light", "dark"])
@pytest.mark.parametrize("name", PAGES)
def test_a_page_in_a_browser(tmp_path, name, options):
    (tmp_path / "report.html").write_text(
        render_html(sample.ALL[name](), {"argv": ["bsp-gp", "close", "data"]}), "utf-8"
    )
    found, console = looked_at(tmp_path, *options)
    assert not console
    assert [f["width"] for f in found] and {f["width"] for f in found} == set(WIDTHS)
    for f in found:
        assert f["closed"] <= f["width"] and f["opened"] <= f["width"], "it scrolls sideways"
        assert name == "hostile" or (f["first"] <= 120 and f["open_words"] <= 2500)
        assert f["folds"] == 0, "a fold does not open"
        assert f["faint"] == []
        assert all(f["controls"]) and len(f["controls"]) == (0 if name == "cannot_tell" else 2)
        assert (f["explored"] is None) == (name == "cannot_tell")
        if f["explored"] and name == "adopted":
            assert " off" in f["explored"].pop("said") and set(f["explored"]) == {
                "drawn", "time", "track", "before", "against", "size"
            }  # fmt: skip
            assert all(f["explored"].values()), f["explored"]
        for fault in ("unnamed", "unscoped", "unlabelled", "lost", "broken"):
            assert f[fault] == 0, fault
