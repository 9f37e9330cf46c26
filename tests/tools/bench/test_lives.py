"""`lpvguard bench lives`: a small pool by default, the full one with LPVGUARD_FULL=1."""

import json

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.base.rates import rate
from lpvguard.extras.bench import lives, run
from lpvguard.extras.bench.lives import GAINS, Pool, drifting_lives, healthy_lives, make_pool


@pytest.fixture(scope="module")
def normal() -> Pool:
    """Made-up scores: normal, and larger the smaller the gain, by two standard deviations at 0.9."""
    random = np.random.default_rng(1)
    own = random.standard_normal(400)
    scores = np.column_stack([own + 20.0 * (1.0 - gain) + 5.0 for gain in GAINS]).astype(np.float32)
    return Pool(scores, np.zeros(scores.shape, bool))


@pytest.mark.parametrize("n", [11, 100])
def test_healthy_lives_keep_their_rate(normal, n):
    rates = healthy_lives(normal, n, 400, 500, 1)
    assert rates["ever"]["interval"][0] <= 0.05
    assert rates["outside"]["interval"][0] <= 0.05 <= rates["outside"]["interval"][1] + 0.03
    assert rates["worst_sets"]["of"] == 20 * lives.AGAIN
    assert 0.0 <= rates["worst_set"] <= 1.0
    hourly, hours = rates["ever_per_1000_judged_h"], 400 * 500 / 60
    assert hourly["rate"] == pytest.approx(1000 * rates["ever"]["count"] / hours, rel=0.1)
    assert hourly["interval"][0] <= hourly["rate"] <= hourly["interval"][1]


def test_a_life_beyond_its_set_is_found_and_the_false_are_told_apart(normal):
    rates = drifting_lives(normal, 100, 20, 300, 1)
    assert rates["in_time"]["count"] + rates["false"]["count"] <= 300
    assert rates["in_time"]["count"] > 200
    assert rates["before_stated_gain"]["count"] < rates["in_time"]["count"]
    never = Pool(np.repeat(normal.scores[:, :1], len(GAINS), axis=1), normal.alarmed)
    assert drifting_lives(never, 100, 20, 300, 1)["in_time"]["count"] < 10


@pytest.mark.unhurried
def test_the_pool_is_of_core_run_drives_whose_scores_grow_with_wear():
    pool = make_pool(6, 0.0, 1)
    assert pool.scores.shape == (6, len(GAINS))
    assert (np.diff(pool.scores[:, 2:], axis=1) > 0).all() and pool.scores[:, -1].mean() > 1
    assert (pool.scores[:, -1] > pool.scores[:, 0]).all()
    assert not pool.alarmed[:, 0].any() and pool.alarmed[:, -1].any()
    np.testing.assert_array_equal(pool.scores[:3], make_pool(3, 0.0, 1).scores)


@pytest.mark.unhurried
def test_the_command_prints_and_writes_the_table(tmp_path, capsys):
    out = tmp_path / "lives.json"
    small = ["--drives", "12", "--lives", "20", "--recordings", "30", "--json", str(out)]
    run("lives", small)
    text, result = capsys.readouterr().out, json.loads(out.read_text())
    assert "pool: 12 core-run drives" in text and "n = 100" in text
    assert result["healthy"][1]["earliest"] == 3 and result["healthy"][0]["ever"]["of"] == 20
    with pytest.raises(InputError, match="--lives"):
        run("lives", ["--lives", "0"])


@pytest.mark.long("10^4 lives from 300 drives")
def test_the_full_pool_keeps_the_rate_and_finds_the_drift(capsys):
    result = lives.bench_lives(make_pool(300, 0.03, 1), 10_000, 1000, 1)
    with capsys.disabled():
        print(lives.words(result))
    for healthy in result["healthy"]:
        assert healthy["ever"]["interval"][1] <= 0.05 + 0.05
        inside = healthy["ever"]["of"] - healthy["outside"]["count"]
        assert healthy["outside"]["interval"][0] <= 0.05
        assert rate(healthy["ever"]["count"], inside)["interval"][0] <= 0.05
    for drift in (d for d in result["drifting"] if d["n"] == 100):
        assert drift["in_time"]["interval"][0] >= 0.9
