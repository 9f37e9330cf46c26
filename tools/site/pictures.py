"""Makes the pictures of the site and of the README in ``tools/site/pages/pictures``.

    .venv/bin/python tools/site/pictures.py [NAME ...]     needs chromium; NAME: only pictures so called

The gallery's pictures are those that the scripts of ``tools/examples`` save. All drives are synthetic, so the
pictures are the same on every machine, up to the versions of the packages that draw them.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image, ImageChops

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "tools" / "examples"
PICTURES = Path(__file__).resolve().parent / "pages" / "pictures"
LPVGUARD = Path(sys.executable).with_name("lpvguard")
FLOWS = {
    "export": (
        "identification\nfolder",
        "lpvguard\nexport",
        "C folder of\nthe vehicle",
        "core and folder\nin one image",
    ),
    "integrate": (
        "sample or\nCAN frame",
        "lpvg_monitor_push",
        "lpvg_monitor_verdict",
        "reaction of\nthe application",
    ),
    "live": ("LCM, SocketCAN\nor candump log", "receiver and\ncompiled core", "page on\n127.0.0.1"),
    "add_output": (
        "signals of the\nproject file",
        "matrix C of\n[model]",
        "identify,\nexport",
        "sizes and C\nare generated",
    ),
    "add_verb": (
        "cli/NAME.py",
        "import in\ncli/__init__.py",
        "test in\ntests/tools/cli",
        "lpvguard NAME\n--help",
    ),
    "chain": ("drives", "bounds", "weights", "controller", "C core", "verdicts"),
}
"""Picture of boxes in a row -> their words."""


def run(*words: object, cwd: Path) -> None:
    done = subprocess.run([str(w) for w in words], cwd=cwd, capture_output=True, text=True, check=False)
    if done.returncode > 1:
        raise SystemExit(f"{' '.join(map(str, words))}:\n{done.stdout}{done.stderr}")


def screenshot(page: Path, target: Path, width: int, height: int) -> None:
    """Take a picture of a page by chromium, without its white margin, in 64 colours."""
    shot = target.with_suffix(".shot.png")
    chromium = ("chromium", "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars")
    run(
        *chromium, f"--window-size={width},{height}", f"--screenshot={shot}", page.as_uri(), cwd=target.parent
    )
    image = Image.open(shot).convert("RGB")
    box = ImageChops.difference(image, Image.new("RGB", image.size, "white")).getbbox()
    if box is None:
        raise SystemExit(f"{page}: nothing was drawn")
    left, top, right, bottom = box
    image = image.crop((max(left - 8, 0), max(top - 8, 0), min(right + 8, width), min(bottom + 8, height)))
    image.quantize(64).save(target, optimize=True)
    shot.unlink()


def flow(words: tuple[str, ...], target: Path) -> None:
    """Boxes in a row with arrows between them, as SVG."""
    width, gap, height = 150, 30, 60
    parts = []
    for i, text in enumerate(words):
        x = 10 + i * (width + gap)
        parts.append(
            f'<rect x="{x}" y="10" width="{width}" height="{height}" rx="6" fill="#eef4fa" stroke="#1b84c6"/>'
        )
        lines = text.split("\n")
        for j, line in enumerate(lines):
            y = 10 + height / 2 + 5 + 16 * (j - (len(lines) - 1) / 2)
            parts.append(f'<text x="{x + width / 2}" y="{y:g}" text-anchor="middle">{line}</text>')
        if i:
            parts.append(
                f'<path d="M{x - gap + 4} 40 h{gap - 10} m-7 -5 l7 5 l-7 5" fill="none" stroke="#333"/>'
            )
    total = 20 + len(words) * (width + gap) - gap
    target.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total} 80" width="{total}" height="80" '
        f'font-family="sans-serif" font-size="13"><rect width="{total}" height="80" fill="#fff"/>'
        f"{''.join(parts)}</svg>\n"
    )


LOOP = """<svg xmlns="http://www.w3.org/2000/svg"
 viewBox="0 0 420 230" width="420" height="230"
 font-family="sans-serif" font-size="16"><rect width="420" height="230" fill="#fff"/>
<g fill="#eef4fa" stroke="#1b84c6"><rect x="160" y="10" width="100" height="50" rx="6"/>
<rect x="160" y="90" width="100" height="60" rx="6"/>
<rect x="160" y="170" width="100" height="50" rx="6"/></g>
<g fill="none" stroke="#333"><path d="M160 105 H110 V35 H155 m-7 -5 l7 5 l-7 5"/>
<path d="M260 35 H310 V105 H265 m7 -5 l-7 5 l7 5"/><path d="M370 120 H265 m7 -5 l-7 5 l7 5"/>
<path d="M160 120 H55 m7 -5 l-7 5 l7 5"/><path d="M160 137 H110 V195 H155 m-7 -5 l7 5 l-7 5"/>
<path d="M260 195 H310 V137 H265 m7 -5 l-7 5 l7 5"/></g>
<g text-anchor="middle"><text x="210" y="41">Δ</text>
<text x="210" y="126">P</text><text x="210" y="201">K</text>
<text x="95" y="74">η</text><text x="325" y="74">ξ</text>
<text x="385" y="125">w</text><text x="40" y="125">z</text>
<text x="95" y="172">y</text><text x="325" y="172">u</text></g></svg>
"""
"""Uncertainty, plant and controller, with their signals."""


def faulty(drive: Path, target: Path) -> None:
    """The drive with 1.5 times the yaw rate from its middle on."""
    rows = list(csv.DictReader(drive.open()))
    for row in rows[len(rows) // 2 :]:
        row["r"] = repr(1.5 * float(row["r"]))
    with target.open("w", newline="") as file:
        table = csv.DictWriter(file, list(rows[0]))
        table.writeheader()
        table.writerows(rows)


def main(names: list[str]) -> None:
    PICTURES.mkdir(exist_ok=True)

    def wanted(name: str) -> bool:
        return not names or name in names

    for name, words in FLOWS.items():
        if wanted(name):
            flow(words, PICTURES / f"{name}.svg")
    if wanted("loop"):
        (PICTURES / "loop.svg").write_text(LOOP)
    if names and all(name in FLOWS or name == "loop" for name in names):
        return
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        run(LPVGUARD, "generate", "--vehicle", "g80", "-o", "drives", cwd=folder)
        run(LPVGUARD, "identify", "--vehicle", "g80", "drives", "--jobs", "2", "-o", "found", cwd=folder)
        run(LPVGUARD, "export", "--vehicle", "g80", "found", "-o", "code", cwd=folder)
        faulty(folder / "drives" / "synthetic_15.csv", folder / "faulty.csv")
        drive = ("g80", "code", "drives/synthetic_15.csv")
        for name, words in {
            "show_bounds": ("found",),
            "show_margins": drive,
            "nominal_and_measured": drive,
            "weight_above_samples": (),
            "wealth_of_a_vehicle": (),
            "hinf_controller": (),
        }.items():
            if wanted(name):
                run(sys.executable, EXAMPLES / f"{name}.py", *words, f"{name}.svg", cwd=folder)
                screenshot(folder / f"{name}.svg", PICTURES / f"{name}.png", 820, 1200)
        if wanted("bounds_and_margins"):
            run(sys.executable, EXAMPLES / "bounds_and_margins.py", "g80", "drives", ".", cwd=folder)
            screenshot(folder / "bounds.svg", PICTURES / "bounds_and_margins.png", 820, 1200)
        if wanted("faulty"):
            words = ("g80", "code", "faulty.csv", "faulty.svg")
            run(sys.executable, EXAMPLES / "show_margins.py", *words, cwd=folder)
            screenshot(folder / "faulty.svg", PICTURES / "faulty.png", 820, 1200)
        if wanted("page"):
            page = ("found", "drives", "--vehicle", "g80", "--coefficients", "code", "-o", "page.html")
            run(LPVGUARD, "report", *page, cwd=folder)
            screenshot(folder / "page.html", PICTURES / "page.png", 1100, 660)
        if wanted("evaluate"):
            run(
                LPVGUARD,
                "evaluate",
                "--vehicle",
                "g80",
                "--coefficients",
                "code",
                "found",
                "drives",
                "--jobs",
                "2",
                "--json",
                "evaluation.json",
                cwd=folder,
            )
            draw = "import lpvguard; lpvguard.plots.evaluation('evaluation.json').save('evaluation.svg')"
            run(sys.executable, "-c", draw, cwd=folder)
            screenshot(folder / "evaluation.svg", PICTURES / "evaluate.png", 820, 900)
        if wanted("simulate"):
            run(LPVGUARD, "sim", "brake_gain_40", "-o", "sim", cwd=folder)
            draw = "import lpvguard; lpvguard.plots.simulated('sim')['brake_gain_40-1'].save('sim.svg')"
            run(sys.executable, "-c", draw, cwd=folder)
            screenshot(folder / "sim.svg", PICTURES / "simulate.png", 820, 1200)


if __name__ == "__main__":
    main(sys.argv[1:])
