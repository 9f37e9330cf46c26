"""Load and validate the CAN catalogue, the one table of messages (can/catalogue.toml).

Another file of the same form can replace catalogue.toml. From the catalogue, dbc.py writes our DBC, and
codegen.py writes the C codec and the receiver's rules.

Raw values follow SAE J1939-71. The two largest codes mean "not available" and "error". They are 0xFF and 0xFE
for 8 bits, 0xFFnn and 0xFEnn for 16 bits, 3 and 2 for 2 bits. The largest data value is 0xFA (8 bits) or
0xFAFF (16 bits).
"""

from __future__ import annotations

from functools import cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from ..base.documents import StrictModel, checked, read_toml
from ..base.errors import InputError

E2E_BITS = 12
"""Number of bits of profile 11 at the start of a frame: CRC (8), counter (4), and 4 unused bits, sent as
1."""

OWN_NODE = "LPVGUARD"
"""Name of the node that runs the generated code."""

J1939_LENGTHS = (2, 4, 8, 16)
"""Signal lengths [bits] for which J1939 defines codes above the data."""


def j1939_data_max(length: int) -> int:
    """Largest raw value of ``length`` bits (2 or more) that is data.

    Its top byte is 0xFA. With fewer than 8 bits, only the two largest values are not data.
    """
    return (0xFB << (length - 8)) - 1 if length >= 8 else (1 << length) - 3


class Supervision(StrictModel):
    """Values that a receiver accepts, in the signal's unit; max_rate is per second (None: no limit)."""

    min: float
    max: float
    max_rate: Annotated[float, Field(gt=0)] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Supervision:
        if not self.min < self.max:
            raise ValueError(f"supervise: min {self.min} must be below max {self.max}")
        return self


class BusSignal(StrictModel):
    """A signal of a message: physical = scale * raw + offset.

    Attributes
    ----------
    name, unit : str
    spn : int or None, suspect parameter number of J1939
    start, length : int, bits
    scale, offset : float, units of the signal
    positive : str, direction of positive values
    coding : str, "j1939" reserves the largest raw values, "plain" reserves none
    values : dict[str, int], raw value by name
    supervise : Supervision or None
    """

    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
    spn: Annotated[int, Field(ge=1, lt=2**19)] | None = None
    start: Annotated[int, Field(ge=0, le=63)]
    length: Annotated[int, Field(ge=1, le=16)]
    scale: Annotated[float, Field(gt=0)]
    offset: float
    unit: str
    positive: str
    coding: Literal["j1939", "plain"] = "j1939"
    values: dict[str, Annotated[int, Field(ge=0)]] = Field(default={})
    supervise: Supervision | None = None

    @model_validator(mode="after")
    def _consistent(self) -> BusSignal:
        if self.coding == "j1939" and self.length not in J1939_LENGTHS:
            raise ValueError(
                f"signal {self.name}: J1939 codes exist for 2, 4, 8 and 16 bits, not {self.length}"
            )
        if (
            self.supervise
            and not self.physical_min <= self.supervise.min < self.supervise.max <= self.physical_max
        ):
            raise ValueError(
                f"signal {self.name}: supervise must lie within {self.physical_min} to {self.physical_max}"
            )
        if any(raw >= 1 << self.length for raw in self.values.values()):
            raise ValueError(f"signal {self.name}: a named value does not fit {self.length} bits")
        return self

    @property
    def bits(self) -> range:
        """Positions of the signal's bits in the frame's data."""
        return range(self.start, self.start + self.length)

    @property
    def raw_max(self) -> int:
        """Largest raw value that is data."""
        return j1939_data_max(self.length) if self.coding == "j1939" else (1 << self.length) - 1

    @property
    def raw_error_min(self) -> int | None:
        """First raw value for "error" (None without this code). The last one is ``raw_absent_min`` - 1."""
        return self._code(0xFE, 2)

    @property
    def raw_absent_min(self) -> int | None:
        """First raw value for "not available"; None: no such code."""
        return self._code(0xFF, 1)

    def _code(self, top_byte: int, below_end: int) -> int | None:
        if self.coding != "j1939":
            return None
        return top_byte << (self.length - 8) if self.length >= 8 else (1 << self.length) - below_end

    def physical(self, raw: float) -> float:
        """Compute the physical value of a raw value."""
        return raw * self.scale + self.offset

    @property
    def physical_min(self) -> float:
        """Physical value of the smallest raw value."""
        return self.physical(0)

    @property
    def physical_max(self) -> float:
        """Physical value of the largest raw value that is data."""
        return self.physical(self.raw_max)


class E2E(StrictModel):
    """AUTOSAR E2E profile 11, data-id mode BOTH."""

    profile: Literal[11]
    data_id: Annotated[int, Field(ge=0, le=0xFFFF)]


class Message(StrictModel):
    """Message: a parameter group in one 8-byte frame.

    Attributes
    ----------
    name, title : str
    pgn : int, parameter group number
    id : int, 29-bit identifier
    period_ms : int, ms
    codec : str, "core" if the C core packs the message, so that no codec is generated
    e2e : E2E or None, end-to-end protection
    signals : list of BusSignal
    """

    name: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]*$")]
    title: str
    pgn: Annotated[int, Field(ge=0, lt=2**18)]
    id: Annotated[int, Field(ge=0, lt=2**29)]
    period_ms: Annotated[int, Field(ge=1)]
    codec: Literal["generated", "core"] = "generated"
    e2e: E2E | None = None
    signals: Annotated[list[BusSignal], Field(min_length=1)]

    @model_validator(mode="after")
    def _consistent(self) -> Message:
        if self.pgn < 0xF000:
            raise ValueError(
                f"message {self.name}: PGN {self.pgn} is peer-to-peer; only broadcast groups are supported"
            )
        if self.id >> 8 & 0x3FFFF != self.pgn:
            raise ValueError(f"message {self.name}: id {self.id:08X} does not carry PGN {self.pgn}")
        names = [s.name for s in self.signals]
        if len(set(names)) != len(names):
            raise ValueError(f"message {self.name}: signal names must be unique")
        taken = dict.fromkeys(range(E2E_BITS), "the E2E header") if self.e2e else {}
        for signal in self.signals:
            for bit in signal.bits:
                if bit > 63:
                    raise ValueError(f"message {self.name}: {signal.name} does not fit 8 bytes")
                if bit in taken:
                    raise ValueError(f"message {self.name}: {signal.name} overlaps {taken[bit]} at bit {bit}")
                taken[bit] = signal.name
        return self

    @property
    def source_address(self) -> int:
        """J1939 source address: the lowest byte of the identifier."""
        return self.id & 0xFF

    @property
    def rules(self) -> list[tuple[BusSignal, Supervision]]:
        """Supervised signals, each with the values that a receiver accepts."""
        return [(s, s.supervise) for s in self.signals if s.supervise]

    @property
    def supervised(self) -> list[BusSignal]:
        """Signals that a receiver supervises."""
        return [s for s, _ in self.rules]


class Node(StrictModel):
    """A controller on the bus and its J1939 source address."""

    name: Annotated[str, Field(pattern=r"^[A-Z][A-Z0-9_]*$")]
    address: Annotated[int, Field(ge=0, le=0xFD)]
    comment: str


class Catalogue(StrictModel):
    """All nodes and messages of the bus.

    Attributes
    ----------
    schema_ : int, version of the format
    nodes : list[Node]
    messages : list[Message]
    """

    schema_: Literal[1] = Field(alias="schema")
    nodes: list[Node]
    messages: list[Message]

    @model_validator(mode="after")
    def _consistent(self) -> Catalogue:
        for what, values in (
            ("node names", [n.name for n in self.nodes]),
            ("node addresses", [n.address for n in self.nodes]),
            ("message names", [m.name for m in self.messages]),
            ("ids", [m.id for m in self.messages]),
            ("E2E data ids", [m.e2e.data_id for m in self.messages if m.e2e]),
        ):
            if len(set(values)) != len(values):
                raise ValueError(f"{what} must be unique")
        if all(n.name != OWN_NODE for n in self.nodes):
            raise ValueError(f"nodes: one must be called {OWN_NODE}")
        for message in self.messages:
            if all(message.source_address != n.address for n in self.nodes):
                raise ValueError(
                    f"message {message.name}: no node has the source address {message.source_address:#04x}"
                )
        return self

    @property
    def own_address(self) -> int:
        """Source address of the guarded controller."""
        return next(n.address for n in self.nodes if n.name == OWN_NODE)

    def sender(self, message: Message) -> Node:
        """Node that sends a message."""
        return next(n for n in self.nodes if n.address == message.source_address)

    def message(self, name: str) -> Message:
        """Return the message ``name``; raise InputError if there is none."""
        for message in self.messages:
            if message.name == name:
                return message
        raise InputError(
            "CAN catalogue", name, "no such message", f"one of {', '.join(m.name for m in self.messages)}"
        )


def load_catalogue(path: Path | None = None) -> Catalogue:
    """Load a catalogue; a process reads the shipped catalogue only once.

    Parameters
    ----------
    path : Path, optional, by default the shipped one

    Returns
    -------
    Catalogue

    Raises
    ------
    InputError
        If a field is refused. The error names the file, the field and the expected value.
    """
    return _shipped() if path is None else _read(path, path)


@cache
def _shipped() -> Catalogue:
    return _read(resources.files(__package__).joinpath("catalogue.toml"), "catalogue.toml")


def _read(source: Traversable | Path, where: str | Path) -> Catalogue:
    return checked(
        Catalogue,
        read_toml(source, "a CAN catalogue", where),
        "a CAN catalogue as catalogue.py describes",
        where,
    )
