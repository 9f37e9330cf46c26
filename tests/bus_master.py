"""A small importer for FMUs with a CAN terminal of FMI-LS-BUS, by fmpy: two of them, directly connected."""

import struct
from pathlib import Path
from xml.etree import ElementTree

import fmpy
from fmpy.fmi3 import FMU3Slave

TRANSMIT = 0x10
MEMBERS = {"Rx_Data", "Rx_Clock", "Tx_Data", "Tx_Clock"}


def transmit(identifier: int, data: bytes) -> bytes:
    """Operation that sends an extended CAN frame."""
    return struct.pack("<IIIBBH", TRANSMIT, 16 + len(data), identifier, 1, 0, len(data)) + data


def operations(data: bytes) -> list[tuple[int, bytes]]:
    """Operations of a terminal's data: (code, content)."""
    operations = []
    while data:
        code, length = struct.unpack_from("<II", data)
        operations.append((code, data[8:length]))
        data = data[length:]
    return operations


def frames(data: bytes) -> list[tuple[int, bytes]]:
    """CAN frames of a terminal's data: (identifier, bytes)."""
    return [
        (struct.unpack_from("<I", content)[0], content[8:])
        for code, content in operations(data)
        if code == TRANSMIT
    ]


class Node:
    """An instance of an FMU with a CAN terminal, in event mode."""

    def __init__(self, path: Path, folder: Path, **parameters: object):
        description = fmpy.read_model_description(str(path))
        self.variables = {v.name: v for v in description.modelVariables}
        self.period = float(description.defaultExperiment.stepSize)
        self.said: list[str] = []
        self.terminal = self._terminal(Path(fmpy.extract(str(path), str(folder))))
        known = {u.variable.name: u.dependencies for u in description.outputs}
        self.after_reception = bool(known[self.terminal["Tx_Data"].name])
        self.fmu = FMU3Slave(
            guid=description.instantiationToken,
            unzipDirectory=str(folder),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName="node",
        )
        self.fmu.instantiate(
            eventModeUsed=True,
            logMessage=lambda _environment, _status, _category, text: self.said.append(text.decode()),
        )
        for name, value in parameters.items():
            setter = self.fmu.setBoolean if isinstance(value, bool) else self.fmu.setString
            setter([self.variables[name].valueReference], [value])
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def _terminal(self, folder: Path) -> dict:
        file = folder / "terminalsAndIcons" / "terminalsAndIcons.xml"
        if not file.is_file():
            raise ValueError(f"{folder}: no terminalsAndIcons.xml; expected a CAN terminal")
        terminal = ElementTree.parse(file).find("Terminals/Terminal")
        assert terminal.get("terminalKind") == "org.fmi-ls-bus.network-terminal"
        assert terminal.get("matchingRule") == "org.fmi-ls-bus.transceiver"
        members = {m.get("memberName"): m.get("variableName") for m in terminal}
        assert set(members) == MEMBERS
        return {member: self.variables[name] for member, name in members.items()}

    def _of(self, member: str) -> list[int]:
        return [self.terminal[member].valueReference]

    def receive(self, data: bytes) -> None:
        """Give it operations, in event mode."""
        if data:
            self.fmu.setClock(self._of("Rx_Clock"), [True])
            self.fmu.setBinary(self._of("Rx_Data"), [data])

    def send(self) -> bytes:
        """Let its clock tick, in event mode; returns its operations."""
        self.fmu.setClock(self._of("Tx_Clock"), [True])
        return self.fmu.getBinary(self._of("Tx_Data"))[0]

    def step(self, t: float, period: float | None = None) -> None:
        """From event mode through a step back into event mode."""
        self.fmu.updateDiscreteStates()
        self.fmu.enterStepMode()
        self.fmu.doStep(t, period or self.period)
        self.fmu.enterEventMode()

    def state(self) -> bytes:
        """The serialized state."""
        kept = self.fmu.getFMUState()
        data = bytes(self.fmu.serializeFMUState(kept))
        self.fmu.freeFMUState(kept)
        return data

    def restore(self, data: bytes) -> None:
        kept = self.fmu.deserializeFMUState(data)
        self.fmu.setFMUState(kept)
        self.fmu.freeFMUState(kept)

    def number(self, name: str) -> int:
        return self.fmu.getInt64([self.variables[name].valueReference])[0]


def exchange(nodes: list[Node]) -> list[bytes]:
    """Let both clocks tick and pass on what is sent; the one that answers comes second."""
    first, second = sorted(nodes, key=lambda node: node.after_reception)
    sent = first.send()
    second.receive(sent)
    answer = second.send()
    first.receive(answer)
    return [sent, answer]
