"""The diagonal blocks of an uncertainty Delta, for validation and synthesis alike."""

from __future__ import annotations

from dataclasses import dataclass

from ..base.errors import InputError

KINDS = ("full", "repeated_complex", "repeated_real")


@dataclass(frozen=True)
class Block:
    """One diagonal block Delta_i of Delta, ``rows`` × ``cols``: ``cols`` inputs eta_i, ``rows`` outputs xi_i
    = Delta_i eta_i.

    ``kind``: full (any complex matrix), repeated_complex or repeated_real (one scalar times the identity, so
    rows = cols). Of a matrix M in eta = M xi the block's part is cols × rows. Raises InputError for another
    kind and for sizes that do not fit.
    """

    kind: str
    rows: int
    cols: int

    def __post_init__(self) -> None:
        size = f"{self.rows} x {self.cols}"
        if self.kind not in KINDS:
            raise InputError("block", "type", repr(self.kind), "one of " + ", ".join(KINDS))
        if self.rows < 1 or self.cols < 1:
            raise InputError("block", "rows, cols", size, "at least 1 x 1")
        if self.repeated and self.rows != self.cols:
            raise InputError("block", "rows, cols", size, "equal numbers for a repeated block")

    @property
    def repeated(self) -> bool:
        """One scalar times the identity."""
        return self.kind != "full"
