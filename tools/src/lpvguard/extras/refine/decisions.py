"""The file of decisions: what `refine` proposes, and what a person signs.

A drive is learnt only where the file says ``accept = true`` of it and names a person in ``signed_by``.
Another action than the proposed one needs a reason in ``why``.
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import tomlkit
from tomlkit.exceptions import TOMLKitError

from ...base import artefacts
from ...base.errors import InputError
from ...base.parallel import Map
from ...drives.tables import TABLE_SUFFIXES, Experiment, index_column, list_experiments, table_hashes
from ...replay.replayer import Replayer
from ...vehicle.project import Project
from ..fleet.recordings import Listed, follow
from ..fleet.state import FleetState
from .judgement import Judge, Judgement
from .lineage import Lineage
from .own import OwnGains
from .proposals import ACTIONS, CONDITION, FAULT, RECENTRE, SPREAD, LearningProposal, proposals

KIND, SCHEMA = "refinement decisions", 1
NOTE = (
    "Decisions of lpvguard refine. A drive is learnt where accept is true. Name yourself in signed_by.",
    f"action: {', '.join(ACTIONS)}. Say why where it is not the proposal.",
    "The first accepted drives of a vehicle set its own gains: accept them of an inspected vehicle.",
)
GROUP_OF_KNOWN = "known"
"""Group of calibrating drives without one, where a new condition makes groups."""


@dataclass(frozen=True)
class Evidence:
    """Further drives, in the order of their vehicles' lives.

    Attributes
    ----------
    experiments : list[Experiment]
    vehicle : dict[str, str], by name of drive
    """

    experiments: list[Experiment]
    vehicle: dict[str, str]

    @classmethod
    def from_paths(cls, lineage: Lineage, paths: Sequence[Path], by: str | None) -> Evidence:
        """Drives of folders with experiments.csv, single tables and records.

        Column ``by`` of the folders names the vehicle; by default all are one. Raises InputError for a drive
        that is known, by its name or table.
        """
        stored, experiments = lineage.stored, list[Experiment]()
        vehicle: dict[str, str] = {}
        known = list_experiments(lineage.drives)
        data = stored.project.data
        roles = {*data.bound_split, *data.noise_split}
        calibrating = next((e.split for e in known if e.split not in roles), "valid")
        for path in paths:
            if path.is_dir():
                added = list_experiments(path)
                names = {} if by is None else index_column(path, by)
            elif path.suffix in TABLE_SUFFIXES and path.is_file():
                names = {}
                added = [Experiment(path.stem, path.absolute(), calibrating, "unknown", path.stem)]
            else:
                raise InputError(
                    path, "", "is no evidence", f"a folder of drives, or one of {', '.join(TABLE_SUFFIXES)}"
                )
            experiments += added
            vehicle |= {e.name: names.get(e.name, stored.project.name) for e in added}
        every = Counter(e.name for e in (*known, *experiments))
        for e in experiments:
            if every[e.name] > 1:
                raise InputError(e.path, "", f"a drive named {e.name} is there already", "names of their own")
        table_hashes([*known, *experiments])
        return cls(experiments, vehicle)

    @contextmanager
    def divided(
        self, own: OwnGains, project: Project, beside: Path, workers: Map = map
    ) -> Iterator[Evidence]:
        """Yield the evidence with the drives of `OwnGains.divided`."""
        with own.divided(project, self.experiments, self.vehicle, beside, workers) as experiments:
            yield Evidence(experiments, self.vehicle)

    def lived(
        self, lineage: Lineage, first: Replayer, workers: Map = map
    ) -> tuple[FleetState, dict[str, Any]]:
        """The lifetime test after these drives, and the object of `lpvguard fleet --json`.

        ``first`` is the core of the lineage's first identification.
        """
        listed = Listed(self.experiments[0].path.parent, self.experiments, self.vehicle, {})
        return follow(first, lineage.life_of(first, workers), listed, {}, workers)


@dataclass(frozen=True)
class DriveDecision:
    """A drive's entry in the file.

    Attributes
    ----------
    name, path, sha256, vehicle, split, driver, recording, group : str
        From the index of drives. ``path`` is relative to the file; ``group`` is empty without a group.
    refutes : list of str
    ratios : dict[str, float]
    like, proposal, reason : str
    action : str, of ACTIONS
    accept : bool
    why : str
    """

    name: str
    path: str
    sha256: str
    vehicle: str
    split: str
    driver: str
    recording: str
    group: str
    refutes: list[str]
    ratios: dict[str, float]
    like: str
    proposal: str
    reason: str
    action: str
    accept: bool = False
    why: str = ""

    @classmethod
    def from_judgement(cls, judgement: Judgement, proposal: LearningProposal, folder: Path) -> DriveDecision:
        """Return the entry of the file in ``folder``, before a person decides."""
        e = judgement.experiment
        return cls(
            e.name,
            os.path.relpath(e.path, folder.resolve()),
            artefacts.file_hash(e.path),
            judgement.vehicle,
            e.split,
            e.driver,
            e.recording,
            e.group or "",
            list(judgement.refutes),
            {test: round(ratio, 6) for test, ratio in judgement.ratios.items()},
            judgement.like,
            proposal.action,
            proposal.reason,
            proposal.action,
        )

    def experiment(self, folder: Path) -> Experiment:
        """Return the drive that the entry of the file in ``folder`` names."""
        path = (folder / self.path).absolute()
        return Experiment(self.name, path, self.split, self.driver, self.recording, self.group or None)


@dataclass(frozen=True)
class Decisions:
    """Content of the file.

    Attributes
    ----------
    identification : str, seal of the one that judged
    signed_by : str, the person
    drives : list[DriveDecision]
    """

    identification: str
    signed_by: str
    drives: list[DriveDecision]

    def text(self) -> str:
        """The file."""
        document = tomlkit.document()
        for line in NOTE:
            document.add(tomlkit.comment(line))
        document.update({"kind": KIND, "schema": SCHEMA, "signed_by": self.signed_by})
        document["identification"] = self.identification
        entries = tomlkit.aot()
        for d in self.drives:
            entry = tomlkit.table()
            for key, value in asdict(d).items():
                entry[key] = tomlkit.inline_table() if isinstance(value, dict) else value
                if isinstance(value, dict):
                    entry[key].update(value)
            entries.append(entry)
        document["drive"] = entries
        return tomlkit.dumps(document)

    @classmethod
    def read(cls, path: Path) -> Decisions:
        """Read a file as a person left it. Raises InputError where it is none, or an entry cannot be."""
        with artefacts.reading(path):
            try:
                document = tomlkit.parse(path.read_text(encoding="utf-8")).unwrap()
            except (OSError, TOMLKitError, ValueError) as error:
                raise InputError(
                    path, "", f"cannot be read ({error})", "a file of `lpvguard refine`"
                ) from None
            if (document.get("kind"), document.get("schema")) != (KIND, SCHEMA):
                raise InputError(path, "kind, schema", "not those of decisions", f"{KIND!r}, {SCHEMA}")
            drives = [DriveDecision(**entry) for entry in document["drive"]]
            decisions = cls(str(document["identification"]), str(document["signed_by"]).strip(), drives)
        for d in drives:
            decisions._require(path, d)
        return decisions

    def _require(self, path: Path, d: DriveDecision) -> None:
        where = f"drive {d.name}"
        if not isinstance(d.accept, bool):
            raise InputError(path, f"{where}, accept", repr(d.accept), "true or false")
        if d.action not in ACTIONS:
            raise InputError(path, f"{where}, action", repr(d.action), " or ".join(ACTIONS))
        if not d.accept:
            return
        if not self.signed_by:
            raise InputError(path, "signed_by", "nobody signed, and drives are accepted", "a person's name")
        if d.action == FAULT:
            raise InputError(path, where, "a fault is accepted; a fault is not learnt", "another action")
        if d.action != d.proposal and not d.why.strip():
            raise InputError(path, f"{where}, why", f"empty; {d.proposal} was proposed", "a reason")
        if d.action == CONDITION and not d.group:
            raise InputError(path, f"{where}, group", "a new condition has none", "the condition's name")

    @property
    def accepted(self) -> list[DriveDecision]:
        """Entries of the drives to learn."""
        return [d for d in self.drives if d.accept]

    @property
    def entries(self) -> list[dict[str, Any]]:
        """Entries as dicts."""
        return [asdict(d) for d in self.drives]

    @property
    def rows(self) -> list[dict[str, str]]:
        """The table for people."""
        return [
            {
                "drive": d.name,
                "refutes": ", ".join(d.refutes) or "nothing",
                "largest ratio": f"{max(d.ratios.values()):.3g}",
                "like": d.like,
                "proposal": d.proposal,
                "reason": d.reason,
            }
            for d in self.drives
        ]

    def accepting(self, person: str, *, recentre: bool = True) -> Decisions:
        """The file as a person signs it who accepts every proposal but faults.

        Without ``recentre`` a drive of that proposal is learnt as spread.
        """
        drives = [replace(d, accept=d.proposal != FAULT) for d in self.drives]
        if not recentre:
            drives = [
                replace(d, action=SPREAD, why="the model stays") if d.action == RECENTRE else d
                for d in drives
            ]
        return replace(self, signed_by=person, drives=drives)


def decide(
    lineage: Lineage,
    evidence: Evidence,
    folder: Path,
    workers: Map = map,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Decisions, dict[str, Any]]:
    """Judge drives and propose what to learn.

    Parameters
    ----------
    lineage : Lineage
    evidence : Evidence
    folder : Path, of the file to come
    workers : Map
    progress : Callable, reports progress

    Returns
    -------
    tuple of Decisions, and dict, the object of `lpvguard fleet --json`

    Raises
    ------
    InputError
        If a drive cannot be judged.
    """
    own, project = lineage.own, lineage.stored.project
    with Judge.for_lineage(lineage) as judge, evidence.divided(own, project, folder, workers) as divided:
        judgements = []
        for judgement in judge.judged(divided.experiments, divided.vehicle, workers):
            progress(f"judged {judgement.experiment.name}")
            judgements.append(judgement)
        progress("lifetime test")
        life, lives = divided.lived(lineage, judge.first, workers)
        groups = {e.group for e in list_experiments(lineage.drives) if e.group}
        known = judge.known_estimates(lineage.drives, workers)
        made = proposals(judge, judgements, known, life, groups, own)
    entries = [
        DriveDecision.from_judgement(replace(j, experiment=e), p, folder)
        for e, j, p in zip(evidence.experiments, judgements, made, strict=True)
    ]
    return Decisions(lineage.stored.manifest["seal"], "", entries), lives
