"""Make validation_problems.json: small problems of the interface with references that do not use lpvguard.

S1 and margins by cvxpy + Clarabel; single repeated blocks by a scan over the scalar with the loop closed
exactly and a local refinement. Run: python tests/golden/make_validation_problems.py >
tests/golden/validation_problems.json
"""

import json

import cvxpy as cp
import numpy as np
from scipy.optimize import minimize


def gauss(rng, *shape):
    return (rng.normal(size=shape) + 1j * rng.normal(size=shape)) / np.sqrt(2)


def pairs(a):
    a = np.asarray(a, dtype=complex)
    return np.stack([a.real, a.imag], axis=-1).tolist()


def multiplicative(rng, k):
    n_y = 1 + k % 4
    e, z = gauss(rng, n_y), gauss(rng, n_y)
    delta = cp.Variable(complex=True)
    b1 = cp.Problem(cp.Minimize(cp.norm(e - delta * z))).solve(solver=cp.CLARABEL) if n_y > 1 else 0.0
    gamma = b1 + rng.uniform(0.2, 0.8) * (np.linalg.norm(e) - b1)
    nu = cp.Problem(cp.Minimize(cp.abs(delta)), [cp.norm(e - delta * z) <= gamma]).solve(solver=cp.CLARABEL)
    problem = {"E": pairs(e), "Z": pairs(z), "gamma_w": gamma}
    return {"kind": "multiplicative", **problem, "answer": {"feasible": True, "nu": nu}, "rtol": 1e-5}


def margin(rng, k):
    n_y = 1 + k % 4
    e, z, w_delta, w_w = gauss(rng, n_y), gauss(rng, n_y), rng.uniform(0.1, 1), rng.uniform(0.1, 1, n_y)
    delta, t = cp.Variable(complex=True), cp.Variable()
    limits = [cp.abs(delta) <= t * w_delta, *(cp.abs(e[j] - delta * z[j]) <= t * w_w[j] for j in range(n_y))]
    value = cp.Problem(cp.Minimize(t), limits).solve(solver=cp.CLARABEL)
    problem = {"E": pairs(e), "Z": pairs(z), "W_delta": w_delta, "W_w": w_w.tolist()}
    return {"kind": "margin", **problem, "answer": {"t": value}, "rtol": 1e-5}


def repeated(rng, kind, k):
    """min |delta| (or the margin) for one repeated block, by a scan and a refinement with a penalty-free
    polar search."""
    block_type, r, n_y = ("repeated_complex", "repeated_real")[k % 2], 2 + k % 2, 1 + k % 3
    p11, p21, eta0 = 0.3 * gauss(rng, r, r), gauss(rng, n_y, r), gauss(rng, r)
    true = rng.uniform(0.1, 0.4) * (np.exp(2j * np.pi * rng.uniform()) if k % 2 == 0 else 1.0)
    w = 0.1 * gauss(rng, n_y)
    e = p21 @ (true * np.linalg.solve(np.eye(r) - true * p11, eta0)) + w

    def left(delta):
        delta = np.atleast_1d(delta)
        loop = np.linalg.solve(
            np.eye(r) - delta[:, None, None] * p11, np.tile(eta0[:, None], (delta.size, 1, 1))
        )[:, :, 0]
        return e - delta[:, None] * (loop @ p21.T)

    real = block_type == "repeated_real"
    grid = (
        np.linspace(-0.6, 0.6, 400001)
        if real
        else (np.linspace(0, 0.6, 1201)[:, None] * np.exp(2j * np.pi * np.arange(1440) / 1440)).ravel()
    )
    problem = {
        "blocks": [{"type": block_type, "rows": r, "cols": r}],
        "P11": pairs(p11),
        "eta0": pairs(eta0),
        "P21": pairs(p21),
        "e": pairs(e),
    }
    if kind == "lft":
        gamma = 1.05 * np.linalg.norm(w)
        inside = np.linalg.norm(left(grid), axis=1) <= gamma
        best = grid[inside][np.argmin(np.abs(grid[inside]))]
        if real:
            value = abs(best) ** 2
        else:
            done = minimize(
                lambda v: v @ v,
                [best.real, best.imag],
                method="SLSQP",
                options={"ftol": 1e-15},
                constraints={
                    "type": "ineq",
                    "fun": lambda v: 1 - np.linalg.norm(left(v[0] + 1j * v[1])) ** 2 / gamma**2,
                },
            )
            value = float(done.fun)
        problem |= {"gamma_w": gamma, "lambda_nu": [1.0]}
        answer = {"J_lower": value * (1 - 1e-4), "J_upper": value * (1 + 1e-4)}
    else:
        w_delta, w_w = abs(true), np.abs(w)
        level = np.maximum(np.abs(grid) / w_delta, np.max(np.abs(left(grid)) / w_w, axis=1))
        best = grid[np.argmin(level)]
        done = minimize(
            lambda v: max(
                np.hypot(*v) / w_delta, np.max(np.abs(left(v[0] + 1j * v[1] * (not real)))[0] / w_w)
            ),
            [best.real, best.imag],
            method="Nelder-Mead",
            options={"xatol": 1e-10, "fatol": 1e-12, "maxiter": 4000},
        )
        value = min(float(done.fun), float(level.min()))
        problem |= {"W_delta": [w_delta], "W_w": w_w.tolist()}
        answer = {"t_lower": value * (1 - 1e-3), "t_upper": value}
    return {"kind": kind, **problem, "answer": answer, "rtol": 1e-3}


def main():
    rng = np.random.default_rng(20260101)
    problems = [multiplicative(rng, k) for k in range(8)] + [margin(rng, k) for k in range(8)]
    problems += [repeated(rng, "lft", k) for k in range(6)] + [
        repeated(rng, "lft_margin", k) for k in range(6)
    ]
    problems = [{"id": f"{p['kind']}-own-{i}", **p} for i, p in enumerate(problems)]
    lines = ",\n".join(json.dumps(p) for p in problems)
    print(f'{{"schema": "lpvguard.problems/1", "problems": [\n{lines}\n]}}')


if __name__ == "__main__":
    main()
