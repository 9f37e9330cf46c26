"""Progress messages of long computations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import accumulate, pairwise
from typing import TypeVar

Progress = Callable[[str], None]
Result = TypeVar("Result")


class Counted(str):
    """Text of the running step with the share that is done, so that a reader can estimate the rest.

    Attributes
    ----------
    done, total : float, finished and total work
    """

    done: float
    total: float

    def __new__(cls, text: str, done: float, total: float) -> Counted:
        self = super().__new__(cls, text)
        self.done, self.total = done, total
        return self


def parts(progress: Progress, *weights: float) -> list[Progress]:
    """Split a progress into parts of a computation.

    A part's count becomes a share of the whole by its weight. A text without a count leaves the share
    unchanged.

    Parameters
    ----------
    progress : Progress
    *weights : float, one a part

    Returns
    -------
    list of Progress, in their order
    """
    total = sum(weights)
    edges = [edge / total for edge in accumulate(weights, initial=0.0)]
    return [_part(progress, begin, end) for begin, end in pairwise(edges)]


def counted(progress: Progress, texts: Sequence[str], results: Iterable[Result]) -> Iterator[Result]:
    """Yield results and report one text before each is awaited.

    Parameters
    ----------
    progress : Progress
    texts : Sequence[str], one a result
    results : Iterable[Result]

    Yields
    ------
    Result
    """
    iterator = iter(results)
    for k, text in enumerate(texts):
        progress(Counted(text, k, len(texts)))
        yield next(iterator)


def _part(progress: Progress, begin: float, end: float) -> Progress:
    at = begin

    def tell(text: str) -> None:
        nonlocal at
        if isinstance(text, Counted):
            at = begin + (end - begin) * min(text.done / text.total, 1.0)
        progress(Counted(text, at, 1.0))

    return tell
