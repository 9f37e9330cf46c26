"""Words for what is proved of a moving speed, the same on the console and on the page."""

from __future__ import annotations


def claim_words(claim: str, level: float, rate: float) -> str:
    """Claim and rate [m/s²], and the level that A_t and A_u are divided by where it is not 1."""
    weighed = "" if level == 1 else f", A_t and A_u over {level:.3g},"
    return f"robust {claim}{weighed} for |dv/dt| up to {rate:.3g} m/s²"
