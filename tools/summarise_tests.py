"""Sum up the JUnit files of a test run: a timing table per suite, what failed, what was skipped and why, one
closing line."""

from __future__ import annotations

import argparse
import re
import sys
import xml.etree.ElementTree as ElementTree
from collections import defaultdict
from pathlib import Path

RUNNERS = ("ctest", "sanitized", "pytest", "pytest_serial")
"""Names of the JUnit files. ``sanitized``: the unit tests that gate.sanitize ran, which says so itself where
it could not."""

SLOW_FROM_S = 1.0
"""What takes more processor seconds than this, without its fixtures, is to be marked unhurried or slow."""

COLLECTED = "pytest.collected"
"""File with the number of tests that pytest found, before any was left out (tests/conftest.py)."""


def suite_of(runner: str, case: ElementTree.Element) -> str:
    """Suite of a test case: the kind in front of a ctest name, of a gate its name too; the file of a pytest
    case."""
    if runner in ("ctest", "sanitized"):
        kind, *rest = case.get("name", "").split(".")
        return f"{runner} {kind}.{rest[0]}" if kind == "gate" and rest else f"{runner} {kind}"
    return f"pytest {case.get('classname', '').replace('tests.', '')}"


def reason_of(case: ElementTree.Element, skipped: ElementTree.Element | None) -> str:
    """Why a case was skipped; a ctest case that stands for a test that could not be built says so itself."""
    said = re.search(
        r"^(?:skipped: |with-vcan: (?=no AF_CAN))(.*)$", case.findtext("system-out") or "", re.MULTILINE
    )
    if said:
        return said[1]
    return (skipped.get("message") if skipped is not None else case.get("status")) or "no reason given"


def processor_seconds(case: ElementTree.Element, name: str) -> float:
    """What tests/conftest.py noted: ``cpu`` in all, ``cpu_call`` without fixtures. Of a test of ctest what it
    printed itself, as the gates do; 0 where it did not."""
    noted = sum(float(p.get("value") or 0.0) for p in case.iter("property") if p.get("name") == name)
    said = re.findall(r"^processor: ([0-9.]+) s$", case.findtext("system-out") or "", re.MULTILINE)
    return noted + (float(said[-1]) if said and name == "cpu" else 0.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--build-failed", type=int, default=0, help="1: the C++ build failed and counts as one failure"
    )
    parser.add_argument("--long", type=int, default=0, help="tests of ctest that were left out as long")
    parser.add_argument(
        "--fast", type=int, metavar="N", help="the fast tier was run; ctest has N tests in all"
    )
    parser.add_argument("--clean-room", help="passed, failed, or skipped: WHY")
    parser.add_argument(
        "results",
        type=Path,
        help="folder with RUNNER.xml and RUNNER.status, the runner's exit status when not 0",
    )
    arguments = parser.parse_args()

    counts = {"passed": 0, "failed": 0, "skipped": 0}
    seconds: dict[str, float] = defaultdict(float)
    processor: dict[str, float] = defaultdict(float)
    number: dict[str, int] = defaultdict(int)
    dear: list[str] = []
    notes: list[str] = []
    skips: dict[tuple[str, str], list[str]] = defaultdict(list)
    may_lack = {"sanitized", "pytest_serial"} if arguments.fast is not None else {"sanitized"}
    for runner in RUNNERS:
        path = arguments.results / f"{runner}.xml"
        if not path.is_file() and runner in may_lack:
            continue
        if not path.is_file():
            counts["failed"] += 1
            notes.append(
                f"FAILED {runner}: it did not run"
                + (" (the build failed)" if runner == "ctest" and arguments.build_failed else "")
            )
            continue
        try:
            root = ElementTree.parse(path).getroot()
        except ElementTree.ParseError as error:
            counts["failed"] += 1
            notes.append(f"FAILED {runner}: it broke off while it wrote {path.name} ({error})")
            continue
        failed_before = counts["failed"]
        for case in root.iter("testcase"):
            name = f"{case.get('classname', '')}::{case.get('name', '')}"
            seconds[suite_of(runner, case)] += float(case.get("time") or 0.0)
            processor[suite_of(runner, case)] += processor_seconds(case, "cpu")
            number[suite_of(runner, case)] += 1
            if (cost := processor_seconds(case, "cpu_call")) > SLOW_FROM_S:
                dear.append(f"{cost:5.1f} s  {name}")
            skipped = case.find("skipped")
            if case.find("failure") is not None or case.find("error") is not None:
                counts["failed"] += 1
                notes.append(f"FAILED {name}")
            elif skipped is not None or case.get("status") in ("disabled", "notrun"):
                counts["skipped"] += 1
                skips[suite_of(runner, case), reason_of(case, skipped)].append(name)
            else:
                counts["passed"] += 1
        status = arguments.results / f"{runner}.status"
        if status.is_file() and counts["failed"] == failed_before:
            counts["failed"] += 1
            notes.append(
                f"FAILED {runner}: no case failed, yet it ended with status {status.read_text().strip()}"
            )
    if arguments.clean_room:
        outcome, _, why = arguments.clean_room.partition(": ")
        counts[outcome] += 1
        if outcome != "passed":
            notes.append(f"{outcome.upper()} clean-room ./tools/test: {why or 'see clean_room.log'}")
    if arguments.long:
        counts["skipped"] += arguments.long
        notes.append(
            f"SKIPPED {arguments.long} of ctest: LPVGUARD_FULL: unit tests of further vehicles, all with "
            "subnormal numbers as zero, and the plant's frequency response"
        )
    notes += [
        f"SKIPPED {names[0] if len(names) == 1 else f'{len(names)} of {suite}'}: {why}"
        for (suite, why), names in skips.items()
    ]
    width = max(map(len, seconds), default=10)
    print(f"\n{'suite':{width}}  tests  seconds  processor")
    for suite in sorted(seconds):
        spent = f"{processor[suite]:9.1f}" if processor[suite] or suite.startswith("pytest") else ""
        print(f"{suite:{width}}  {number[suite]:5d}  {seconds[suite]:7.1f}  {spent}".rstrip())
    # A test program has one thread: on idle cores its seconds are its processor time.
    unsaid = sum(seconds[suite] for suite in seconds if not processor[suite])
    rows = sum(number.values()), sum(seconds.values()), sum(processor.values()) + unsaid
    print(f"{'all':{width}}  {rows[0]:5d}  {rows[1]:7.1f}  {rows[2]:9.1f}")
    if arguments.fast is not None and dear:
        print(f"\nover {SLOW_FROM_S:g} processor seconds, in the fast tier all the same:", *dear, sep="\n  ")
    print("\n".join(["", *notes]) if notes else "")
    if not counts["passed"]:
        counts["failed"] += 1
    if arguments.fast is not None:
        collected = arguments.results / COLLECTED
        tests = arguments.fast + (int(collected.read_text()) if collected.is_file() else 0)
        print(f"fast: {sum(number.values())} of {tests} tests; the others run with tools/test alone")
    print(f"{counts['passed']} passed, {counts['failed']} failed, {counts['skipped']} skipped")
    return 1 if counts["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
