"""Words and rows from certificates, shared by the console, the page and the benchmarks."""


def claim_words(claim: str, level: float, rate: float) -> str:
    """Return a claim with its rate, and its level where it is not 1.

    Parameters
    ----------
    claim : str
    level : float, divides A_t and A_u
    rate : float, m/s²

    Returns
    -------
    str
    """
    weighed = "" if level == 1 else f", A_t and A_u over {level:.3g},"
    return f"robust {claim}{weighed} for |dv/dt| up to {rate:.3g} m/s²"


def worst_frozen(certificates: dict) -> dict:
    """Return the certificate row with the largest proved mu at a frozen speed.

    Parameters
    ----------
    certificates : dict, of a controller.json

    Returns
    -------
    dict, a row of the grid or between its speeds
    """
    return max((*certificates["speeds"], certificates["off_grid"]), key=lambda row: row["mu_upper"])
