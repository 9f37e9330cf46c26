"""Unknowns of a fit: the fitted numbers of a project file with their ranges, and the project with new
values."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..base.errors import InputError
from ..vehicle.nominal import NominalModel, SpeedTable, tabulate
from ..vehicle.project import Project

DELAY = "input_delay_s"
REACH = 5.0
"""Default range of a parameter: its value over REACH to its value times REACH."""
LONGEST_DELAY_S = 1.0
"""Largest delay of the default range; a vehicle has no longer one."""
AT_END = 2e-3
"""Distance from an end, as a share of the range, below which an unknown is at its end."""
SEARCH_CELLS = 24
"""Cells of the speed table of tried models."""


class TriedModel(NominalModel):
    """Nominal model for frequent construction: SEARCH_CELLS cells over speed, and quick exponentials."""

    @cached_property
    def table(self) -> SpeedTable:
        """Entries over speed."""
        return tabulate(self.discrete_entries, *self.speed_range, SEARCH_CELLS)

    @staticmethod
    def exponential(a: np.ndarray) -> np.ndarray:
        """Matrix exponentials of a (m, n, n), in the same shape, by scaled Taylor series to 1e-12."""
        norm = float(np.abs(a).sum(axis=2).max(initial=0.0))
        squarings = max(0, int(np.ceil(np.log2(max(norm, 1e-300) / 0.25))))
        scaled = a / 2.0**squarings
        result = term = np.broadcast_to(np.eye(a.shape[1]), a.shape)
        for k in range(1, 10):
            term = term @ scaled / k
            result = result + term
        for _ in range(squarings):
            result = result @ result
        return result


@dataclass(frozen=True)
class Unknowns:
    """The p unknowns of a project: names, and start, low, high, step (p,) in the project file's units.

    ``step`` is half the difference of derivatives.
    """

    base: Project
    names: tuple[str, ...]
    start: np.ndarray
    low: np.ndarray
    high: np.ndarray
    step: np.ndarray

    @classmethod
    def from_project(cls, project: Project) -> Unknowns:
        """Unknowns that the project's [fit] names. InputError where a range is missing or excludes its
        value."""
        rows = [*_parameters(project), *_delay(project), *_offsets(project)]
        if not rows:
            raise InputError(
                f"vehicle {project.name}", "model", "nothing to fit", "model.parameters, a delay or offsets"
            )
        names, *columns = zip(*rows, strict=True)
        return cls(project, tuple(names), *(np.array(column, float) for column in columns))

    def project(self, theta: np.ndarray) -> Project:
        """The project with these values (p,) of its unknowns."""
        values = dict(zip(self.names, (float(x) for x in theta), strict=True))
        model = self.base.model
        update: dict[str, object] = {
            "parameters": {name: values.get(name, old) for name, old in model.parameters.items()}
        }
        if DELAY in values:
            update[DELAY] = values[DELAY]
        for key in ("input_offset", "output_offset"):
            old = getattr(model, key)
            if old is not None:
                update[key] = [values.get(f"{key}[{i}]", x) for i, x in enumerate(old)]
        return self.base.model_copy(update={"model": model.model_copy(update=update)})

    def model(self, theta: np.ndarray) -> NominalModel:
        """The nominal model with these values (p,) of the unknowns."""
        return TriedModel(self.project(theta))

    def inside(self, theta: np.ndarray) -> np.ndarray:
        """Theta (p,) a little inside the ranges, where a search may begin."""
        span = self.high - self.low
        inset = np.where(np.isfinite(span), 1e-6 * np.where(np.isfinite(span), span, 1.0), 0.0)
        return np.clip(theta, self.low + inset, self.high - inset)

    def at_end(self, theta: np.ndarray) -> list[str]:
        """Names of the unknowns at an end of their range, except a delay of 0; ``theta`` (p,)."""
        width = np.where(np.isfinite(self.high - self.low), self.high - self.low, np.inf)
        near = np.minimum(theta - self.low, self.high - theta) < AT_END * width
        return [
            name
            for name, end, value in zip(self.names, near & np.isfinite(width), theta, strict=True)
            if end and not (name == DELAY and value < AT_END * self.base.Ts_s)
        ]


Row = tuple[str, float, float, float, float]
"""Name, start, low, high, step."""


def _parameters(project: Project) -> list[Row]:
    ranges = project.fit.parameters
    rows = []
    for name, value in project.model.parameters.items():
        if ranges is not None and name not in ranges:
            continue
        if ranges is None and value == 0:
            raise InputError(
                f"vehicle {project.name}",
                f"model.parameters.{name}",
                "0 gives no scale for its range",
                f"a range for it: fit.parameters.{name} = [low, high]",
            )
        low, high = ranges[name] if ranges is not None else sorted((value / REACH, value * REACH))
        if not low <= value <= high:
            raise InputError(
                f"vehicle {project.name}",
                f"fit.parameters.{name}",
                f"{low:g} to {high:g} does not contain the value {value:g}",
                "a range around model.parameters",
            )
        rows.append((name, value, low, high, 1e-3 * max(abs(value), 0.01 * (high - low))))
    return rows


def _delay(project: Project) -> list[Row]:
    value, Ts = project.model.input_delay_s, project.Ts_s
    low, high = project.fit.input_delay_s or [0.0, max(10 * Ts, min(3 * value, LONGEST_DELAY_S))]
    if low == high:
        return []
    # A quarter of a sample: the output is not smooth in the delay where a sample of the input ends.
    return [(DELAY, min(max(value, low), high), low, high, 0.25 * Ts)]


def _offsets(project: Project) -> list[Row]:
    model, rows = project.model, []
    for key, signals in (("input_offset", project.inputs), ("output_offset", project.outputs)):
        if key == "input_offset" and project.fit.trim == "drive":
            continue
        for i, value in enumerate(getattr(model, key) or []):
            # The model is affine in an offset: any step of the signal's size will do.
            rows.append((f"{key}[{i}]", value, -np.inf, np.inf, 1e-3 * (signals[i].max - signals[i].min)))
    return rows
