"""What is read from certificates, the same on the console, on the page and in benchmarks."""

from __future__ import annotations


def claim_words(claim: str, level: float, rate: float) -> str:
    """Claim and rate [m/s²], and the level that A_t and A_u are divided by where it is not 1."""
    weighed = "" if level == 1 else f", A_t and A_u over {level:.3g},"
    return f"robust {claim}{weighed} for |dv/dt| up to {rate:.3g} m/s²"


def worst_frozen(certificates: dict) -> dict:
    """The row of a controller.json's certificates with the largest proved mu at a frozen speed, on the grid
    or off it."""
    return max((*certificates["speeds"], certificates["off_grid"]), key=lambda row: row["mu_upper"])
