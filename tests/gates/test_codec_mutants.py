"""The mutants of the generated CAN codec, all of them in one library, against what the codec has to do.

Each runs in a process of its own: a mutant may read what is not there. A function of a message is asked that
message's checks; encode and decode are asked those of every signal.
"""

import ctypes
import faulthandler
import os
import random
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from compiled_codec import (
    GENERATED,
    check_codes,
    check_every_raw_value,
    check_frames,
    check_refusals,
    check_rounding,
    random_frames,
    written,
)
from lpvguard.can.codegen import SOURCE
from made import ROOT
from mutation import Sites, read, sites_of, switched
from mutation_run import CLANG, MOST_EQUIVALENT, Mutant, command, mutants_of
from parts import require

Check = Callable[[ctypes.CDLL], None]

TESTS = Path(__file__).resolve().parents[1]
DRAWN, N_FRAMES = 100, 1000
SWITCH = """#include "mutant_switch.h"
#include <stdlib.h>
int lpvg_mutant = -1;
unsigned char lpvg_reached[LPVG_SITES_MAX];
unsigned long long lpvg_sites_left = ~0ULL;
void lpvg_runs_on(void) { abort(); }
"""
SHARED = (
    "frame->data[{}] = (uint8_t)(((uint32_t)message->{} & 0x0Fu) | (((uint32_t)message->{} << 4) & {{}}));"
)
BYTES = [
    (SHARED.format(7, "supervision_state", "engagement"), "0xF0u", "241"),
    (SHARED.format(6, "control_request", "other_priority"), "0xF0u", "241"),
    (
        SHARED.format(6, "monitor_verdict", "command_authentication").replace("));", ") | 0xC0u);"),
        "0x30u",
        "49",
    ),
    ("frame->data[0] = (uint8_t)((((uint32_t)message->abs_active << 4) & {}) | 0xCFu);", "0x30u", "49"),
]
REPEATED = "the other bits are added by | and are set by then, or the shift has left them 0"
EQUIVALENT = {
    "if (!(steps > 0.0f)) {  ->  if (!(steps >= 0.0f)) {": "no step rounds to 0, too",
    "if (!(steps > 0.0f)) {  ->  if (!(steps > -1f)) {": "above -1 the cast cuts to 0, and no half is left",
    "if (steps >= (float)scale->raw_max) {  ->  if (steps > (float)scale->raw_max) {": (
        "the largest value rounds to itself"
    ),
    **{f"{line.format(mask)}  ->  {line.format(other)}": REPEATED for line, mask, other in BYTES},
}
"""Change -> why no check can notice it, in whichever function."""


def checks_of(function: str) -> Iterator[Check]:
    """What is asked of a function of the codec."""
    messages = [m for m in GENERATED if function.startswith(f"lpvg_can_{m.name.lower()}_")]
    if not messages:
        for message, signal in ((m, s) for m in GENERATED for s in m.signals):
            for check in (check_codes, check_rounding, check_every_raw_value):
                yield partial(check, m=message, s=signal)
    for m in messages:
        yield partial(check_refusals, m=m)
        yield partial(check_frames, m=m, n=N_FRAMES)


def survives(codec: ctypes.CDLL, mutant: Mutant) -> bool:
    """Whether no check notices the mutant; each is asked until one does, in a process of its own."""
    child = os.fork()
    if child == 0:
        status = 1
        faulthandler.disable()
        try:
            ctypes.c_int.in_dll(codec, "lpvg_mutant").value = mutant.number
            for check in checks_of(mutant.site.function):
                check(codec)
            status = 0
        finally:
            os._exit(status)
    return os.waitpid(child, 0)[1] == 0


@pytest.fixture(scope="module")
def mutated(tmp_path_factory: pytest.TempPathFactory) -> tuple[ctypes.CDLL, list[Mutant]]:
    """The library with all mutants of the codec behind the switch, and the mutants."""
    require("llvm19")
    folder = tmp_path_factory.mktemp("codec_mutants")
    written(folder)
    source = folder / SOURCE
    flags = ["-std=c99", "-I", ROOT / "lib/include", "-I", folder]
    dump = command(f"clang-{CLANG}", *flags, "-fsyntax-only", "-Xclang", "-ast-dump=json", source)
    sites: Sites = sites_of(dump, {str(source): read(source)})[str(source)]
    source.write_text(switched(read(source), sites, 0))
    (folder / "switch.c").write_text(SWITCH)
    switch = ["-I", TESTS / "gates", "-include", "mutant_switch.h"]
    shared = ["-O1", "-w", "-ffp-contract=off", "-fPIC", "-shared", "-o", folder / "mutated.so"]
    sources = [source, folder / "loops.c", folder / "switch.c"]
    command(f"clang-{CLANG}", *flags, *switch, *shared, *sources)
    for m in GENERATED:  # once, for all processes
        random_frames(m.name, N_FRAMES)
    return ctypes.CDLL(str(folder / "mutated.so")), mutants_of(SOURCE, sites, 0)


@pytest.mark.unhurried
def test_no_check_refuses_the_codec_as_it_is(mutated):
    codec, _ = mutated
    for m in GENERATED:
        for check in checks_of(f"lpvg_can_{m.name.lower()}_pack"):
            check(codec)
    for check in checks_of("lpvg_can_decode"):
        check(codec)


@pytest.mark.slow("7 s: 100 mutants of the codec")
def test_every_mutant_of_the_codec_is_noticed(mutated):
    """All of them with LPVGUARD_FULL=1, else so many that are drawn."""
    codec, mutants = mutated
    assert len(mutants) > 1000
    if os.environ.get("LPVGUARD_FULL") != "1":
        mutants = random.Random(7).sample(mutants, DRAWN)
    alive = [m for m in mutants if survives(codec, m)]
    print(f"{SOURCE}: {len(mutants)} mutants, {len(mutants) - len(alive)} killed, {len(alive)} argued")
    assert [f"{m.site.function}: {m.key}" for m in alive if str(m.change) not in EQUIVALENT] == []
    if os.environ.get("LPVGUARD_FULL") == "1":
        assert {str(m.change) for m in alive} == set(EQUIVALENT), "argued, and noticed or gone"
        assert len(alive) <= MOST_EQUIVALENT * len(mutants)
