"""The layout of the coefficients: what is generated from it stands in the tree, and what does not fit it is
refused by name."""

from dataclasses import replace

import numpy as np
import pytest

from lpvguard.base import layout
from lpvguard.base.errors import InputError
from lpvguard.base.layout import COEFF, CONTROL
from lpvguard.core.compiled import Core, library_root, shipped_vehicle


def test_the_generated_files_are_those_of_the_tree():
    stale = [
        str(path)
        for path, text in layout.generated(library_root()).items()
        if path.read_text(encoding="utf-8") != text
    ]
    assert not stale, "run `python -m lpvguard.base.layout`"


def test_a_changed_table_changes_header_checks_and_manual():
    words = tuple(replace(f, within="[2, inf)") if f.name == "energy_rearm" else f for f in COEFF.words)
    changed = replace(COEFF, words=words)
    assert layout.header_block(changed) != layout.header_block(COEFF)
    assert "x >= 2U" in "\n".join(layout._checks(changed))


def test_a_header_without_its_marks_is_refused(tmp_path):
    (tmp_path / "include/lpvguard").mkdir(parents=True)
    (tmp_path / "include/lpvguard/coeff.h").write_text("no marks")
    with pytest.raises(InputError, match=r"coeff\.h: the marks"):
        layout.generated(tmp_path)


@pytest.fixture(scope="module")
def truck():
    return Core(shipped_vehicle("truck"))


def test_the_fields_of_the_compiled_core_have_the_shapes_of_the_table(truck):
    fields = truck.fields(truck.compiled[1])
    assert list(fields) == [f.name for f in COEFF.reals]
    assert truck.sizes["NBANDS"] == 3 and fields["energy_corner"].shape == (2,)
    assert fields["cell"].shape == (truck.sizes["NCELLS"], truck.sizes["NVARYING"], 4)
    directions = fields["energy_direction"]
    assert directions.shape == (truck.sizes["NDIRECTIONS"], 2)
    assert np.allclose(np.abs(directions).sum(axis=1), 1)
    with pytest.raises(AssertionError, match="items by the layout"):
        truck.fields(truck.compiled[1][:-1])


def parts(core):
    """The compiled-in words and numbers in the shapes that an exporter gives."""
    words, reals = core.words, core.fields(core.compiled[1])
    return [
        {f.name: values[f.name] if f.shape else values[f.name][0] for f in fields}
        for fields, values in ((COEFF.words, words), (COEFF.reals, reals))
    ]


@pytest.mark.parametrize("part", ["words", "reals"])
def test_what_the_core_holds_is_accepted_in_any_order(truck, part):
    values = parts(truck)[part == "reals"]
    packed = COEFF.packed(part, dict(reversed(values.items())), truck.sizes, "here")
    assert list(packed) == [f.name for f in getattr(COEFF, part)]
    assert np.array_equal(
        np.concatenate([np.ravel(v) for v in packed.values()]), truck.compiled[part == "reals"]
    )


@pytest.mark.parametrize(
    ("part", "name", "value", "says"),
    [
        ("reals", "base", np.zeros(3), r"here: base: shape \(3,\); expected \(24,\), NENTRIES of coeff.h"),
        ("reals", "speed_max", np.zeros(1), r"speed_max: shape \(1,\); expected \(\), scalar"),
        ("reals", "threshold", np.nan, "threshold: not finite"),
        ("reals", "threshold", 0.0, r"threshold: 0.0; expected every item within \(0, inf\)"),
        ("reals", "speed_min", 22.0, r"speed_min: 22.0; expected every item within \(0, speed_max\)"),
        ("reals", "energy_corner", np.array([0.1, 1.0]), r"energy_corner: .* \(0, 1\)"),
        ("words", "confirm", 2, r"confirm: 2; expected every item within \[1, of_last\]"),
        ("words", "of_last", 9, r"of_last: 9; .*NHISTORY"),
        ("words", "varying_entry", np.full(15, 24), r"varying_entry: .* \[0, NENTRIES\)"),
        ("reals", "tread", 1.0, "tread: missing or unknown"),
    ],
)
def test_a_field_that_does_not_fit_is_named(truck, part, name, value, says):
    values = parts(truck)[part == "reals"] | {name: value}
    with pytest.raises(InputError, match=says):
        COEFF.packed(part, values, truck.sizes, "here")


def test_a_missing_field_is_named(truck):
    values = parts(truck)[1]
    del values["W_delta"]
    with pytest.raises(InputError, match="W_delta: missing or unknown"):
        COEFF.packed("reals", values, truck.sizes, "here")


def test_every_dimension_is_one_of_a_struct():
    assert set(layout.DIMENSIONS) == set(COEFF.dimensions) | set(CONTROL.dimensions)


@pytest.mark.parametrize(
    ("n_y", "n_delta", "bins", "latency"),
    [
        (1, 1, 11, 3 + 5 + 11),
        (2, 1, 11, 3 + 5 + 22),
        (2, 2, 11, 3 + 5 + 11),
        (4, 1, 64, 3 + 32 + 128),
        (4, 4, 64, 3 + 32 + 64),
    ],
)
def test_the_latency_of_the_core_is_that_of_its_header(n_y, n_delta, bins, latency):
    assert layout.constant("NLATENCY", {"NY": n_y, "NDELTA": n_delta, "NBINS": bins}) == latency
