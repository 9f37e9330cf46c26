"""Results kept in a folder: the same bits, less work, and a damaged file is computed anew."""

import filecmp
import shutil
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from lpvguard.base.errors import InputError
from lpvguard.base.kept_results import KIND, KeptResults, decoded, digest_of, encoded
from lpvguard.drives.tables import list_experiments
from lpvguard.identify import identification as stage
from lpvguard.identify.bounds import fold
from lpvguard.identify.calibration import Peak
from lpvguard.identify.over_drives import Origins
from lpvguard.identify.passes import Judged, error_sums_of


def back(value):
    arrays: list[np.ndarray] = []
    return decoded(encoded(value, arrays), arrays)


def test_a_value_comes_back_with_its_types_and_bits():
    value = {
        "a": (1, 2.5, None, True, "x", float("inf")),
        3: [np.float32(0.1), np.arange(6.0).reshape(2, 3)[:, ::2], np.array([1j, np.nan])],
        "texts": np.array(["ab", "c"], object),
        "peak": Peak(0.1, 3),
    }
    restored = back(value)
    assert restored["a"] == value["a"] and [type(x) for x in restored["a"]] == [type(x) for x in value["a"]]
    for a, b in zip(restored[3], value[3], strict=True):
        assert type(a) is type(b) and a.dtype == b.dtype and a.tobytes() == b.tobytes()
    assert restored["texts"].dtype == object and list(restored["texts"]) == ["ab", "c"]
    assert restored["peak"] == value["peak"]
    judged = Judged(1.0, None, None, None, None, 2.0, {"frame": Peak(1.0)})
    assert back(judged) == judged and type(back(judged)) is Judged
    assert vars(back(Origins())).keys() == vars(Origins()).keys()


@dataclass
class OfTheTests:
    x: int = 0


@pytest.mark.parametrize("value", [OfTheTests(), {1}, b"", lambda: 0, np.array([None])])
def test_a_value_that_the_codec_does_not_know_is_refused(value):
    with pytest.raises(TypeError):
        encoded(value, [])


def test_a_form_that_names_another_class_is_refused():
    for kind in ("os:system", "lpvguard.base.errors:InputError", "lpvguard.identify.passes:judge"):
        with pytest.raises(ValueError, match="no class of results"):
            decoded({kind: []}, [])


def test_the_digest_is_that_of_the_table_and_of_all_arguments(synthetic, tmp_path):
    e = list_experiments(synthetic)[0]
    copy = tmp_path / e.path.name
    shutil.copy(e.path, copy)
    assert digest_of(replace(e, path=copy)) == digest_of(e) != digest_of(replace(e, group="dry"))
    copy.write_bytes(copy.read_bytes() + b"\n")
    assert digest_of(replace(e, path=copy)) != digest_of(e)
    x = np.arange(4.0)
    tasks = [partial(fold, a, b=b) for a, b in [(x, 1), (x, 2), (x + 1, 1), (x.reshape(2, 2), 1), (x, 1.0)]]
    assert len({digest_of(task) for task in [*tasks, fold]}) == 6
    with pytest.raises(TypeError):
        digest_of(partial(error_sums_of, lambda: 0))


def test_another_folder_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match=f"holds no {KIND}"):
        KeptResults(tmp_path)
    (tmp_path / "MANIFEST.json").write_text('{"kind": "identify"}')
    with pytest.raises(InputError, match=f"holds no {KIND}"):
        KeptResults(tmp_path)


def test_a_damaged_result_is_computed_anew_and_unused_ones_are_dropped(tmp_path):
    items, task = [np.arange(3.0), np.arange(4.0)], partial(np_sum, 2.0)
    first = KeptResults(tmp_path / "kept")
    assert list(first.over(map)(task, items)) == [6.0, 12.0] and (first.read, first.computed) == (0, 2)
    assert list(first.over(map)(lambda x: x.sum(), items)) == [3.0, 6.0] and first.computed == 2
    kept = sorted((tmp_path / "kept").glob("*.kept"))
    data = kept[0].read_bytes()
    for at in range(len(data)):
        kept[0].write_bytes(data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :])
        assert list(KeptResults(tmp_path / "kept").over(map)(task, items)) == [6.0, 12.0]
    again = KeptResults(tmp_path / "kept")
    assert list(again.over(map)(task, items[:1])) == [6.0] and (again.read, again.computed) == (1, 0)
    again.drop_unused()
    assert len(list((tmp_path / "kept").glob("*.kept"))) == 1


def np_sum(factor: float, x: np.ndarray) -> float:
    return float(factor * x.sum())


np_sum.__module__ = "lpvguard.tests"  # the folder keeps the results of the package's functions only


def one_by_one(project, drives: Path, first: int, tmp_path: Path) -> list[tuple[int, int]]:
    """Identify with the ``first`` drives, then with one more at a time; results read and computed. The last
    one has the bits of all drives at once."""
    index = (drives / "experiments.csv").read_text().splitlines(keepends=True)
    folder, counts = tmp_path / "drives", []
    folder.mkdir()
    for path in drives.iterdir():
        (folder / path.name).symlink_to(path)
    (folder / "experiments.csv").unlink()
    for n in range(first, len(index)):
        (folder / "experiments.csv").write_text("".join(index[: n + 1]))
        kept = KeptResults(tmp_path / "kept")
        stage.save(*stage.identify(project, folder, workers=kept.over(map)), tmp_path / "grown")
        kept.drop_unused()
        counts.append((kept.read, kept.computed))
    stage.save(*stage.identify(project, folder), tmp_path / "at_once")
    names = sorted(p.name for p in (tmp_path / "at_once").iterdir())
    assert names == sorted(p.name for p in (tmp_path / "grown").iterdir())
    assert filecmp.cmpfiles(tmp_path / "at_once", tmp_path / "grown", names, False) == (names, [], [])
    return counts


def test_drives_identified_one_by_one_give_the_bits_of_all_at_once(g80, synthetic, tmp_path):
    counts = one_by_one(g80, synthetic, 14, tmp_path)
    assert all(computed < 10 < 80 < read for read, computed in counts[1:])


@pytest.mark.unhurried
def test_measured_drives_identified_one_by_one_give_the_bits_of_all_at_once(g80, measured, tmp_path):
    one_by_one(g80, measured, 4, tmp_path)
