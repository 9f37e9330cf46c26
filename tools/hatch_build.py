"""Put the C core's sources into the wheel and into the source archive, so that both stand alone."""

from pathlib import Path

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CoreSources(BuildHookInterface):
    """Name lib/ where the package looks for it. An unpacked source archive holds it already."""

    def initialize(self, version, build_data):
        lib = Path(self.root).parent / "lib"
        if version == "standard" and (lib / "CMakeLists.txt").is_file():
            inside = "src/lpvguard" if self.target_name == "sdist" else "lpvguard"
            build_data["force_include"][str(lib)] = f"{inside}/_lib"
