"""Slow double-precision reference of the g80 chain, written from the definitions and from nothing in the
package.

Nominal model: closed-form solution of T dx/dt = -x + G u over each piece of held input. Frames: the defining
sums. Margin, one output: t* = |E| / (B_w + W_delta |Z|). Energy test, one output: THEORY (T19) to (T22),
sample by sample.
"""

import numpy as np

L, K, T1 = 2.661231232601298, 0.002678775525841357, 0.005145515095355525
DELAY, D0, R0 = 0.025, -0.0007443694838896991, 0.0009170204750782256
TS, SPEED = 0.02, (3.5, 19.0)


def nominal(v: np.ndarray, delta: np.ndarray, r_first: float) -> np.ndarray:
    """Nominal yaw rate (N,) along a drive."""
    speed = np.clip(v, *SPEED)
    G, T = speed / (L + K * speed**2), T1 * speed * L / (L + K * speed**2)
    whole = int(DELAY / TS)
    old = DELAY - whole * TS
    x, out = r_first - R0, np.empty(len(v))
    for k in range(len(v)):
        out[k] = x + R0
        for duration, index in ((old, k - whole - 1), (TS - old, k - whole)):
            decay = np.exp(-duration / T[k])
            x = decay * x + (1 - decay) * G[k] * (delta[max(index, 0)] - D0)
    return out


def frame(x: np.ndarray, start: int, length: int, cycles: int) -> complex:
    """Hann frame of x by its defining sum."""
    n = np.arange(length)
    w = 0.5 - 0.5 * np.cos(2 * np.pi * n / length)
    scale = (2.0 if cycles else 1.0) / w.sum()
    return scale * np.sum(w * x[start : start + length] * np.exp(-2j * np.pi * cycles * n / length))


def margin(E: complex, Z: complex, W_delta: float, B_w: float) -> float:
    return abs(E) / (B_w + W_delta * abs(Z))


def recursion(num: np.ndarray, den: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Output of a filter with polynomials in z, highest power first, as its difference equation."""
    y = np.zeros(len(x))
    for k in range(len(x)):
        past = min(k + 1, len(num))
        y[k] = num[:past] @ x[k::-1][:past] - den[1:past] @ y[k - 1 :: -1][: past - 1]
        y[k] /= den[0]
    return y


def weight_in_z(num: np.ndarray, den: np.ndarray, rho: float) -> tuple[np.ndarray, np.ndarray]:
    """Polynomials in z of a weight in s, with s = (2/Ts) (z/rho - 1) / (z/rho + 1)."""
    order = len(den) - 1

    def in_z(polynomial: np.ndarray) -> np.ndarray:
        total = np.zeros(order + 1)
        for power, c in enumerate(np.r_[np.zeros(order + 1 - len(polynomial)), polynomial][::-1]):
            factors = [[1.0, -1.0]] * power + [[1.0, 1.0]] * (order - power)
            product = np.ones(1)
            for factor in factors:
                product = np.convolve(product, factor)
            total += c * (2 / TS) ** power * product
        return total / rho ** np.arange(order, -1, -1)

    return in_z(num), in_z(den)


def energy_ratios(
    e: np.ndarray, yhat: np.ndarray, weight: tuple[np.ndarray, np.ndarray], test: dict
) -> np.ndarray:
    """Largest ratio of three bands at each sample (N,), 0 until the sums have settled. ``test``: corners
    [rad/s], memory [s], samples to settle, sigma (3,) and what is remembered (3,)."""
    memory, (low, high) = test["memory_s"], test["band_radps"]
    rho = np.exp(-TS / memory)
    explained = recursion(*weight_in_z(*weight, rho), yhat)

    def low_pass(omega: float, x: np.ndarray) -> np.ndarray:
        t = np.tan(omega * TS / 2)
        return recursion(np.array([t, t]), np.array([t + 1, t - 1]), x)

    def bands(x: np.ndarray) -> list[np.ndarray]:
        below_high = low_pass(high, x)
        below = low_pass(low, below_high)
        return [below, below_high - below, x - below_high]

    def norms(x: np.ndarray, rate: float, first: int) -> np.ndarray:
        out, total = np.zeros(len(x)), 0.0
        for k in range(first, len(x)):
            total = rate**2 * total + x[k] ** 2
            out[k] = np.sqrt(total)
        return out

    ratios, settle = np.zeros(len(e)), test["settle_samples"]
    fading = rho ** (np.arange(len(e)) + 1.0)
    for band, (left, right) in enumerate(zip(bands(e), bands(explained), strict=True)):
        rate = rho if band < 2 else np.exp(-TS / (memory * low / high))
        allowed = norms(right, rho, 0) + fading * test["start"][band] + test["sigma"][band]
        ratios = np.maximum(ratios, norms(left, rate, settle) / allowed)
    return ratios
