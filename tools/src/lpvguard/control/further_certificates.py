"""Certificates of a design besides mu and the moving speed: margins, a varying Delta, and demand limits."""

from dataclasses import dataclass
from pathlib import Path

from ..base.parallel import Map
from ..base.progress import Progress, parts
from ..core.scheduled import Scheduled
from ..engine.synthesis.dk import Scaling
from .limits import Limits, limits, require_limits
from .plants import DesignProblem
from .robustness import Robustness, require_robustness, robustness
from .slow_delta import Slowness, require_slowness, slowness

SHARES = (3, 1, 1)
"""Approximate shares of the work."""


@dataclass(frozen=True)
class FurtherCertificates:
    """Further certificates; ``slow_delta`` is None for a design without Delta."""

    robustness: Robustness
    slow_delta: Slowness | None
    limits: Limits

    def to_dict(self) -> dict:
        """Fields of controller.json's certificates."""
        return {
            "robustness": self.robustness.to_dict(),
            "slow_delta": None if self.slow_delta is None else self.slow_delta.to_dict(),
            "limits": self.limits.to_dict(),
        }


NOTHING = {"robustness": None, "slow_delta": None, "limits": None}
"""The same fields for a design without further certificates."""


def further_certificates(
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> FurtherCertificates:
    """Compute the further certificates of one controller; ``workers`` share the speeds."""
    tells = parts(progress, *SHARES)
    design = problem, schedule, scaling
    return FurtherCertificates(
        robustness(*design, tells[0], workers),
        slowness(*design, tells[1], workers),
        limits(*design, tells[2], workers),
    )


def require_further_certificates(
    path: Path,
    stated: dict,
    problem: DesignProblem,
    schedule: Scheduled,
    scaling: Scaling,
    progress: Progress = lambda _: None,
    workers: Map = map,
) -> None:
    """Raise InputError unless a new proof confirms the certificates ``stated`` in ``path``.

    A field that is missing or None claims nothing. ``workers`` share the speeds.
    """
    tells = parts(progress, *SHARES)
    design = problem, schedule, scaling
    require_robustness(path, stated.get("robustness"), *design, tells[0], workers)
    require_slowness(path, stated.get("slow_delta"), *design, tells[1], workers)
    require_limits(path, stated.get("limits"), *design, tells[2], workers)
