"""The factor with which B_w covers every frame's disturbance jointly, from the frames that can decide it."""

import numpy as np
import pytest

from lpvguard.identify.bounds import covering, undominated


@pytest.mark.parametrize("n_y", [1, 2, 3])
def test_the_undominated_frames_are_those_that_no_other_reaches_in_every_output(n_y):
    sizes = np.random.default_rng(n_y).integers(0, 12, (400, n_y)).astype(float)
    rows = {tuple(row) for row in undominated(sizes)}
    reached = (sizes[:, None] <= sizes[None]).all(axis=2) & (sizes[:, None] < sizes[None]).any(axis=2)
    assert rows == {tuple(row) for row in sizes[~reached.any(axis=1)]}
    assert len(undominated(sizes)) == len(rows)


def test_the_covering_factor_of_parts_is_that_of_all_frames():
    random = np.random.default_rng(1)
    w, B_w = np.abs(random.standard_normal((3000, 2))), np.array([[2.0, 0.5], [1.0, 3.0]])
    parts = np.concatenate([undominated(part) for part in np.split(w, 10)])
    factors = covering([undominated(parts), np.zeros((0, 2))], B_w)
    assert factors[0] == np.sqrt(((w / B_w[0]) ** 2).sum(axis=1).max()) and np.isnan(factors[1])
    assert covering([np.array([[1.0, 1.0]])], np.array([[0.0, 2.0]]))[0] == 0.5
