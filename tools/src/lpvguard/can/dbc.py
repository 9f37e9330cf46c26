"""Write our DBC from the catalogue, for cantools, canmatrix and the usual bus tools.

The DBC marks every message as a J1939 parameter group (``VFrameFormat``) with its PGN and cycle time. It
states the SPN of every signal. The text depends only on the catalogue. The DBC does not describe unused bits,
which senders set to 1.
"""

from .catalogue import BusSignal, Catalogue, Message, load_catalogue

_EXTENDED = 0x80000000
_J1939_PG = 3
_ATTRIBUTES = """\
BA_DEF_ "BusType" STRING ;
BA_DEF_ "ProtocolType" STRING ;
BA_DEF_ BU_ "NmStationAddress" INT 0 255;
BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_ BO_ "PGN" INT 0 262143;
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ SG_ "SPN" INT 0 524287;
BA_DEF_DEF_ "BusType" "";
BA_DEF_DEF_ "ProtocolType" "";
BA_DEF_DEF_ "NmStationAddress" 254;
BA_DEF_DEF_ "VFrameFormat" "J1939PG";
BA_DEF_DEF_ "PGN" 0;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_DEF_DEF_ "SPN" 0;
BA_ "BusType" "CAN";
BA_ "ProtocolType" "J1939";
"""


def _number(value: float) -> str:
    return f"{value:.15g}"


def _signal(signal: BusSignal) -> str:
    return (
        f" SG_ {signal.name} : {signal.start}|{signal.length}@1+ "
        f"({_number(signal.scale)},{_number(signal.offset)}) "
        f'[{_number(signal.physical_min)}|{_number(signal.physical_max)}] "{signal.unit}" Vector__XXX\n'
    )


def _message(catalogue: Catalogue, message: Message) -> str:
    lines = [f"BO_ {message.id | _EXTENDED} {message.name}: 8 {catalogue.sender(message).name}\n"]
    if message.e2e:
        lines += [
            ' SG_ e2e_crc : 0|8@1+ (1,0) [0|255] "" Vector__XXX\n',
            ' SG_ e2e_counter : 8|4@1+ (1,0) [0|14] "" Vector__XXX\n',
        ]
    lines += [_signal(signal) for signal in message.signals]
    return "".join(lines)


def _comment(message: Message) -> str:
    return message.title + (f"; E2E profile 11, data id 0x{message.e2e.data_id:04X}" if message.e2e else "")


def dbc_text(catalogue: Catalogue | None = None) -> str:
    """Write the DBC of a catalogue.

    Parameters
    ----------
    catalogue : Catalogue, optional, by default the shipped one

    Returns
    -------
    str
    """
    catalogue = catalogue or load_catalogue()
    parts = [
        'VERSION "lpvguard"\n\nNS_ :\n\nBS_:\n\n',
        "BU_: " + " ".join(n.name for n in catalogue.nodes) + "\n\n",
    ]
    parts += [_message(catalogue, m) + "\n" for m in catalogue.messages]
    parts += [f'CM_ BU_ {n.name} "{n.comment}";\n' for n in catalogue.nodes]
    parts += [f'CM_ BO_ {m.id | _EXTENDED} "{_comment(m)}";\n' for m in catalogue.messages]
    parts += [
        f'CM_ SG_ {m.id | _EXTENDED} {s.name} "positive: {s.positive}";\n'
        for m in catalogue.messages
        for s in m.signals
        if s.positive
    ]
    parts.append(_ATTRIBUTES)
    parts += [f'BA_ "NmStationAddress" BU_ {n.name} {n.address};\n' for n in catalogue.nodes]
    for m in catalogue.messages:
        parts += [
            f'BA_ "{key}" BO_ {m.id | _EXTENDED} {value};\n'
            for key, value in (("VFrameFormat", _J1939_PG), ("PGN", m.pgn), ("GenMsgCycleTime", m.period_ms))
        ]
    parts += [
        f'BA_ "SPN" SG_ {m.id | _EXTENDED} {s.name} {s.spn};\n'
        for m in catalogue.messages
        for s in m.signals
        if s.spn
    ]
    parts += [
        f"VAL_ {m.id | _EXTENDED} {s.name} "
        + " ".join(f'{raw} "{name}"' for name, raw in s.values.items())
        + " ;\n"
        for m in catalogue.messages
        for s in m.signals
        if s.values
    ]
    return "".join(parts)
