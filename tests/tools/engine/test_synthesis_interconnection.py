"""Fig. 1 by its equations, one signal at a time, and the weights in it by their factors."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sl

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.interconnection import (
    GeneralisedPlant,
    PlantWeights,
    generalised_plant,
    rational,
    weight_from_table,
    zeros_poles,
)
from lpvguard.engine.synthesis.statespace import StateSpace, gain

A = np.array([[-1.0, 0.4, 0.3], [0.2, -2.0, 0.7], [-0.6, 0.5, -0.8]])
B = np.array([[0.5], [1.1], [-0.9]])
B_2 = np.array([[0.5, -0.3], [1.1, 0.8], [-0.9, 0.2]])
C_3 = np.array([[1.0, 0.5, 0.0], [0.0, -0.7, 1.0], [0.3, 0.0, 0.9]])
POINT = 0.3 + 0.9j
NAMES = ("R", "C", "t", "u", "nr", "ndelta", "wr", "wdelta", "delta_i", "delta_s", "delta_r", "delta_delta")
SYSTEMS = {
    name: StateSpace([[-1.0 - k]], [[1.0]], [[0.3 + 0.1 * k]], [[0.2 * (k + 1)]])
    for k, name in enumerate(NAMES)
}
WEIGHTS = replace(
    PlantWeights.of_paper({f"W_{name}": SYSTEMS[name] for name in NAMES[:10]}),
    W_delta_o=(SYSTEMS["delta_r"], SYSTEMS["delta_delta"]),
)


def by_equations(structure: str, dt: float, delay: int, probes: bool) -> dict[str, dict[str, complex]]:
    """Outputs of Fig. 1 at POINT by name: response to each input by name."""
    s = 2 / dt * (POINT - 1) / (POINT + 1) if dt else POINT
    W = {name: SYSTEMS[name].evaluate([s])[0, 0, 0] for name in NAMES}
    Ad, held = A, np.eye(3)
    if dt:
        Ad = sl.expm(A * dt)
        held = np.linalg.solve(A, Ad - np.eye(3))
    resolvent = np.linalg.inv(POINT * np.eye(3) - Ad) @ held
    outer = ("w_r", "w_delta", "n_r", "n_delta", "r_c", "u")
    uncertain = {
        "K_inf": (),
        "K_i": ("xi_i",),
        "K_is": ("xi_i", "xi_s0", "xi_s1", "xi_s2"),
        "K_o": ("xi_r", "xi_delta"),
    }[structure]
    out: dict[str, dict[str, complex]] = {}
    for name in (*uncertain, *outer):
        one = dict.fromkeys(("xi_i", "xi_s0", "xi_s1", "xi_s2", "xi_r", "xi_delta", *outer), 0.0)
        one[name] = 1.0
        u_tilde = one["u"] * POINT**-delay + W["delta_i"] * one["xi_i"]
        x_in = W["delta_s"] * np.array([one[f"xi_s{k}"] for k in range(3)])
        x = resolvent @ (B[:, 0] * u_tilde + x_in)
        r_m = x[0] + W["wr"] * one["w_r"] + W["delta_r"] * one["xi_r"]
        delta_m = x[1] + W["wdelta"] * one["w_delta"] + W["delta_delta"] * one["xi_delta"]
        y_c = W["C"] * one["r_c"]
        signals = {
            "K_inf": {},
            "K_i": {"eta_i": one["u"]},
            "K_is": {"eta_i": one["u"], **{f"eta_s{k}": x[k] for k in range(3)}},
            "K_o": {"eta_r": x[0], "eta_delta": x[1]},
        }[structure]
        signals |= {"z_t": W["t"] * (W["R"] * y_c - r_m), "z_u": W["u"] * one["u"]}
        if probes:
            signals |= {f"x_{k}": x[k] for k in range(3)} | {"u_tilde": u_tilde}
            if structure == "K_is":
                signals |= {f"x_in{k}": x_in[k] for k in range(3)}
        signals |= {"y_c": y_c, "y_r": r_m + W["nr"] * one["n_r"]}
        signals["y_delta"] = delta_m + W["ndelta"] * one["n_delta"]
        for signal, value in signals.items():
            out.setdefault(signal, {})[name] = value
    return out


@pytest.mark.parametrize("structure", ["K_inf", "K_i", "K_is", "K_o"])
@pytest.mark.parametrize(("dt", "delay"), [(0.0, 0), (0.1, 0), (0.1, 1), (0.1, 3)])
@pytest.mark.parametrize("probes", [False, True])
def test_every_signal_is_that_of_the_equations(structure, dt, delay, probes):
    system = generalised_plant(A, B, WEIGHTS, structure, dt, delay, probes)
    wanted = by_equations(structure, dt, delay, probes)
    G = system.system
    assert G.outputs == tuple(wanted) and G.inputs == tuple(wanted["z_u"]) and G.dt == dt
    values = np.array([list(row.values()) for row in wanted.values()])
    np.testing.assert_allclose(G.evaluate([POINT])[0], values, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(G.A[:3, :3], sl.expm(A * dt) if dt else A, rtol=1e-12)
    one, blocks = Block("full", 1, 1), system.blocks
    full = {"K_inf": (), "K_i": (one,), "K_is": (one, Block("full", 3, 3)), "K_o": (one, one)}
    assert blocks == full[structure]
    n = {"K_inf": 0, "K_i": 1, "K_is": 4, "K_o": 2}[structure]
    assert (system.n_delta_out, system.n_delta_in, system.n_control, system.n_measurement) == (n, n, 1, 3)
    z = 2 + (4 + 3 * (structure == "K_is")) * probes
    assert system.performance_block == Block("full", 5, z)
    weights = {"K_inf": 8, "K_i": 9, "K_is": 12, "K_o": 10}[structure]
    assert G.order == 3 + weights + delay


def two_inputs(structure: str, delay: float, n_y: int = 3) -> GeneralisedPlant:
    """Fig. 1 of a vehicle with two inputs and outputs that are no states, the last of which is controlled."""
    W = [SYSTEMS[name] for name in NAMES]
    weights = PlantWeights(
        *W[:3],
        (W[3], W[4]),
        (*W[5:8],)[:n_y],
        (*W[8:11],)[:n_y],
        W[2],
        W[1],
        (*W[3:6],)[:n_y],
        tuple("abc"[:n_y]),
        n_y - 1,
    )
    return generalised_plant(A, B_2, weights, structure, 0.1, delay, True, C_3[:n_y])


@pytest.mark.parametrize("delay", [0.0, 2.0, 0.3, 2.7])
@pytest.mark.parametrize("n_y", [1, 3])
def test_two_inputs_act_late_by_any_delay_and_the_named_output_is_controlled(delay, n_y):
    """With K_o: every path from the inputs, against the exact response to inputs held from instants between
    samples."""
    plant = two_inputs("K_o", delay, n_y)
    G, names = plant.system, "abc"[:n_y]
    s, whole, part = 2 / 0.1 * (POINT - 1) / (POINT + 1), int(delay), delay - int(delay)
    late, early = (
        np.linalg.solve(A, sl.expm(A * x) - np.eye(3)) @ B_2 for x in (part * 0.1, (1 - part) * 0.1)
    )
    held = sl.expm(A * (1 - part) * 0.1) @ late / POINT + early
    y = C_3[:n_y] @ np.linalg.solve(POINT * np.eye(3) - sl.expm(A * 0.1), held) * POINT**-whole
    got = {
        (o, i): value
        for o, row in zip(G.outputs, G.evaluate([POINT])[0], strict=True)
        for i, value in zip(G.inputs, row, strict=True)
    }

    def weight(name: str) -> complex:
        return SYSTEMS[name].evaluate([s])[0, 0, 0]

    for i, u in enumerate(("u1", "u2")):
        for j, name in enumerate(names):
            assert got[f"y_{name}", u] == pytest.approx(y[j, i], rel=1e-9)
            assert got[f"eta_{name}", u] == pytest.approx(y[j, i], rel=1e-9)
        assert got["z_t", u] == pytest.approx(-weight("t") * y[-1, i], rel=1e-9)
        for k, own in enumerate(("u", "nr")):
            assert got[f"z_u{k + 1}", u] == pytest.approx(weight(own) * (k == i))
    assert got["z_t", "r_c"] == pytest.approx(weight("t") * weight("R") * weight("C"))
    assert plant.blocks == (Block("full", 1, 1),) * n_y
    assert (plant.n_control, plant.n_measurement) == (2, 1 + n_y)
    assert two_inputs("K_i", delay, n_y).blocks == (Block("full", 2, 2),)


def test_a_delayed_state_is_among_the_probes():
    whole, part = (two_inputs("K_i", delay).system.outputs for delay in (2.0, 2.7))
    assert [name for name in part if name not in whole] == ["x_3", "x_4"]


def test_the_plant_is_continuous_and_without_probes_unless_asked():
    plain, system = (
        generalised_plant(A, B, WEIGHTS, "K_is"),
        generalised_plant(A, B, WEIGHTS, "K_is", 0.0, 0, False),
    )
    assert plain.system.dt == 0 and plain.system.outputs == system.system.outputs


def test_what_fig_1_cannot_have_is_refused():
    with pytest.raises(SynthesisError, match=r"delay: -1 samples at dt 0\.1"):
        generalised_plant(A, B, WEIGHTS, "K_i", 0.1, -1)
    with pytest.raises(SynthesisError, match="delay: 2 samples at dt 0"):
        generalised_plant(A, B, WEIGHTS, "K_i", 0.0, 2)
    with pytest.raises(SynthesisError, match="'K_x'"):
        generalised_plant(A, B, WEIGHTS, "K_x")
    fewer = replace(WEIGHTS, W_delta_o=WEIGHTS.W_delta_o[:1])
    with pytest.raises(SynthesisError, match="W_delta_o: 1 weights; expected 2 for K_o"):
        generalised_plant(A, B, fewer, "K_o")
    assert generalised_plant(A, B, fewer, "K_is").system.order == 15
    for bad, said in ((gain(np.ones((1, 2))), r"\(1, 2\)"), (gain(np.eye(1), 0.1), r".*dt 0\.1")):
        with pytest.raises(SynthesisError, match=f"W_n: {said}"):
            replace(WEIGHTS, W_n=(bad, WEIGHTS.W_n[1]))


def test_a_ratio_of_polynomials_has_their_values():
    for num, den in (
        ([3.0], [2.0]),
        ([1.0], [4.0, 2.0]),
        ([5.0, 1.0], [4.0, 2.0]),
        ([0.0, 7.0, 3.0], [2.0, 3.0, 5.0, 8.0]),
        ([2.0, 7.0, 3.0, 1.0], [0.0, 2.0, 3.0, 5.0, 8.0]),
        ([0.0], [1.0, 2.0]),
        (6.0, 3.0),
    ):
        G = rational(num, den)
        want = np.polyval(np.atleast_1d(num), POINT) / np.polyval(np.atleast_1d(den), POINT)
        assert G.evaluate([POINT])[0, 0, 0] == pytest.approx(want, rel=1e-12)
        assert G.order == len(np.trim_zeros(np.atleast_1d(den), "f")) - 1
    for num, den, said in (
        ([1.0, 2.0], [3.0], "degrees 1 and 0"),
        ([1.0], [0.0], "degrees 0 and -1"),
        ([0.0], [0.0], "degrees -1 and -1"),
    ):
        with pytest.raises(SynthesisError, match=said):
            rational(num, den)
    # States far apart in size are balanced: a companion form has 1 and 1e8 beside each other.
    G = rational([1e8], [1.0, 1e4, 1e8])
    assert np.abs(G.A[0, 1]) == pytest.approx(np.abs(G.A[1, 0]), rel=3.0)


def test_a_gain_with_zeros_and_poles_has_the_value_of_its_factors():
    for zeros, poles in (
        ([], []),
        ([], [2.0]),
        ([3.0], [2.0]),
        ([5.0], [2.0, 0.5]),
        ([5.0, -1.5], [2.0, 0.5, 9.0]),
        ([4.0, 6.0, 0.3], [2.0, 0.5, 9.0]),
    ):
        G = zeros_poles(1.7, zeros, poles)
        want = 1.7 * np.prod([POINT / z + 1 for z in zeros]) / np.prod([POINT / p + 1 for p in poles])
        assert G.evaluate([POINT])[0, 0, 0] == pytest.approx(want, rel=1e-12)
        np.testing.assert_allclose(np.sort(-G.poles().real), np.sort(poles))
    # The largest zeros meet the largest poles: each section's step stays near 1.
    np.testing.assert_allclose(zeros_poles(1.0, [10.0], [10.0, 1.0]).A, [[-1.0, 0.0], [0.0, -10.0]])
    for zeros, poles in (([1.0], []), ([0.0], [1.0]), ([], [0.0]), ([np.inf], [1.0]), ([], [np.nan])):
        with pytest.raises(SynthesisError, match="none at 0"):
            zeros_poles(1.0, zeros, poles)


def test_a_weights_gain_may_be_a_name():
    entry = {"gain": "A_t", "zeros": [], "poles": [2.0]}
    assert weight_from_table(entry, A_t=5.0).evaluate([0.0])[0, 0, 0] == pytest.approx(5.0)
    assert weight_from_table(entry | {"gain": 3.0}).evaluate([0.0])[0, 0, 0] == pytest.approx(3.0)
    assert weight_from_table({"num": [1.0], "den": [4.0]}).D[0, 0] == pytest.approx(0.25)
