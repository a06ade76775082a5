"""Captures as other programs write them, and the streams in them whatever became of their segments."""

from __future__ import annotations

import itertools
import random
import shutil
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from pytest_otmcp.wire.capture import Capture, Segment, Stream
from pytest_otmcp.wire.framing import MalformedError

SAID = [bytes([number]) * (number * 900 + 1) for number in range(12)]
"""What both sides of a connection send each other in turn; the longer ones take several segments."""
TCPDUMP = ("tcpdump", "--immediate-mode", "-U", "-s", "0", "-B", "65536", "-Z", "root")
WRITERS: Mapping[str, Sequence[str]] = {
    "pcap": (*TCPDUMP, "-i", "lo"),
    "any": (*TCPDUMP, "-y", "LINUX_SLL2", "-i", "any"),
    "nanoseconds": (*TCPDUMP, "--nano", "-i", "lo"),
    "pcapng": ("dumpcap", "-n", "-q", "-B", "64", "-i", "lo"),
}


def talk(listener: socket.socket) -> None:
    """Speak with one client: answer each message with its bytes in reverse order."""
    peer, _ = listener.accept()
    with peer:
        for message in SAID:
            got = b""
            while len(got) < len(message):
                got += peer.recv(65536)
            peer.sendall(got[::-1])


@contextmanager
def written(kind: str, path: Path, port: int) -> Iterator[None]:
    program, *options = WRITERS[kind]
    if shutil.which(program) is None:
        pytest.skip(f"no {program} here")
    command = [program, *options, "-w", str(path), "-f" * (program == "dumpcap"), f"tcp port {port}"]
    capturing = subprocess.Popen(list(filter(None, command)), stderr=subprocess.PIPE, text=True)
    assert capturing.stderr is not None
    try:
        for line in capturing.stderr:
            if "listening on" in line or "File:" in line:
                break
        else:
            pytest.skip(f"{program} may not capture here")
        yield
    finally:
        capturing.terminate()
        capturing.communicate()


def conversation(listener: socket.socket) -> None:
    """Have a conversation with a server."""
    answering = threading.Thread(target=talk, args=(listener,))
    answering.start()
    with socket.create_connection(listener.getsockname()[:2]) as client:
        for message in SAID:
            client.sendall(message)
            got = b""
            while len(got) < len(message):
                got += client.recv(65536)
    answering.join()


def streams(segments: Sequence[Segment], port: int) -> tuple[bytes, bytes]:
    """Return what a server was told and what it said."""
    told, said = Stream(), Stream()
    found = [b"", b""]
    for segment in segments:
        if segment.target[1] == port:
            found[0] += told.take(segment)
        elif segment.source[1] == port:
            found[1] += said.take(segment)
    return found[0], found[1]


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
@pytest.mark.parametrize("kind", WRITERS)
def test_what_was_said_is_in_the_capture_of_another_program(kind: str, host: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    try:
        listener = socket.create_server((host, 0), family=socket.AF_INET6 if ":" in host else socket.AF_INET)
    except OSError as error:
        pytest.skip(f"no {host} here: {error}")
    expected = b"".join(SAID), b"".join(message[::-1] for message in SAID)
    with listener, written(kind, path, port := listener.getsockname()[1]):
        conversation(listener)
        until = time.monotonic() + 20
        segments: list[Segment] = []
        # An end for each side, at least.
        while sum(segment.ends for segment in segments) < 2 and time.monotonic() < until:
            segments = list(Capture().feed(path.read_bytes())) if path.exists() else []
            time.sleep(0.05)
    assert streams(segments, port) == expected
    mine = [segment for segment in segments if port in (segment.source[1], segment.target[1])]
    assert {segment.source[0] for segment in mine} == {host}
    assert abs(mine[-1].t_ns / 1e9 - time.time()) < 60
    assert any(segment.opens for segment in mine)
    capture, content = Capture(), path.read_bytes()
    piecewise = [one for at in range(0, len(content), 997) for one in capture.feed(content[at : at + 997])]
    assert piecewise[: len(segments)] == segments


def segment(seq: int, data: bytes, *, opens: bool = False) -> Segment:
    ends = ("a", 1), ("b", 2)
    return Segment(
        t_ns=0,
        source=ends[0],
        target=ends[1],
        seq=seq % (1 << 32),
        opens=opens,
        answers=False,
        ends=False,
        resets=False,
        data=data,
        cut=0,
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_stream_is_whole_whatever_the_order_of_its_segments(seed: int) -> None:
    rng = random.Random(seed)
    text = rng.randbytes(5000)
    # Its numbers pass 2 ** 32 on the way.
    first = (1 << 32) - rng.randrange(1, 4000)
    cuts = sorted({0, len(text), *(rng.randrange(len(text)) for _ in range(30))})
    parts = [segment(first + 1 + at, text[at:to]) for at, to in itertools.pairwise(cuts)]
    # Sent again, in other pieces.
    again = [rng.randrange(len(text)) for _ in range(10)]
    parts += [segment(first + 1 + at, text[at : at + rng.randrange(1, 400)]) for at in again]
    rng.shuffle(parts)
    stream = Stream()
    assert stream.take(segment(first, b"", opens=True)) == b""
    assert b"".join(map(stream.take, parts)) == text
    assert stream.waiting == 0


def test_what_a_capture_has_lost_is_missed() -> None:
    stream = Stream()
    stream.take(segment(0, b"", opens=True))
    assert stream.take(segment(1, b"one")) == b"one"
    assert stream.take(segment(7, b"three")) == b""
    assert stream.waiting == 5
    assert stream.take(segment(4, b"two")) == b"twothree"


PCAP = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"no capture at all, by any means", "neither pcap nor pcapng"),
        (PCAP + struct.pack("<IIII", 0, 0, 1 << 30, 1 << 30), "a packet of 1073741824 bytes"),
        (
            struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 105) + struct.pack("<IIII", 0, 0, 1, 1) + b"x",
            "type 105",
        ),
        (struct.pack("<III", 0x0A0D0D0A, 5, 0x1A2B3C4D) + bytes(24), "a block of 5 bytes"),
        (
            struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
            + struct.pack("<IIIIIIII", 6, 32, 3, 0, 0, 0, 0, 32),
            "interface 3",
        ),
    ],
)
def test_what_is_no_capture_is_refused(content: bytes, problem: str) -> None:
    with pytest.raises(MalformedError, match=problem):
        list(Capture().feed(content))


@pytest.mark.parametrize("seed", range(200))
def test_whatever_bytes_come_nothing_else_is_raised(seed: int) -> None:
    rng = random.Random(seed)
    packet = bytearray(struct.pack(">12xH", 0x0800) + b"\x45\x00\x00\x2a" + bytes(5) + b"\x06" + bytes(32))
    for _ in range(rng.randrange(8)):
        packet[rng.randrange(len(packet))] = rng.randrange(256)
    kept = bytes(packet[: rng.randrange(len(packet) + 1)])
    head = PCAP if seed % 2 else struct.pack("<IIIHHqI", 0x0A0D0D0A, 28, 0x1A2B3C4D, 1, 0, -1, 28)
    content = bytearray(head + struct.pack("<IIII", 1, 2, len(kept), len(packet)) + kept + rng.randbytes(40))
    for _ in range(rng.randrange(4)):
        content[rng.randrange(len(content))] = rng.randrange(256)
    with suppress(MalformedError):
        list(Capture().feed(bytes(content)))
