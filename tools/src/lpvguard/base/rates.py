"""Rates with exact 95 % intervals: shares of drives, recordings or runs, and events per hour of driving.

No interval has zero width, not even at 0 % or 100 %. The counted things must be independent. Therefore count
the recordings that alarm: the alarms of one recording depend on each other.
"""

from typing import Any

from scipy.special import betaincinv, gammaincinv


def rate(count: int, total: int) -> dict[str, Any]:
    """Return the share ``count`` of ``total`` with its interval by Clopper and Pearson.

    Parameters
    ----------
    count, total : int

    Returns
    -------
    dict, with None where ``total`` is 0
    """
    low = float(betaincinv(count, total - count + 1, 0.025)) if count else 0.0
    high = float(betaincinv(count + 1, total - count, 0.975)) if count < total else 1.0
    return {"count": count, "of": total, "interval": [low, high] if total else None}


def per_hour(count: int, hours: float) -> dict[str, Any]:
    """Return events per hour with their Poisson interval by Garwood.

    Parameters
    ----------
    count : int
    hours : float, hours of driving

    Returns
    -------
    dict, with None where ``hours`` is 0
    """
    low = float(gammaincinv(count, 0.025)) if count else 0.0
    high = float(gammaincinv(count + 1, 0.975))
    return {
        "rate": count / hours if hours else None,
        "interval": [low / hours, high / hours] if hours else None,
    }


def share_words(share: dict[str, Any]) -> str:
    """Word a `rate` for terminal and page: count, total and interval [%], or a dash.

    Parameters
    ----------
    share : dict[str, Any], of `rate`

    Returns
    -------
    str
    """
    if not share["of"]:
        return "–"
    low, high = share["interval"]
    return f"{share['count']} of {share['of']}, {100 * low:.2f} to {100 * high:.2f} %"


def hourly_words(hourly: dict[str, Any]) -> str:
    """Word a `per_hour` for terminal and page: rate and interval [1/h], or a dash.

    Parameters
    ----------
    hourly : dict[str, Any], of `per_hour`

    Returns
    -------
    str
    """
    if hourly["interval"] is None:
        return "–"
    return f"{hourly['rate']:.2f}, {hourly['interval'][0]:.2f} to {hourly['interval'][1]:.2f}"


def number_words(value: float) -> str:
    """Word a number with three digits, without an exponent from 1 on.

    Parameters
    ----------
    value : float

    Returns
    -------
    str
    """
    return f"{float(f'{value:.3g}'):.0f}" if 1000 <= value < 1e9 else f"{value:.3g}"


def recordings_for(alpha: float) -> int:
    """Return the fewest calibrating recordings that allow a share of false alarms.

    Parameters
    ----------
    alpha : float

    Returns
    -------
    int
    """
    return round(1 / alpha) - 1
