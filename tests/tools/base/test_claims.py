"""What is read from certificates: words of a moving speed, the worst of the frozen ones."""

from lpvguard.base.claims import claim_words, worst_frozen


def test_a_level_is_said_where_it_is_not_one():
    assert claim_words("stability", 1.0, 2.8) == "robust stability for |dv/dt| up to 2.8 m/s²"
    assert claim_words("performance", 1.625, 1.0) == (
        "robust performance, A_t and A_u over 1.62, for |dv/dt| up to 1 m/s²"
    )


def test_the_worst_frozen_speed_may_lie_on_the_grid_or_off_it():
    def certificates(*mu: float, off_grid: float) -> dict:
        rows = [{"v_mps": float(v), "mu_upper": one} for v, one in enumerate(mu)]
        return {"speeds": rows, "off_grid": {"v_mps": 0.5, "mu_upper": off_grid}}

    assert worst_frozen(certificates(0.7, 0.9, off_grid=0.8))["v_mps"] == 1.0
    assert worst_frozen(certificates(0.7, 0.9, off_grid=0.95))["v_mps"] == 0.5
