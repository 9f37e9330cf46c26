"""Kinds ``hinf``, ``mu`` and ``mu_interval`` of the problem interface.

Fields are as in lpvguard/extras/problems/solve.py: complex numbers are [re, im], matrices row-major nested
lists. An impossible problem raises InputError (what, where, expected), which becomes an error answer.
"""

import numpy as np

from lpvguard.base.errors import InputError
from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.hinf import hinf_synthesis, moved_by_digits, proved_lower_bound
from lpvguard.engine.synthesis.mu import MuBounds, mu_bounds, mu_interval
from lpvguard.engine.synthesis.statespace import StateSpace

RESOLVED = 1.01
"""Largest ratio of achieved to proved level in a resolved H∞ answer."""
ZERO = 1e-9
"""An achieved level below this share of the plant's gain counts as zero."""
UNDETERMINED = 5e-4
"""If rounding of the data changes the optimum by more than this share, there is an error instead of an
unresolved answer. The bounds then cannot be within 1 %."""
DIGITS = "the optimum depends on the last digits of the data"


def solve_hinf(problem: dict) -> dict:
    """Answer kind ``hinf``: the H∞ controller of a plant, its certified level and a proved lower bound.

    The fields are A, B, C, D, n_control, n_measurement, dt (default 0).

    Returns
    -------
    dict
        ``gamma_achieved``: proved norm of the closed loop with the ``controller``. ``gamma_lower``: proved
        lower bound of the level of every controller. ``gamma``: optimum by the Riccati equations, between the
        two. ``resolved``: the two differ by at most 1 %. ``note``: what is singular or not proved.

    Raises
    ------
    SynthesisError
        If a field makes an answer impossible, or if the optimum depends on the last digits of the data. The
        error names the field.
    """
    name = str(problem.get("id", "hinf"))
    plant = _system(problem, name)
    counts = _count(problem, "n_control", name), _count(problem, "n_measurement", name)
    try:
        result = hinf_synthesis(plant, *counts, thorough=True)
        lower = proved_lower_bound(plant, *counts, result.gamma)
    except (np.linalg.LinAlgError, ArithmeticError) as exc:
        raise SynthesisError(
            name, "arithmetic", str(exc), "a plant whose signals are scaled to order one"
        ) from exc
    proved, achieved = lower.value, result.gamma_achieved
    if proved > achieved:
        raise SynthesisError(
            name,
            "gamma_achieved",
            f"not proved: the closed loop's norm of {achieved:.6g} lies below {proved:.6g}, "
            "the lower bound for every controller",
            "a plant whose signals are scaled to order one",
        )
    proved = min(proved, result.certificate.lower)
    resolved = achieved <= max(RESOLVED * proved, ZERO * lower.size)
    if not resolved:
        share, moved = moved_by_digits(plant, *counts)
        if moved > UNDETERMINED:
            raise SynthesisError(
                name,
                "A, B, C, D",
                f"{DIGITS}: a relative change of {share:g} of the entries moves it by {moved:.2g} of itself; "
                f"known is {proved:.6g} <= optimum <= {achieved:.6g}",
                "data in coordinates whose digits determine it: balanced or modal states",
            )
    notes = list(result.notes)
    if not resolved:
        notes.append(f"not proved: the optimum lies between {proved:.6g} and {achieved:.6g}")
    K = result.controller
    return {
        "gamma": float(np.clip(result.gamma, proved, achieved)),
        "gamma_lower": proved,
        "gamma_achieved": achieved,
        "resolved": resolved,
        "controller": {
            "A": K.A.tolist(),
            "B": K.B.tolist(),
            "C": K.C.tolist(),
            "D": K.D.tolist(),
            "dt": K.dt,
        },
        "norm_lower": result.certificate.lower,
        "peak_frequency": _finite(result.certificate.peak_frequency),
        "regularisation": result.regularisation,
        "note": "; ".join(notes),
    }


def solve_mu(problem: dict) -> dict:
    """Answer kind ``mu``: upper and lower bound of μ for the fields M and blocks.

    Returns
    -------
    dict
        ``mu_upper`` (proved), ``mu_lower``, and ``delta``, which makes I − M' Δ singular at size 1/mu_lower
        for an M' within 1e-11 of each entry of M. With real blocks μ jumps, so μ of M itself may be less.
        ``gap`` is mu_upper/mu_lower − 1; ``resolved`` tells whether it is at most 1 %. ``delta`` and ``gap``
        are null for mu_lower = 0.

    Raises
    ------
    SynthesisError
        If there is no answer. The error names the field.
    """
    name = str(problem.get("id", "mu"))
    return _bounds(mu_bounds(_complex_matrix(problem, "M", name), _blocks(problem, name)))


def solve_mu_interval(problem: dict) -> dict:
    """Answer kind ``mu_interval``: upper and lower bound of μ between ``low`` and ``high`` [rad/s].

    The fields are A, B, C, D, dt (default 0), blocks, low (default 0), high (default or null: infinite, of a
    discrete system pi / dt).

    Returns
    -------
    dict
        As from ``solve_mu``, with two more keys. ``omega`` [rad/s] is the frequency of ``mu_lower`` (null:
        infinite). ``cells`` is the number of boxes and intervals in the proof of ``mu_upper``.

    Raises
    ------
    SynthesisError
        If there is no answer. The error names the field.
    """
    name = str(problem.get("id", "mu_interval"))
    loop, blocks = _system(problem, name), _blocks(problem, name)
    last = np.pi / loop.dt if loop.dt else np.inf
    high = last if problem.get("high") is None else _number(problem, "high", name, last)
    bounds = mu_interval(loop, blocks, _number(problem, "low", name, 0.0), high)
    return _bounds(bounds) | {"omega": _finite(bounds.omega), "cells": len(bounds.proof)}


def _bounds(bounds: MuBounds) -> dict:
    """Fields of an answer that both kinds of μ have."""
    delta = bounds.delta
    return {
        "mu_upper": bounds.upper,
        "mu_lower": bounds.lower,
        "gap": _finite(bounds.gap),
        "resolved": bounds.resolved,
        "delta": None if delta is None else np.stack([delta.real, delta.imag], axis=-1).tolist(),
    }


def _system(problem: dict, name: str) -> StateSpace:
    D = _matrix(problem, "D", name)
    n = len(problem["A"]) if isinstance(problem.get("A"), list) else 0
    A, B, C = (
        _matrix(problem, key, name, shape)
        for key, shape in (("A", (n, n)), ("B", (n, D.shape[1])), ("C", (D.shape[0], n)))
    )
    return StateSpace(A, B, C, D, _number(problem, "dt", name, 0.0))


def _blocks(problem: dict, name: str) -> list[Block]:
    listed = problem.get("blocks")
    if not isinstance(listed, list) or not listed:
        raise SynthesisError(name, "blocks", "missing or empty", "a list of {type, rows, cols}")
    blocks = []
    for k, b in enumerate(listed):
        if not isinstance(b, dict):
            raise SynthesisError(name, f"blocks[{k}]", repr(b), "{type, rows, cols}")
        where = f"{name}: blocks[{k}]"
        rows_of_M, cols_of_M = _count(b, "rows", where), _count(b, "cols", where)
        try:
            # The interface states the part of M; Block describes Delta_i.
            blocks.append(Block(b.get("type", "full"), cols_of_M, rows_of_M))
        except InputError as error:
            what = error.what if error.where == "type" else f"{rows_of_M} x {cols_of_M}"
            raise SynthesisError(where, error.where, what, error.expected) from None
    return blocks


def _numbers(problem: dict, key: str, name: str, expected: str, lists: str) -> np.ndarray:
    try:
        return np.asarray(problem[key], dtype=float)
    except KeyError:
        raise SynthesisError(name, key, "missing", expected) from None
    except (TypeError, ValueError):
        raise SynthesisError(name, key, "not a matrix of numbers", lists) from None


def _matrix(problem: dict, key: str, name: str, shape: tuple[int, int] | None = None) -> np.ndarray:
    value = _numbers(problem, key, name, "a matrix as nested lists", "nested lists of equal length")
    if shape is not None and value.size == 0 and 0 in shape:
        return value.reshape(shape)
    if value.ndim != 2:
        raise SynthesisError(name, key, f"{value.ndim} dimensions", "a matrix as nested lists")
    return value


def _complex_matrix(problem: dict, key: str, name: str) -> np.ndarray:
    value = _numbers(problem, key, name, "a matrix of [re, im]", "nested lists of [re, im]")
    if value.ndim == 2:
        return value.astype(complex)
    if value.ndim != 3 or value.shape[2] != 2:
        raise SynthesisError(name, key, f"shape {value.shape}", "rows of [re, im]")
    return value[..., 0] + 1j * value[..., 1]


def _number(problem: dict, key: str, name: str, default: float) -> float:
    value = problem.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise SynthesisError(name, key, repr(value), "a number")
    return float(value)


def _count(problem: dict, key: str, name: str) -> int:
    value = problem.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or value != int(value) or value < 1:
        raise SynthesisError(name, key, repr(value), "a whole number of at least 1")
    return int(value)


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
