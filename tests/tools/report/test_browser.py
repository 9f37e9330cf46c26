"""The page in a browser: headless Chromium opens it, zooms every picture, sorts and searches, and finds no
error, no request to anybody, nothing missing and no text over other text. A wide page's pictures are zoomed
with LPVGUARD_FULL=1."""

import json
import os
import re
from html import unescape
from pathlib import Path

import pytest
from report_case import DRIVES

from parts import chromium, require

FULL = os.environ.get("LPVGUARD_FULL") == "1"
EARLY = """<script>
window.wrong = [];
addEventListener("error", (event) => wrong.push(String(event.message)));
addEventListener("unhandledrejection", (event) => wrong.push(String(event.reason)));
addEventListener("securitypolicyviolation", (event) => wrong.push(`blocked ${event.blockedURI}`));
for (const kind of ["error", "warn"]) console[kind] = (...words) => wrong.push(words.join(" "));
</script>"""
LATE = """<script>
const boxes = (root) => {
  const found = [];
  const walk = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
  while (walk.nextNode()) {
    const text = walk.currentNode;
    if (!text.textContent.trim() || text.parentElement.closest("script,style,svg,sub,sup,.zoom")) continue;
    const range = document.createRange();
    range.selectNodeContents(text);
    for (const r of range.getClientRects()) if (r.width > 1) found.push([r, text.textContent.trim()]);
  }
  return found;
};
const letters = (svg) => [...svg.querySelectorAll("g[transform]")]
  .filter((g) => g.querySelector(':scope > use[href^="#DejaVu"]'))
  .map((g) => [g.getBoundingClientRect(), `letters in ${svg.closest("figure").id}`]);
const over = (found) => {
  const laps = [];
  found.sort(([a], [b]) => a.top - b.top);
  found.forEach(([a, one], i) => {
    for (let j = i + 1; j < found.length && found[j][0].top < a.bottom - 3; j += 1) {
      const [b, other] = found[j];
      if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 2) laps.push(`${one} / ${other}`);
    }
  });
  return laps;
};
const pause = (ms) => new Promise((done) => setTimeout(done, ms));
addEventListener("load", async () => {
  const told = { wide: document.documentElement.scrollWidth - innerWidth, lost: [], letters: 0 };
  told.bottom = document.getElementById("glance").getBoundingClientRect().bottom;
  told.overlaps = over(boxes(document.body));
  for (const svg of document.querySelectorAll("figure > svg")) {
    const box = svg.getBoundingClientRect();
    if (box.width < 100 || box.height < 30) told.lost.push(svg.closest("figure").id);
    told.overlaps.push(...over(letters(svg)));
    told.letters += letters(svg).length;
  }
  const first = document.querySelector("#blind-map td[data-state]");
  first.focus();
  first.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
  told.focused = document.activeElement.id;
  told.reading = document.getElementById("map-reading").textContent;
  const names = () => [...document.querySelectorAll("#drive-index tbody tr")]
    .filter((row) => !row.hidden).map((row) => row.dataset.drive);
  const sort = [...document.querySelectorAll("#drive-index th button")]
    .find((button) => button.textContent.startsWith("largest"));
  sort.click();
  told.sorted = names();
  const search = document.getElementById("drive-search");
  search.value = "weak";
  search.dispatchEvent(new Event("input"));
  told.searched = names();
  for (const button of window.zooms ? document.querySelectorAll(".zoom-button") : []) {
    const picture = button.closest("figure");
    button.click();
    for (let i = 0; i < 100 && !picture.querySelector(".zoom > *"); i += 1) await pause(20);
    const zoom = picture.querySelector(".zoom");
    if (!zoom || zoom.getBoundingClientRect().height < 100) told.lost.push(`zoom of ${picture.id}`);
  }
  await pause(500);
  told.zoomed = document.querySelectorAll(".zoomed").length;
  told.asked = performance.getEntriesByType("resource").map((entry) => entry.name)
    .filter((name) => !/^(data|blob):/.test(name));
  told.wrong = wrong;
  const out = document.createElement("pre");
  out.id = "told";
  out.textContent = JSON.stringify(told);
  document.body.append(out);
});
</script>"""


def opened(folder: Path, page: str, width: int, zooms: bool) -> dict:
    """What the page says of itself at this width [px], with everything in it used once; pictures are zoomed
    where ``zooms`` says so."""
    path = folder / "page.html"
    early = f"<script>window.zooms = {json.dumps(zooms)};</script>{EARLY}"
    path.write_text(page.replace("<style>", early + "<style>", 1).replace("</body>", LATE + "</body>"))
    options = (f"--window-size={width},800", "--virtual-time-budget=120000", "--dump-dom")
    dom = chromium(folder, path.as_uri(), *options).stdout
    match = re.search(r'<pre id="told">(.*?)</pre>', dom, re.DOTALL)
    assert match, "the page did not finish"
    return json.loads(unescape(match.group(1)))


@pytest.mark.slow("8 s: a browser opens the page and zooms every picture")
@pytest.mark.parametrize("width", [1280, 800])
def test_the_page_works_in_a_browser_and_asks_nobody(page, tmp_path, width):
    require("chromium")
    zooms = FULL or width < 1000
    result = opened(tmp_path, page, width, zooms)
    pictures = page.count('<script type="application/json">')
    assert result["wrong"] == [] and result["asked"] == []
    assert result["lost"] == [] and pictures > 0 and result["zoomed"] == (pictures if zooms else 0)
    assert result["overlaps"] == [] and result["letters"] > 100
    assert result["wide"] <= 0, "the page is wider than the window"
    assert width < 1000 or result["bottom"] <= 800, "the answers do not fit on the first screen"
    assert result["focused"].startswith("cell-") and "rad/s" in result["reading"]
    assert sorted(result["sorted"]) == sorted(name for name, *_ in DRIVES) and result["searched"] == ["weak"]
    ratios = dict(re.findall(r'data-drive="(\w+)" data-ratio="([^"]*)" data-alarms', page))
    judged = [float(ratios[name]) for name in result["sorted"] if ratios[name]]
    assert judged == sorted(judged, reverse=True)


@pytest.mark.slow("4 s: a browser opens the page")
def test_the_browser_test_finds_errors_requests_and_overlaps(page, tmp_path):
    require("chromium")
    bad = page.replace(
        "</body>",
        '<img src="https://example.org/x.png"><p style="position:absolute;top:0">over the title</p>'
        "<script>undefined_name()</script></body>",
    )
    result = opened(tmp_path, bad, 1280, zooms=False)
    assert any("undefined_name" in w for w in result["wrong"])
    assert any("blocked https://example.org" in w for w in result["wrong"])
    assert any("over the title" in pair for pair in result["overlaps"])


@pytest.mark.long("11 s: a browser prints the page")
def test_the_page_prints(page, tmp_path):
    require("chromium")
    (tmp_path / "page.html").write_text(page)
    chromium(tmp_path, (tmp_path / "page.html").as_uri(), f"--print-to-pdf={tmp_path / 'page.pdf'}")
    printed = (tmp_path / "page.pdf").read_bytes()
    assert printed.startswith(b"%PDF") and len(printed) > 50e3
