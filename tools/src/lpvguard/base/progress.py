"""What a long computation says while it works."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate, pairwise
from typing import TypeVar

Progress = Callable[[str], None]
Result = TypeVar("Result")


class Counted(str):
    """The step that runs, as text, and that ``done`` of ``of`` is over, in equal steps or shares of the work.
    So a reader can estimate what remains."""

    done: float
    of: float

    def __new__(cls, text: str, done: float, of: float) -> Counted:
        """``text`` says the step."""
        self = super().__new__(cls, text)
        self.done, self.of = done, of
        return self


def parts(progress: Progress, *weights: float) -> list[Progress]:
    """A progress for each part of a computation, in their order. What a part says becomes a share of the
    whole by its weight; a text without a count leaves the share where it was."""
    total = sum(weights)
    edges = [edge / total for edge in accumulate(weights, initial=0.0)]
    return [_part(progress, begin, end) for begin, end in pairwise(edges)]


def counted(progress: Progress, texts: Sequence[str], results: Iterable[Result]) -> Iterator[Result]:
    """The ``results``, one a text. Each text is said while its result is waited for."""
    found = iter(results)
    for k, text in enumerate(texts):
        progress(Counted(text, k, len(texts)))
        yield next(found)


def _part(progress: Progress, begin: float, end: float) -> Progress:
    at = begin

    def tell(text: str) -> None:
        nonlocal at
        if isinstance(text, Counted):
            at = begin + (end - begin) * min(text.done / text.of, 1.0)
        progress(Counted(text, at, 1.0))

    return tell
