"""One drive in every dialect of ASC has the same frames at the same times."""

import numpy as np
import pytest

from lpvguard.can.logs import read_log

TIMES = (0.0, 0.003, 0.02, 0.023, 1.5)
FRAME = (
    "{t:11.6f} 1  {id:<15} Rx   d 8 9B 04 15 00 FF FF FF {n:02X}  Length = 240000 BitCount = 124 ID = 291\n"
)


def text_of(stamps: str, start: str = "Start of measurement", event: bool = False) -> str:
    """The drive with its time stamps absolute or relative; ``event``: a statistics line between frames."""
    lines = [
        "date Tue Jun 04 10:00:00.000 am 2024\n",
        f"base hex  timestamps {stamps}\n",
        "internal events logged\n",
        "// version 9.0.0\n",
        "Begin Triggerblock Tue Jun 04 10:00:00.000 am 2024\n",
        f"   0.000000 {start}\n",
    ]
    before = 0.0
    for n, t in enumerate(TIMES):
        if event and n == 2:
            at = t - 0.001
            lines.append(f"{at - before if stamps == 'relative' else at:11.6f} 1  Statistic: D 0 R 0 XD 0\n")
            before = at
        stamp = t - before if stamps == "relative" else t
        lines.append(FRAME.format(t=stamp, id="123" if n % 2 == 0 else "18FECA0Ex", n=n))
        before = t
    return "".join([*lines, "End TriggerBlock\n"])


@pytest.mark.parametrize("stamps", ["absolute", "relative"])
@pytest.mark.parametrize(
    "start", ["Start of measurement", "CANFD   Start of measurement", "CANFD\tstart of measurement"]
)
@pytest.mark.parametrize("event", [False, True])
def test_every_dialect_has_the_same_frames_at_the_same_times(stamps, start, event, tmp_path):
    path = tmp_path / "drive.asc"
    path.write_text(text_of(stamps, start, event))
    log = read_log(path)
    np.testing.assert_allclose(log.t_ns - log.t_ns[0], np.array(TIMES) * 1e9, atol=2)
    assert log.data[:, 7].tolist() == list(range(len(TIMES)))
    assert [hex(one & 0x1FFFFFFF) for one in log.id[:2]] == ["0x123", "0x18feca0e"]
