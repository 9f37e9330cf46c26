"""One node of the core's J1939 module, compiled and driven step by step in its own time."""

import ctypes
from collections.abc import Callable, Iterable
from pathlib import Path

from lpvguard.base import native

HERE = Path(__file__).resolve().parent
LIB = HERE.parents[2] / "lib"
STEP_US = 10_000
FRAMES_OUT = 8  # LPVG_J1939_FRAMES_OUT
ANSWER_MAX = 67  # LPVG_UDS_ANSWER_MAX


def library() -> ctypes.CDLL:
    """The module and its plain arguments (j1939_node.cpp); one node a process."""
    path = native.compile_shared(
        [
            LIB / "src" / "guard" / "can.cpp",
            LIB / "src" / "services" / "j1939.cpp",
            LIB / "src" / "services" / "uds.cpp",
            HERE / "j1939_node.cpp",
        ],
        flags=("-O1", "-std=c++17", "-ffp-contract=off"),
        include_dirs=[LIB / "include", LIB / "src"],
        name="j1939_node",
    )
    lib = ctypes.CDLL(str(path))
    lib.node_name.restype = ctypes.c_uint64
    lib.node_uds.restype = ctypes.c_size_t
    return lib


class Node:
    """Frames handed to ``receive`` are taken by the next step; what a step sends goes to ``send``, as
    identifier and bytes."""

    def __init__(self, name: int, address: int, send: Callable[[int, bytes], None]):
        self.lib = library()
        self.now_us = 0
        self.codes: list[tuple[int, int]] = []
        self._send = send
        self._received: list[tuple[int, bytes]] = []
        assert self.lib.node_start(ctypes.c_uint64(name), address, ctypes.c_int64(0)) == 0

    @property
    def address(self) -> int:
        """254: none."""
        return self.lib.node_address()

    def receive(self, can_id: int, data: Iterable[int]) -> None:
        self._received.append((can_id, bytes(data)))

    def step(self) -> None:
        self.now_us += STEP_US
        frames, self._received = self._received, []
        n, n_codes = len(frames), len(self.codes)
        ids_out, data_out = (ctypes.c_uint32 * FRAMES_OUT)(), (ctypes.c_uint8 * (8 * FRAMES_OUT))()
        sent = self.lib.node_step(
            ctypes.c_int64(self.now_us),
            (ctypes.c_uint32 * n)(*(can_id for can_id, _ in frames)),
            (ctypes.c_uint8 * n)(*(len(data) for _, data in frames)),
            b"".join(data.ljust(8, b"\xff") for _, data in frames),
            ctypes.c_size_t(n),
            (ctypes.c_uint32 * n_codes)(*(spn for spn, _ in self.codes)),
            (ctypes.c_uint8 * n_codes)(*(fmi for _, fmi in self.codes)),
            ctypes.c_size_t(n_codes),
            ids_out,
            data_out,
        )
        assert sent >= 0
        for i in range(sent):
            self._send(ids_out[i], bytes(data_out[8 * i : 8 * i + 8]))

    def uds(self, request: bytes) -> bytes:
        """What the node answers to a request that ISO-TP has put together; empty: nothing."""
        answer = (ctypes.c_uint8 * ANSWER_MAX)()
        n = self.lib.node_uds(request, ctypes.c_size_t(len(request)), answer)
        return bytes(answer[:n])

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds * 1e6 / STEP_US)):
            self.step()
