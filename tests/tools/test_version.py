"""One version for the package, the core, CMake, the citation and the changelog's newest release."""

import lpvguard
from made import ROOT
from parts import release


def test_every_place_names_the_same_version():
    stated = release().stated_versions(ROOT)
    assert len(stated) >= 11 and sum("MANIFEST" in name for name in stated) > 1
    assert stated == dict.fromkeys(stated, lpvguard.__version__)
