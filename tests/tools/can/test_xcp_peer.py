"""The core's XCP slave, read by pyxcp: a session, memory, and a list of data after each step."""

import ctypes
import queue
import struct
from pathlib import Path

import can
import pytest

from lpvguard.base import native
from lpvguard.extras.measure.xcp_access import OPTIONAL_COMMANDS, XcpAccess, if_data

pytest.importorskip("pyxcp", reason="pip install pyxcp")
from pyxcp.transport.can import CanInterfaceBase
from pyxcp.types import Command, XcpResponseError

from xcp_master import TO_MASTER, TO_SLAVE, Rows, master

HERE = Path(__file__).resolve().parent
LIB = HERE.parents[2] / "lib"
PLACE, FRAMES = 0x20000000, 8
EXTENDED = 0x80000000


class Slave(CanInterfaceBase):
    """The slave at the other end of a bus in this process."""

    def __init__(self) -> None:
        path = native.compile_shared(
            [LIB / "src" / "services" / "xcp.cpp", HERE / "xcp_slave.cpp"],
            flags=("-O1", "-std=c++17"),
            include_dirs=[LIB / "include", LIB / "src"],
            name="xcp_slave",
        )
        self.lib = ctypes.CDLL(str(path))
        self.lib.slave_receive.restype = self.lib.slave_event.restype = ctypes.c_size_t
        assert self.lib.slave_start(TO_SLAVE, TO_MASTER) == 0
        self.sent: queue.Queue[can.Message] = queue.Queue()
        self._filters: list = []

    def write(self, offset: int, data: bytes) -> None:
        self.lib.slave_write(offset, data, ctypes.c_size_t(len(data)))

    def step(self) -> int:
        """A step ends; returns the frames that the slave sends."""
        data, lengths = (ctypes.c_uint8 * (8 * FRAMES))(), (ctypes.c_uint8 * FRAMES)()
        n = self.lib.slave_event(data, lengths)
        for i in range(n):
            self._send(bytes(data[8 * i : 8 * i + lengths[i]]))
        return n

    def _send(self, data: bytes) -> None:
        self.sent.put(can.Message(arbitration_id=TO_MASTER ^ EXTENDED, is_extended_id=True, data=data))

    def send(self, msg: can.Message) -> None:
        assert len(msg.data) <= 8
        answer = (ctypes.c_uint8 * 8)()
        can_id = msg.arbitration_id | (EXTENDED if msg.is_extended_id else 0)
        n = self.lib.slave_receive(can_id, bytes(msg.data), ctypes.c_uint8(len(msg.data)), answer)
        if n:
            self._send(bytes(answer[:n]))

    def recv(self, timeout: float | None = None) -> can.Message | None:
        try:
            return self.sent.get(timeout=timeout)
        except queue.Empty:
            return None

    def set_filters(self, filters=None) -> None:
        self._filters = filters

    @property
    def filters(self):
        return self._filters

    @property
    def state(self):
        return can.BusState.ACTIVE


@pytest.fixture
def slave() -> Slave:
    return Slave()


@pytest.mark.requirement("REQ-XCP-6")
def test_a_master_connects_and_reads_memory(slave):
    slave.write(16, bytes(range(100, 200)))
    with master(bus=slave) as tool:
        said = tool.connect()
        assert (said.maxCto, said.maxDto) == (8, 8)
        assert tool.slaveProperties.supportsDaq and not tool.slaveProperties.supportsCalpag
        assert tool.identifier(0) == "a slave to read"
        tool.setMta(PLACE + 16)
        assert bytes(tool.fetch(100)) == bytes(range(100, 200))
        with pytest.raises(XcpResponseError):
            tool.shortUpload(4, PLACE + 254)
        with pytest.raises(XcpResponseError):
            tool.download(b"\x01")
        tool.disconnect()


@pytest.mark.requirement("REQ-XCP-6")
def test_a_master_lists_what_every_step_left(slave):
    """Three frames: numbers of all sizes, the first fit of pyxcp."""
    rows = Rows(
        [
            ("t", PLACE, "U32"),
            ("small", PLACE + 5, "I8"),
            ("wide", PLACE + 8, "F32"),
            ("word", PLACE + 14, "U16"),
        ]
    )
    with master(rows, bus=slave) as tool:
        tool.connect()
        events = tool.getDaqInfo()["channels"]
        assert [(e["name"], e["unit"], e["cycle"]) for e in events] == [
            ("step", "EVENT_CHANNEL_TIME_UNIT_100US", 100)
        ]
        rows.setup()
        assert slave.step() == 0
        rows.start()
        wanted = []
        for k in range(50):
            row = {"t": 70_000 * k, "small": k - 25, "wide": k / 8, "word": 1000 + k}
            slave.write(0, struct.pack("=IxbxxfxxH", *row.values()))
            assert slave.step() > 1
            wanted.append(row)
        assert rows.wait_for(50) == wanted
        rows.stop()
        assert slave.step() == 0
        tool.disconnect()


@pytest.mark.requirement("REQ-XCP-6")
def test_a_master_asks_for_every_third_step(slave):
    rows = Rows([("k", PLACE, "U8")], prescaler=3)
    with master(rows, bus=slave) as tool:
        tool.connect()
        rows.setup()
        rows.start()
        for k in range(30):
            slave.write(0, bytes([k]))
            assert slave.step() == (k % 3 == 0)
        assert [row["k"] for row in rows.wait_for(10)] == list(range(0, 30, 3))
        rows.stop()
        tool.disconnect()


@pytest.mark.requirement("REQ-XCP-6")
def test_the_a2l_says_what_the_slave_says(slave):
    lines = if_data(XcpAccess(TO_SLAVE, TO_MASTER), 10_000, False, LIB / "include" / "lpvguard")
    words = " ".join(lines).replace('"', "").split()
    daq = words[words.index("DAQ") + 1 : words.index("PRESCALER_SUPPORTED") + 1]
    event = words[words.index("EVENT") + 1 : words.index("/end", words.index("EVENT"))]
    with master(bus=slave) as tool:
        said = tool.connect()
        assert words[words.index("PROTOCOL_LAYER") + 9 :][:2] == [str(said.maxCto), str(said.maxDto)]
        tool.freeDaq()
        tool.allocDaq(1)
        info = tool.getDaqInfo()
        processor, resolution = info["processor"], info["resolution"]
        properties, channel = processor["properties"], info["channels"][0]
        assert daq == [
            properties["configType"],
            str(processor["maxDaq"]),
            str(len(info["channels"])),
            str(processor["minDaq"]),
            "OPTIMISATION_TYPE_DEFAULT",
            "ADDRESS_EXTENSION_FREE",
            "IDENTIFICATION_FIELD_TYPE_ABSOLUTE",
            "GRANULARITY_ODT_ENTRY_SIZE_DAQ_BYTE",
            str(resolution["maxOdtEntrySizeDaq"]),
            "NO_OVERLOAD_INDICATION",
            "PRESCALER_SUPPORTED",
        ]
        assert processor["keyByte"] == {
            "identificationField": "IDF_ABS_ODT_NUMBER",
            "addressExtension": "AE_DIFFERENT_WITHIN_ODT",
            "optimisationType": "OM_DEFAULT",
        }
        assert properties["prescalerSupported"] and not properties["overloadMsb"]
        raw = tool.getDaqEventInfo(0)
        assert event == ["step", "step", "0", "DAQ", "1", str(raw.eventChannelTimeCycle), "5", "0"]
        assert (channel["name"], channel["unit"]) == ("step", "EVENT_CHANNEL_TIME_UNIT_100US")
        tool.disconnect()


@pytest.mark.requirement("REQ-XCP-6")
def test_the_commands_of_the_a2l_are_those_that_the_slave_knows(slave):
    """Of wrong length, so that nothing but what a command is called decides."""
    always = {"CONNECT", "DISCONNECT", "GET_STATUS", "SYNCH"}
    known = set()
    for command in Command:
        if command.name in always or not 0xC0 <= command.value <= 0xFF:
            continue
        slave.send(can.Message(arbitration_id=TO_SLAVE ^ EXTENDED, is_extended_id=True, data=b"\xff\x00"))
        slave.send(
            can.Message(arbitration_id=TO_SLAVE ^ EXTENDED, is_extended_id=True, data=bytes([command.value]))
        )
        connected, answer = slave.recv(1.0), slave.recv(1.0)
        assert connected and answer and connected.data[0] == 0xFF
        if bytes(answer.data[:2]) not in (b"\xfe\x20", b"\xfe\x24"):
            known.add(command.name)
    assert known == set(OPTIONAL_COMMANDS)
