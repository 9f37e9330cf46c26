"""Foxglove's WebSocket beside the page: a client reads what replay's MCAP recording says of the same frames,
and can do nothing else."""

import asyncio
import json
import socket
import struct
import threading
import time
from contextlib import contextmanager

import pytest
from live_case import Given, cut

from lpvguard.base.errors import InputError
from lpvguard.extras.live.watch import Watch
from lpvguard.replay.messages import messages, schemas

pytest.importorskip("foxglove", reason="the package foxglove-sdk (lpvguard[foxglove])")
websocket = pytest.importorskip("tornado.websocket", reason="the package tornado (lpvguard[live])")

from lpvguard.extras.live.foxglove_server import BACKLOG, FoxgloveServer  # noqa: E402

DATA = struct.Struct("<BIQ")
"""Head of a message: operation 1, number of the subscription, time [ns]."""


@pytest.fixture
def server(replayer):
    foxglove = FoxgloveServer(replayer, 0)
    yield foxglove
    foxglove.stop()


class Client:
    """A client of Foxglove's protocol that subscribes to everything and keeps what it gets."""

    def __init__(self, url: str):
        self.url, self.info, self.channels, self.got = url, {}, {}, []
        self.subscribed, self.refused = threading.Event(), []

    async def read(self, until) -> None:
        """Connects and reads until ``until(self)``, or the server hangs up."""
        link = await websocket.websocket_connect(self.url, subprotocols=["foxglove.sdk.v1"])
        assert link.selected_subprotocol == "foxglove.sdk.v1"
        while not until(self):
            text = await asyncio.wait_for(link.read_message(), 60)
            if text is None:
                break
            if isinstance(text, bytes):
                operation, number, t_ns = DATA.unpack_from(text)
                assert operation == 1
                self.got.append((t_ns, self.channels[number]["topic"], json.loads(text[DATA.size :])))
                continue
            said = json.loads(text)
            if said["op"] == "serverInfo":
                self.info = said
            elif said["op"] == "advertise":
                self.channels |= {c["id"]: c for c in said["channels"]}
                wanted = [{"id": c["id"], "channelId": c["id"]} for c in said["channels"]]
                await link.write_message(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                # Nobody may publish, call or set anything.
                one = {"id": 1, "topic": "/x", "encoding": "json", "schemaName": "x"}
                await link.write_message(json.dumps({"op": "advertise", "channels": [one]}))
                self.subscribed.set()
            elif said["op"] == "status":
                self.refused.append(said["message"])
        link.close()


@contextmanager
def reading(client: Client, until):
    """The client in a thread of its own; at the end everything that it waited for is there."""
    wrong = []

    def run():
        try:
            asyncio.run(client.read(until))
        except BaseException as error:
            wrong.append(error)
            client.subscribed.set()

    thread = threading.Thread(target=run)
    thread.start()
    assert client.subscribed.wait(60)
    yield
    thread.join(60)
    assert not thread.is_alive() and wrong == []


def heard(server: FoxgloveServer) -> None:
    """Waits until the server knows of the subscriptions."""
    for _ in range(1000):
        if server.listens():
            return
        time.sleep(0.01)
    raise AssertionError("no subscription reached the server")


@pytest.mark.slow("6 s: a server and its client")
def test_a_client_reads_what_the_recording_of_replay_says(server, replayer, faulty):
    frames, path = faulty
    recorded = replayer.received(frames, path)
    said = replayer.replay_recorded(recorded)
    series = replayer.series(recorded, said)
    written = messages(series, said.to_dict()["alarms"])
    watch, client = Watch(replayer, Given(), 3600, listeners=[server]), Client(server.url)
    pieces = cut(frames, 500)
    n = series.num_rows - 1  # the last tick waits for a frame after it

    def all_samples(c):
        return sum(topic == "/lpvguard/sample" for _, topic, _ in c.got) >= n

    with reading(client, all_samples):
        heard(server)
        for piece in pieces:
            watch.take(piece)
    assert client.info["capabilities"] == [] and client.info["name"] == "lpvguard live"
    offered = {c["topic"]: json.loads(c["schema"]) for c in client.channels.values()}
    assert offered == schemas(series.column_names)
    assert {(c["encoding"], c["schemaEncoding"]) for c in client.channels.values()} == {
        ("json", "jsonschema")
    }
    begin = client.got[0][0]
    for topic in offered:
        got = [(t - begin, content) for t, where, content in client.got if where == topic]
        want = [(m.t_ns, m.content) for m in written if m.topic == topic][: len(got)]
        assert len(got) > (n - 1 if topic.endswith("sample") else 10), topic
        assert [t for t, _ in got] == pytest.approx([t for t, _ in want], abs=1000)
        for (_, one), (_, other) in zip(got, want, strict=True):
            numbers = {k: v for k, v in other.items() if isinstance(v, float)}
            assert {k: one[k] for k in numbers} == pytest.approx(numbers, abs=1e-9)
            rest = set(other) - set(numbers) - {"timestamp"}
            assert {k: one[k] for k in rest} == {k: other[k] for k in rest} and set(one) == set(other)
    verdicts = [c["verdict"] for _, topic, c in client.got if topic == "/lpvguard/sample"]
    assert verdicts == series["verdict"].to_pylist()[: len(verdicts)] and len(set(verdicts)) > 1


def test_a_client_that_writes_is_refused_and_one_that_stalls_or_dies_holds_up_nothing(
    server, replayer, faulty
):
    watch, client = Watch(replayer, Given(), 3600, listeners=[server]), Client(server.url)
    host, port = server.url.removeprefix("ws://").split(":")
    with socket.create_connection((host, int(port))) as stalled:
        # It shakes hands by hand, subscribes and never reads; then it goes without a word.
        stalled.sendall(
            f"GET / HTTP/1.1\r\nHost: {host}:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n".encode()
        )
        stalled.recv(65536)
        with reading(client, lambda c: bool(c.got) and bool(c.refused)):
            heard(server)
            for piece in cut(faulty[0], 500):
                watch.take(piece)
    assert any("capability" in text or "not supported" in text for text in client.refused), client.refused
    assert watch.view(60, None, 100)["n_alarms"] > 0


def test_nothing_is_made_for_nobody(server, replayer, faulty, monkeypatch):
    def refused(*_):
        raise AssertionError("a piece of a series was made")

    monkeypatch.setattr(replayer, "series_of", refused)
    watch = Watch(replayer, Given(), 3600, listeners=[server])
    for piece in cut(faulty[0], 5000):
        watch.take(piece)
    assert watch._ring.count > 1000 and not server.listens() and BACKLOG > 4096


def test_a_port_that_is_taken_is_refused(server, replayer):
    port = int(server.url.rpartition(":")[2])
    with pytest.raises(InputError, match="a free port of this machine"):
        FoxgloveServer(replayer, port)
