"""Sum up the JUnit files of a test run: a timing table per suite, what failed, what was skipped and why, one closing line."""

from __future__ import annotations

import argparse
import sys
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path

RUNNERS = ("ctest", "pytest", "pytest_serial")

COLLECTED = "collected"
"""Property of a JUnit file: tests that pytest found, before any was left out (tests/conftest.py)."""


def suite_of(runner: str, case: ElementTree.Element) -> str:
    """Suite of a test case: the kind in front of a ctest name, the file of a pytest case."""
    if runner == "ctest":
        return f"ctest {case.get('name', '').split('.')[0]}"
    return f"pytest {case.get('classname', '').replace('tests.', '')}"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--build-failed", type=int, default=0, help="1: the C++ build failed and counts as one failure")
    parser.add_argument("--fast", type=int, metavar="N", help="the fast tier was run; ctest has N tests in all")
    parser.add_argument("results", type=Path, help="folder with RUNNER.xml, and RUNNER.status where a runner broke off")
    arguments = parser.parse_args()

    counts = {"passed": 0, "failed": 0, "skipped": 0}
    seconds: dict[str, float] = defaultdict(float)
    number: dict[str, int] = defaultdict(int)
    notes: list[str] = []
    collected = 0
    for runner in RUNNERS:
        path = arguments.results / f"{runner}.xml"
        if not path.is_file():
            counts["failed"] += 1
            notes.append(f"FAILED {runner}: it did not run" + (" (the build failed)" if runner == "ctest" and arguments.build_failed else ""))
            continue
        status = arguments.results / f"{runner}.status"
        if status.is_file():
            counts["failed"] += 1
            notes.append(f"FAILED {runner}: it broke off with status {status.read_text().strip()}")
        root = ElementTree.parse(path).getroot()
        collected += sum(int(p.get("value", 0)) for p in root.iter("property") if p.get("name") == COLLECTED)
        for case in root.iter("testcase"):
            name = f"{case.get('classname', '')}::{case.get('name', '')}"
            seconds[suite_of(runner, case)] += float(case.get("time") or 0.0)
            number[suite_of(runner, case)] += 1
            skipped = case.find("skipped")
            if case.find("failure") is not None or case.find("error") is not None:
                counts["failed"] += 1
                notes.append(f"FAILED {name}")
            elif skipped is not None or case.get("status") in ("disabled", "notrun"):
                counts["skipped"] += 1
                notes.append(f"SKIPPED {name}: {skipped.get('message') if skipped is not None else case.get('status')}")
            else:
                counts["passed"] += 1
    width = max(map(len, seconds), default=10)
    print(f"\n{'suite':{width}}  tests  seconds")
    for suite in sorted(seconds):
        print(f"{suite:{width}}  {number[suite]:5d}  {seconds[suite]:7.1f}")
    print("\n".join(["", *notes]) if notes else "")
    if not counts["passed"]:
        counts["failed"] += 1
    if arguments.fast is not None:
        print(f"fast: {sum(number.values())} of {collected + arguments.fast} tests; the slow ones run with tools/test alone")
    print(f"{counts['passed']} passed, {counts['failed']} failed, {counts['skipped']} skipped")
    return 1 if counts["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
