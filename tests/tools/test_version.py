"""One version for the package, the core, CMake, the citation and the changelog's newest release."""

from __future__ import annotations

import json
import re
import tomllib

import lpvguard
from made import ROOT


def test_every_place_names_the_same_version():
    def first(file: str, pattern: str) -> str:
        return re.search(pattern, (ROOT / file).read_text(encoding="utf-8"), re.MULTILINE)[1]

    stated = {
        "tools/pyproject.toml": tomllib.loads((ROOT / "tools/pyproject.toml").read_text())["project"][
            "version"
        ],
        "CMakeLists.txt": first("CMakeLists.txt", r"^project\(lpvguard VERSION (\S+)"),
        "CITATION.cff": first("CITATION.cff", r"^version: (\S+)"),
        "CHANGELOG.md": first("CHANGELOG.md", r"^## (\d+\.\d+\.\d+)"),
    }
    stated |= {
        "lib/conanfile.py": first("lib/conanfile.py", r'^    version = "(\S+)"'),
        "lib/INTEGRATION.md": first("lib/INTEGRATION.md", r"require `lpvguard/(\d+\.\d+\.\d+)`"),
        "lib/idf_component.yml": first("lib/idf_component.yml", r'^version: "(\S+)"'),
        **{
            name: json.loads((ROOT / name).read_text())["version"]
            for name in ("lib/library.json", "lib/vcpkg.json")
        },
    }
    manifests = sorted((ROOT / "lib/vehicles").glob("*/MANIFEST.json"))
    assert len(manifests) > 1
    stated |= {str(m): json.loads(m.read_text())["tool"].removeprefix("lpvguard ") for m in manifests}
    assert stated == dict.fromkeys(stated, lpvguard.__version__)
