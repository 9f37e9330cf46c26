"""What stands in the terminal while a command works."""

from functools import partial
from io import StringIO

import pytest
from rich.console import Console

from lpvguard.base.progress import Counted, parts
from lpvguard.cli import shared


@pytest.mark.parametrize("counted", [True, False])
def test_counted_steps_have_an_estimate_of_what_remains_and_others_have_none(monkeypatch, counted):
    written = StringIO()
    monkeypatch.setattr(shared, "console", Console(file=written, force_terminal=True, width=160))
    with shared.progress_bar("work") as tell:
        for done in (1, 2, 3):
            text = f"run {done} of 4"
            tell(Counted(text, done, 4) if counted else text)
    assert "work: run 3 of 4" in written.getvalue()
    assert (" left" in written.getvalue()) == counted


def test_parts_say_shares_of_the_whole_that_never_fall():
    texts = []
    first, second, last = parts(texts.append, 1, 2, 1)
    first(Counted("a", 1, 2))
    second("no count")
    second(Counted("b", 3, 4))
    second("no count either")
    second(Counted("beyond its own count", 9, 4))
    last("c")
    assert [str(t) for t in texts] == ["a", "no count", "b", "no count either", "beyond its own count", "c"]
    assert [t.done / t.total for t in texts] == [0.125, 0.25, 0.625, 0.625, 0.75, 0.75]


def test_what_remains_is_estimated_from_all_that_was_done(monkeypatch):
    """A step a minute, however long ago the first was."""
    written, now = StringIO(), [0.0]
    monkeypatch.setattr(shared, "console", Console(file=written, force_terminal=True, width=160))
    monkeypatch.setattr(shared, "Bar", partial(shared.Bar, get_time=lambda: now[0], auto_refresh=False))
    with shared.progress_bar("work") as tell:
        for k in range(1, 6):
            now[0] = 60.0 * k
            tell(Counted(f"step {k}", k, 10))
    assert "0:05:00 left" in written.getvalue()


def test_export_says_what_it_came_to_in_the_last_line(lpvguard, identified, tmp_path):
    out = tmp_path / "vehicle"
    done = lpvguard("export", "--vehicle", "g80", identified, "-o", out)
    files = len(list(out.iterdir()))
    assert done.returncode == 0 and files > 3
    assert done.stderr.splitlines()[-1] == f"g80: {files} files written to {out}"
