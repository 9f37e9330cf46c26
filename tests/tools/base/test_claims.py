"""What is said of a moving speed."""

from lpvguard.base.claims import claim_words


def test_a_level_is_said_where_it_is_not_one():
    assert claim_words("stability", 1.0, 2.8) == "robust stability for |dv/dt| up to 2.8 m/s²"
    assert claim_words("performance", 1.625, 1.0) == (
        "robust performance, A_t and A_u over 1.62, for |dv/dt| up to 1 m/s²"
    )
