"""MATLAB's files as tables: what is read, and what is refused before scipy looks at it."""

import contextlib
import struct
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from lpvguard.base.errors import InputError
from lpvguard.can.matlab import read_matlab

DOUBLES, BYTES, MATRIX, COMPRESSED = 9, 1, 14, 15


def element(kind: int, data: bytes, order: str = "<") -> bytes:
    return struct.pack(order + "II", kind, len(data)) + data + bytes(-len(data) % 8)


def variable(
    order: str = "<",
    *,
    flags: int = 6,
    sides: tuple[int, ...] = (3, 1),
    name: bytes = b"speed",
    kind: int = DOUBLES,
    described: tuple[int, int, int] = (6, 5, 1),
    size: int = 24,
) -> bytes:
    """The numbers 1, 2 and 3 as the format lays out its parts; ``size``: bytes that they are said to be."""
    of_flags, of_sides, of_name = described
    numbers = np.arange(1.0, 4.0).astype(order + "f8").tobytes()
    body = element(of_flags, struct.pack(order + "II", flags, 0), order)
    body += element(of_sides, struct.pack(f"{order}{len(sides)}i", *sides), order)
    body += element(of_name, name, order)
    return element(MATRIX, body + struct.pack(order + "II", kind, size) + numbers, order)


def packed(content: bytes) -> bytes:
    data = zlib.compress(content)
    return struct.pack("<II", COMPRESSED, len(data)) + data


def written(path: Path, *variables: bytes, order: str = "<", version: int = 0x100) -> Path:
    head = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + struct.pack(order + "H", version)
    path.write_bytes(head + {"<": b"IM", ">": b"MI"}[order] + b"".join(variables))
    return path


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_byte_orders_are_read(order, tmp_path):
    table = read_matlab(written(tmp_path / "a.mat", variable(order), order=order))
    assert table.to_pydict() == {"speed": [1.0, 2.0, 3.0]}


def test_names_of_at_most_four_letters_and_what_is_compressed_are_read(tmp_path):
    small = struct.pack("<HH", 1, 2) + b"ab" + bytes(2)
    short = variable(name=b"").replace(element(1, b""), small)
    short = short[:4] + struct.pack("<I", len(short) - 8) + short[8:]
    table = read_matlab(written(tmp_path / "a.mat", short, packed(variable()), variable(name=b"w" * 63)))
    assert table.column_names == ["ab", "speed", "w" * 63]
    assert set(map(tuple, table.to_pydict().values())) == {(1.0, 2.0, 3.0)}


@pytest.mark.parametrize("options", [{"format": "4"}, {}, {"do_compression": True}, {"oned_as": "column"}])
def test_vectors_of_numbers_are_columns_and_all_else_is_left_out(options, tmp_path):
    kinds = ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4")
    if options.get("format") != "4":
        kinds += ("i8", "u8", ">f8")
    columns = {f"column_{k}": np.arange(5).astype(kind) for k, kind in enumerate(kinds)}
    others = {"text": "of the car", "scalar": 2.0, "table": np.eye(5), "wave": np.arange(5) * 1j}
    if options.get("format") != "4":
        others |= {
            "cells": np.array([1, "two"], object),
            "record": {"a": 1.0},
            "cube": np.zeros((5, 2, 2)),
            "nothing": np.zeros((0, 5)),
        }
    savemat(tmp_path / "a.mat", columns | others, **options)
    table = read_matlab(tmp_path / "a.mat")
    assert table.to_pydict() == {name: list(range(5)) for name in columns}


def test_vectors_in_structures_are_columns(tmp_path):
    t = np.arange(5.0)
    of_simulink = {"time": t, "signals": {"values": 2 * t, "label": "v"}}
    inside = {"yaw": 3 * t, "name": "car", "sides": [1.0, 2.0], "none": np.zeros((0, 0))}
    for compressed in (False, True):
        variables = {"speed": of_simulink, "log": {"vehicle": inside}, "long": np.arange(2e4).reshape(2, -1)}
        savemat(tmp_path / "a.mat", variables, do_compression=compressed)
        table = read_matlab(tmp_path / "a.mat")
        read = {n: np.array(column).tolist() for n, column in table.to_pydict().items()}
        assert read.pop("log.vehicle.yaw") == [0, 3, 6, 9, 12]
        assert read == {"speed.time": [0, 1, 2, 3, 4], "speed": [0, 2, 4, 6, 8]}
    savemat(tmp_path / "a.mat", {"log": {"yaw": t}})
    whole = (tmp_path / "a.mat").read_bytes()
    for at in range(128, len(whole), 2):  # each is read, or refused
        for byte in (7, 255):
            (tmp_path / "b.mat").write_bytes(whole[:at] + bytes([byte]) + whole[at + 1 :])
            with contextlib.suppress(InputError):
                read_matlab(tmp_path / "b.mat")


DAMAGED = {
    "a type that scipy's table does not have": (variable(kind=200), r"\[3, 1\] numbers of type 200"),
    "a type of another size": (variable(kind=7), r"\[3, 1\] numbers of type 7 in 24 bytes"),
    "more numbers than bytes": (variable(sides=(4, 1)), r"\[4, 1\] numbers of type 9 in 24 bytes"),
    "more bytes than the variable": (
        variable(sides=(1 << 20, 1), size=1 << 23),
        "numbers of type 9 in 8388608 bytes",
    ),
    "flags of another type": (variable(described=(5, 5, 1)), "a description of type 5 with 8 bytes"),
    "sides of another type": (variable(described=(6, 9, 1)), "a description of type 9 with 8 bytes"),
    "a name of another type": (variable(described=(6, 5, 9)), "a description of type 9 with 5 bytes"),
    "a name without an end": (variable(name=b"w" * 5000), "a description of type 1 with 5000 bytes"),
    "no variable": (element(DOUBLES, bytes(8)), "a variable of type 9 with 8 bytes"),
    "a variable that is cut": (variable()[:-1], "a variable ends behind the file"),
    "a tag that is cut": (variable() + bytes(4), "cannot be parsed"),
    "what is no zlib": (struct.pack("<II", COMPRESSED, 8) + bytes(8), "error: Error -3"),
    "more than zlib can make": (
        packed(struct.pack("<II", MATRIX, 1 << 30) + variable()[8:]),
        "a variable of type 14 with 1073741824 bytes",
    ),
}


@pytest.mark.parametrize("what", DAMAGED)
def test_a_damaged_variable_is_refused(what, tmp_path):
    """Found by fuzz/foreign_input.py: of a type that there is not, scipy ended the process."""
    content, why = DAMAGED[what]
    if what == "a name without an end":  # of a compressed one no more is read than describes it
        content = packed(content)
    with pytest.raises(InputError, match=rf"a\.mat: cannot be parsed .*{why}|{why}") as error:
        read_matlab(written(tmp_path / "a.mat", content))
    assert "save -v7" in str(error.value)


def test_versions_that_are_no_matlab_5_are_left_to_scipy(tmp_path):
    for version, why in ((0x200, "HDF"), (0x900, "Unknown mat file type")):
        with pytest.raises(InputError, match=why):
            read_matlab(written(tmp_path / "a.mat", variable(), version=version))


def test_a_file_of_version_7_3_is_read_by_h5py(tmp_path):
    path, of_text = tmp_path / "a.mat", {"MATLAB_class": np.bytes_(b"char")}
    with h5py.File(path, "w", userblock_size=512) as file:
        for name in ("time", "log/speed", "bus/signals/values"):
            file[name] = np.arange(30.0).reshape(1, 30)
        file["note"] = np.array([[104], [105]], np.uint16)
        file["note"].attrs.update(of_text)
        file["#refs#/x"] = np.arange(3.0)
        file["table"] = np.ones((3, 30))
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    assert read_matlab(path).column_names == ["bus", "log.speed", "time"]
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(InputError, match="cannot be parsed"):
        read_matlab(path)
