"""Proposals: what each drive is learnt as, unless a person decides otherwise.

The first rule that holds decides.

    fault          the lifetime test says that the vehicle changed, a sensor is broken, or the gain is off by
                   half the least gain fault that `evaluate` injects. For a vehicle with own gains, its drives
                   must show that their mean gain is off by less
    confirm        the drive refutes nothing
    new condition  its group has no known drive, and two recordings here
    recentre       the mean error of all drives is more than half of the largest: fit again
    spread         the bounds grow
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..fleet.scores import DriveEstimate
from ..fleet.state import FleetState
from .judgement import Judge, Judgement
from .own import OwnGains, mean_changes

FAULT, CONFIRM, CONDITION, RECENTRE, SPREAD = "fault", "confirm", "new condition", "recentre", "spread"
ACTIONS = (FAULT, CONFIRM, CONDITION, RECENTRE, SPREAD)
FEWEST_TO_RECENTRE = 3
"""Fewest drives whose mean error is worth a new nominal model."""
FEWEST_OF_CONDITION = 2
"""Fewest recordings of a new condition."""
SHARE_OF_FAULT = 0.5
"""Share of the least gain fault of the project from which a gain is taken for a fault."""
SHARE_OF_MEAN = 0.5
"""Share of the largest error that the mean must exceed for a new nominal model."""

ERRORS = 3.0
"""Standard errors that the mean must exceed."""
PARTS = ("gain", "delay_s")
TINY = 1e-9
Part = tuple[int, str]
"""Index of an output, and one of PARTS."""


@dataclass(frozen=True)
class LearningProposal:
    """Action of ACTIONS with its reason."""

    action: str
    reason: str


def proposals(
    judge: Judge,
    judgements: Sequence[Judgement],
    known: Sequence[tuple[DriveEstimate, ...]],
    life: FleetState,
    known_groups: set[str],
    own: OwnGains,
) -> list[LearningProposal]:
    """Propose an action for every judged drive, in order.

    ``known`` holds the estimates of the known drives. ``life`` is the state after the judged drives. ``own``
    are the gains by which the drives are divided.
    """
    gains = judge.stored.project.evaluation.gains
    least = SHARE_OF_FAULT * min(abs(1 - g) for g in gains if g != 1)
    shifted = _shifted([*known, *(j.estimates for j in judgements)])
    groups: dict[str, set[str]] = {}
    for j in judgements:
        groups.setdefault(j.experiment.group or "", set()).add(j.experiment.recording)
    new = {
        g
        for g, recordings in groups.items()
        if g and g not in known_groups and len(recordings) >= FEWEST_OF_CONDITION
    }
    largest = _largest(known)
    changed = _changed(judgements, own, least)
    return [
        _proposal(
            j, life, _off(j, own, least) or changed.get(j.vehicle),
            shifted.get(_dominant(j.estimates, largest)), new,
        )
        for j in judgements
    ]  # fmt: skip


def _off(judgement: Judgement, own: OwnGains, least: float) -> str | None:
    """Say that the gain of a drive is off, where it is."""
    if judgement.vehicle in own.vehicles:
        gains, whose = own.changes([judgement.estimates])[0], f"{judgement.vehicle}'s own gain"
    else:
        gains, whose = np.array([e.gain for e in judgement.estimates]), "the first model's gain"
    worst = int(np.abs(gains).argmax())
    if abs(gains[worst]) < least:
        return None
    output = judgement.estimates[worst].output
    return f"{output} has {1 + gains[worst]:.3f} of {whose}; from {least:.2g} off on it is taken for a fault"


def _changed(judgements: Sequence[Judgement], own: OwnGains, least: float) -> dict[str, str]:
    """Say of vehicles with own gains that their drives do not show a gain near these."""
    by_vehicle: dict[str, list[tuple[DriveEstimate, ...]]] = {}
    for j in judgements:
        by_vehicle.setdefault(j.vehicle, []).append(j.estimates)
    said = {}
    for vehicle, (change, error) in mean_changes(own, by_vehicle).items():
        drives, worst = by_vehicle[vehicle], int((np.abs(change) + error).argmax())
        if abs(change[worst]) + error[worst] >= least:
            said[vehicle] = (
                f"{drives[0][worst].output} has {1 + change[worst]:.3f} of {vehicle}'s own gain in the mean "
                f"of {len(drives)} drives, with an error up to {error[worst]:.2g}: they do not show less "
                f"than {least:.2g}"
            )
    return said


def _proposal(
    judgement: Judgement, life: FleetState, off: str | None, shifted: str | None, new: set[str]
) -> LearningProposal:
    member = life.members.get(judgement.vehicle)
    if member is not None and member.life.changed_at:
        return LearningProposal(
            FAULT,
            f"the lifetime test says that {judgement.vehicle} changed, with {member.changed_by}: a slow "
            f"change is no healthy drive",
        )
    if judgement.broken is not None:
        return LearningProposal(FAULT, judgement.broken)
    if off is not None:
        return LearningProposal(FAULT, off)
    if not judgement.refutes:
        return LearningProposal(CONFIRM, "it refutes nothing")
    if judgement.experiment.group in new:
        return LearningProposal(CONDITION, f"no known drive has group {judgement.experiment.group}")
    if shifted is not None:
        return LearningProposal(RECENTRE, shifted)
    return LearningProposal(
        SPREAD, f"its largest ratio is {max(judgement.ratios.values()):.3g}, and no fault shows"
    )


def _largest(known: Sequence[tuple[DriveEstimate, ...]]) -> dict[Part, float]:
    """Largest magnitude of each part over the known drives; empty without any."""
    every = [(j, part) for j in range(len(known[0])) for part in PARTS] if known else []
    return {(j, part): max(abs(getattr(e[j], part)) for e in known) for j, part in every}


def _dominant(estimates: tuple[DriveEstimate, ...], largest: dict[Part, float]) -> Part:
    """Output and part of a drive's estimate that is the farthest from the known ones, relative to these."""

    def beyond(place: Part) -> float:
        j, part = place
        return abs(getattr(estimates[j], part)) / max(largest.get(place, 0.0), TINY)

    return max(((j, part) for j in range(len(estimates)) for part in PARTS), key=beyond)


def _shifted(estimates: Sequence[tuple[DriveEstimate, ...]]) -> dict[Part, str]:
    """Common errors of all drives that a new nominal model would take, in words by output and part."""
    shifts: dict[Part, str] = {}
    if len(estimates) < FEWEST_TO_RECENTRE:
        return shifts
    for j, estimate in enumerate(estimates[0]):
        for part in PARTS:
            values = np.array([getattr(e[j], part) for e in estimates])
            mean, error = float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))
            if abs(mean) > max(SHARE_OF_MEAN * np.abs(values).max(), ERRORS * error):
                name = part.removesuffix("_s")
                shifts[j, part] = (
                    f"{name} of {estimate.output} is off by {mean:+.3g} in the mean of {len(values)} drives"
                )
    return shifts
