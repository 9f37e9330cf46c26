"""Diagonal blocks of an uncertainty Delta, for validation and synthesis."""

from dataclasses import dataclass

from ..base.errors import InputError

KINDS = ("full", "repeated_complex", "repeated_real")


@dataclass(frozen=True)
class Block:
    """One diagonal block Delta_i of Delta with xi_i = Delta_i eta_i.

    In a matrix M with eta = M xi, the part of the block has the shape cols × rows.

    Attributes
    ----------
    kind : str, full (any complex matrix), repeated_complex or repeated_real (a scalar times the identity)
    rows, cols : int, number of outputs xi_i and of inputs eta_i

    Raises
    ------
    InputError
        If the kind is unknown, or the sizes do not fit.
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
        """Whether the block is one scalar times the identity."""
        return self.kind != "full"
