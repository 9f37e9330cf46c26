"""The core's UDS answers, read by udsoncan over can-isotp: both ends of ISO-TP in one thread."""

import struct
from collections import deque

import pytest
from j1939_node import Node

isotp = pytest.importorskip("isotp", reason="pip install can-isotp")
udsoncan = pytest.importorskip("udsoncan", reason="pip install udsoncan")
client = pytest.importorskip("udsoncan.client")
connections = pytest.importorskip("udsoncan.connections")

STATE, FREEZE, NAME = 0x4C00, 0x4C01, 0x4C02
CODES = [(1000 + i, 2) for i in range(16)]
HELD = struct.Struct("<HBHHIB")  # speed, bin, statistic, causes, time, run
FROZEN = (round(12.5 * 3.6 * 256), 9, 1536, 0x1240)
"""What j1939_node.cpp freezes, but for time and run."""


def number(spn: int, fmi: int) -> int:
    """A code as UDS counts: the first of its three bytes is the highest."""
    return (spn & 0xFF) << 16 | (spn >> 8 & 0xFF) << 8 | (spn >> 16) << 5 | fmi


class Raw(udsoncan.DidCodec):
    """So many bytes."""

    def __init__(self, size: int):
        super().__init__()
        self.size = size

    def encode(self, *values):
        return bytes(values[0])

    def decode(self, payload):
        return bytes(payload)

    def __len__(self):
        return self.size


class OneThread(connections.BaseConnection):
    """The tester's end. Waiting for an answer lets both ends of ISO-TP and the node work."""

    def __init__(self, node: Node):
        super().__init__()
        to_node: deque = deque()
        to_tester: deque = deque()
        self.node = node
        # Normal fixed addressing: 29 bits, node 0xFC, tester 0xF9.
        addressing = isotp.AddressingMode.NormalFixed_29bits
        self.tester_end = isotp.TransportLayerLogic(
            lambda timeout: to_tester.popleft() if to_tester else None,
            to_node.append,
            isotp.Address(addressing, source_address=0xF9, target_address=0xFC),
        )
        self.node_end = isotp.TransportLayerLogic(
            lambda timeout: to_node.popleft() if to_node else None,
            to_tester.append,
            isotp.Address(addressing, source_address=0xFC, target_address=0xF9),
        )

    def open(self):
        return self

    def close(self):
        pass

    def is_open(self):
        return True

    def empty_rxqueue(self):
        while self.tester_end.available():
            self.tester_end.recv()

    def specific_send(self, payload: bytes, timeout=None):
        self.tester_end.send(payload)

    def specific_wait_frame(self, timeout=None):
        for _ in range(100):
            for end in (self.tester_end, self.node_end):
                end.process()
            if self.node_end.available() and (answer := self.node.uds(bytes(self.node_end.recv()))):
                self.node_end.send(answer)
            if self.tester_end.available():
                return bytes(self.tester_end.recv())
        raise udsoncan.exceptions.TimeoutException("no answer")


@pytest.fixture
def node():
    one = Node(0x0102030405060708, 0xFC, lambda can_id, data: None)
    one.codes = CODES
    one.step()
    one.codes = CODES[1:]
    one.step()
    return one


@pytest.fixture
def tester(node):
    config = {
        **udsoncan.configs.default_client_config,
        "data_identifiers": {STATE: Raw(4), FREEZE: Raw(16), NAME: Raw(8)},
        "dtc_snapshot_did_size": 2,
    }
    # A snapshot holds the freeze frame without code and count.
    return lambda **other: client.Client(OneThread(node), config={**config, **other})


@pytest.mark.requirement("REQ-J1939-12")
def test_a_tester_reads_codes_by_status(tester):
    every = tester().get_dtc_by_status_mask(0xFF).service_data
    assert {dtc.id for dtc in every.dtcs} == {number(*code) for code in CODES}
    assert every.status_availability.get_byte_as_int() == 0x09
    active = tester().get_dtc_by_status_mask(0x01).service_data
    assert {dtc.id for dtc in active.dtcs} == {number(*code) for code in CODES[1:]}
    assert all(dtc.status.test_failed and dtc.status.confirmed for dtc in active.dtcs)


@pytest.mark.requirement("REQ-J1939-12")
def test_a_tester_reads_the_freeze_frame_and_the_count(tester):
    code = number(*CODES[0])
    one = tester(data_identifiers={FREEZE: Raw(12)}).get_dtc_snapshot_by_dtc_number(code, 1).service_data
    (dtc,) = one.dtcs
    assert dtc.id == code and dtc.status.get_byte_as_int() == 0x08
    (snapshot,) = dtc.snapshots
    assert snapshot.record_number == 1 and snapshot.did == FREEZE
    assert HELD.unpack(snapshot.data) == (*FROZEN, 10, 1)  # found in the first step, after 10 ms
    extended = tester().get_dtc_extended_data_by_dtc_number(code, 1, data_size=1).service_data
    assert [(e.record_number, e.raw_data) for e in extended.dtcs[0].extended_data] == [(1, b"\x01")]


@pytest.mark.requirement("REQ-J1939-12")
def test_a_tester_reads_identifiers_and_is_told_what_is_refused(tester):
    values = tester().read_data_by_identifier(STATE).service_data.values
    assert values[STATE] == bytes([2, 0xFC, 15, 16])
    name = tester().read_data_by_identifier(NAME).service_data.values[NAME]
    assert int.from_bytes(name, "little") == 0x0102030405060708
    newest = tester().read_data_by_identifier(FREEZE).service_data.values[FREEZE]
    assert newest[:4] == bytes([number(*CODES[-1]) >> 16, 3, 2, 1])
    for ask, why in (
        (lambda c: c.get_dtc_snapshot_by_dtc_number(number(5, 5), 1), "RequestOutOfRange"),
        (lambda c: c.get_supported_dtc(), "SubFunctionNotSupported"),
        (lambda c: c.tester_present(), "ServiceNotSupported"),
    ):
        with pytest.raises(udsoncan.exceptions.NegativeResponseException) as refused:
            ask(tester())
        assert refused.value.response.code_name == why
