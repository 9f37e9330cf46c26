"""What stands in the terminal while a command works."""

from __future__ import annotations

from io import StringIO

import pytest
from rich.console import Console

from lpvguard.base.progress import Counted
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
