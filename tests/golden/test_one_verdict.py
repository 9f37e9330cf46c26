"""One verdict for one drive: float, double, and either with fused multiply-add say the same of each sample.

A threshold is the score of a calibration drive, raised by ROUNDING. Without that margin, rounding decides
whether the drive that set the threshold falsifies the model.
"""

import platform

import numpy as np
import pytest

from lpvguard.core import compiled, targets
from lpvguard.core.compiled import Core, library_root
from lpvguard.drives.tables import list_experiments, read_drive
from lpvguard.identify.calibration import ROUNDING
from parts import require

FUSED = ("-march=x86-64-v3",) if platform.machine() in ("x86_64", "AMD64") else ()


@pytest.fixture(scope="module")
def builds() -> dict[str, Core]:
    """The shipped g80 by number type and contraction."""
    folder, flags = library_root() / "vehicles" / "g80", compiled.CORE_FLAGS
    made = {}
    with pytest.MonkeyPatch.context() as patch:
        for contract in ("off", "fast"):
            kept = tuple(flag for flag in flags if not flag.startswith("-ffp-contract"))
            more = FUSED if contract == "fast" else ()
            patch.setattr(compiled, "CORE_FLAGS", (*kept, f"-ffp-contract={contract}", *more))
            for double in (False, True):
                made[f"{'double' if double else 'float'}, {contract}"] = Core(folder, double=double)
    return made


@pytest.mark.slow("10 s: four cores compiled, and every measured drive four times")
@pytest.mark.requirement("REQ-MON-18")
def test_all_builds_say_the_same_of_every_measured_drive(builds, measured, g80):
    different = []
    for experiment in list_experiments(measured):
        drive = read_drive(experiment.path, g80)
        runs = {name: core.monitor().run_drive(drive) for name, core in builds.items()}
        first = runs["float, off"]
        assert len(first.frames.bin) > 0
        different += [
            (experiment.name, name) for name, run in runs.items() if (run.verdict != first.verdict).any()
        ]
    assert different == []


@pytest.mark.long("some minutes a processor: every measured drive four times in an emulator")
@pytest.mark.requirement("REQ-MON-18")
@pytest.mark.parametrize("name", sorted(targets.TARGETS))
def test_every_target_says_of_every_measured_drive_what_this_pc_says(builds, measured, g80, name):
    require("qemu")
    drives = [read_drive(experiment.path, g80) for experiment in list_experiments(measured)]
    wanted = []
    for drive in drives:
        verdict = builds["float, off"].monitor().run_drive(drive).verdict
        changed = np.flatnonzero(np.diff(verdict, prepend=0))
        wanted.append([(int(k), int(verdict[k])) for k in changed])
    inputs = [targets.Input(drive.v, drive.u, drive.y) for drive in drives]
    folder = library_root() / "vehicles" / "g80"
    for double in (False, True):
        for fused in (False, True):
            said = targets.run_verdicts(name, folder, inputs, double=double, fused=fused)
            assert said.changes == wanted, (double, fused)


@pytest.mark.slow("5 s: four cores compiled")
@pytest.mark.requirement("REQ-MON-18")
@pytest.mark.parametrize("test", ["threshold", "energy_threshold", "change_threshold"])
def test_the_margin_holds_what_rounding_adds_to_a_score(builds, synthetic, g80, test):
    """The threshold at the score of the drive itself, as one build has it: raised by the margin, no build
    falsifies; lowered by it, all do."""
    drive = read_drive(synthetic / "synthetic_02.csv", g80)
    for core in builds.values():
        reals = core.compiled[1].copy()
        fields = core.fields(reals)
        for name in ("threshold", "energy_threshold", "change_threshold"):
            fields[name][:] = 1e9
        run = core.monitor(reals=reals, seal=True).run_drive(drive)
        scores = {
            "threshold": run.frames.statistic.max(),
            "energy_threshold": run.energy.max(),
            "change_threshold": run.change.max(),
        }
        for other in builds.values():
            for factor, alarms in ((1 + ROUNDING, False), (1 - ROUNDING, True)):
                changed = other.compiled[1].copy()
                fields = other.fields(changed)
                fields["pool_scale"][:] = 0.0  # their ratio would share the threshold
                for name in scores:
                    fields[name][:] = 1e9
                fields[test][:] = max(scores[test] * factor, 1.0 if test == "energy_threshold" else 0.0)
                run = other.monitor(reals=changed, seal=True).run_drive(drive)
                assert np.isin(run.verdict, (2, 6)).any() == (alarms and fields[test][0] < scores[test])
