"""A refinement starts from an identification, its drives, and the vehicle as it was first identified.

The lifetime test and all estimates compare with the first identification of a lineage. A fault that grows
slower than each refinement therefore grows in them.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ...base import artefacts
from ...base.errors import InputError
from ...base.parallel import Map
from ...core.compiled import Core
from ...identify import identification as stage
from ...identify.export import export_vehicle
from ...replay.replayer import Replayer
from ..fleet.recordings import begun
from ..fleet.state import FleetState
from .own import OwnGains

KIND = "refine"
IDENTIFICATION, DRIVES, ORIGIN, LIFE, OWN = "identification", "drives", "origin", "life.json", "own.json"
"""Content of a refined folder."""


@dataclass(frozen=True)
class Lineage:
    """An identification with what its refinement compares with.

    Attributes
    ----------
    stored : StoredIdentification, of now
    drives : Path, folder of its drives
    origin : Path, folder of the first identification
    life : FleetState or None, of the lifetime test; None: no drive has been counted
    own : OwnGains
    """

    stored: stage.StoredIdentification
    drives: Path
    origin: Path
    life: FleetState | None
    own: OwnGains

    @classmethod
    def from_folder(cls, folder: Path, drives: Path | None) -> Lineage:
        """Lineage of a refined folder, or of an identification and its ``drives``.

        Raises InputError where one is missing or too much, and where a drive is not the file that was
        identified.
        """
        if (folder / IDENTIFICATION).is_dir():
            if drives is not None:
                raise InputError(folder, "--drives", "given, but a refined folder has them", "one of them")
            artefacts.read_manifest(folder, KIND)
            lineage = cls(
                stage.load(folder / IDENTIFICATION),
                folder / DRIVES,
                folder / ORIGIN,
                FleetState.read(folder / LIFE),
                OwnGains.read(folder / OWN),
            )
        elif drives is None:
            raise InputError(folder, "--drives", "not given", "the folder of drives that were identified")
        else:
            lineage = cls(stage.load(folder), drives, folder, None, OwnGains())
        known = lineage.stored.manifest["sha256"]
        for e in stage.DriveSet(
            lineage.stored.project, lineage.stored.model, lineage.drives
        ).experiments.values():
            if known.get(e.name) != artefacts.file_hash(e.path):
                raise InputError(e.path, "", "is not the file that was identified", f"the drives of {folder}")
        return lineage

    @contextmanager
    def first(self) -> Iterator[Replayer]:
        """The compiled core of the first identification."""
        with compiled(stage.load(self.origin)) as replayer:
            yield replayer

    def life_of(self, first: Replayer, workers: Map = map) -> FleetState:
        """State of the lifetime test before the evidence, calibrated by the first identification's drives."""
        if self.life is not None:
            return self.life
        stated = dict.fromkeys(("judged_s", "alpha", "eta"))
        return begun(first, None, self.drives, stated, workers)[0]


@contextmanager
def compiled(stored: stage.StoredIdentification) -> Iterator[Replayer]:
    """Compile the core of an identification, with its diagnosis, in a temporary folder.

    Parameters
    ----------
    stored : StoredIdentification

    Yields
    ------
    Replayer
    """
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / stored.project.name
        export_vehicle(stored, folder)
        yield Replayer(stored.project, Core(folder))


def put(source: Path, target: Path) -> None:
    """Link a file, or copy it to another file system."""
    try:
        os.link(source, target)
    except OSError:
        shutil.copyfile(source, target)
