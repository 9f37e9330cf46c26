"""Store the state of a fleet between calls in a small, sealed JSON file.

It holds the calibration recordings, so that their set stays fixed. It also holds each vehicle's wealth and
counted recordings. A state is refused if it was changed by hand, or if its vehicle, generated folder, length
or rate differs; the error names the difference. An error never leaves half a file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from ...base import artefacts
from ...base.errors import InputError
from .wealth import Life, LifeTable

KIND = "fleet"
SCHEMA = 1


@dataclass(frozen=True)
class Terms:
    """Terms of a wealth: vehicle, hash of its folder, judged driving per recording [s], two rates."""

    vehicle: str
    coefficients: str
    judged_s: float
    alpha: float
    eta: float


@dataclass(frozen=True)
class Member:
    """A vehicle: its life, the cause of its first alarm, and the counted recordings with their tables."""

    life: Life = field(default_factory=Life)
    changed_by: str | None = None
    counted: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    def after(self, recording: str, sha256: Mapping[str, str], place: int, table: LifeTable) -> Member:
        """This member after a further recording with these tables and a score at ``place``."""
        life = self.life.after(place, table)
        first = recording if life.changed_at and not self.life.changed_at else self.changed_by
        return Member(life, first, {**self.counted, recording: dict(sha256)})


@dataclass(frozen=True)
class FleetState:
    """State of a fleet.

    Attributes
    ----------
    terms : Terms
    calibration : Mapping[str, float], score by recording
    calibrated : Mapping, SHA-256 by recording and drive
    members : Mapping[str, Member], by vehicle
    """

    terms: Terms
    calibration: Mapping[str, float]
    calibrated: Mapping[str, Mapping[str, str]]
    members: Mapping[str, Member] = field(default_factory=dict)

    @cached_property
    def table(self) -> LifeTable:
        """Levels and factors of the calibration set."""
        return LifeTable.from_scores(self.calibration.values(), self.terms.alpha, self.terms.eta)

    def with_member(self, vehicle: str, member: Member) -> FleetState:
        """Copy of the state with a new member for one vehicle."""
        return replace(self, members={**self.members, vehicle: member})

    def to_dict(self) -> dict[str, Any]:
        """Sealed JSON object, which `read` can read."""
        return artefacts.sealed(
            artefacts.marked(
                {
                    "kind": KIND,
                    "schema": SCHEMA,
                    "terms": asdict(self.terms),
                    "calibration": dict(self.calibration),
                    "calibrated": {k: dict(v) for k, v in self.calibrated.items()},
                    "members": {
                        name: {
                            "recordings": m.life.recordings,
                            "bets": list(m.life.bets),
                            "changed_at": m.life.changed_at,
                            "changed_by": m.changed_by,
                            "counted": {k: dict(v) for k, v in m.counted.items()},
                        }
                        for name, m in self.members.items()
                    },
                },
                KIND,
            )
        )

    def write(self, path: Path) -> None:
        """Write the whole file; an error leaves the old file unchanged."""
        artefacts.write_file(path, artefacts.to_json(self.to_dict()), KIND)

    @classmethod
    def read(cls, path: Path) -> FleetState:
        """Read a file of `write`; InputError for a changed file, another kind of file or another schema."""
        document = artefacts.read_json(path)
        if not isinstance(document, dict) or (document.get("kind"), document.get("schema")) != (KIND, SCHEMA):
            raise InputError(path, "kind, schema", "not the fields of a fleet's state", f"{KIND!r}, {SCHEMA}")
        artefacts.require_seal(path, document, "`lpvguard fleet`")
        members = {
            name: Member(
                Life(m["recordings"], tuple(m["bets"]), m["changed_at"]), m["changed_by"], m["counted"]
            )
            for name, m in document["members"].items()
        }
        return cls(Terms(**document["terms"]), document["calibration"], document["calibrated"], members)

    def require(self, path: Path, terms: Mapping[str, Any]) -> None:
        """Raise InputError unless the state has these terms (by name); a term of None is not compared."""
        for name, value in terms.items():
            own = getattr(self.terms, name)
            if value is not None and value != own:
                raise InputError(path, f"terms.{name}", f"{own}", f"{value}; other terms need another state")
