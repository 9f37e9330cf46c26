"""Fig. 1: generalised plant of the yaw-rate tracking problem, with any of the three uncertainty structures.

The nominal vehicle takes u (brake pressure difference, bar) to r (yaw rate, rad/s) and δ (road-wheel angle,
rad):

    ũ = u + W_Δi ξ_i            x' = A x + B ũ + W_Δs ξ_s         [r; δ] = C x
    r_m = r + W_wr w_r          δ_m = δ + W_wδ w_δ                (disturbances)
    e_t = W_R W_C r_c − r_m     z = [W_t e_t; W_u u]              (performance)
    y = [W_C r_c, r_m + W_nr n_r, δ_m + W_nδ n_δ]                 (controller input)

Inputs are [Δ outputs, w_r, w_δ, n_r, n_δ, r_c, u], outputs [Δ inputs, z_t, z_u, y_c, y_r, y_δ], with
η_i = u and η_s = x where present. W_u weights u, not ũ. Every external signal is normalised.

K_o has one Δ an output in place of Δ_i, as class S1_diagonal of the identification (THEORY 4.1):

    r_m = r + W_Δr ξ_r + W_wr w_r,  η_r = r            δ_m = δ + W_Δδ ξ_δ + W_wδ w_δ,  η_δ = δ
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.statespace import StateSpace, append, balanced, to_discrete, zero_order_hold

STRUCTURES = ("K_inf", "K_i", "K_is")
"""The paper's uncertainty structures: none, input-multiplicative, input-multiplicative and state."""
OUTPUTWISE = "K_o"
"""One Δ an output, output-multiplicative."""
Terms = dict[str | tuple[str, int], int]
"""A sum: sign of each external input, by name, and of each part's output, as (part, output)."""


@dataclass(frozen=True)
class PlantWeights:
    """The ten weights of Fig. 1 as single-input single-output continuous systems, s in rad/s.

    Attributes
    ----------
    W_R, W_C, W_t, W_u, W_nr, W_ndelta, W_wr, W_wdelta, W_delta_i, W_delta_s : StateSpace
    W_delta_r, W_delta_delta : StateSpace or None, for K_o only
    """

    W_R: StateSpace
    W_C: StateSpace
    W_t: StateSpace
    W_u: StateSpace
    W_nr: StateSpace
    W_ndelta: StateSpace
    W_wr: StateSpace
    W_wdelta: StateSpace
    W_delta_i: StateSpace
    W_delta_s: StateSpace
    W_delta_r: StateSpace | None = None
    W_delta_delta: StateSpace | None = None

    def __post_init__(self):
        for f in fields(self):
            W = getattr(self, f.name)
            if W is not None and (W.D.shape != (1, 1) or W.dt != 0):
                raise SynthesisError(
                    "interconnection",
                    f.name,
                    f"{W.D.shape} system with dt {W.dt:g}",
                    "a continuous system with one input and one output",
                )


@dataclass(frozen=True)
class GeneralisedPlant:
    """A generalised plant with its signals.

    Attributes
    ----------
    system : StateSpace, with named signals
    blocks : tuple of Block, of Δ
    n_delta_out, n_delta_in : int, outputs and inputs of Δ
    n_control, n_measurement : int
    """

    system: StateSpace
    blocks: tuple[Block, ...]
    n_delta_out: int
    n_delta_in: int
    n_control: int
    n_measurement: int

    @property
    def performance_block(self) -> Block:
        """The fictitious full block from z to [w; n; r_c] that turns robust performance into a μ test."""
        n_w = self.system.n_inputs - self.n_delta_out - self.n_control
        n_z = self.system.n_outputs - self.n_delta_in - self.n_measurement
        return Block("full", n_w, n_z)


def rational(num, den) -> StateSpace:
    """Realise num(s)/den(s), proper, by a balanced companion form.

    Parameters
    ----------
    num, den : array_like, coefficients in descending powers of s [rad/s]

    Returns
    -------
    StateSpace

    Raises
    ------
    SynthesisError
        If it is improper or not finite.
    """
    num, den = (np.trim_zeros(np.atleast_1d(np.asarray(c, dtype=float)), "f") for c in (num, den))
    if den.size == 0 or num.size > den.size:
        raise SynthesisError(
            "weight",
            "num, den",
            f"degrees {num.size - 1} and {den.size - 1}",
            "a proper transfer function with a denominator that is not zero",
        )
    num = np.concatenate([np.zeros(den.size - num.size), num]) / den[0]
    den = den / den[0]
    n = den.size - 1
    A = np.eye(n, k=1)
    if n:
        A[-1] = -den[:0:-1]
    B = np.zeros((n, 1))
    B[-1:] = 1
    C = (num[1:] - num[0] * den[1:])[::-1][None]
    return balanced(StateSpace(A, B, C, num[:1, None]))


def zeros_poles(gain: float, zeros, poles) -> StateSpace:
    """Realise gain · Π(s/zero + 1) / Π(s/pole + 1) as a cascade of sections.

    Parameters
    ----------
    gain : float
    zeros, poles : array_like, rad/s, real

    Returns
    -------
    StateSpace

    Raises
    ------
    SynthesisError
        If it is improper, or a zero or pole is 0.
    """
    zeros, poles = sorted(float(z) for z in zeros), sorted(float(p) for p in poles)
    if len(zeros) > len(poles) or any(v == 0 or not np.isfinite(v) for v in (*zeros, *poles)):
        raise SynthesisError(
            "weight", "zeros, poles", f"{zeros} and {poles}", "no more zeros than poles, none at 0"
        )
    A, B, C, D = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.array([[float(gain)]])
    for k, p in enumerate(poles):
        z = zeros[k - len(poles)] if k >= len(poles) - len(zeros) else None
        d = 0.0 if z is None else p / z
        b = p * (1 - d)  # (s/z + 1)/(s/p + 1) = d + p (1 − d)/(s + p)
        n = len(A)
        A = np.block([[A, np.zeros((n, 1))], [b * C, np.array([[-p]])]])
        B = np.vstack([B, b * D])
        C = np.hstack([d * C, [[1.0]]])
        D = d * D
    return StateSpace(A, B, C, D)


def weight_from_table(entry: dict, **gains: float) -> StateSpace:
    """Realise a weight of a case file: {num, den} or {gain, zeros, poles}.

    Parameters
    ----------
    entry : dict
    **gains : float, values of gains that are given as a name

    Returns
    -------
    StateSpace
    """
    if "num" in entry:
        return rational(entry["num"], entry["den"])
    gain = entry["gain"]
    return zeros_poles(gains[gain] if isinstance(gain, str) else gain, entry["zeros"], entry["poles"])


def generalised_plant(
    A, B, weights: PlantWeights, structure: str, dt: float = 0.0, delay: int = 0, probes: bool = False
) -> GeneralisedPlant:
    """Build Fig. 1 around the vehicle x' = A x + B u, whose first two states are [r; δ].

    The plant's first n states are the vehicle's. In discrete time u and ξ_s are held (ξ_s enters through
    ∫exp(As)ds), and the weights are mapped by Tustin; signals then are sequences.

    Parameters
    ----------
    A : array_like (n, n), continuous
    B : array_like (n, 1), continuous
    weights : PlantWeights
    structure : str, K_inf, K_i, K_is or K_o
    dt : float, s, > 0: discrete time, default 0.0
    delay : int, samples from u to the vehicle, for computation and bus, default 0
        Δ_i and W_u read u at once.
    probes : bool, add outputs after z, default False
        They are the vehicle's state (n), input (1) and with state uncertainty input on every state (n).

    Returns
    -------
    GeneralisedPlant

    Raises
    ------
    SynthesisError
        If the structure is unknown, or a shape or a delay does not fit.

    References
    ----------
    Paper, Fig. 1.
    """
    if delay < 0 or (delay and not dt):
        raise SynthesisError(
            "interconnection", "delay", f"{delay} samples at dt {dt:g}", "a whole number ≥ 0, and dt > 0"
        )
    if structure not in (*STRUCTURES, OUTPUTWISE):
        raise SynthesisError(
            "interconnection", "structure", repr(structure), f"one of {', '.join((*STRUCTURES, OUTPUTWISE))}"
        )
    outputwise = structure == OUTPUTWISE
    if outputwise and (weights.W_delta_r is None or weights.W_delta_delta is None):
        raise SynthesisError("interconnection", "weights", "no W_delta_r, W_delta_delta", "both, for K_o")
    A, B, n = np.asarray(A, dtype=float), np.asarray(B, dtype=float), len(A)
    with_input, n_state = structure in ("K_i", "K_is"), n * (structure == "K_is")
    net = _Network(
        _parts(A, B, weights, structure, dt, delay),
        [
            *(["xi_i"] * with_input),
            *(f"xi_s{k}" for k in range(n_state)),
            *(["xi_r", "xi_delta"] * outputwise),
            *("w_r", "w_delta", "n_r", "n_delta", "r_c", "u"),
        ],
    )
    u_tilde: Terms = {("delay", 0) if delay else "u": 1}
    if with_input:
        u_tilde[("W_delta_i", 0)] = 1
    r_m: Terms = {("vehicle", 0): 1, ("W_wr", 0): 1}
    delta_m: Terms = {("vehicle", 1): 1, ("W_wdelta", 0): 1}
    if outputwise:
        r_m[("W_delta_r", 0)] = delta_m[("W_delta_delta", 0)] = 1
    _join(net, u_tilde, r_m, n_state)
    rows: dict[str, Terms] = {"eta_i": {"u": 1}} if with_input else {}
    rows |= {f"eta_s{k}": {("vehicle", 2 + k): 1} for k in range(n_state)}
    if outputwise:
        rows = {"eta_r": {("vehicle", 0): 1}, "eta_delta": {("vehicle", 1): 1}}
    rows |= {"z_t": {("W_t", 0): 1}, "z_u": {("W_u", 0): 1}}
    if probes:
        rows |= {f"x_{k}": {("vehicle", 2 + k): 1} for k in range(n)}
        rows["u_tilde"] = u_tilde
        rows |= {f"x_in{k}": {("W_delta_s", k): 1} for k in range(n_state)}
    rows |= {
        "y_c": {("W_C", 0): 1},
        "y_r": {**r_m, ("W_nr", 0): 1},
        "y_delta": {**delta_m, ("W_ndelta", 0): 1},
    }
    scalars = int(with_input) + 2 * outputwise
    blocks = (*[Block("full", 1, 1)] * scalars, *[Block("full", n, n)] * bool(n_state))
    return GeneralisedPlant(
        net.close(rows), blocks, sum(b.rows for b in blocks), sum(b.cols for b in blocks), 1, 3
    )


def _parts(
    A: np.ndarray, B: np.ndarray, weights: PlantWeights, structure: str, dt: float, delay: int
) -> dict[str, StateSpace]:
    """The systems of Fig. 1 by name, sampled where ``dt`` > 0. The vehicle goes from [ũ; an input on every
    state] to [r; δ; x]. W_delta_s acts on every state. The weights of Δ that the structure does not have are
    left out, as the delay is where it is 0."""
    n = len(A)
    channels = {
        "W_delta_i": int(structure in ("K_i", "K_is")),
        "W_delta_s": n if structure == "K_is" else 0,
        "W_delta_r": int(structure == OUTPUTWISE),
        "W_delta_delta": int(structure == OUTPUTWISE),
    }
    vehicle = StateSpace(
        A, np.hstack([B, np.eye(n)]), np.vstack([np.eye(2, n), np.eye(n)]), np.zeros((2 + n, 1 + n))
    )
    W = {f.name: getattr(weights, f.name) for f in fields(weights) if channels.get(f.name, True)}
    if dt:
        vehicle = zero_order_hold(vehicle, dt)
        W = {name: to_discrete(w, dt) for name, w in W.items()}
    parts = {"vehicle": vehicle, **W}
    parts |= {name: append(*[parts[name]] * count) for name, count in channels.items() if count}
    if delay:
        parts["delay"] = StateSpace(
            np.eye(delay, k=1), np.eye(delay)[:, -1:], np.eye(delay)[:1], np.zeros((1, 1)), dt
        )
    return parts


def _join(net: _Network, u_tilde: Terms, r_m: Terms, n_state: int) -> None:
    """The connections of Fig. 1 between its parts; ``u_tilde`` and ``r_m`` are ũ and r_m as sums."""
    if "delay" in net.first_in:
        net.feed("delay", 0, {"u": 1})
    if "W_delta_i" in net.first_in:
        net.feed("W_delta_i", 0, {"xi_i": 1})
    for name, source in (("W_delta_r", "xi_r"), ("W_delta_delta", "xi_delta")):
        if name in net.first_in:
            net.feed(name, 0, {source: 1})
    for k in range(n_state):
        net.feed("W_delta_s", k, {f"xi_s{k}": 1})
        net.feed("vehicle", 1 + k, {("W_delta_s", k): 1})
    net.feed("vehicle", 0, u_tilde)
    net.feed("W_wr", 0, {"w_r": 1})
    net.feed("W_wdelta", 0, {"w_delta": 1})
    net.feed("W_nr", 0, {"n_r": 1})
    net.feed("W_ndelta", 0, {"n_delta": 1})
    net.feed("W_C", 0, {"r_c": 1})
    net.feed("W_R", 0, {("W_C", 0): 1})
    net.feed("W_t", 0, {("W_R", 0): 1, **dict.fromkeys(r_m, -1)})
    net.feed("W_u", 0, {"u": 1})


class _Network:
    """Systems joined by sums of each other's outputs and of external signals."""

    def __init__(self, parts: dict[str, StateSpace], external: list[str]):
        """``parts`` by name, side by side; ``external``: names of the external inputs, in order."""
        self.joined = append(*parts.values())
        self.first_in: dict[str, int] = {}
        self.first_out: dict[str, int] = {}
        i, o = 0, 0
        for name, g in parts.items():
            self.first_in[name], self.first_out[name] = i, o
            i, o = i + g.n_inputs, o + g.n_outputs
        self.names = external
        self.inner, self.outer = np.zeros((i, o)), np.zeros((i, len(external)))

    def feed(self, name: str, port: int, terms: Terms) -> None:
        """Input ``port`` of part ``name`` is the sum of ``terms``."""
        inner, outer = self._row(terms)
        self.inner[self.first_in[name] + port], self.outer[self.first_in[name] + port] = inner, outer

    def _row(self, terms: Terms) -> tuple[np.ndarray, np.ndarray]:
        """Row of ``terms`` over the parts' outputs and over the external inputs."""
        inner, outer = np.zeros(self.joined.n_outputs), np.zeros(len(self.names))
        for key, sign in terms.items():
            if isinstance(key, str):
                outer[self.names.index(key)] = sign
            else:
                inner[self.first_out[key[0]] + key[1]] = sign
        return inner, outer

    def close(self, rows: dict[str, Terms]) -> StateSpace:
        """The system from the external inputs to the named ``rows``; Fig. 1 has no algebraic loop."""
        G = self.joined
        pick, direct = (np.array([self._row(t)[k] for t in rows.values()]) for k in (0, 1))
        # part inputs v = inner (C x + D v) + outer w
        loop = np.linalg.inv(np.eye(G.n_inputs) - self.inner @ G.D)
        v_x, v_w = loop @ self.inner @ G.C, loop @ self.outer
        return StateSpace(
            G.A + G.B @ v_x,
            G.B @ v_w,
            pick @ (G.C + G.D @ v_x),
            pick @ G.D @ v_w + direct,
            G.dt,
            tuple(self.names),
            tuple(rows),
        )
