"""Variables of the FMUs: names, units and ranges of the signal table and the CAN catalogue, and the core's
results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ...can.catalogue import BusSignal, Catalogue, Message
from ...core.c_enums import enum_names
from ...core.compiled import CAUSES, REASONS, STATUSES, SUPERVISION, VERDICTS, library_root
from ...vehicle.project import Project, Signal

_ECU_HEADER = library_root() / "include" / "lpvguard" / "ecu.h"
ENUMERATIONS = {
    "verdict": VERDICTS,
    "reason": REASONS,
    "status": STATUSES,
    "cause": CAUSES,
    "supervision": SUPERVISION,
    "engagement": enum_names(_ECU_HEADER, "lpvg_ecu_engagement_t"),
    "fault": enum_names(_ECU_HEADER, "lpvg_ecu_fault_t"),
}
"""Names of the core's enumerations, in the order of their numbers from 0."""
REQUESTS = "0 release, 1 control, 2 acknowledge"
PRIORITIES = "priority of the strongest other command on the actuators"
TIME = 99
"""Value reference of the time."""


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU.

    Attributes
    ----------
    name, description : str
    reference : int, value reference, as in the unit's source
    causality : str, input, output, parameter or independent (time)
    kind : str, real, integer, boolean, string, binary, clock, or a key of ``ENUMERATIONS``
    unit : str, unit of a real; "1" without one
    start : float, bool, str or None, start value of an input or a parameter, and of an output that never
        changes
    low, high : float or None, physical range
    clock : int or None, value reference of the clock of a binary
    interval_s : float or None, interval of a clock; None: triggered
    dependencies : tuple of int, value references on which an output depends at its own instant
    """

    name: str
    description: str
    reference: int
    causality: str
    kind: str = "real"
    unit: str = "1"
    start: float | bool | str | None = None
    low: float | None = None
    high: float | None = None
    clock: int | None = None
    interval_s: float | None = None
    dependencies: tuple[int, ...] = ()

    @property
    def constant(self) -> bool:
        """Whether the value never changes."""
        return self.causality == "output" and self.start is not None


def numbered(
    first: int, variables: Sequence[tuple[str, str] | tuple[str, str, str] | tuple[str, str, str, str]]
) -> list[Variable]:
    """Return outputs with references from ``first`` on; each is (name, description, kind, unit)."""
    outputs = []
    for k, (name, text, *more) in enumerate(variables):
        kind, unit = (*more, *("real", "1")[len(more) :])
        outputs.append(Variable(name, text, first + k, "output", kind, unit))
    return outputs


def result_variables(thresholds: dict[str, float]) -> list[Variable]:
    """Return the results of a monitor and its diagnosis, in the order of results.hpp.

    ``thresholds`` has ``threshold``, ``energy_threshold`` and ``change_threshold`` of the coefficients.
    """
    numbers = [
        ("margin", "least common inflation of the bounds that explains the newest frame"),
        ("statistic", "statistic of the frame test; above threshold it falsifies"),
        ("evidence", "margin of the newest frame for a vehicle without response"),
        ("energy_ratio", "ratio of the energy test; above energy_threshold it falsifies"),
        ("change_ratio", "ratio of the change test; above change_threshold the vehicle has changed"),
        ("cause_value", "value of the cause, in the unit of the cause"),
        ("cause_low", "lower end of the 95 % interval of the cause"),
        ("cause_high", "upper end of the 95 % interval of the cause"),
    ]
    integers = [
        ("verdict", "verdict of the monitor", "verdict"),
        ("reason", "why the newest frame is no evidence", "reason"),
        ("cause", "cause of the newest alarm", "cause"),
        ("frames", "number of judged frames", "integer"),
        ("bin", "bin of the newest frame, 0 is DC", "integer"),
        ("cause_output", "output of the cause, from 0", "integer"),
    ]
    constants = [
        Variable(name, f"calibrated {name.replace('_', ' ')}", 108 + k, "output", start=value)
        for k, (name, value) in enumerate(thresholds.items())
    ]
    return [time_variable(), *numbered(100, numbers), *constants, *numbered(200, integers)]


def time_variable() -> Variable:
    """Return the independent variable."""
    return Variable("time", "time of the newest sample", TIME, "independent", unit="s")


def monitor_variables(project: Project, thresholds: dict[str, float]) -> list[Variable]:
    """Return the variables of a vehicle's monitor.

    Parameters
    ----------
    project : Project
    thresholds : dict, of the coefficients

    Returns
    -------
    list of Variable
    """
    signals = [project.speed, *project.inputs, *project.outputs]
    return [
        *(_input(signal, k) for k, signal in enumerate(signals)),
        *result_variables(thresholds),
        Variable("status", "status of the newest sample", 206, "output", "status"),
    ]


def ecu_variables(
    project: Project, thresholds: dict[str, float], inputs: Sequence[Variable], period_s: float
) -> list[Variable]:
    """Return the variables of a vehicle's ECU with the plain ``inputs``.

    ``thresholds`` are those of the coefficients. The last four variables are the CAN terminal, of FMI 3.0
    only.
    """
    demands = [(s.name, "demand of the controller", "real", s.unit) for s in project.inputs]
    codes = [
        ("supervision", "supervision of the received messages", "supervision"),
        ("engagement", "whether the controller is engaged", "engagement"),
        ("fault", "most severe active finding", "fault"),
        ("causes", "bits of what keeps the controller released, LPVG_ECU_CAUSE_*", "integer"),
        ("implausible", "bits of the sensors that contradict each other", "integer"),
    ]
    return [
        *inputs,
        *result_variables(thresholds),
        *numbered(111, demands),
        *numbered(206, codes),
        Variable(
            "authentication",
            "obey only commands with an authenticator by the simulation's key; concerns the terminal",
            300,
            "parameter",
            "boolean",
            start=False,
        ),
        *terminal_variables(period_s, after_reception=True),
    ]


def plant_variables(scenario: str, period_s: float) -> list[Variable]:
    """Return the variables of the simulated truck, which by default drives the text of a scenario file.

    The last four variables are the CAN terminal, of FMI 3.0 only.
    """
    inputs = [
        ("brake_demand", "pressure right minus left; acts without the terminal", "real", "bar"),
        ("driver_torque", "on the steering wheel, left turn positive", "real", "N.m"),
    ]
    wheels = ("front_left", "front_right", "rear_left", "rear_right")
    outputs = [
        ("speed", "sensor", "real", "m/s"),
        ("yaw_rate", "sensor, left turn positive", "real", "rad/s"),
        ("steering_wheel_angle", "sensor, left turn positive", "real", "rad"),
        ("lateral_acceleration", "sensor, left positive", "real", "m/s2"),
        *((f"wheel_speed_{wheel}", "sensor", "real", "m/s") for wheel in wheels),
        ("brake_pressure_left", "sensor, front wheel", "real", "bar"),
        ("brake_pressure_right", "sensor, front wheel", "real", "bar"),
        ("true_speed", "without sensor", "real", "m/s"),
        ("true_yaw_rate", "without sensor", "real", "rad/s"),
        ("true_lateral_velocity", "without sensor", "real", "m/s"),
        ("true_lateral_acceleration", "without sensor", "real", "m/s2"),
        ("true_roll", "without sensor", "real", "rad"),
        ("true_road_wheel_angle", "without sensor", "real", "rad"),
        ("received_demand", "demand of GUARD_OUT that the brakes obey", "real", "bar"),
    ]
    reports = [
        ("reported_verdict", "verdict of GUARD_OUT", "verdict"),
        ("reported_supervision", "supervision of GUARD_OUT; off while none comes", "supervision"),
        ("reported_engagement", "engagement of GUARD_OUT", "engagement"),
    ]
    text = "scenario file (TOML): how the truck is driven, what is asked of it, and what breaks"
    return [
        *(replace(v, causality="input", start=0.0) for v in numbered(0, inputs)),
        time_variable(),
        *numbered(100, outputs),
        *numbered(200, reports),
        Variable("scenario", text, 300, "parameter", "string", start=scenario),
        *terminal_variables(period_s, after_reception=False),
    ]


def received_messages(catalogue: Catalogue) -> list[Message]:
    """Return the messages of signals that the ECU receives, in the catalogue's order."""
    return [
        m for m in catalogue.messages if m.codec == "generated" and m.source_address != catalogue.own_address
    ]


def start_of(signal: BusSignal) -> float:
    """Return the start value of a bus signal: 0, or the nearest that the bus can carry."""
    return min(max(0.0, signal.physical_min), signal.physical_max)


def plain_inputs(messages: Sequence[Message]) -> list[Variable]:
    """Return the signals of messages as inputs with references from 0."""
    signals = [(message, signal) for message in messages for signal in message.signals]
    return [
        Variable(
            f"{message.name}.{signal.name}",
            f"signal of {message.name}, positive: {signal.positive}; acts without the terminal",
            k,
            "input",
            "real",
            signal.unit or "1",
            start_of(signal),
            signal.physical_min,
            signal.physical_max,
        )
        for k, (message, signal) in enumerate(signals)
    ]


def own_inputs(project: Project) -> list[Variable]:
    """Return what the ECU of a vehicle on its own bus receives: speed, outputs, and the command's signals.

    The inputs have references from 0.
    """
    signals = [project.speed, *project.outputs]
    controlled, n, said = project.outputs[project.controlled], len(signals), "; acts without the terminal"
    command = f"command of {controlled.name}, positive: {controlled.positive}"
    ends = (controlled.min, controlled.max)
    plain = [
        *(_input(signal, k) for k, signal in enumerate(signals)),
        Variable("GUARD_IN.reference", command, n, "input", "real", controlled.unit, 0.0, *ends),
        Variable("GUARD_IN.control_request", REQUESTS, n + 1, "input", start=0.0, low=0.0, high=2.0),
        Variable("GUARD_IN.other_priority", PRIORITIES, n + 2, "input", start=0.0, low=0.0, high=3.0),
    ]
    return [replace(v, description=v.description + said) for v in plain]


def terminal_variables(period_s: float, *, after_reception: bool) -> list[Variable]:
    """Return the four variables of a CAN terminal (FMI-LS-BUS).

    With ``after_reception``, the unit answers at the instant at which it receives.
    """
    return [
        Variable("CAN.Rx_Data", "received operations", 400, "input", "binary", start="", clock=401),
        Variable("CAN.Rx_Clock", "operations arrive", 401, "input", "clock"),
        Variable(
            "CAN.Tx_Data",
            "sent operations",
            402,
            "output",
            "binary",
            clock=403,
            dependencies=(400,) if after_reception else (),
        ),
        Variable("CAN.Tx_Clock", "the unit sends", 403, "input", "clock", interval_s=period_s),
    ]


def _input(signal: Signal, reference: int) -> Variable:
    """Return an input of the signal table; it starts at the number of its range that is nearest to 0."""
    start = min(max(0.0, signal.min), signal.max)
    text = f"{signal.role}, positive: {signal.positive}"
    return Variable(signal.name, text, reference, "input", "real", signal.unit, start, signal.min, signal.max)
