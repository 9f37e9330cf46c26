"""What a long computation says while it works."""

from __future__ import annotations


class Counted(str):
    """The step that runs, as text, and that ``done`` of ``of`` equal steps are over, so that a reader can
    estimate what remains."""

    done: int
    of: int

    def __new__(cls, text: str, done: int, of: int) -> Counted:
        """``text`` says the step."""
        self = super().__new__(cls, text)
        self.done, self.of = done, of
        return self
