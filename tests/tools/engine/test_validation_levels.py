"""The search for the best level by its steps, and the ends of what a certificate proves, at their borders."""

import numpy as np
import pytest

from lft_problems import hermitian
from lpvguard.engine.validation import lmi


def best_length(decrement: float) -> float:
    """Whole near the centre, damped further out, and four times as bold far out."""
    if decrement < 0.25:
        return 1.0
    damped = 1.0 / (1.0 + decrement)
    return min(1.0, 4.0 * damped) if decrement > 1.0 else damped


@pytest.mark.parametrize("relative", [0.3, 1e-5])
@pytest.mark.parametrize("shift", [4.0, 0.0, -9.0])
@pytest.mark.parametrize(
    "groups", [2 * [("psd", 1)], [("psd", 1), ("psd", 2), ("free", 1)], [("psd", 3), ("free", 1)]]
)
def test_a_level_is_followed_along_its_centres_by_newtons_steps(groups, shift, relative, monkeypatch):
    """Each step is checked against the barrier's derivatives that it came from."""
    trace: list[dict] = []
    barrier, feasible = lmi._barrier, lmi._feasible_step

    def watch_barrier(inverse, forms, c, y, eps):
        g, h = barrier(inverse, forms, c, y, eps)
        trace.append({"inverse": inverse, "forms": forms, "y": y, "eps": eps, "g": g, "h": h})
        return g, h

    def watch_step(q, c, y, x, step, length):
        moved = feasible(q, c, y, x, step, length)
        trace[-1] |= {"step": step, "length": length, "x": x, "moved": moved}
        return moved

    monkeypatch.setattr(lmi, "_barrier", watch_barrier)
    monkeypatch.setattr(lmi, "_feasible_step", watch_step)
    monkeypatch.setattr(np.linalg, "lstsq", None)  # Newton's equations are regular
    rng, c, n = np.random.default_rng(31), lmi.cone(groups), 3
    m = len(c.normal)
    q = hermitian(rng, m, n)
    q[: c.start[1]] += shift * np.eye(n)
    certificate = lmi.maximise_level(q, c, relative=relative, absolute=1e-7)
    y = c.normal / sum(r for kind, r in groups if kind == "psd")
    matrix = sum(y[j] * q[j] for j in range(m))
    low = np.linalg.eigvalsh(matrix)[0]
    x, above = low - 0.5 * abs(low), np.inf
    eps, inverse = 0.5 * (low - x), np.linalg.inv(matrix - x * np.eye(n))
    degree, normal = n + sum(r for kind, r in groups if kind == "psd"), np.append(c.normal, 0.0)
    along = np.linalg.svd(normal[None])[2][1:].T  # steps that keep the normalisation
    for k, at in enumerate(trace):
        assert at["eps"] == pytest.approx(eps, rel=1e-12) and at["x"] == pytest.approx(x, rel=1e-12)
        np.testing.assert_allclose(at["y"], y, rtol=1e-12)
        np.testing.assert_allclose(at["inverse"], inverse, rtol=1e-9, atol=1e-9 * np.abs(inverse).max())
        np.testing.assert_array_equal(at["forms"], [*q, -np.eye(n)])
        wanted = np.linalg.solve(along.T @ at["h"] @ along, along.T @ at["g"])
        np.testing.assert_allclose(at["step"], along @ wanted, rtol=1e-6, atol=1e-6 * np.abs(wanted).max())
        decrement = np.sqrt(max(at["g"] @ at["step"] / eps, 0.0))
        assert at["length"] == pytest.approx(best_length(decrement), rel=1e-9)
        y, x, slack, taken = at["moved"]
        inverse = np.linalg.inv(slack)
        np.testing.assert_allclose(inverse, inverse.conj().T, atol=1e-9 * np.abs(inverse).max())
        if decrement < 1.0 and decrement * taken < 0.5:
            above = min(above, x + 2 * eps * degree)
            ended = above < 0.0 or above - x <= max(1e-7, relative * abs(x))
            assert ended == (k == len(trace) - 1)
            eps *= 0.15
        else:
            assert k < len(trace) - 1
    assert (certificate.x, certificate.x_above) == (pytest.approx(x), pytest.approx(above)) and above < np.inf
    np.testing.assert_array_equal(certificate.y, y)
    np.testing.assert_allclose(certificate.inverse, inverse, rtol=1e-9, atol=1e-9 * np.abs(inverse).max())
    np.testing.assert_allclose(certificate.inverse, certificate.inverse.conj().T, rtol=1e-14)


class Steps:
    """A search whose decrements, levels and lengths are given."""

    def __init__(self, monkeypatch, decrements, levels=(), shares=()):
        self.decrements, self.levels, self.shares = (iter(v) for v in (decrements, levels, shares))
        self.curvature = 1.0
        self.eps: list[float] = []
        self.lengths: list[float] = []
        monkeypatch.setattr(lmi, "_barrier", self.barrier)
        monkeypatch.setattr(lmi, "_feasible_step", self.step)

    def barrier(self, inverse, forms, c, y, eps):
        """Derivatives of a step in x alone."""
        self.eps.append(eps)
        return np.array([0.0, 0.0, next(self.decrements) * np.sqrt(eps)]), self.curvature * np.eye(3)

    def step(self, q, c, y, x, step, length):
        self.lengths.append(length)
        level = next(self.levels, x)
        return None if level is None else (y, level, np.eye(2), length * next(self.shares, 1.0))

    def run(self, **accuracy) -> lmi.Centre:
        return lmi.maximise_level(np.stack([np.eye(2)] * 2), lmi.cone(2 * [("psd", 1)]), **accuracy)


def test_how_long_a_step_is_follows_its_decrement(monkeypatch):
    decrements = [0.24, 0.26, 0.99, 1.01, 2.9, 3.1, 9.0]
    steps = Steps(monkeypatch, decrements, [1.0] * 6 + [None])
    steps.run(relative=0.0, absolute=0.0)
    want = [1.0, 1 / 1.26, 1 / 1.99, 1.0, 1.0, 4 / 4.1, 0.4]
    assert steps.lengths == pytest.approx(want, rel=1e-9)


def test_the_barrier_shrinks_where_a_step_ended_near_the_centre(monkeypatch):
    """Less than half a decrement away, and less than one before."""
    decrements, shares = [0.9, 0.9, 0.99, 1.01, 0.7, 0.7], [1.0, 1.06, 1.0, 0.4, 1.2, 1.22]
    steps = Steps(monkeypatch, [*decrements, 5.0], [1.0] * 6 + [None], shares)
    result = steps.run(relative=0.0, absolute=0.0)
    factors = np.array(steps.eps[1:]) / steps.eps[:-1]
    assert steps.eps[0] == 0.25 and factors == pytest.approx([0.15, 1.0, 0.15, 1.0, 0.15, 1.0])
    # Four states and multipliers in all: the last shrinking was at 0.25 * 0.15^2.
    assert result.x_above == pytest.approx(1.0 + 2 * 4 * 0.25 * 0.15**2) and result.x == 1.0


def test_a_level_is_known_where_its_gap_is_small_or_it_is_proven_negative(monkeypatch):
    """At the first centre the gap is 2 * 4 * 0.25 = 2, at the second 0.3."""
    for accuracy, level, steps_taken in (
        ({"relative": 0.0, "absolute": 2.01}, 7.0, 1),
        ({"relative": 0.0, "absolute": 2.0}, 7.0, 1),
        ({"relative": 0.0, "absolute": 1.99}, 7.0, 2),
        ({"relative": 0.29, "absolute": 0.0}, 7.0, 1),
        ({"relative": 0.28, "absolute": 0.0}, 7.0, 2),
        ({"relative": 1.05, "absolute": 0.0}, -1.95, 1),
        ({"relative": 1.01, "absolute": 0.0}, -1.95, 2),
        ({"relative": 0.0, "absolute": 0.31}, -2.0, 2),
        ({"relative": 0.0, "absolute": 0.0}, -2.01, 1),
        ({"relative": 0.0, "absolute": 0.0}, -2.0, 2),
        ({}, 19.0, 2),
        ({}, 21.0, 1),
    ):
        steps = Steps(monkeypatch, [0.0] * 9, [level] * 2 + [None])
        result = steps.run(**accuracy)
        assert len(steps.lengths) == steps_taken, (accuracy, level)
        assert result.x == level and result.x_above == pytest.approx(level + [2.0, 0.3][steps_taken - 1])
    # Of itself a level of 0 is known to a billionth: 2 * 0.15^12.
    steps = Steps(monkeypatch, [0.0] * 30, [0.0] * 30)
    assert steps.run().x_above == pytest.approx(2 * 0.15**12) and len(steps.lengths) == 13
    # Where the level falls again the earlier limit stays.
    steps = Steps(monkeypatch, [0.0] * 3, [1.0, 9.0, None])
    assert steps.run(relative=0.0, absolute=0.0).x_above == 3.0


def test_a_search_ends_with_what_it_has_after_120_steps_or_one_that_is_none(monkeypatch):
    steps = Steps(monkeypatch, [2.0] * 200)
    steps.run()
    assert len(steps.lengths) == 120
    steps = Steps(monkeypatch, [2.0, np.nan])
    result = steps.run()
    assert len(steps.lengths) == 1 and result.x_above == np.inf and result.y.tolist() == [0.5, 0.5]
    # Where rounding makes the promised gain negative the step is that of a centre.
    steps = Steps(monkeypatch, [2.0, np.nan], [0.5])
    steps.curvature = -1.0
    assert steps.run(relative=0.0, absolute=0.0).x_above == 2.5 and steps.lengths == [1.0]
    steps = Steps(monkeypatch, [0.0, 2.0], [0.5, None])
    result = steps.run(relative=0.0, absolute=0.0)
    assert (result.x, result.x_above) == (0.5, 2.5)
    np.testing.assert_array_equal(result.inverse, np.eye(2))


def test_a_level_of_almost_zero_is_begun_a_two_thousandth_below():
    """The least distance of the start, so that the barrier has room."""
    for low, below in ((1e-5, 5e-4), (-1e-5, 5e-4), (2e-3, 1e-3), (-3.0, 1.5)):
        seen = []

        def end(inverse, forms, c, y, eps, seen=seen):
            seen.append((inverse, eps))
            return np.full(2, np.nan), np.eye(2)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(lmi, "_barrier", end)
            certificate = lmi.maximise_level(np.diag([low, low + 1.0])[None], lmi.cone([("psd", 1)]))
        assert certificate.x == pytest.approx(low - below, rel=1e-9) and seen[0][1] == pytest.approx(
            0.5 * below
        )
        np.testing.assert_allclose(seen[0][0], np.diag([1 / below, 1 / (1 + below)]), rtol=1e-9)


def test_free_forms_of_zero_change_no_level():
    """They make Newton's equations singular: the least step leaves them alone."""
    q = hermitian(np.random.default_rng(3), 2, 3)
    q[0] += 4 * np.eye(3)
    alone = lmi.maximise_level(q, lmi.cone(2 * [("psd", 1)]), relative=1e-4)
    beside = lmi.maximise_level(
        np.concatenate([q, np.zeros((1, 3, 3))]), lmi.cone([*2 * [("psd", 1)], ("free", 1)]), relative=1e-4
    )
    assert beside.x == pytest.approx(alone.x, rel=1e-6) and abs(beside.y[2]) < 1e-12
    np.testing.assert_allclose(beside.y[:2], alone.y, rtol=1e-5)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("copies", [[1.0, 1.0], [1.0, 1.0, 2.0], [1.0, -1.0]])
def test_free_forms_of_one_span_are_one_form_with_multipliers_as_small(seed, copies):
    """Their multiples may cancel; what is left must not rest on the rounding of large ones."""
    q = hermitian(np.random.default_rng(seed), 3, 4)
    q[0] += 5 * np.eye(4)
    once = lmi.maximise_level(q, lmi.cone([*2 * [("psd", 1)], ("free", 1)]), relative=1e-6)
    twice = lmi.maximise_level(
        np.stack([q[0], q[1], *(k * q[2] for k in copies)]),
        lmi.cone([*2 * [("psd", 1)], *len(copies) * [("free", 1)]]),
        relative=1e-6,
    )
    assert twice.x == pytest.approx(once.x, rel=1e-5) and twice.x_above >= once.x * (1 - 1e-9)
    assert np.abs(twice.y).max() < 2 * np.abs(once.y).max()


def test_a_matrix_of_which_an_eigenvalue_is_zero_is_not_inside():
    assert not lmi._interior(lmi.cone([("psd", 2)]), np.array([1.0, 0.0, 0.0, 0.0]))


def test_a_step_is_not_tried_once_it_is_a_ten_billionth():
    c, q = lmi.cone([("psd", 1)]), np.eye(2)[None]
    still = np.zeros(2)
    assert lmi._feasible_step(q, c, np.ones(1), 0.0, still, 1e-10) is None
    assert lmi._feasible_step(q, c, np.ones(1), 0.0, still, 1.1e-10)[3] == 1.1e-10


def test_the_rounding_counts_rows_and_not_forms():
    assert lmi.rounding(np.ones(3), np.ones((3, 2, 2))) == pytest.approx(4 * 2 * 2.0**-52 * 3 * 2, abs=0)


def test_what_nothing_ends_is_divided_by_nothing():
    still, rising = np.zeros((1, 2, 2)), np.stack([np.zeros((2, 2)), 4 * np.eye(2)])
    with np.errstate(all="raise"):
        assert lmi.reach(np.eye(2), still).tolist() == [np.inf]
        assert lmi.reaches(np.eye(2)[None], rising, np.zeros(1)) == pytest.approx(np.array([[np.inf, 0.25]]))


def test_a_zero_must_be_positive_by_more_than_its_error_left_once_more():
    """1 - error has to be above error."""
    times = lmi.reaches(np.stack([np.eye(2)] * 2), np.eye(2)[None], np.array([0.5, 0.499]))
    assert times[0, 0] == -np.inf and times[1, 0] == pytest.approx(0.501)


def test_a_ray_is_asked_eighty_levels_at_most(monkeypatch):
    """Each proof leads a tenth further, from 1e-60 on."""
    tried: list[float] = []

    def level(q, c, *, relative, absolute):
        tried.append(float(-q[0, 0, 0].real))
        return lmi.Centre(np.ones(1), 1.0, np.inf, np.eye(1))

    monkeypatch.setattr(lmi, "maximise_level", level)
    monkeypatch.setattr(lmi, "reach", lambda *_: [1.1 * tried[-1] or 1e-60])
    one = np.ones((1, 1, 1), complex)
    length, y, _ = lmi._ray_length_numpy(0 * one, one, lmi.cone([("psd", 1)]), np.inf)
    assert len(tried) == 80 and length == 1.1 * tried[-1] and y is not None
