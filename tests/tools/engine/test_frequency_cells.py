"""How cells are laid side by side over an interval of frequencies, with given bounds in place of mu's."""

from dataclasses import replace

import numpy as np
import pytest

from lpvguard.engine.blocks import Block
from lpvguard.engine.synthesis import frequency_cells as interval
from lpvguard.engine.synthesis.errors import SynthesisError
from lpvguard.engine.synthesis.frequency_cells import PointBound
from lpvguard.engine.synthesis.mu import mu_interval
from lpvguard.engine.synthesis.statespace import StateSpace, gain
from lpvguard.engine.synthesis.structure import Structure


def cell_of(G, point, level, centre, a, b):
    """The cell about ``centre`` by the test of Phi on G's own response."""
    return interval.cell(
        G, point, level, centre, a, b, lambda omega: interval._positive_on(G, point, level, omega)
    )


ONE = Structure((Block("full", 1, 1),))
LAG = StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
"""M = 1 / (1 + j omega) tells the frequency at which it is asked for."""


def frequency(M: np.ndarray) -> float:
    return float((1 / M[0, 0]).imag)


def bound(value: float) -> PointBound:
    return PointBound(value, *(np.ones((1, 1)) for _ in range(4)))


class Laid:
    """Record of the calls while cells of half a rad/s to either side cover an interval. ``values`` maps a
    frequency to the bound there, and ``held`` maps it to the bound by other scalings.
    """

    def __init__(self, monkeypatch, values, held=lambda omega: np.inf):
        self.asked: list[tuple[float, float]] = []
        self.cells: list[tuple[float, float, float, float, float]] = []
        self.values, self.proved = values, held
        monkeypatch.setattr(interval, "cell", self.cell)
        monkeypatch.setattr(interval, "_likely_peak", lambda *_: 1.7)

    def at(self, M: np.ndarray, largest: float) -> PointBound:
        self.asked.append((frequency(M), largest))
        return bound(self.values(frequency(M)))

    def held(self, M: np.ndarray, known: PointBound) -> float:
        return self.proved(frequency(M))

    def cell(self, G, point, level, centre, a, b, positive):
        self.cells.append((a, b, centre, point.value, level))
        return max(a, centre - 0.5), min(b, centre + 0.5)

    def cover(self, low=0.0, high=4.0, rtol=0.1):
        return interval.cover("here", LAG, ONE, low, high, rtol, self.at, self.held)


def test_cells_cover_the_interval_and_the_level_is_that_of_the_largest_bound(monkeypatch):
    laid = Laid(monkeypatch, lambda omega: 5.0 - omega)
    cells = laid.cover()
    covered = np.sort([(max(a, c - 0.5), min(b, c + 0.5)) for a, b, c, *_ in laid.cells], axis=0)
    assert covered[0, 0] == 0.0 and covered[-1, 1] == 4.0
    np.testing.assert_allclose(covered[1:, 0], covered[:-1, 1], rtol=1e-12)
    first = next(c for *_, c, _, _ in laid.cells)
    assert first == 1.7 and len(cells.cells) == len(laid.cells) == len(laid.asked) > 4
    values = np.array([5.0 - omega for omega, _ in laid.asked])
    before = np.r_[0.0, np.maximum.accumulate(values)[:-1]]
    np.testing.assert_allclose([largest for _, largest in laid.asked], before, rtol=1e-12)
    np.testing.assert_allclose(
        [level for *_, level in laid.cells], 1.1 * np.maximum.accumulate(values), rtol=1e-12
    )
    assert cells.largest == pytest.approx(values.max()) and cells.omega == pytest.approx(5.0 - values.max())
    assert cells.upper == pytest.approx(1.1 * values.max())


def test_scalings_that_prove_clearly_less_serve_again(monkeypatch):
    for proved, again in ((0.95 * 3.0, True), (0.9501 * 3.0, False)):
        laid = Laid(monkeypatch, lambda omega: 3.0, lambda omega, proved=proved: proved)
        cells = laid.cover()
        assert (len(laid.asked) == 1) == again and len(cells.cells) == len(laid.cells) > 4
        assert [value for *_, value, _ in laid.cells[1:]] == [proved if again else 3.0] * (
            len(cells.cells) - 1
        )
        assert cells.upper == pytest.approx(3.3) and cells.omega == pytest.approx(1.7)


def test_an_interval_without_a_bound_ends_the_search(monkeypatch):
    laid = Laid(monkeypatch, lambda omega: 1.0 if omega > 1.0 else np.inf)
    cells = laid.cover()
    assert cells.upper == cells.largest == np.inf and cells.omega <= 1.0
    assert len(cells.cells) == len(laid.cells) == len(laid.asked) - 1


def test_a_loop_without_a_gain_has_a_bound_above_zero(monkeypatch):
    cells = Laid(monkeypatch, lambda omega: 0.0).cover()
    assert cells.largest == 0.0 and cells.upper == 1e-12 and cells.omega == pytest.approx(1.7)


def test_too_many_cells_are_refused(monkeypatch):
    cells = len(Laid(monkeypatch, lambda omega: 1.0).cover().cells)
    monkeypatch.setattr(interval, "MOST_CELLS", cells)
    assert Laid(monkeypatch, lambda omega: 1.0).cover().cells.__len__() == cells
    monkeypatch.setattr(interval, "MOST_CELLS", cells - 1)
    with pytest.raises(SynthesisError, match=rf"here: .* rad/s: {cells - 1} cells do not cover it"):
        Laid(monkeypatch, lambda omega: 1.0).cover()


def test_half_the_rate_may_be_passed_by_its_rounding():
    discrete = StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.3)
    last = np.pi / 0.3 * (1 + 4 * interval.EPS)
    assert mu_interval(discrete, ONE.blocks, 0.0, last).upper == pytest.approx(2.0, rel=3e-3)
    with pytest.raises(SynthesisError, match="low, high"):
        mu_interval(discrete, ONE.blocks, 0.0, np.nextafter(last, np.inf))


def test_a_constant_loop_is_covered_by_one_cell_and_a_loop_that_does_not_decay_is_refused():
    interval = mu_interval(gain([[3.0]]), ONE.blocks, 0.0, np.inf)
    assert (
        len(interval.proof) == 1
        and interval.lower == pytest.approx(3.0)
        and interval.upper == pytest.approx(3.006)
    )
    for pole in (0.0, 0.1):
        with pytest.raises(SynthesisError, match="not stable"):
            mu_interval(StateSpace([[pole]], [[1.0]], [[1.0]], [[0.0]]), ONE.blocks, 0.0, 1.0)
    for blocks in ((Block("full", 2, 1),), (Block("full", 1, 2),)):
        with pytest.raises(SynthesisError, match="sums of the blocks' sides"):
            mu_interval(LAG, blocks, 0.0, 1.0)


def two_resonances() -> StateSpace:
    """Poles at 2 and 5 rad/s; the second is the higher peak."""
    A = np.zeros((4, 4))
    for k, (omega, damping) in enumerate(((2.0, 0.1), (5.0, 0.02))):
        A[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = [[0, omega], [-omega, -2 * damping * omega]]
    return StateSpace(A, [[0.0], [1.0], [0.0], [1.0]], [[1.0, 0.0, 1.0, 0.0]], [[0.0]])


@pytest.mark.parametrize("case", range(5))
def test_a_search_begins_at_the_pole_where_the_middles_scalings_prove_the_least(case):
    """Poles at the ends do not count as inside. Without a pole the middle is used, and no bound is computed
    there."""
    G, asked = two_resonances(), []
    first, second = (f(np.abs(G.poles())) for f in (np.min, np.max))
    cases = [(1.0, 9.0, 5.0), (1.0, 4.5, 2.0), (3.0, 3.5, None), (0.5, first, None), (second, 8.0, None)]
    a, b, start = cases[case]

    def at(M, largest):
        asked.append((M[0, 0], largest))
        return bound(1.0)

    peak = interval._likely_peak(G, at, lambda M, point: point.value * abs(M[0, 0]), a, b, 7.0)
    middle = interval.middle(a, b, 7.0)
    assert peak == pytest.approx(middle if start is None else start, rel=1e-9)
    assert asked == ([] if start is None else [(G.response([middle])[0, 0, 0], 0.0)])


def test_a_search_begins_in_the_middle_where_that_has_no_bound():
    held = None  # not asked
    assert interval._likely_peak(two_resonances(), lambda M, _: bound(np.inf), held, 1.0, 9.0, 7.0) == 3.0


def test_the_quadratic_form_of_scalings_is_that_of_their_definition():
    random = np.random.default_rng(1)
    M, left, skew = (random.standard_normal((2, *s)) for s in ((2, 3), (2, 2), (3, 2)))
    M, left, skew = M[0] + 1j * M[1], left[0] @ left[0].T + 0j, skew[0] + 1j * skew[1]
    left[0, 1] += 0.3j
    left[1, 0] -= 0.3j
    point = replace(bound(1.0), left=left, skew=skew)
    form = interval.quadratic(M, point)
    turned = skew @ M
    np.testing.assert_allclose(form, M.conj().T @ left @ M + 1j * (turned - turned.conj().T), rtol=1e-12)
    assert (form == form.conj().T).all(), "Hermitian to the last bit"


# --- one cell ---


def random_loop(seed: int) -> tuple[StateSpace, PointBound]:
    """A stable loop of 3 x 3, and scalings with a complex D and G."""
    random = np.random.default_rng(seed)
    A = random.standard_normal((3, 3))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(3)
    G = StateSpace(
        A, *(random.standard_normal((3, 3)) for _ in range(2)), 0.2 * random.standard_normal((3, 3))
    )
    D = np.diag(random.uniform(0.5, 2.0, 3)).astype(complex)
    D[:2, :2] = [[1.5, 0.3j], [-0.3j, 1.0]]
    skew = np.zeros((3, 3), complex)
    skew[:2, :2] = [[1.6, 0.4 + 0.8j], [0.4 - 0.8j, -1.2]]
    return G, PointBound(1.0, D, 0.05 * np.eye(3), D, skew)


def least(G: StateSpace, point: PointBound, level: float, omega) -> np.ndarray:
    """Least eigenvalue of Phi at ``omega`` (K,)."""
    forms = [interval.quadratic(M, point) for M in G.response(np.atleast_1d(omega))]
    return np.array([np.linalg.eigvalsh(point.fixed + level**2 * point.scaled - N)[0] for N in forms])


@pytest.mark.unhurried
@pytest.mark.parametrize("seed", [0, 1, 2, 8, 18])
@pytest.mark.parametrize("share", [0.5, 0.8, 0.95])
@pytest.mark.parametrize("b", [20.0, np.inf])
def test_a_cell_reaches_as_far_as_phi_is_positive(seed, share, b):
    G, point = random_loop(seed)
    grid = np.linspace(0.0, 20.0, 801)
    level = share * np.sqrt(1.0 - least(G, point, 1.0, grid).min())
    positive = least(G, point, level, grid) > 0
    for centre in grid[5:-5:100][positive[5:-5:100]]:
        left, right = cell_of(G, point, level, centre, 0.0, b)
        assert 0.0 <= left <= centre <= right <= b
        inside = np.linspace(left, min(right, 200.0), 400)
        assert (least(G, point, level, inside) > 0).all()
        if left > 0.0:
            assert least(G, point, level, left - 2e-3 * (centre - left))[0] < 0
        if right < b:
            assert least(G, point, level, right + 2e-3 * (right - centre))[0] < 0


def test_a_cell_goes_past_frequencies_that_are_nearly_singular():
    """A level a ten millionth above a resonance: eigenvalues lie near the axis, and Phi is positive there."""
    G = StateSpace([[-1e-4, 1.0], [-1.0, -1e-4]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    peak = np.abs(G.response(np.linspace(0.999, 1.001, 200001))[:, 0, 0]).max()
    point = replace(bound(peak), fixed=np.zeros((1, 1)), skew=np.zeros((1, 1)))
    assert interval._singular(G, point, peak * (1 + 1e-7)).size
    for b in (3.0, np.inf):
        for centre in (0.5, 2.0):
            assert cell_of(G, point, peak * (1 + 1e-7), centre, 0.1, b) == (0.1, b)
    left, right = cell_of(G, point, 0.5 * peak, 0.5, 0.0, np.inf)
    assert left == 0.0 and 0.99 < right < 1.0


def test_a_cell_of_a_gain_that_rises_ends_below_its_level():
    G = StateSpace([[-10.0]], [[1.0]], [[-100.0]], [[10.0]])  # 10 s / (s + 10)
    point = replace(bound(1.0), fixed=np.zeros((1, 1)), skew=np.zeros((1, 1)))
    edge = 10 / np.sqrt(100 / 25 - 1)  # where the gain is 5
    left, right = cell_of(G, point, 5.0, 1.0, 0.0, np.inf)
    assert left == 0.0 and right == pytest.approx(1.0 + 0.999 * (edge - 1.0), rel=1e-9)
    for level in np.linspace(2.0, 9.5, 40):
        edge = 10 / np.sqrt(100 / level**2 - 1)
        assert cell_of(G, point, level, 1.0, 0.0, np.inf)[1] < edge, "whatever rounding says at the edge"
    left, right = cell_of(G, replace(point, scaled=4 * point.scaled), 4.0, 1.0, 0.5, 9.0)
    assert left == 0.5 and right == 9.0, "8 is above the gain at 9"


def test_a_state_that_nothing_reaches_leaves_the_singular_frequencies():
    """The Hamiltonian has zeros, and is complex in other entries."""
    G, point = random_loop(1)
    A = np.diag([0.0, 0.0, 0.0, -1.0])
    A[:3, :3] = G.A
    more = StateSpace(A, np.vstack([G.B, np.zeros(3)]), np.column_stack([G.C, np.zeros(3)]), G.D)
    level = 0.8 * np.sqrt(1.0 - least(G, point, 1.0, np.linspace(0.0, 20.0, 801)).min())
    frequencies = interval._singular(G, point, level)
    assert frequencies.size
    np.testing.assert_allclose(interval._singular(more, point, level), frequencies, rtol=1e-8)
