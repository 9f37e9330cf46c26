"""Rates with exact 95 % intervals: of drives, recordings or runs, and an hour of driving.

No interval is of zero width, whether none alarmed or all. What is counted must be independent: recordings or
runs that alarm, not their alarms, for alarms of one recording come together.
"""

from __future__ import annotations

from typing import Any

from scipy.special import betaincinv, gammaincinv


def rate(count: int, of: int) -> dict[str, Any]:
    """The share ``count`` of ``of`` with its interval by Clopper and Pearson; None where there is nothing."""
    low = float(betaincinv(count, of - count + 1, 0.025)) if count else 0.0
    high = float(betaincinv(count + 1, of - count, 0.975)) if count < of else 1.0
    return {"count": count, "of": of, "interval": [low, high] if of else None}


def per_hour(count: int, hours: float) -> dict[str, Any]:
    """Events an hour with their interval (Poisson, by Garwood); None where there is no driving."""
    low = float(gammaincinv(count, 0.025)) if count else 0.0
    high = float(gammaincinv(count + 1, 0.975))
    return {
        "rate": count / hours if hours else None,
        "interval": [low / hours, high / hours] if hours else None,
    }


def share_words(found: dict[str, Any]) -> str:
    """What `rate` gave, for terminal and page: the count of all and its interval [%]; a dash for nothing."""
    if not found["of"]:
        return "–"
    low, high = found["interval"]
    return f"{found['count']} of {found['of']}, {100 * low:.2f} to {100 * high:.2f} %"


def hourly_words(found: dict[str, Any]) -> str:
    """What `per_hour` gave, for terminal and page: rate [1/h] and interval; a dash for no driving."""
    if found["interval"] is None:
        return "–"
    return f"{found['rate']:.2f}, {found['interval'][0]:.2f} to {found['interval'][1]:.2f}"
