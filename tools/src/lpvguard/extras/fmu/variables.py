"""Variables of the monitor's FMU: names, units and ranges of the signal table, and the core's results."""

from dataclasses import dataclass

from ...core.compiled import CAUSES, REASONS, STATUSES, VERDICTS
from ...vehicle.project import Project, Signal

ENUMERATIONS = {"verdict": VERDICTS, "reason": REASONS, "status": STATUSES, "cause": CAUSES}
"""Names of the core's enumerations, in the order of their numbers from 0."""


@dataclass(frozen=True)
class Variable:
    """One variable of the FMU.

    Attributes
    ----------
    name, description : str
    reference : int, value reference, as in monitor.cpp
    causality : str, input, output or independent (time)
    kind : str, real, integer, or a key of ``ENUMERATIONS``
    unit : str, unit of a real; "1" without one
    start : float or None, start value of an input, and of an output that never changes
    low, high : float or None, physical range
    """

    name: str
    description: str
    reference: int
    causality: str
    kind: str = "real"
    unit: str = "1"
    start: float | None = None
    low: float | None = None
    high: float | None = None

    @property
    def constant(self) -> bool:
        """Whether the value never changes."""
        return self.causality == "output" and self.start is not None


def monitor_variables(project: Project, thresholds: dict[str, float]) -> list[Variable]:
    """Return the variables of a vehicle's monitor.

    Parameters
    ----------
    project : Project
    thresholds : dict, ``threshold``, ``energy_threshold`` and ``change_threshold`` of the coefficients

    Returns
    -------
    list of Variable
    """
    signals = [project.speed, *project.inputs, *project.outputs]
    results = [
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
        ("verdict", "verdict", "verdict of the monitor"),
        ("reason", "reason", "why the newest frame is no evidence"),
        ("status", "status", "status of the newest sample"),
        ("cause", "cause", "cause of the newest alarm"),
        ("frames", "integer", "number of judged frames"),
        ("bin", "integer", "bin of the newest frame, 0 is DC"),
        ("cause_output", "integer", "output of the cause, from 0"),
    ]
    return [
        *(_input(signal, k) for k, signal in enumerate(signals)),
        Variable("time", "time of the newest sample", 99, "independent", unit="s"),
        *(Variable(name, text, 100 + k, "output") for k, (name, text) in enumerate(results)),
        *(
            Variable(
                name, f"calibrated {name.replace('_', ' ')}", 100 + len(results) + k, "output", start=value
            )
            for k, (name, value) in enumerate(thresholds.items())
        ),
        *(Variable(name, text, 200 + k, "output", kind) for k, (name, kind, text) in enumerate(integers)),
    ]


def _input(signal: Signal, reference: int) -> Variable:
    """Return an input of the signal table; it starts at the number of its range that is nearest to 0."""
    start = min(max(0.0, signal.min), signal.max)
    text = f"{signal.role}, positive: {signal.positive}"
    return Variable(signal.name, text, reference, "input", "real", signal.unit, start, signal.min, signal.max)
