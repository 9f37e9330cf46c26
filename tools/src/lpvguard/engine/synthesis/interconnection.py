"""Generalised plant of the tracking problem in Fig. 1, with one of four uncertainty structures.

The nominal vehicle has n_u inputs u and n_y outputs y. One output, the controlled one, follows a command. In
the paper u is a brake pressure difference [bar]. The outputs y are the yaw rate r [rad/s], which is
controlled, and the road-wheel angle δ [rad]:

    ũ = u + W_Δi ξ_i            x' = A x + B ũ + W_Δs ξ_s         y = C x
    y_m,j = y_j + W_w,j w_j                                        (disturbances)
    e_t = W_R W_C r_c − y_m,c   z = [W_t e_t; W_u u]              (performance, c: the controlled output)
    m = [W_C r_c, y_m,j + W_n,j n_j]                              (controller input)

Inputs are [Δ outputs, w, n, r_c, u]. Outputs are [Δ inputs, z_t, z_u, m], with η_i = u and η_s = x where
present. W_u weights each input of u, not of ũ. Every external signal is normalised. Δ_i and Δ_s are full
blocks.

K_o has one Δ for each output in place of Δ_i, like class S1_diagonal of the identification (THEORY 4.1):

    y_m,j = y_j + W_Δo,j ξ_j + W_w,j w_j,  η_j = y_j
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.statespace import StateSpace, append, balanced, to_discrete, zero_order_hold

STRUCTURES = ("K_inf", "K_i", "K_is")
"""The paper's uncertainty structures: none, input-multiplicative, input-multiplicative and state."""
OUTPUTWISE = "K_o"
"""Uncertainty structure with one output-multiplicative Δ for each output."""
PAPER_WEIGHTS = (
    *("W_R", "W_C", "W_t", "W_u", "W_nr", "W_ndelta", "W_wr", "W_wdelta"),
    *("W_delta_i", "W_delta_s"),
)
"""The ten weights of the paper. Yaw rate r and road-wheel angle delta each have a noise and a disturbance."""
Terms = dict[str | tuple[str, int], int]
"""A sum of signals: the sign of each external input (key: its name) and each part's output (key: part,
output)."""


@dataclass(frozen=True)
class PlantWeights:
    """The weights of Fig. 1 as single-input single-output continuous systems, s in rad/s.

    Attributes
    ----------
    W_R, W_C, W_t : StateSpace
    W_u : tuple (n_u,) of StateSpace
    W_n, W_w : tuple (n_y,) of StateSpace
    W_delta_i, W_delta_s : StateSpace
    W_delta_o : tuple (n_y,) of StateSpace, for K_o only; may be empty
    outputs : tuple (n_y,) of str, names of the outputs
    controlled : int, index of the controlled output
    """

    W_R: StateSpace
    W_C: StateSpace
    W_t: StateSpace
    W_u: tuple[StateSpace, ...]
    W_n: tuple[StateSpace, ...]
    W_w: tuple[StateSpace, ...]
    W_delta_i: StateSpace
    W_delta_s: StateSpace
    W_delta_o: tuple[StateSpace, ...] = ()
    outputs: tuple[str, ...] = ("r", "delta")
    controlled: int = 0

    def __post_init__(self):
        for name, weights in self.systems().items():
            for W in weights:
                if W.D.shape != (1, 1) or W.dt != 0:
                    raise SynthesisError(
                        "interconnection",
                        name,
                        f"{W.D.shape} system with dt {W.dt:g}",
                        "a continuous system with one input and one output",
                    )

    def systems(self) -> dict[str, tuple[StateSpace, ...]]:
        """The weights by name, each as a tuple of its channels."""
        weights = {f.name: getattr(self, f.name) for f in fields(self) if f.name.startswith("W_")}
        return {name: W if isinstance(W, tuple) else (W,) for name, W in weights.items()}

    @classmethod
    def of_paper(cls, weights: Mapping[str, StateSpace]) -> PlantWeights:
        """Weights of the paper's vehicle, from a mapping with the names PAPER_WEIGHTS."""
        R, C, t, u, n_r, n_delta, w_r, w_delta, delta_i, delta_s = (weights[name] for name in PAPER_WEIGHTS)
        return cls(R, C, t, (u,), (n_r, n_delta), (w_r, w_delta), delta_i, delta_s)

    @property
    def n_u(self) -> int:
        """Number of inputs."""
        return len(self.W_u)

    @property
    def n_y(self) -> int:
        """Number of outputs."""
        return len(self.outputs)


@dataclass(frozen=True)
class GeneralisedPlant:
    """A generalised plant with its signals.

    Attributes
    ----------
    system : StateSpace, with named signals
    blocks : tuple of Block, blocks of Δ
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
    """Realise a proper num(s)/den(s) in a balanced companion form.

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
    **gains : float, values of the gains that the case file gives by name

    Returns
    -------
    StateSpace
    """
    if "num" in entry:
        return rational(entry["num"], entry["den"])
    gain = entry["gain"]
    return zeros_poles(gains[gain] if isinstance(gain, str) else gain, entry["zeros"], entry["poles"])


def generalised_plant(
    A,
    B,
    weights: PlantWeights,
    structure: str,
    dt: float = 0.0,
    delay: float = 0,
    probes: bool = False,
    C=None,
) -> GeneralisedPlant:
    """Build Fig. 1 around the vehicle x' = A x + B u, y = C x.

    The plant's first n states are the vehicle's. In discrete time a zero-order hold acts on u and ξ_s (ξ_s
    enters through ∫exp(As)ds), and Tustin's method maps the weights.

    Parameters
    ----------
    A : array_like (n, n), continuous
    B : array_like (n, n_u), continuous
    weights : PlantWeights
    structure : str, K_inf, K_i, K_is or K_o
    dt : float, s, 0 for continuous time, default 0.0
    delay : float, samples from u to the vehicle, for computation and bus, default 0
        Δ_i and W_u read u at once. A fraction of a sample lies between Δ_i and the vehicle.
    probes : bool, add outputs after z, default False
        They are the vehicle's state (n), its input (n_u) and, with state uncertainty, the input on every
        state (n). Where the delay has a fraction of a sample, the state also holds the n_u previous inputs.
    C : array_like (n_y, n), by default the first n_y states

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
    _require_posed(weights, structure, dt, delay)
    outputwise, n_u, n_y = structure == OUTPUTWISE, weights.n_u, weights.n_y
    A, B, n = np.asarray(A, dtype=float), np.asarray(B, dtype=float), len(A)
    C = np.eye(n_y, n) if C is None else np.asarray(C, dtype=float)
    whole = int(delay)
    parts, held = _parts(A, B, C, weights, structure, dt, whole, delay - whole)
    n_state = n * (structure == "K_is")
    u = numbered("u", n_u)
    xi_i = numbered("xi_i", n_u) if "W_delta_i" in parts else []
    net = _Network(
        parts,
        [
            *xi_i,
            *(f"xi_s{k}" for k in range(n_state)),
            *(f"xi_{name}" for name in weights.outputs if outputwise),
            *(f"{kind}_{name}" for kind in "wn" for name in weights.outputs),
            *("r_c", *u),
        ],
    )
    u_tilde: list[Terms] = [{("delay", i) if whole else u[i]: 1} for i in range(n_u)]
    for i in range(len(xi_i)):
        u_tilde[i][("W_delta_i", i)] = 1
    measured: list[Terms] = [{("vehicle", j): 1, ("W_w", j): 1} for j in range(n_y)]
    if outputwise:
        for j in range(n_y):
            measured[j][("W_delta_o", j)] = 1
    _join(net, weights, u, u_tilde, measured, n_state)
    rows: dict[str, Terms] = {f"eta{name[2:]}": {u[i]: 1} for i, name in enumerate(xi_i)}
    rows |= {f"eta_s{k}": {("vehicle", n_y + k): 1} for k in range(n_state)}
    if outputwise:
        rows = {f"eta_{name}": {("vehicle", j): 1} for j, name in enumerate(weights.outputs)}
    rows["z_t"] = {("W_t", 0): 1}
    rows |= {name: {("W_u", i): 1} for i, name in enumerate(numbered("z_u", n_u))}
    if probes:
        rows |= {f"x_{k}": {("vehicle", n_y + k): 1} for k in range(held)}
        rows |= dict(zip(numbered("u_tilde", n_u), u_tilde, strict=True))
        rows |= {f"x_in{k}": {("W_delta_s", k): 1} for k in range(n_state)}
    rows["y_c"] = {("W_C", 0): 1}
    rows |= {f"y_{name}": {**measured[j], ("W_n", j): 1} for j, name in enumerate(weights.outputs)}
    blocks = (
        *[Block("full", n_u, n_u)] * bool(xi_i),
        *[Block("full", 1, 1)] * (n_y * outputwise),
        *[Block("full", n, n)] * bool(n_state),
    )
    return GeneralisedPlant(
        net.close(rows), blocks, sum(b.rows for b in blocks), sum(b.cols for b in blocks), n_u, 1 + n_y
    )


def _require_posed(weights: PlantWeights, structure: str, dt: float, delay: float) -> None:
    """Raise SynthesisError for an unknown structure, a wrong delay, or missing weights of K_o."""
    if delay < 0 or (delay and not dt):
        raise SynthesisError("interconnection", "delay", f"{delay} samples at dt {dt:g}", "≥ 0, and dt > 0")
    if structure not in (*STRUCTURES, OUTPUTWISE):
        raise SynthesisError(
            "interconnection", "structure", repr(structure), f"one of {', '.join((*STRUCTURES, OUTPUTWISE))}"
        )
    if structure == OUTPUTWISE and len(weights.W_delta_o) != weights.n_y:
        raise SynthesisError(
            "interconnection", "W_delta_o", f"{len(weights.W_delta_o)} weights", f"{weights.n_y} for K_o"
        )


def numbered(name: str, count: int) -> list[str]:
    """Names of ``count`` signals: ``name`` for one, and ``name``1, ``name``2, .. for several."""
    return [name] if count == 1 else [f"{name}{i + 1}" for i in range(count)]


def _parts(
    A: np.ndarray,
    B: np.ndarray,
    C: np.ndarray,
    weights: PlantWeights,
    structure: str,
    dt: float,
    delay: int,
    fraction: float,
) -> tuple[dict[str, StateSpace], int]:
    """The systems of Fig. 1 by name, sampled where ``dt`` > 0, and the number of the vehicle's states.

    The vehicle has the inputs [ũ; an input on every state] and the outputs [y; x]. W_delta_s acts on every
    state. A weight of a Δ that the structure lacks is left out, and so is a delay of 0.
    """
    n, n_u = B.shape
    channels = {
        "W_delta_i": n_u * (structure in ("K_i", "K_is")),
        "W_delta_s": n if structure == "K_is" else 0,
        "W_delta_o": int(structure == OUTPUTWISE),
    }
    vehicle = StateSpace(
        A, np.hstack([B, np.eye(n)]), np.vstack([C, np.eye(n)]), np.zeros((len(C) + n, n_u + n))
    )
    W = {name: systems for name, systems in weights.systems().items() if channels.get(name, True)}
    if dt:
        vehicle = held_with_delay(vehicle, n_u, dt, fraction)
        W = {name: tuple(to_discrete(w, dt) for w in systems) for name, systems in W.items()}
    parts = {"vehicle": vehicle}
    parts |= {name: append(*systems * channels.get(name, 1)) for name, systems in W.items()}
    if delay:
        parts["delay"] = append(*[delay_line(delay, dt)] * n_u)
    return parts, vehicle.order


def delay_line(samples: int, dt: float) -> StateSpace:
    """Delay one signal by whole samples.

    Parameters
    ----------
    samples : int
    dt : float, s

    Returns
    -------
    StateSpace
    """
    return StateSpace(
        np.eye(samples, k=1),
        np.eye(samples)[:, -1:],
        np.eye(samples)[:1],
        np.full((1, 1), float(not samples)),
        dt,
    )


def held_with_delay(G: StateSpace, n_u: int, dt: float, fraction: float) -> StateSpace:
    """Sample a system with held inputs. Its first ``n_u`` inputs act a fraction of a sample late.

    Where ``fraction`` is not 0, the previous values of these inputs are appended to the states and to the
    outputs of G.

    Parameters
    ----------
    G : StateSpace, continuous
    n_u : int
    dt : float, s
    fraction : float, of a sample, below 1

    Returns
    -------
    StateSpace
    """
    whole = zero_order_hold(G, dt)
    if not fraction:
        return whole
    late, early = (zero_order_hold(G, part * dt) for part in (fraction, 1 - fraction))
    n, m = G.order, G.n_inputs
    old = early.A @ late.B[:, :n_u]
    return StateSpace(
        np.block([[whole.A, old], [np.zeros((n_u, n + n_u))]]),
        np.block([[early.B[:, :n_u], whole.B[:, n_u:]], [np.eye(n_u, m)]]),
        np.block([[G.C, np.zeros((G.n_outputs, n_u))], [np.zeros((n_u, n)), np.eye(n_u)]]),
        np.zeros((G.n_outputs + n_u, m)),
        dt,
    )


def _join(
    net: _Network,
    weights: PlantWeights,
    u: list[str],
    u_tilde: list[Terms],
    measured: list[Terms],
    n_state: int,
) -> None:
    """Connect the parts of Fig. 1. ``u_tilde`` and ``measured`` are ũ and y_m as sums."""
    n_u = len(u)
    for i in range(n_u):
        if "delay" in net.first_in:
            net.feed("delay", i, {u[i]: 1})
        if "W_delta_i" in net.first_in:
            net.feed("W_delta_i", i, {numbered("xi_i", n_u)[i]: 1})
        net.feed("vehicle", i, u_tilde[i])
        net.feed("W_u", i, {u[i]: 1})
    for j, name in enumerate(weights.outputs):
        if "W_delta_o" in net.first_in:
            net.feed("W_delta_o", j, {f"xi_{name}": 1})
        net.feed("W_w", j, {f"w_{name}": 1})
        net.feed("W_n", j, {f"n_{name}": 1})
    for k in range(n_state):
        net.feed("W_delta_s", k, {f"xi_s{k}": 1})
        net.feed("vehicle", n_u + k, {("W_delta_s", k): 1})
    net.feed("W_C", 0, {"r_c": 1})
    net.feed("W_R", 0, {("W_C", 0): 1})
    net.feed("W_t", 0, {("W_R", 0): 1, **dict.fromkeys(measured[weights.controlled], -1)})


class _Network:
    """Systems whose inputs are sums of the systems' outputs and of external signals."""

    def __init__(self, parts: dict[str, StateSpace], external: list[str]):
        """``parts`` are the systems by name. ``external`` are the names of the external inputs, in order."""
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
        """Connect the sum of ``terms`` to input ``port`` of part ``name``."""
        inner, outer = self._row(terms)
        self.inner[self.first_in[name] + port], self.outer[self.first_in[name] + port] = inner, outer

    def _row(self, terms: Terms) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of ``terms``: over the outputs of the parts, and over the external inputs."""
        inner, outer = np.zeros(self.joined.n_outputs), np.zeros(len(self.names))
        for key, sign in terms.items():
            if isinstance(key, str):
                outer[self.names.index(key)] = sign
            else:
                inner[self.first_out[key[0]] + key[1]] = sign
        return inner, outer

    def close(self, rows: dict[str, Terms]) -> StateSpace:
        """System from the external inputs to the named ``rows``. Fig. 1 has no algebraic loop."""
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
