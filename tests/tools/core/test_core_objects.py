"""Compiled parts of a core: what vehicles share, and what each compiles for itself."""

import shutil

from lpvguard.core.compiled import OF_NO_VEHICLE, Core, core_objects, library_root, shipped_vehicle


def by_name(objects):
    """Path by the name of the source."""
    return {path.name.rsplit("-", 1)[0]: path for path in objects}


def test_vehicles_that_differ_in_numbers_alone_compile_the_numbers_alone(tmp_path):
    shipped, other = shipped_vehicle("g80"), tmp_path / "elsewhere" / "g80"
    shutil.copytree(shipped, other)
    table = other / "lpvguard_coeff.c"
    table.write_text(table.read_text() + "/* other bytes */\n")
    ours, theirs = (by_name(core_objects(folder)) for folder in (shipped, other))
    assert {name for name in ours if ours[name] != theirs[name]} == {"lpvguard_coeff"}
    trucks = by_name(core_objects(shipped_vehicle("truck")))
    assert {name for name in ours if ours[name] == trucks[name]} == OF_NO_VEHICLE


def test_a_changed_source_alone_is_compiled_anew(tmp_path):
    shipped, lib = shipped_vehicle("g80"), tmp_path / "lib"
    shutil.copytree(library_root(), lib)
    source = lib / "src" / "monitor" / "change.cpp"
    source.write_text(source.read_text() + "// other bytes\n")
    ours, theirs = by_name(core_objects(shipped)), by_name(core_objects(shipped, source_root=lib))
    assert {name for name in ours if ours[name] != theirs[name]} == {"change"}
    assert Core(shipped).library != Core(shipped, source_root=lib).library
