"""Collect the counted frames and the stretches for Fig. 4 in one pass over the drives."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..base.runs import runs


@dataclass(frozen=True)
class Longest:
    """The longest stretch so far: name of its drive, first sample, and the sample after the last one."""

    drive: str = ""
    start: int = 0
    stop: int = 0

    @property
    def samples(self) -> int:
        """Length of the stretch [samples]; 0 without one."""
        return self.stop - self.start

    def or_longer(self, drive: str, span: slice) -> Longest:
        """Return this stretch, or the ``span`` of ``drive`` if it is longer."""
        other = Longest(drive, span.start, span.stop)
        return other if other.samples > self.samples else self


@dataclass
class Visits:
    """Counted frames of all drives, with bins (F,) and Z (F, n_y) per drive, and two long stretches.

    The stretches are the longest judged, excited ones in the lower and in the upper third of the model's
    speed range.
    """

    bin: list[np.ndarray] = field(default_factory=list)
    Z: list[np.ndarray] = field(default_factory=list)
    slow: Longest = Longest()
    fast: Longest = Longest()


def longest_run(mask: np.ndarray) -> slice:
    """Longest run of True in ``mask`` (N,); an empty slice if there is none."""
    edges = runs(mask)
    if not len(edges):
        return slice(0, 0)
    a, b = edges[np.argmax(edges[:, 1] - edges[:, 0])]
    return slice(int(a), int(b))
