"""The core's J1939 module against a second implementation, can-j1939.

Each claims against the other; the peer asks, and reads what the node says. Frames are handed over directly,
in the node's own time."""

import ctypes
import random

import pytest
from j1939_node import Node, library

j1939 = pytest.importorskip("j1939", reason="pip install can-j1939")

OWN, TOOL = 0xFC, 0xF9
DM2, DM3 = 65227, 65228
ACKNOWLEDGE, CLAIM = 59392, 60928
CODES = [(520206, 12), (904, 9), (520201, 31)]
FIELDS = {
    "identity_number": 21,
    "manufacturer_code": 11,
    "ecu_instance": 3,
    "function_instance": 5,
    "function": 8,
    "vehicle_system": 7,
    "vehicle_system_instance": 4,
    "industry_group": 3,
    "arbitrary_address_capable": 1,
}
"""Of a NAME: bits, in the order of node_name."""


class Bus:
    """A node of the core and a peer of can-j1939, each hearing the other. ``heard``: what the peer put
    together, (pgn, source, bytes)."""

    def __init__(self, own_name: int, peer_name: int, peer_address: int = TOOL):
        self.heard: list[tuple[int, int, bytes]] = []
        self.sent: list[tuple[int, bytes]] = []
        self.peer = j1939.ElectronicControlUnit(send_message=self._from_peer)
        self.application = j1939.ControllerApplication(
            j1939.Name(value=peer_name), peer_address, bypass_address_claim=True
        )
        self.peer.add_ca(controller_application=self.application)
        self.application.subscribe(self._hear)
        self.node = Node(own_name, OWN, self._from_node)

    def _from_peer(self, can_id: int, extended: bool, data: list[int], fd_format: bool = False) -> None:
        assert extended and not fd_format
        self.node.receive(can_id, data)

    def _from_node(self, can_id: int, data: bytes) -> None:
        self.sent.append((can_id, data))
        self.peer.notify(can_id, bytearray(data), 0.0)

    def _hear(self, priority: int, pgn: int, source: int, timestamp: float, data: list[int]) -> None:
        self.heard.append((pgn, source, bytes(data)))

    def claims(self) -> list[int]:
        """Source addresses of the node's claims."""
        return [can_id & 0xFF for can_id, _ in self.sent if (can_id >> 8) & 0x3FF00 == CLAIM]


@pytest.fixture
def bus():
    made: list[Bus] = []

    def make(*arguments: int) -> Bus:
        made.append(Bus(*arguments))
        return made[-1]

    yield make
    for one in made:
        one.peer.stop()


@pytest.mark.requirement("REQ-J1939-11")
def test_names_are_packed_alike():
    rng, lib = random.Random(3), library()
    for _ in range(300):
        fields = {name: rng.getrandbits(bits) for name, bits in FIELDS.items()}
        words = (ctypes.c_uint32 * len(fields))(*fields.values())
        assert lib.node_name(words) == j1939.Name(**fields).value, fields


@pytest.mark.requirement("REQ-J1939-11")
def test_the_peer_gives_way_to_a_lower_name_and_the_node_to_a_lower_one(bus):
    ours = bus(0x100, 0x200, OWN)
    ours.node.step()
    assert ours.application.state == j1939.ControllerApplication.State.CANNOT_CLAIM
    ours.node.run(0.5)
    assert ours.node.address == OWN and ours.claims() == [OWN]

    theirs = bus(0x300, 0x200, OWN)
    theirs.node.run(0.5)
    assert theirs.application.state == j1939.ControllerApplication.State.NORMAL
    assert theirs.node.address == 254 and theirs.claims() == [OWN, 254]

    mobile = bus(1 << 63 | 0x300, 0x200, OWN)
    mobile.node.run(0.5)
    assert mobile.node.address == 128 and mobile.claims() == [OWN, 128]


@pytest.mark.requirement("REQ-J1939-11")
def test_the_peer_reads_one_code_and_many_as_they_were_found(bus):
    one = bus(0x100, 0x200)
    heard = []
    reader = j1939.Dm1(one.application)
    reader.subscribe(lambda source, lamps, codes, timestamp: heard.append((source, lamps, codes)))
    one.node.run(0.5)
    assert heard[-1][1]["awl"] == j1939.DtcLamp.OFF
    for codes in (CODES[:1], CODES):
        one.node.codes = codes
        one.node.run(0.5)
        source, lamps, read = heard[-1]
        assert source == OWN and lamps["awl"] == j1939.DtcLamp.ON
        assert [(c["spn"], c["fmi"], c["oc"]) for c in read] == [(spn, fmi, 1) for spn, fmi in codes]


@pytest.mark.requirement("REQ-J1939-11")
def test_the_peer_asks_clears_and_is_refused(bus):
    one = bus(0x100, 0x200)
    one.node.codes = CODES
    one.node.run(1.5)
    one.node.codes = CODES[:1]
    one.node.run(1.5)
    one.application.send_request(0, DM2, OWN)
    one.node.run(0.5)
    (message,) = [data for pgn, _, data in one.heard if pgn == DM2]
    codes = [j1939.DTC(dtc=int.from_bytes(message[i : i + 4], "little")) for i in range(2, len(message), 4)]
    assert [(c.spn, c.fmi, c.oc) for c in codes] == [(spn, fmi, 1) for spn, fmi in CODES[1:]]

    def answered(pgn: int) -> list[tuple[int, int]]:
        one.heard.clear()
        one.application.send_request(0, pgn, OWN)
        one.node.run(0.5)
        return [
            (d[0], d[4]) for p, _, d in one.heard if p == ACKNOWLEDGE and d[5:8] == pgn.to_bytes(3, "little")
        ]

    assert answered(DM3) == [(0, TOOL)]
    assert answered(65262) == [(1, TOOL)]
    one.heard.clear()
    j1939.Dm11(one.application).request_clear_all(255)
    one.application.send_request(0, DM2, 255)
    one.node.run(1.5)
    assert [d for p, _, d in one.heard if p == DM2] == [bytes([4, 255, 0, 0, 0, 0, 255, 255])]
    assert not [d for p, _, d in one.heard if p == ACKNOWLEDGE]
