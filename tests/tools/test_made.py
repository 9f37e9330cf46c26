"""The folders that tests share (tests/made.py): made once, whole, for one state of the sources, and not
changed unnoticed."""

from concurrent.futures import ThreadPoolExecutor

import pytest

import made


@pytest.fixture
def sources(monkeypatch):
    """Sets the digest of the sources."""
    return lambda digest: monkeypatch.setattr(made, "sources_digest", lambda: digest)


def one_file(folder):
    folder.mkdir()
    (folder / "file").write_text("content")


def test_of_several_that_ask_together_one_makes_the_folder(tmp_path, sources):
    sources("now")
    calls = []

    def ask(_):
        with made.store(tmp_path) as store:
            return store.folder("thing", lambda folder: (calls.append(1), one_file(folder)))

    with ThreadPoolExecutor(4) as pool:
        folders = set(pool.map(ask, range(4)))
    assert calls == [1] and (folders.pop() / "file").read_text() == "content" and not folders


def test_a_folder_whose_making_breaks_off_is_not_there(tmp_path, sources):
    sources("now")

    def breaks_off(folder):
        one_file(folder)
        raise RuntimeError("half made")

    with made.store(tmp_path) as store:
        with pytest.raises(RuntimeError, match="half made"):
            store.folder("thing", breaks_off)
        assert (store.folder("thing", one_file) / "file").is_file()


@pytest.mark.parametrize(
    "change",
    [
        lambda f: (f / "file").write_text("other"),
        lambda f: (f / "more").touch(),
        lambda f: (f / "file").unlink(),
    ],
)
def test_a_changed_folder_is_named_and_made_anew(tmp_path, sources, change):
    sources("now")
    with made.store(tmp_path) as store:
        folder = store.folder("thing", one_file)
        assert store.changed() == []
        change(folder)
        assert store.changed() == ["thing"] and not folder.exists()


def test_folders_of_other_sources_go_when_no_run_holds_them(tmp_path, sources):
    sources("held")
    with made.store(tmp_path) as held:
        held.folder("thing", one_file)
        sources("new")
        with made.store(tmp_path):
            assert held.root.is_dir()
    with made.store(tmp_path):
        assert not held.root.exists()


def test_any_changed_byte_or_name_changes_the_digest(tmp_path):
    one_file(tmp_path / "a")
    first = made.digest_of(tmp_path / "a")
    (tmp_path / "a" / "file").rename(tmp_path / "a" / "elif")
    assert made.digest_of(tmp_path / "a") != first
