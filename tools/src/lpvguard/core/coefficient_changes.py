"""Compare the coefficients in two generated folders of a vehicle."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..base import artefacts
from ..base.errors import InputError
from ..base.layout import COEFF
from .compiled import Core

TINY = 1e-30


@dataclass(frozen=True)
class FieldChange:
    """Change of a field of coeff.h, or of another file of the folder.

    Attributes
    ----------
    name : str
    numbers, changed : int, numbers in the field and how many changed; 1 and 1 for a file
    largest : float or None, largest relative change of a number; None for whole numbers and files
    """

    name: str
    numbers: int
    changed: int
    largest: float | None


def coefficient_changes(old: Path, new: Path) -> list[FieldChange]:
    """List what differs between two generated folders.

    Parameters
    ----------
    old, new : Path, generated folders

    Returns
    -------
    list of FieldChange, in the order of coeff.h, then files

    Raises
    ------
    InputError
        If a folder is not a generated folder, or the two differ in vehicle or sizes.
    """
    manifests = [artefacts.read_manifest(folder, "vehicle") for folder in (old, new)]
    vehicles = [m["project"]["name"] for m in manifests]
    cores = [Core(folder) for folder in (old, new)]
    sizes = [core.sizes for core in cores]
    if vehicles[0] != vehicles[1] or sizes[0] != sizes[1]:
        raise InputError(old, "--delta", f"{vehicles[0]}, {sizes[0]}", f"{vehicles[1]}, {sizes[1]}")
    changes = []
    for part, kind in enumerate(("words", "reals")):
        before, after = (COEFF.split(kind, core.compiled[part], core.sizes) for core in cores)
        for name in before:
            a, b = np.ravel(before[name]), np.ravel(after[name])
            if not np.array_equal(a, b, equal_nan=kind == "reals"):
                relative = None
                if kind == "reals":
                    relative = float(np.max(np.abs(b - a) / np.maximum(np.abs(a), TINY)))
                changes.append(FieldChange(name, len(a), int((a != b).sum()), relative))
    names = sorted({p.name for folder in (old, new) for p in folder.glob("*.c")} - {"lpvguard_coeff.c"})
    for name in names:
        hashes = [artefacts.file_hash(f / name) if (f / name).is_file() else None for f in (old, new)]
        if hashes[0] != hashes[1]:
            changes.append(FieldChange(name, 1, 1, None))
    return changes
