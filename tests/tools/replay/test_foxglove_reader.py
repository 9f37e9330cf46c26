"""A recorded MCAP opened by Foxglove's own parser library: every topic decodes, by its schema and by
Foxglove's, to what the core said.

foxglove_reader/ is a program of node; npm brings the library at the versions and hashes of its lock file.
tools/setup.sh does not install node.
"""

import json
import re
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import pytest

from lpvguard.core.compiled import VERDICTS
from lpvguard.replay import recordings
from lpvguard.replay.messages import messages

READER = Path(__file__).with_name("foxglove_reader")
NO_NETWORK = ("EAI_AGAIN", "ECONNREFUSED", "ECONNRESET", "ENETUNREACH", "ENOTFOUND", "ETIMEDOUT", "E403")
"""What npm says where there is no registry."""


@pytest.fixture(scope="session")
def reader(tmp_path_factory):
    """reader(file): Foxglove's library reads the file; the finished process."""
    programs = {name: shutil.which(name) for name in ("node", "npm")}
    if lost := [name for name, path in programs.items() if path is None]:
        pytest.skip(f"{', '.join(lost)} not found")
    folder = tmp_path_factory.mktemp("foxglove_reader")
    shutil.copytree(READER, folder, dirs_exist_ok=True)
    install = [programs["npm"], "ci", "--ignore-scripts", "--no-audit", "--no-fund"]
    try:
        done = subprocess.run(install, cwd=folder, capture_output=True, text=True, check=False, timeout=300)
    except subprocess.TimeoutExpired:
        pytest.skip("npm ci: no answer within 300 s")
    if done.returncode and any(code in done.stderr for code in NO_NETWORK):
        pytest.skip(f"npm ci: {done.stderr.strip().splitlines()[0]}")
    assert done.returncode == 0, done.stderr

    def read(path: Path) -> subprocess.CompletedProcess[str]:
        words = [programs["node"], folder / "read.mjs", path]
        return subprocess.run(words, capture_output=True, text=True, check=False)

    return read


@pytest.mark.slow("5 s: npm brings Foxglove's library")
def test_foxglove_reads_the_verdicts_margins_and_alarms_of_a_recording(reader, replayer, alarmed, tmp_path):
    path, said = alarmed
    series = replayer.series(replayer.read_file(path), said)
    alarms = said.to_dict()["alarms"]
    recordings.write_series(tmp_path / "run.mcap", "mcap", series, alarms, "g80")
    done = reader(tmp_path / "run.mcap")
    assert done.returncode == 0, done.stderr
    topics = json.loads(done.stdout)
    written = messages(series, alarms)
    for topic in ("/lpvguard/sample", "/lpvguard/margin", "/lpvguard/alarm"):
        want = [[str(m.t_ns), m.content] for m in written if m.topic == topic]
        assert topics.pop(topic) == json.loads(json.dumps(want)) != [], topic
    assert topics == {}
    verdicts = [m.content["verdict"] for m in written if m.topic == "/lpvguard/sample"]
    assert verdicts == [VERDICTS[code] for code in said.run.verdict] and len(set(verdicts)) > 1


@pytest.mark.slow("5 s: npm brings Foxglove's library")
@pytest.mark.parametrize(
    ("topic", "wrong", "says"),
    [
        ("/lpvguard/sample", {"Speed": 1.0}, "/lpvguard/sample.*must NOT have additional properties"),
        ("/lpvguard/margin", {"margin": "1"}, "/lpvguard/margin.*margin must be number"),
        ("/lpvguard/alarm", {"timestamp": {"sec": 0, "nsec": -1}}, "/lpvguard/alarm.*nsec must be >= 0"),
    ],
)
def test_the_reader_objects_to_a_message_that_is_not_as_its_schema_says(
    reader, replayer, alarmed, tmp_path, monkeypatch, topic, wrong, says
):
    path, said = alarmed
    series = replayer.series(replayer.read_file(path), said)

    def bent(*arguments):
        series_messages = messages(*arguments)
        at = next(i for i, m in enumerate(series_messages) if m.topic == topic)
        series_messages[at] = replace(series_messages[at], content=series_messages[at].content | wrong)
        return series_messages

    monkeypatch.setattr(recordings, "messages", bent)
    recordings.write_series(tmp_path / "run.mcap", "mcap", series, said.to_dict()["alarms"], "g80")
    done = reader(tmp_path / "run.mcap")
    assert done.returncode != 0 and re.search(says, done.stderr), done.stderr
