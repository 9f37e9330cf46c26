"""The compiled C core of one vehicle, called from Python. It is the only monitor in this package.

The core is compiled on first use from the ECU's sources: ``lib/`` and the vehicle's generated folder. The
result is kept in a cache, keyed by a hash.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from ..base import artefacts, native
from ..base.errors import InputError
from ..base.layout import COEFF, constant
from ..drives.tables import Drive
from ..vehicle.project import Project
from ..vehicle.stored_settings import require_settings
from .c_enums import enum_names

PACKAGE = Path(__file__).resolve().parents[1]


def band_names(n: int) -> tuple[str, ...]:
    """Return the names of the energy test's bands, lowest first.

    Parameters
    ----------
    n : int, number of bands

    Returns
    -------
    tuple of str
    """
    between = ["between"] if n == 3 else [f"between_{k}_{k + 1}" for k in range(1, n - 1)]
    return ("below", *between, "above")


DIAGNOSIS_SOURCE = "lpvguard_diagnosis.c"
"""Table of the diagnosis in a generated folder, where it has one."""
ISOLATION_SOURCE = "lpvguard_isolation.c"
"""Table of the isolation in a generated folder, where it has one."""
CHANGE_PARTS = ("gain", "delay", "bias")
"""Parts of the change test's estimate, in the order of change.h."""


def library_root() -> Path:
    """Return the folder lib/ of the C core, from the source tree or otherwise from the wheel.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If there is none.
    """
    for candidate in (PACKAGE.parents[2] / "lib", PACKAGE / "_lib"):
        if (candidate / "src" / "monitor" / "monitor.cpp").is_file():
            return candidate
    raise InputError(
        PACKAGE, "lib", "the C core's sources are missing", "lib/ beside tools/, or an installed package"
    )


def _enum(header: str, name: str) -> tuple[str, ...]:
    return enum_names(library_root() / "include" / "lpvguard" / header, name)


VERDICTS = _enum("monitor.h", "lpvg_verdict_t")
ALARMING = ("invalid", "degraded")
"""Verdicts that an alarm of a test can cause."""


def is_alarming(verdict: np.ndarray) -> np.ndarray:
    """Mark verdicts that an alarm can cause.

    Parameters
    ----------
    verdict : ndarray (N,) of int, codes of monitor.h

    Returns
    -------
    ndarray (N,) of bool
    """
    return np.isin(verdict, [VERDICTS.index(word) for word in ALARMING])


REASONS = _enum("monitor.h", "lpvg_reason_t")
TESTS = _enum("monitor.h", "lpvg_test_t")
CAUSES = _enum("cause.h", "lpvg_cause_t")
STATUSES = _enum("status.h", "lpvg_status_t")
SUPERVISION = _enum("can.h", "lpvg_can_state_t")
EVENTS = _enum("can.h", "lpvg_can_event_t")


def firmware_root() -> Path:
    """Return the folder firmware_sim/ of a checkout.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If there is none, because the wheel holds the core only.
    """
    root = PACKAGE.parents[2] / "firmware_sim"
    if not (root / "plant" / "CMakeLists.txt").is_file():
        raise InputError(root, "", "the simulator's sources are missing", "a checkout of the project")
    return root


def shipped_vehicle(name: str) -> Path:
    """Return the generated folder of a shipped vehicle.

    Parameters
    ----------
    name : str

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If there is no folder of that name.
    """
    folder = library_root() / "vehicles" / name
    if not (folder / "lpvguard_coeff.c").is_file():
        raise InputError(
            f"vehicle {name}",
            "coefficients",
            f"no generated folder {folder}",
            "`lpvguard identify` and `lpvguard export` first, then --coefficients DIR",
        )
    return folder


def generated_folder(project: Project, coefficients: Path | None, where: object) -> Path:
    """Return the generated folder of a project, made with the project's settings.

    Parameters
    ----------
    project : Project
    coefficients : Path, or None for the shipped folder
    where : object, name of the project in errors

    Returns
    -------
    Path

    Raises
    ------
    InputError
        If there is none, or it was made with other settings.
    """
    folder = coefficients or shipped_vehicle(project.name)
    require_settings(artefacts.read_manifest(folder, "vehicle")["project"], folder, project, where)
    return folder


EIGEN_PREFIXES = ("/usr", "/usr/local", "/opt/homebrew")


def eigen_include() -> str:
    """Find the folder of Eigen 3 in the system or in the package cmeel-eigen, else raise NativeError."""
    if shutil.which("pkg-config"):
        answer = subprocess.run(
            ["pkg-config", "--variable=includedir", "eigen3"], capture_output=True, text=True, check=False
        )
        path = Path(answer.stdout.strip() or "/usr/include") / "eigen3"
        if path.is_dir():
            return str(path)
    for prefix in (*EIGEN_PREFIXES, *(f"{folder}/cmeel.prefix" for folder in sys.path)):
        folder = Path(prefix) / "include" / "eigen3"
        if folder.is_dir():
            return str(folder)
    raise native.NativeError("Eigen 3.4 not found; install libeigen3-dev or lpvguard[compiler]")


CORE_FLAGS = (
    "-std=c++17",
    "-O3",
    "-fno-exceptions",
    "-fno-rtti",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fPIC",
)
OF_NO_VEHICLE = {"authentication", "can", "evidence", "j1939", "life", "uds", "xcp"}
"""Sources that do not depend on a vehicle's sizes, compiled once for all vehicles."""


def core_sources(root: Path, folder: Path) -> list[Path]:
    """List the sources of the core below ``root`` (lib/) that a vehicle's generated folder needs.

    The folder has ECU code only with lpvguard_bus.c.
    """
    without = set() if (folder / "lpvguard_bus.c").is_file() else {"ecu"}
    return sorted(p for p in (root / "src").rglob("*.cpp") if p.stem not in without)


def core_objects(
    folder: Path,
    more: Sequence[Path] = (),
    *,
    flags: Sequence[str] = (),
    include_dirs: Sequence[Path] = (),
    double: bool = False,
    source_root: Path | None = None,
) -> list[Path]:
    """Compile the core and a generated folder to objects of a shared library or a program.

    An object depends on its source, its headers and the vehicle's sizes. Vehicles of the same sizes share all
    objects except the tables of numbers.

    Parameters
    ----------
    folder : Path, generated folder of a vehicle
    more : Sequence[Path], further sources, default ()
    flags : Sequence[str], for ``more``, default ()
    include_dirs : Sequence[Path], further folders of headers for ``more``, default ()
    double : bool, numbers are double, default False
    source_root : Path, optional, another lib/ than the package's

    Returns
    -------
    list of Path

    Raises
    ------
    NativeError
        If there is no compiler, or a source does not compile.
    """
    root, folder = source_root or library_root(), Path(folder)
    eigen, header = eigen_include(), root / "src" / "monitor" / "eigen.hpp"
    common = (*CORE_FLAGS, "-isystem", eigen, *(["-DLPVG_DOUBLE"] if double else []))
    of_no_vehicle = [root / "include", root / "src"]
    of_vehicle = [*of_no_vehicle, folder]
    jobs = [
        (source, common, of_no_vehicle if source.stem in OF_NO_VEHICLE else of_vehicle)
        for source in core_sources(root, folder)
    ]
    jobs += [(source, common, of_vehicle) for source in sorted(folder.glob("*.c"))]
    jobs += [(source, (*common, *flags), [*of_vehicle, *include_dirs]) for source in more]

    def eigen_first(source: Path) -> Path | None:
        """Precompile Eigen's header, which needs half of the compile time of a source."""
        version = Path(eigen) / "Eigen" / "src" / "Core" / "util" / "Macros.h"
        if f'{header.name}"' not in source.read_text(encoding="utf-8") or not version.is_file():
            return None
        return native.precompiled(
            header, flags=common, include_dirs=of_no_vehicle, version=version.read_bytes()
        )

    def compiled(job: tuple[Path, Sequence[str], list[Path]]) -> Path:
        source, own_flags, includes = job
        return native.compile_object(
            source, flags=own_flags, include_dirs=includes, first=lambda: eigen_first(source)
        )

    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return list(pool.map(compiled, jobs))


def shared_core(
    folder: Path,
    wrapper: Sequence[Path],
    name: str,
    *,
    flags: Sequence[str] = (),
    include_dirs: Sequence[Path] = (),
    link: Sequence[str] = (),
    double: bool = False,
    source_root: Path | None = None,
) -> Path:
    """Compile the core of a generated folder and a wrapper around it into a shared library.

    Parameters
    ----------
    folder : Path, generated folder
    wrapper : Sequence[Path], sources with the library's functions
    name : str, first part of the library's name
    flags : Sequence[str], of the wrapper
    include_dirs : Sequence[Path], further folders of headers of the wrapper
    link : Sequence[str], flags of the linker
    double : bool, number type, default float
    source_root : Path, optional, another lib/ than the package's

    Returns
    -------
    Path, of the library

    Raises
    ------
    InputError
        If it does not compile.
    """
    try:
        objects = core_objects(
            folder, wrapper, flags=flags, include_dirs=include_dirs, double=double, source_root=source_root
        )
        return native.compile_shared(objects, flags=tuple(link), name=f"{name}_{folder.name}")
    except native.NativeError as error:
        raise InputError(
            folder, "compiling the C core", str(error).strip(), "a C++17 compiler and Eigen 3.4"
        ) from None


@dataclass(frozen=True)
class FrameLog:
    """Frames judged by the core during a run, in the order of judgement.

    Arrays are over frames; E and Z are (F, n_y). t_judged_s is the time of the sample at which the core
    judged. Frames that end together are judged one after the other. Alarms of the other tests have the same
    form (lpvg_frame_t in monitor.h). For the energy test, bin is band and direction, and E and Z hold norms.
    For the change test, bin is output and part, and E and Z hold the estimate.
    """

    t_judged_s: np.ndarray
    bin: np.ndarray
    t_end_s: np.ndarray
    reason: np.ndarray
    falsified: np.ndarray
    speed: np.ndarray
    margin: np.ndarray
    statistic: np.ndarray
    evidence: np.ndarray
    E: np.ndarray
    Z: np.ndarray
    pooled: np.ndarray
    refuted: np.ndarray

    @property
    def counted(self) -> np.ndarray:
        """Mask (F,) of the frames that counted (their reason is none or not_excited)."""
        return self.reason <= REASONS.index("not_excited")

    def judged(self, samples: int, t0: float, Ts: float, length: np.ndarray) -> np.ndarray:
        """Mask (N,) of the samples that lie in a counted frame, from time t0 [s] on.

        ``length`` (K,) is the length of a frame in samples, by bin.
        """
        after = np.round((self.t_end_s[self.counted] - t0) / Ts).astype(int) + 1
        frames_open = np.zeros(samples + 1, int)
        np.add.at(frames_open, after - length[self.bin[self.counted]], 1)
        np.add.at(frames_open, after, -1)
        return np.cumsum(frames_open)[:-1] > 0

    @classmethod
    def from_rows(cls, rows: np.ndarray, n_y: int) -> FrameLog:
        """Convert rows (F, 12 + 4 n_y) of the C wrapper, which has times in microseconds."""
        parts = rows[:, 10:-2].reshape(len(rows), 2, n_y, 2)
        spectra = parts[..., 0] + 1j * parts[..., 1]
        return cls(
            rows[:, 0] * 1e-6,
            rows[:, 1].astype(int),
            rows[:, 2] * 1e-6,
            rows[:, 3].astype(int),
            rows[:, 4] > 0,
            rows[:, 5],
            rows[:, 6],
            rows[:, 7],
            rows[:, 8],
            spectra[:, 0],
            spectra[:, 1],
            rows[:, -2],
            rows[:, -1] > 0,
        )

    @property
    def verdict(self) -> list[str]:
        """Verdict (F,) of each alarm: "invalid" if it refutes the certificate, else "degraded"."""
        return ["invalid" if x else "degraded" for x in self.refuted]


@dataclass(frozen=True)
class CauseLog:
    """Causes that the core found during a run, in the order of time; one entry (C,) per alarm and output.

    Attributes
    ----------
    t_found_s, t_alarm_s : ndarray (C,), s, time of the diagnosis and of the alarm's block
    output : ndarray (C,), index
    cause : ndarray (C,), code of CAUSES
    value, low, high : ndarray (C,), in the cause's unit (diagnosis.h)
    onset_s : ndarray (C,), s, time from the onset to the alarm
    before : ndarray (C,), the onset may be earlier than the stored record
    final : ndarray (C,), from the whole record; otherwise preliminary, from the first half of it
    """

    t_found_s: np.ndarray
    t_alarm_s: np.ndarray
    output: np.ndarray
    cause: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray
    onset_s: np.ndarray
    before: np.ndarray
    final: np.ndarray

    @classmethod
    def from_rows(cls, rows: np.ndarray, block_s: float) -> CauseLog:
        """Convert rows (C, 10) of the C wrapper; a block has the length ``block_s`` [s]."""
        found_us, alarm_us, output, cause, value, low, high, onset, before, final = rows.T
        return cls(
            found_us * 1e-6,
            alarm_us * 1e-6,
            output.astype(int),
            cause.astype(int),
            value,
            low,
            high,
            onset * block_s,
            before > 0,
            final > 0,
        )


@dataclass(frozen=True)
class PartLog:
    """Windows that the core's isolation judged during a run, in the order of time; arrays over windows (W,).

    Attributes
    ----------
    from_s, until_s : ndarray (W,), s, begin and end of the window
    alarmed, differs : ndarray (W,) of bool, as in isolation.h
    parts : ndarray (W,) of int, one bit for each named part
    likeliest, size : ndarray (W,) of int, index of the likeliest part and of its size
    value, low, high : ndarray (W,), that size and its interval
    """

    from_s: np.ndarray
    until_s: np.ndarray
    alarmed: np.ndarray
    differs: np.ndarray
    parts: np.ndarray
    likeliest: np.ndarray
    size: np.ndarray
    value: np.ndarray
    low: np.ndarray
    high: np.ndarray

    @classmethod
    def from_rows(cls, rows: np.ndarray) -> PartLog:
        """Convert rows (W, 10) of the C wrapper."""
        from_us, until_us, alarmed, differs, parts, likeliest, size, *value = rows.T
        whole = (x.astype(int) for x in (parts, likeliest, size))
        return cls(from_us * 1e-6, until_us * 1e-6, alarmed > 0, differs > 0, *whole, *value)


@dataclass(frozen=True)
class Run:
    """Results of the core along a drive of N samples.

    Attributes
    ----------
    frames : FrameLog, judged frames
    verdict : ndarray (N,) of int, codes of monitor.h
    status : ndarray (N,) of int, codes of status.h
    energy : ndarray (N,), ratio of the energy test, 0 where the test does not judge
    energy_band : ndarray (N,) of int, band of that ratio
    energy_alarms, change_alarms : FrameLog, alarms of these tests
    change : ndarray (N,), newest ratio of the change test, 0 before the first
    causes : CauseLog or None, causes of alarms, where the folder has a diagnosis
    parts : PartLog, windows of the isolation, where the folder has one
    """

    frames: FrameLog
    verdict: np.ndarray
    status: np.ndarray
    energy: np.ndarray
    energy_band: np.ndarray
    energy_alarms: FrameLog
    change: np.ndarray
    change_alarms: FrameLog
    causes: CauseLog
    parts: PartLog


class Core:
    """Compiled core of a vehicle; ``diagnoses`` is True if it names the causes of alarms.

    Parameters
    ----------
    folder : Path, generated folder of the vehicle
    double : bool, default False
    source_root : Path or None, optional

    Raises
    ------
    InputError
        If the folder is incomplete or does not compile.
    """

    def __init__(self, folder: Path, *, double: bool = False, source_root: Path | None = None):
        self.folder, self._double, self._source_root = Path(folder), double, source_root
        missing = [n for n in ("lpvguard_vehicle.h", "lpvguard_coeff.c") if not (self.folder / n).is_file()]
        if missing:
            raise InputError(
                folder, "", f"{', '.join(missing)} missing", "a folder written by `lpvguard export`"
            )
        # The sources stay in memory, because a temporary folder may be deleted before a worker gets the core.
        self._files = tuple(
            (p.name, p.read_text(encoding="utf-8"))
            for p in sorted(self.folder.iterdir())
            if p.suffix in (".h", ".c")
        )
        self.diagnoses = (self.folder / DIAGNOSIS_SOURCE).is_file()
        self.library = self._compile()
        self._lib = ctypes.CDLL(str(self.library))
        self._lib.lpvgb_create.restype = ctypes.c_void_p
        self._lib.lpvgb_run.restype = ctypes.c_int64
        sizes = (ctypes.c_uint32 * 7)()
        self._lib.lpvgb_sizes(sizes)
        self.n_u, self.n_y, self.n_bins, self._n_words, self._n_reals, self._columns, self.monitor_bytes = (
            map(int, sizes)
        )

    def __reduce__(self):
        """Pickle the core as sources; the receiving process or machine compiles them."""
        return _rebuilt, (self.folder.name, self._files, self._double, self._source_root)

    def _compile(self) -> Path:
        return shared_core(
            self.folder,
            [Path(__file__).with_name("binding.cpp")],
            "core",
            flags=[
                *(["-DLPVGB_DIAGNOSIS"] if self.diagnoses else []),
                *(["-DLPVGB_ISOLATION"] if (self.folder / ISOLATION_SOURCE).is_file() else []),
            ],
            double=self._double,
            source_root=self._source_root,
        )

    @property
    def identity(self) -> str:
        """Name of the library with its hash, because results depend on it (base/kept_results.py)."""
        return self.library.name

    @cached_property
    def compiled(self) -> tuple[np.ndarray, np.ndarray]:
        """Compiled-in coefficients as flat words (W,) and numbers (R,), in the order of coeff.h."""
        words, reals = np.zeros(self._n_words, np.uint32), np.zeros(self._n_reals)
        self._lib.lpvgb_compiled_coeff(_pointer(words), _pointer(reals))
        return words, reals

    @cached_property
    def sizes(self) -> dict[str, int]:
        """Compiled-in sizes by dimension (base/layout.py)."""
        return COEFF.sizes_in(self.compiled[0])

    @cached_property
    def words(self) -> dict[str, np.ndarray]:
        """Compiled-in words by field of coeff.h, each in its shape; a scalar as (1,)."""
        return COEFF.split("words", self.compiled[0], self.sizes)

    @property
    def period_s(self) -> float:
        """Sample period [s]."""
        return float(self.words["sample_period_us"][0]) * 1e-6

    @property
    def thresholds(self) -> dict[str, float]:
        """Thresholds of the tests, by field of coeff.h."""
        reals = self.fields(self.compiled[1])
        return {n: float(reals[n][0]) for n in ("threshold", "energy_threshold", "change_threshold")}

    def estimator_id(self) -> int:
        """Identifier of the estimator in the compiled-in coefficients."""
        return int(self.words["estimator_id"][0])

    def fields(self, reals: np.ndarray) -> dict[str, np.ndarray]:
        """Views of flat numbers ``reals`` (R,) by field of coeff.h, each in its shape; a scalar as (1,)."""
        return COEFF.split("reals", reals, self.sizes)

    def monitor(
        self, *, words: np.ndarray | None = None, reals: np.ndarray | None = None, seal: bool = False
    ) -> RunningMonitor:
        """Start a monitor with the compiled-in coefficients, or with the given ones.

        ``words`` (W,) and ``reals`` (R,) are flat, as in ``compiled``. With ``seal`` their CRC is computed
        anew. Raises InputError with the core's status when init refuses the coefficients.
        """
        compiled_words, compiled_reals = self.compiled
        arguments: tuple[ctypes.c_void_p | None, ctypes.c_void_p | None] = (None, None)
        if words is not None or reals is not None:
            words = np.ascontiguousarray(compiled_words if words is None else words, np.uint32)
            reals = np.ascontiguousarray(compiled_reals if reals is None else reals, float)
            arguments = (_pointer(words), _pointer(reals))
        status = ctypes.c_int()
        handle = self._lib.lpvgb_create(*arguments, int(seal), ctypes.byref(status))
        if not handle:
            raise InputError(
                self.folder,
                "coefficients",
                f"init of the core refused the coefficients ({STATUSES[status.value]})",
                "coefficients written for this core, estimator and number type",
            )
        return RunningMonitor(self, handle)


@lru_cache(maxsize=4)
def _rebuilt(name: str, files: tuple[tuple[str, str], ...], double: bool, source_root: Path | None) -> Core:
    """Core from generated sources; each process compiles it once for all its drives."""
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch) / name
        folder.mkdir()
        artefacts.write_files(folder, dict(files))
        return Core(folder, double=double, source_root=source_root)


def _pointer(array: np.ndarray) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


class RunningMonitor:
    """A running monitor of the core; a drive arrives in one or several pieces."""

    def __init__(self, core: Core, handle: int):
        self._core, self._handle = core, ctypes.c_void_p(handle)

    def __del__(self) -> None:
        self._core._lib.lpvgb_destroy(self._handle)

    def run(
        self, t: np.ndarray, v: np.ndarray, u: np.ndarray, y: np.ndarray, present: np.ndarray | None = None
    ) -> Run:
        """Process samples t (N,) [s], v (N,), u (N, n_u), y (N, n_y).

        If ``present`` (N,) is False, the monitor gets only the time and no sample.
        """
        n = len(t)
        columns = self._core._columns
        arrays = [
            np.ascontiguousarray(a, dtype)
            for a, dtype in ((np.round(np.asarray(t) * 1e6), np.int64), (v, float), (u, float), (y, float))
        ]
        rows = np.empty((3 * n, columns))  # at most one frame and two alarms per sample
        verdict, status, band = (np.empty(n, np.uint8) for _ in range(3))
        energy, change = np.empty(n), np.empty(n)
        causes, n_causes = np.empty((n + self._core.n_y, 10)), ctypes.c_int64(n)
        windows, n_windows = np.empty((n, 10)), ctypes.c_int64(n)
        pushed = None if present is None else np.ascontiguousarray(present, np.uint8)
        count = self._core._lib.lpvgb_run(
            self._handle,
            ctypes.c_int64(n),
            *map(_pointer, arrays),
            None if pushed is None else _pointer(pushed),
            _pointer(rows),
            ctypes.c_int64(3 * n),
            _pointer(verdict),
            _pointer(status),
            _pointer(energy),
            _pointer(band),
            _pointer(change),
            _pointer(causes),
            ctypes.byref(n_causes),
            _pointer(windows),
            ctypes.byref(n_windows),
        )
        frames, energy_alarms, change_alarms = (
            FrameLog.from_rows(rows[:count][rows[:count, 9] == test], self._core.n_y)
            for test in range(len(TESTS))
        )
        period_s = self._core.period_s
        cause_log = CauseLog.from_rows(causes[: n_causes.value], constant("NBLOCK", {}) * period_s)
        parts = PartLog.from_rows(windows[: n_windows.value])
        return Run(
            frames, verdict, status, energy, band, energy_alarms, change, change_alarms, cause_log, parts
        )

    def run_drive(self, drive: Drive) -> Run:
        """Run a whole drive; at missing samples the monitor gets only the time."""
        present = None if drive.missing is None else ~drive.missing
        return self.run(drive.t, drive.v, drive.u, drive.y, present)
