"""Generate the C code (C99) that packs values into frames of a car's own bus, such as a controller's demands.

The demands' files are ``lpvg_demand.h`` and ``lpvg_demand.c``. The code scales, rounds and saturates the
values, increments the counters, and writes the named checksums. The caller sets the bits of other signals.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .decode import signal_pieces
from .own import Sent
from .own_code import BANNER, frame_to_check
from .protection import PROTECTIONS, check_source

if TYPE_CHECKING:
    from cantools.database.can import Signal as CarSignal

    from .own import Bits

DEMAND = "demand"


def demand_files(demands: list[Sent], n_u: int) -> dict[str, str]:
    """Generate the C code that packs the demands of ``n_u`` inputs: text by file name."""
    header, source = packing(DEMAND, demands, n_u)
    return {
        f"lpvg_{DEMAND}.h": enclosed(DEMAND, header),
        f"lpvg_{DEMAND}.c": f'{BANNER}#include "lpvg_{DEMAND}.h"\n\n#include <math.h>\n{source}',
    }


def enclosed(name: str, declarations: str) -> str:
    """C header of the files ``name`` around its declarations."""
    guard = f"LPVG_{name.upper()}_H"
    return f"""{BANNER}#ifndef {guard}
#define {guard}

#include "lpvguard/can.h"

#ifdef __cplusplus
extern "C" {{
#endif

{declarations}
#ifdef __cplusplus
}}
#endif
#endif
"""


def packing(name: str, messages: list[Sent], n: int) -> tuple[str, str]:
    """Generate declarations and definitions that pack ``n`` values into frames: ``lpvg_NAME_pack`` and
    others.
    """
    macro, longest = f"LPVG_{name.upper()}", max(m.message.car.length for m in messages)
    declared = (
        f"lpvg_status_t lpvg_{name}_pack(const float* u, uint16_t* counters, lpvg_{name}_frame_t* frames)"
    )
    header = f"""\
#define {macro}_INPUTS {n}u
#define {macro}_MESSAGES {len(messages)}u
#define {macro}_BYTES {longest}u

/* A frame of the car: identifier with its flags (can.h), and data [length]. */
typedef struct lpvg_{name}_frame_t {{
    uint32_t id;
    uint8_t length;
    uint8_t data[{macro}_BYTES];
}} lpvg_{name}_frame_t;

/* Packs values u [{macro}_INPUTS], in the units of the signal table, into frames [{macro}_MESSAGES]:
 * scaled, rounded, saturated at the signals' ends; then steps counters [{macro}_MESSAGES] and puts in
 * counter and checksum. Zero-initialise counters and frames before first use; bits of other signals are kept.
 * Returns bad_argument, changing nothing, when a pointer is NULL or a value is not finite. */
LPVG_NODISCARD {declared};
"""
    names: set[str] = {m.message.checksum_name for m in messages if m.message.checksum_name}
    parts = [check_source(names), _STEP]
    parts += [_pack(name, i, m) for i, m in enumerate(messages)]
    finite = "".join(f" || !isfinite(u[{k}])" for k in range(n))
    calls = "".join(f"    pack_{i}(u, &counters[{i}], &frames[{i}]);\n" for i in range(len(messages)))
    parts.append(
        f"\n{declared}\n{{\n"
        f"    if ((u == NULL) || (counters == NULL) || (frames == NULL){finite}) {{\n"
        "        return lpvg_status_bad_argument;\n    }\n"
        f"{calls}    return lpvg_status_ok;\n}}\n"
    )
    return header, "".join(parts)


_STEP = """
/* The whole number nearest to value, within least and most. */
static double step_of(double value, double least, double most)
{
    const double rounded = floor(value + 0.5);
    return (rounded < least) ? least : ((rounded > most) ? most : rounded);
}
"""


def _write(bits: Bits, name: str) -> list[str]:
    """C statements that write the integer ``name`` into the bits of a signal in ``data``."""
    lines, shift = [], 0
    for byte, low, count in reversed(signal_pieces(bits)):
        mask = (1 << count) - 1
        lines.append(
            f"    data[{byte}] = (uint8_t)((data[{byte}] & 0x{0xFF & ~(mask << low):02X}u) | "
            f"((({name} >> {shift}) & 0x{mask:X}u) << {low}));\n"
        )
        shift += count
    return lines


def _pack(name: str, index: int, sent: Sent) -> str:
    """C function that packs one message."""
    m = sent.message
    declared = [
        "    uint8_t* data = frame->data;\n",
        f"    const uint32_t id = 0x{m.identifier:08X}u;\n",
        f"    const uint32_t length = {m.car.length}u;\n",
        "    double left;\n",
        "    double step;\n",
        "    uint32_t raw;\n",
    ]
    lines = ["    frame->id = id;\n", "    frame->length = (uint8_t)length;\n"]
    if m.selector is not None:
        lines += [f"    raw = {m.selected[0]}u;\n", *_write(m.selector, "raw")]
    signs = {c.name: c.sign for c in m.signals}
    for signals, k, factor in sent.signals:
        lines.append(f"    left = {factor!r} * (double)u[{k}];\n")
        for s, following in zip(signals, [*signals[1:], None], strict=True):
            lines += _summand(s, signs[s.name], following)
    if m.counter is not None:
        counters = m.counters
        lines += [
            f"    *counter = (uint16_t)((*counter + 1u) % {counters}u);\n",
            "    raw = *counter;\n",
            *_write(m.counter, "raw"),
        ]
    else:
        lines.append("    (void)counter;\n")
    if m.checksum_name is not None and m.checksum is not None:
        more, assigned = frame_to_check(m, m.checksum)
        declared += more
        lines += [*assigned, f"    raw = {PROTECTIONS[m.checksum_name].function}(&checked);\n"]
        lines += _write(m.checksum, "raw")
    head = [
        f"\n/* {m.car.name} */\n"
        f"static void pack_{index}(const float* u, uint16_t* counter, lpvg_{name}_frame_t* frame)\n{{\n",
        *declared,
    ]
    return "".join([*head, *lines, "}\n"])


def _summand(s: CarSignal, sign: Bits | None, following: CarSignal | None) -> list[str]:
    """C statements that put a signal's part of ``left`` into the frame; ``following`` takes the remainder."""
    scale, offset = float(s.scale), float(s.offset)
    least = -(1 << (s.length - 1)) if s.is_signed else 0
    most = least + (1 << s.length) - 1
    # A remainder for an unsigned signal is not negative.
    down = " - 0.5" if following is not None and not following.is_signed else ""
    lines, value = [], "left"
    if sign is not None:
        lines += ["    raw = (left < 0.0) ? 1u : 0u;\n", *_write(sign, "raw")]
        value = "fabs(left)"
    lines.append(f"    step = step_of(({value} - {offset!r}) / {scale!r}{down}, {least}.0, {most}.0);\n")
    lines += ["    raw = (uint32_t)(int64_t)step;\n", *_write(s, "raw")]
    if following is not None:
        lines.append(f"    left -= {scale!r} * step + {offset!r};\n")
    return lines
