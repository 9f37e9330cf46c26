"""Project files: one TOML file describes one vehicle and is validated on load.

Only its signal table states names, units, signs, ranges and CAN places of signals. The signals have the order
scheduling, inputs, outputs, gates.
"""

from __future__ import annotations

from importlib import resources
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ..base.documents import Fraction, InRadians, Positive, StrictModel, checked, read_toml
from ..base.errors import InputError
from .design_settings import DesignSettings
from .physics import KindName

NAME = r"^[a-z][a-z0-9_]*$"
"""Pattern of a vehicle's or a signal's name, from which identifiers in C are made."""


class CanPlace(StrictModel):
    """Place of a signal on the bus: bus value = factor * value, in the unit of the bus signal.

    The message belongs to lpvguard's CAN catalogue or to the car's own bus (``[can]``).

    Attributes
    ----------
    message, signal : str, names on the bus
    factor : float, bus value divided by value
    plus : tuple of str, signals of the message that are added to ``signal``
    """

    message: str
    signal: str
    factor: Annotated[float, Field(allow_inf_nan=False)] = 1.0
    plus: tuple[str, ...] = ()

    @model_validator(mode="after")
    def _invertible(self) -> CanPlace:
        if self.factor == 0.0:
            raise ValueError(f"signal {self.signal}: factor must not be 0")
        return self

    @model_serializer(mode="wrap")
    def _brief(self, plain: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Leave out an empty ``plus``, because older settings do not have it."""
        return {key: value for key, value in plain(self).items() if key != "plus" or value}


Checksum = Literal[
    "toyota",
    "honda",
    "subaru",
    "tesla",
    "chrysler",
    "volkswagen_xor",
    "nissan",
    "ford_speed",
    "ford_yaw_rate",
    "hyundai_sum",
    "hyundai_sum_before",
    "hyundai_nibbles",
    "hyundai_crc8",
    "hyundai_canfd",
    "autosar_p01",
    "autosar_p02",
    "autosar_p05",
    "autosar_p11",
    "autosar_p22",
]
"""Checksums of a car's own bus by name; can/protection.py defines them."""


class OwnMessage(StrictModel):
    """Supervision of a message of the car's own bus.

    Attributes
    ----------
    period_ms : int or None, by default the database's cycle time
    checksum : str or None, its name
    data_id : int, list of int or None, of an AUTOSAR profile; profiles 2 and 22 have a list of 16
    checksum_signal, counter : str or None
        By default the signals CHECKSUM and COUNTER, otherwise the place in the profile.
    """

    period_ms: Annotated[int, Field(ge=1, le=10_000)] | None = None
    checksum: Checksum | None = None
    data_id: Annotated[int, Field(ge=0, le=0xFFFF)] | list[Annotated[int, Field(ge=0, le=0xFF)]] | None = None
    checksum_signal: str | None = None
    counter: str | None = None


class OwnBus(StrictModel):
    """The car's own bus; an identification does not depend on it.

    Attributes
    ----------
    dbc : str, CAN database beside the project file, which describes the messages
    messages : dict[str, OwnMessage], supervision of each message
    demand : dict[str, CanPlace], place of each input's demand in a message that a controller sends
        It has all inputs or none.
    """

    dbc: str
    messages: dict[str, OwnMessage] = Field(default={})
    demand: dict[str, CanPlace] = Field(default={})


class Signal(StrictModel):
    """One measured signal.

    Attributes
    ----------
    name, column, unit : str
    role : str, scheduling, input, disturbance, output or gate
        A disturbance is a measured input of the model that nobody commands, such as the road's bank.
    positive : str, direction of positive values
    min, max : float, physical limits in ``unit``; the limits of a gate bound the use of the model
        A sample outside the limits counts as missing.
    can : CanPlace or None
    resolution, noise : float or None, step and standard deviation of white noise of an output's sensor in
    ``unit``
        By default they are estimated from the bound-setting drives (THEORY 7.13).
    """

    name: Annotated[str, Field(pattern=NAME)]
    role: Literal["scheduling", "input", "disturbance", "output", "gate"]
    column: str
    unit: str
    positive: str
    min: float
    max: float
    can: CanPlace | None = None
    resolution: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None
    noise: Annotated[float, Field(ge=0, allow_inf_nan=False)] | None = None

    @model_validator(mode="after")
    def _ordered(self) -> Signal:
        if not self.min < self.max:
            raise ValueError(f"signal {self.name}: min {self.min} must be below max {self.max}")
        if self.role != "output" and (self.resolution, self.noise) != (None, None):
            raise ValueError(f"signal {self.name}: resolution and noise apply to outputs only")
        return self

    @model_serializer(mode="wrap")
    def _brief(self, plain: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Leave out sensor data that is None, because older settings do not have it."""
        return {k: v for k, v in plain(self).items() if k not in ("resolution", "noise") or v is not None}


class ModelSettings(StrictModel):
    """Continuous-time nominal model.

    Entries of A and B are numbers or expressions in v, the parameters and ``let``. Expressions use + - * / **
    and abs, min, max, sqrt.

    Attributes
    ----------
    input_delay_s : float, s
    speed_min_mps, speed_max_mps : float, m/s
    input_offset, output_offset : list of float or None
    A : list (n, n) of float or str
    B : list (n, n_u) of float or str
    C : list (n_y, n) of float
    parameters : dict[str, float], values by name
    let : dict[str, str], expressions by name
    """

    input_delay_s: Annotated[float, Field(ge=0)] = 0.0
    speed_min_mps: Positive
    speed_max_mps: Positive
    input_offset: list[float] | None = None
    output_offset: list[float] | None = None
    A: list[list[float | str]]
    B: list[list[float | str]]
    C: list[list[float]]
    parameters: dict[str, float] = Field(default={})
    let: dict[str, str] = Field(default={})


class FrameSettings(InRadians):
    """Settings of the estimator (THEORY 3.2, 3.3).

    Attributes
    ----------
    estimator : str
        ``hann``: constant-Q Hann frames. ``dft``: the paper's plain DFT, one frame per experiment with all
        its lines.
    length_s : float or None, s, length of the frame of ``dft``
    periods : int, periods in a Hann frame
    bins_per_decade : int
    omega_min_radps, omega_max_radps, f_min_hz, f_max_hz : float, rad/s, of which six digits count
        In Hz, as f_min_hz and f_max_hz, in Python and in older files.
    hop_per_frame : int, hops in a frame
    speed_tolerance : float, relative change of speed within a frame
    """

    estimator: Literal["hann", "dft"] = "hann"
    length_s: Positive | None = None
    periods: Annotated[int, Field(ge=2, le=64)] = 6
    bins_per_decade: Annotated[int, Field(ge=1, le=50)] = 10
    f_min_hz: Positive
    f_max_hz: Positive
    hop_per_frame: Literal[2] = 2
    speed_tolerance: Fraction = 0.15

    FREQUENCIES: ClassVar = {"omega_min_radps": "f_min_hz", "omega_max_radps": "f_max_hz"}

    @model_validator(mode="after")
    def _length(self) -> FrameSettings:
        if (self.estimator == "dft") != (self.length_s is not None):
            raise ValueError("frames: length_s must be given for estimator 'dft', and only for it")
        return self


class NuCeiling(InRadians):
    """Upper limit on the uncertainty bound over frequency (THEORY 5.1).

    Attributes
    ----------
    omega_radps, f_hz : list of float, rad/s
        In Hz, as f_hz, in Python and in older files.
    nu : list of float, upper limit at omega_radps
    """

    f_hz: list[Positive]
    nu: list[Positive]

    FREQUENCIES: ClassVar = {"omega_radps": "f_hz"}

    @model_validator(mode="after")
    def _shape(self) -> NuCeiling:
        if len(self.f_hz) != len(self.nu) or not self.f_hz:
            raise ValueError("nu_ceiling: omega_radps and nu must be non-empty and equally long")
        if any(b <= a for a, b in zip(self.f_hz, self.f_hz[1:], strict=False)):
            raise ValueError("nu_ceiling: omega_radps must increase")
        return self

    def at(self, f_hz: np.ndarray) -> np.ndarray:
        """Upper limit (F,) at ``f_hz`` (F,) [Hz]: linear in log f, constant outside; 0 at DC."""
        f = np.asarray(f_hz, float)
        safe = np.where(f > 0, f, self.f_hz[0])
        return np.where(f > 0, np.interp(np.log(safe), np.log(self.f_hz), self.nu), 0.0)


class BoundSettings(StrictModel):
    """Settings of the bounds (THEORY 5).

    Attributes
    ----------
    structure : str, S0 (no Delta), S1 (one Delta for all outputs) or S1_diagonal (one per output), THEORY 4.1
    disturbance_set : str, the paper's set, or one that covers the record
    nu_ceiling : NuCeiling, optional
        Ceiling on the uncertainty bound, as the paper sets it: what the controller can stand. By default
        W_delta is the band of the model error (THEORY 7.15). The frame test has a healthy set within
        (THEORY 7.16).
    """

    structure: Literal["S0", "S1", "S1_diagonal"] = "S1"
    disturbance_set: Literal["paper", "covering"] = "covering"
    nu_ceiling: NuCeiling | None = None


class Beyond(StrictModel):
    """Assumption on an output beyond the frequencies with data (THEORY 7.6).

    Attributes
    ----------
    output : str
    ratio : float or str, bound on |G/P|, at least 1; a number or an expression in omega [rad/s]
    reason : str
    """

    output: str
    ratio: float | str
    reason: str


class ModelErrorSettings(StrictModel):
    """Settings of the model error model (THEORY 7.6).

    Attributes
    ----------
    amplitude_edges : list of float, edges between the classes of sqrt(2) times the first input's rms [input
    unit]
    speed_cells : int, cells of equal width over the model's speed range, pooled if a line over speed fits
    instrument : str or None, instrumental variable from outside the loop (column), by default the nominal
    output
    beyond : list of Beyond
    """

    amplitude_edges: list[Positive] = Field(default=[])
    speed_cells: Literal[1, 2, 4, 8, 16] = 4
    instrument: str | None = None
    beyond: list[Beyond] = Field(default=[])

    @model_validator(mode="after")
    def _rising(self) -> ModelErrorSettings:
        if any(b <= a for a, b in pairwise(self.amplitude_edges)):
            raise ValueError("model_error.amplitude_edges must rise")
        return self


class WeightSettings(StrictModel):
    """Settings of the weight fits.

    Attributes
    ----------
    max_order : int, largest order
    tolerance_db : float, dB above the smallest worst-case ratio
    """

    max_order: Annotated[int, Field(ge=0, le=8)] = 4
    tolerance_db: Positive = 0.3


class FrameTestSettings(StrictModel):
    """Settings of the frame test (THEORY 7.1).

    Attributes
    ----------
    confirm : int, exceedances that make an alarm
    of_last : int, frames of a bin among which they are counted
        With a rate and ``of_last`` 1, identify chooses both for it (THEORY 7.20).
    alpha : float, false-alarm rate that calibration aims at
    joint : bool
        One threshold decides all tests, so that alpha holds for any of them (THEORY 7.3). Else alpha holds
        for each.
    alarms_per_1000_h : float or None
        Rate of all tests together per 1000 judged hours, in place of alpha (THEORY 7.20).
    alarms_confident : bool
        Extrapolated thresholds are the upper end of their interval, with 95 % confidence.
    excited_std : float
        A sample is excited if the first input's standard deviation over 10 s is at least this [input unit].
    """

    confirm: Annotated[int, Field(ge=1, le=8)] = 1
    of_last: Annotated[int, Field(ge=1, le=8)] = 1
    alpha: Fraction = 0.1
    joint: bool = False
    alarms_per_1000_h: Positive | None = None
    alarms_confident: bool = False
    excited_std: Positive

    @model_validator(mode="after")
    def _k_of_m(self) -> FrameTestSettings:
        if self.confirm > self.of_last:
            raise ValueError(f"frame_test: confirm {self.confirm} must not exceed of_last {self.of_last}")
        return self

    @model_serializer(mode="wrap")
    def _brief(self, plain: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Leave out what is not stated, because older settings do not have it."""
        further = ("joint", "alarms_per_1000_h", "alarms_confident")
        return {k: v for k, v in plain(self).items() if k not in further or v}


class EnergyTestSettings(InRadians):
    """Settings of the energy test (THEORY 7.2).

    Attributes
    ----------
    band_radps, band_hz : tuple of float or None, rad/s
        Two to seven increasing corner frequencies, by default the frames' omega_min_radps and
        omega_max_radps. In Hz, as band_hz, in Python and in older files.
    memory_s : float or None, s, time constant of the forgetting, by default one period of omega_min_radps
    """

    band_hz: Annotated[tuple[Positive, ...], Field(min_length=2, max_length=7)] | None = None
    memory_s: Positive | None = None

    FREQUENCIES: ClassVar = {"band_radps": "band_hz"}


class ChangeTestSettings(StrictModel):
    """Settings of the change test (THEORY 7.7).

    Attributes
    ----------
    memory_s : float or None, s, time constant of the forgetting
        By default a quarter of a period of omega_min_radps, but at least two blocks.
    """

    memory_s: Positive | None = None


class DataSettings(StrictModel):
    """Roles of the splits of drives, and the data generator; all other splits calibrate.

    Attributes
    ----------
    bound_split : list of str, splits that set the bounds
    command_split : list of str or None, splits of bound_split with commands as in use, for W_C; default: all
    noise_split : list of str, zero-input runs, for W_n
    generator : str or None, data set that `generate` makes
    """

    bound_split: list[str]
    command_split: list[str] | None = None
    noise_split: list[str] = Field(default=[])
    generator: Literal["car", "truck"] | None = None

    @property
    def command_splits(self) -> list[str]:
        """Splits from which W_C is computed."""
        return self.bound_split if self.command_split is None else self.command_split

    @model_validator(mode="after")
    def _disjoint(self) -> DataSettings:
        if set(self.bound_split) & set(self.noise_split):
            raise ValueError("data: bound_split and noise_split must be disjoint")
        if self.command_split is not None and not set(self.command_split) <= set(self.bound_split):
            raise ValueError("data: command_split must be among bound_split")
        return self


Range = Annotated[list[float], Field(min_length=2, max_length=2)]
"""Lower and upper end."""


class FitSettings(StrictModel):
    """Settings of `fit`; an identification does not depend on them.

    Offsets are fitted if the model has them.

    Attributes
    ----------
    parameters : dict or None
        Range of each fitted entry. By default all entries are fitted, from one fifth of their value to five
        times it.
    input_delay_s : (low, high) or None, s, at most 1 s; equal ends keep the delay
        By default from 0 to ten samples or three times the value.
    trim : str, one input_offset for all drives, or one for each drive (then their mean is written)
    kind : str or None, kind of vehicle, whose ranges a fit must keep; None means no ranges
    """

    kind: KindName | None = None
    parameters: dict[str, Range] | None = None
    input_delay_s: Range | None = None
    trim: Literal["common", "drive"] = "common"

    @model_validator(mode="after")
    def _ordered(self) -> FitSettings:
        for name, (low, high) in (self.parameters or {}).items():
            if not low < high:
                raise ValueError(f"fit.parameters.{name}: {low:g} must be below {high:g}")
        if self.input_delay_s is not None and not 0 <= self.input_delay_s[0] <= self.input_delay_s[1]:
            raise ValueError("fit.input_delay_s: 0 <= lower <= upper end must hold")
        return self


Way = Literal["step", "ramp", "start"]
"""Ways in which `evaluate` lets a fault begin (evaluate/detection.py)."""


class EvaluationSettings(StrictModel):
    """Faults that `evaluate` injects, and their times; an identification does not depend on them.

    Attributes
    ----------
    fault_from_s : float, s, earliest start of a fault in a drive
    shortest_drive_s : float, s; shorter drives get no fault
    found_within_s : float, s of judged, excited driving within which a fault counts as found
    starts : int, instants per drive
    gains : tuple of float, factors on the outputs
    delays_s : tuple of float, s, of the input and of the outputs
    bias : float or None, on every output, in its unit
    bias_of_spread : float
        The default bias as a share of the output's standard deviation in bound-setting drives.
    ways : tuple of str, as a step, growing for ``ramp_s``, or from the drive's first sample
    ramp_s : float, s
    """

    fault_from_s: Annotated[float, Field(ge=0)] = 60.0
    shortest_drive_s: Positive = 120.0
    found_within_s: Positive = 30.0
    starts: Annotated[int, Field(ge=1, le=100)] = 5
    gains: Annotated[tuple[float, ...], Field(min_length=1)] = (0.6, -1.0, 0.7, 1.3)
    delays_s: Annotated[tuple[Positive, ...], Field(min_length=1)] = (0.3, 0.15)
    bias: Positive | None = None
    bias_of_spread: Positive = 0.5
    ways: Annotated[tuple[Way, ...], Field(min_length=1)] = ("step", "ramp", "start")
    ramp_s: Positive = 20.0

    @model_validator(mode="after")
    def _long_enough(self) -> EvaluationSettings:
        if len(set(self.ways)) < len(self.ways):
            raise ValueError("evaluation.ways: each way at most once")
        if self.shortest_drive_s < self.fault_from_s + self.found_within_s:
            raise ValueError("evaluation.shortest_drive_s: must be at least fault_from_s + found_within_s")
        return self


class AdviceSettings(StrictModel):
    """Advice on each cause of alarms, one text or one text per output. An identification does not depend on
    it."""

    gain: str | dict[str, str] | None = None
    delay: str | dict[str, str] | None = None
    bias: str | dict[str, str] | None = None
    sign: str | dict[str, str] | None = None
    frozen: str | dict[str, str] | None = None
    noise: str | dict[str, str] | None = None

    def for_cause(self, cause: str, output: str) -> str | None:
        """Advice on a cause in an output; None if there is none."""
        text = getattr(self, cause, None)
        return text.get(output) if isinstance(text, dict) else text


class IsolationSettings(StrictModel):
    """Redundant outputs and the parts that they can tell apart (THEORY 7.21).

    Attributes
    ----------
    vehicle : tuple of at most two str, parameters of the model that tyres and load change
    speed_power : dict[str, int], by output the power of the measured speed in it, as -1 of a_y / v
    parts : dict[str, str], part that measures a signal, by default its name
    window_s : float, s, length of the window after an alarm from which the part is found
    check : dict[str, str], what to check, by part
    """

    vehicle: Annotated[tuple[str, ...], Field(max_length=2)] = ()
    speed_power: dict[str, Annotated[int, Field(ge=-2, le=2)]] = Field(default={})
    parts: dict[str, str] = Field(default={})
    window_s: Annotated[float, Field(ge=10, le=600)] = 60.0
    check: dict[str, str] = Field(default={})

    def part_of(self, signal: str) -> str:
        """Part that measures a signal."""
        return self.parts.get(signal, signal)


class Project(StrictModel):
    """Project file of a vehicle.

    Attributes
    ----------
    schema_ : int, version of the format
    name, title : str
    Ts_s : float, s, sample period
    seed : int
    signals : list of Signal
    model : ModelSettings
    frames : FrameSettings
    bounds : BoundSettings
    model_error : ModelErrorSettings
    weights : WeightSettings
    frame_test : FrameTestSettings
    energy_test : EnergyTestSettings
    change_test : ChangeTestSettings
    data : DataSettings
    design : DesignSettings or None
    isolation : IsolationSettings or None
    can : OwnBus or None
    fit : FitSettings
    evaluation : EvaluationSettings
    advice : AdviceSettings
    """

    schema_: Literal[1] = Field(alias="schema")
    name: Annotated[str, Field(pattern=NAME)]
    title: str
    Ts_s: Positive
    seed: Annotated[int, Field(ge=0)]
    signals: list[Signal]
    model: ModelSettings
    frames: FrameSettings
    bounds: BoundSettings
    model_error: ModelErrorSettings = ModelErrorSettings()
    weights: WeightSettings
    frame_test: FrameTestSettings
    energy_test: EnergyTestSettings = EnergyTestSettings()
    change_test: ChangeTestSettings = ChangeTestSettings()
    data: DataSettings
    design: DesignSettings | None = None
    isolation: IsolationSettings | None = None
    can: OwnBus | None = Field(default=None, exclude=True)
    fit: FitSettings = Field(default=FitSettings(), exclude=True)
    evaluation: EvaluationSettings = Field(default=EvaluationSettings(), exclude=True)
    advice: AdviceSettings = Field(default=AdviceSettings(), exclude=True)

    @model_serializer(mode="wrap")
    def _brief(self, plain: SerializerFunctionWrapHandler) -> dict[str, object]:
        """Leave out ``isolation`` if it is None, because older settings do not have it."""
        return {k: v for k, v in plain(self).items() if k != "isolation" or v is not None}

    @model_validator(mode="after")
    def _consistent(self) -> Project:
        names = [s.name for s in self.signals]
        columns = [s.column for s in self.signals]
        if len(set(names)) != len(names) or len(set(columns)) != len(columns) or "t" in columns:
            raise ValueError("signals: names and columns must be unique, and column 't' is time")
        if len(self.of_role("scheduling")) != 1:
            raise ValueError("signals: exactly one signal must have role 'scheduling'")
        if self.can is not None:
            self._require_own_bus(self.can)
        if not 1 <= self.n_u <= 2 or not 1 <= self.n_y <= 4:
            raise ValueError(
                f"signals: 1 to 2 inputs and 1 to 4 outputs are supported, got {self.n_u} and {self.n_y}"
            )
        if self.inputs[0].role == "disturbance":
            raise ValueError(
                f"signals: {self.inputs[0].name} is a disturbance; an input must stand before it"
            )
        n = len(self.model.A)
        shapes = {"A": (n, n), "B": (n, self.n_u), "C": (self.n_y, n)}
        for key, (rows, cols) in shapes.items():
            matrix = getattr(self.model, key)
            if len(matrix) != rows or any(len(row) != cols for row in matrix):
                raise ValueError(f"model.{key}: must be {rows} x {cols}")
        for key, size in (("input_offset", self.n_u), ("output_offset", self.n_y)):
            value = getattr(self.model, key)
            if value is not None and len(value) != size:
                raise ValueError(f"model.{key}: must have {size} entries")
        unknown = {b.output for b in self.model_error.beyond} - {s.name for s in self.outputs}
        if unknown:
            raise ValueError(f"model_error.beyond: no output is named {', '.join(sorted(unknown))}")
        advised = {o for text in vars(self.advice).values() if isinstance(text, dict) for o in text}
        if unknown := advised - {s.name for s in self.outputs}:
            raise ValueError(f"advice: no output is named {', '.join(sorted(unknown))}")
        if self.frames.estimator == "dft" and self.frame_test.alarms_per_1000_h is not None:
            raise ValueError("frame_test.alarms_per_1000_h: needs frames of estimator 'hann'")
        if self.design is not None:
            self._require_designable(self.design)
        if self.isolation is not None:
            self._require_isolable(self.isolation)
        if unknown := set(self.fit.parameters or {}) - set(self.model.parameters):
            raise ValueError(f"fit.parameters: {', '.join(sorted(unknown))} not among model.parameters")
        if self.fit.trim == "drive" and self.model.input_offset is None:
            raise ValueError(
                "fit.trim: a trim for each drive needs model.input_offset, which receives their mean"
            )
        if not self.model.speed_min_mps < self.model.speed_max_mps:
            raise ValueError("model: speed_min_mps must be below speed_max_mps")
        if not self.frames.f_min_hz < self.frames.f_max_hz < 0.5 / self.Ts_s:
            raise ValueError("frames: lowest < highest frequency < half the sampling rate must hold")
        corners = (*(self.energy_test.band_hz or ()), 0.5 / self.Ts_s)
        if not all(low < high for low, high in pairwise(corners)):
            raise ValueError(
                "energy_test.band_radps: corners must rise and stay below half the sampling rate"
            )
        return self

    def _require_own_bus(self, bus: OwnBus) -> None:
        """Raise an error unless every message of ``[can]`` carries a signal of the table or a demand."""
        if bus.demand and sorted(bus.demand) != sorted(s.name for s in self.actuators):
            names = ", ".join(s.name for s in self.actuators)
            raise ValueError(f"can.demand: {', '.join(bus.demand)}, expected every input: {names}")
        used = {s.can.message for s in self.signals if s.can is not None}
        used |= {place.message for place in bus.demand.values()}
        if unknown := sorted(set(bus.messages) - used):
            raise ValueError(f"can.messages: {', '.join(unknown)} named by no signal's can.message")

    def _require_isolable(self, settings: IsolationSettings) -> None:
        """Raise an error unless the isolation names existing parameters and signals."""
        if unknown := sorted(set(settings.vehicle) - set(self.model.parameters)):
            raise ValueError(f"isolation.vehicle: {', '.join(unknown)} not among model.parameters")
        if unknown := sorted(set(settings.speed_power) - {s.name for s in self.outputs}):
            raise ValueError(f"isolation.speed_power: no output is named {', '.join(unknown)}")
        measured = {s.name for s in (self.speed, *self.inputs, *self.outputs)}
        if unknown := sorted(set(settings.parts) - measured):
            raise ValueError(f"isolation.parts: no signal is named {', '.join(unknown)}")

    def _require_designable(self, design: DesignSettings) -> None:
        """Raise an error if a design is impossible; identification and monitor accept any vehicle."""
        if self.gates:
            names = ", ".join(s.name for s in self.gates)
            raise ValueError(f"design: the ECU does not read gates, so {names} would have no effect")
        if len(self.actuators) < self.n_u:
            raise ValueError(
                f"design: a controller cannot command the disturbance {self.inputs[-1].name}; design on a "
                "project file without it"
            )
        outputs = {s.name: s.unit for s in self.outputs}
        if design.controlled is not None and design.controlled not in outputs:
            raise ValueError(
                f"design.controlled: no output is named {design.controlled}, but {', '.join(outputs)}"
            )
        for key in ("input_max", "input_rate_max_per_s"):
            if len(getattr(design, key)) != self.n_u:
                raise ValueError(f"design.{key}: must have {self.n_u} entries")
        turning = self.outputs[self.controlled]
        if design.lateral_acceleration_max_mps2 is not None and turning.unit != "rad/s":
            raise ValueError(
                "design.lateral_acceleration_max_mps2: the controlled output must be a yaw rate in rad/s, "
                f"got {turning.name} in {turning.unit}"
            )

    def of_role(self, role: str) -> list[Signal]:
        """Signals of a role, in the order of the file."""
        return [s for s in self.signals if s.role == role]

    @property
    def speed(self) -> Signal:
        """The scheduling signal."""
        return self.of_role("scheduling")[0]

    @property
    def inputs(self) -> list[Signal]:
        """Inputs u of the model, commanded ones and measured disturbances, in the order of the file."""
        return [s for s in self.signals if s.role in ("input", "disturbance")]

    @property
    def actuators(self) -> list[Signal]:
        """Inputs that are commanded, in the order of the file."""
        return self.of_role("input")

    @property
    def outputs(self) -> list[Signal]:
        """Outputs y, in the order of the file."""
        return self.of_role("output")

    @property
    def gates(self) -> list[Signal]:
        """Signals that bound the model's use, in the order of the file."""
        return self.of_role("gate")

    @property
    def recorded(self) -> list[Signal]:
        """Speed, inputs, outputs and gates."""
        return [self.speed, *self.inputs, *self.outputs, *self.gates]

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @property
    def n_y(self) -> int:
        """Number of outputs."""
        return len(self.outputs)

    @property
    def controlled(self) -> int:
        """Index of the output that follows the command: the one in ``design``, by default the first."""
        names = [s.name for s in self.outputs]
        stated = None if self.design is None else self.design.controlled
        return 0 if stated is None else names.index(stated)

    @property
    def n_delta(self) -> int:
        """Number of uncertainty blocks Delta: one per output for S1_diagonal, else one."""
        return self.n_y if self.bounds.structure == "S1_diagonal" else 1


def shipped_vehicles() -> list[str]:
    """Names of the vehicles in the package."""
    return sorted(
        p.name.removesuffix(".toml")
        for p in resources.files(__package__).joinpath("shipped").iterdir()
        if p.name.endswith(".toml")
    )


def load_project(vehicle: str | Path) -> Project:
    """Load a project file by shipped name or by path.

    Parameters
    ----------
    vehicle : str or Path

    Returns
    -------
    Project

    Raises
    ------
    InputError
        If the file is refused; the error names the file, the field and what was expected.
    """
    path = Path(vehicle)
    if path.suffix == ".toml" or path.is_file():
        return _parsed(read_toml(path, "a project file", str(vehicle)), path.parent, str(vehicle))
    if str(vehicle) in shipped_vehicles():
        folder, where = resources.files(__package__) / "shipped", f"vehicle {vehicle}"
        shipped = read_toml(folder / f"{vehicle}.toml", "a project file", where)
        return _parsed(shipped, Path(str(folder)), where)
    raise InputError(
        str(vehicle),
        "--vehicle",
        "unknown vehicle",
        f"one of {', '.join(shipped_vehicles())}, or a path to a project file (*.toml)",
    )


def _parsed(document: dict, folder: Path, where: str) -> Project:
    """Project of a file in ``folder``, which also holds its CAN database."""
    project = parse_project(document, where)
    if project.can is None:
        return project
    bus = project.can.model_copy(update={"dbc": str(folder / project.can.dbc)})
    return project.model_copy(update={"can": bus})


def parse_project(document: object, where: str) -> Project:
    """Validate a project document.

    Parameters
    ----------
    document : object
    where : str, the document's name in errors

    Returns
    -------
    Project

    Raises
    ------
    InputError
        If a field is refused; the error names ``where``, the field and what was expected.
    """
    return checked(Project, document, "a project file as project.py describes", where)
