"""What is no regular file is opened nowhere: whoever opens a FIFO waits for its other end, for ever if there is none."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import py_compile
import signal
import socket
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from pytest_otmcp.cli import Refusal
from pytest_otmcp.cli.files import content
from pytest_otmcp.cli.signature import signer
from pytest_otmcp.core.errors import UsageError
from pytest_otmcp.core.files import digest, new_file, new_file_below, read, remove_below
from pytest_otmcp.record.reader import RecordError, open_record
from pytest_otmcp.record.schema import SCHEMA
from pytest_otmcp.record.writer import RunWriter, SampleSpool
from pytest_otmcp.subject import load_subject
from pytest_otmcp.subject.functions import load_functions, named_functions

Make = Callable[[Path], object]


def bind(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))


@pytest.mark.parametrize("link", ["inner", "inner/deep", "inner/deep/file"])
def test_a_link_leads_no_new_file_out_of_its_folder(tmp_path: Path, link: str) -> None:
    outside, folder = tmp_path / "outside", tmp_path / "folder"
    (outside / "deep").mkdir(parents=True)
    for precious in (outside / "file", outside / "deep" / "file"):
        precious.write_bytes(b"precious")
    (folder / link).parent.mkdir(parents=True)
    target = outside if link == "inner" else outside / "deep" if link == "inner/deep" else outside / "file"
    (folder / link).symlink_to(target)
    with new_file_below(folder, "inner/deep/file") as file:
        file.write(b"new")
    assert (folder / "inner" / "deep" / "file").read_bytes() == b"new"
    (folder / "inner" / "deep" / "file").unlink()
    (folder / "inner" / "deep").rmdir()
    (folder / "inner" / "deep").symlink_to(outside)
    remove_below(folder, "inner/deep/file")
    assert not (folder / "inner" / "deep" / "file").exists()
    assert [path.read_bytes() for path in (outside / "file", outside / "deep" / "file")] == [b"precious"] * 2


NO_FILES: dict[str, Make] = {
    "fifo": os.mkfifo,
    "socket": bind,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "folder": lambda path: path.mkdir(),
}


@pytest.fixture(autouse=True)
def _bounded() -> Iterator[None]:
    """End what waits for ever."""

    def end(_number: int, _frame: FrameType | None) -> None:
        raise AssertionError("the file was opened, and nobody is at its other end")

    before = signal.signal(signal.SIGALRM, end)
    signal.alarm(10)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(params=NO_FILES)
def make(request: pytest.FixtureRequest) -> Make:
    return NO_FILES[request.param]


def test_a_record_that_something_else_has_replaced_is_not_sealed(make: Make, tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    header: Any = {"schema": SCHEMA}
    writer = RunWriter(path, header)
    path.unlink()
    make(path)
    item: Any = {"order": 0, "devices": {}, "around": []}
    with pytest.raises(OSError, match=r"regular file|folder|directory"):
        writer.append(item, [])
    footer: Any = {"complete": True}
    with pytest.raises(OSError, match=r"regular file|folder|directory"):
        writer.finish(header, footer)


def test_samples_go_into_a_regular_file(make: Make, tmp_path: Path) -> None:
    make(tmp_path / "spool")
    sample: Any = {"calls": [], "device": []}
    with pytest.raises(OSError, match="regular file"):
        SampleSpool(tmp_path / "spool").add(sample)
    with pytest.raises(OSError, match="regular file"):
        list(SampleSpool.read(tmp_path / "spool", ""))


def test_nothing_else_is_read(make: Make, tmp_path: Path) -> None:
    path = tmp_path / "file"
    make(path)
    with pytest.raises(OSError, match="it is a pipe, a socket, a device or a folder, where a regular file should be"):
        read(path)
    with pytest.raises(RecordError, match="regular file"), open_record(path):
        pass
    with pytest.raises(UsageError, match="regular file"):
        load_subject(path)
    with pytest.raises(UsageError, match="regular file"):
        load_functions(path, "modbus", "key")
    with pytest.raises(UsageError, match="regular file"):
        named_functions(path, "modbus", "key")
    with pytest.raises(UsageError, match="no regular file"):
        content(path, 100)
    with pytest.raises((UsageError, Refusal), match="there is no such file"):
        signer(b"", b"", path)


@pytest.mark.parametrize("kind", ["fifo", "socket", "device"])
def test_a_new_file_takes_the_place_of_whatever_is_there(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    NO_FILES[kind](path)
    with new_file(path) as file:
        file.write(b"new")
    assert path.is_file()
    assert not path.is_symlink()
    assert read(path) == b"new"


def test_byte_code_beside_a_bindings_file_is_not_executed(tmp_path: Path) -> None:
    source = tmp_path / "bindings.py"
    source.write_text("async def ping(tools):\n    return {}\n")
    other = tmp_path / "other.py"
    # As long as the genuine one, and of the same time: byte code of it is taken for that of the genuine one.
    other.write_text("async def pong(tools):\n    return {}\n")
    os.utime(source, (1, 1))
    os.utime(other, (1, 1))
    py_compile.compile(str(other), cfile=importlib.util.cache_from_source(str(source)))
    assert list(load_functions(source, "modbus", "key")) == ["ping"]


def test_a_file_of_any_size_costs_nothing_to_refuse(tmp_path: Path) -> None:
    small, sparse = tmp_path / "small", tmp_path / "sparse"
    small.write_bytes(b"content")
    assert digest(small) == hashlib.sha256(b"content").hexdigest()
    with open(sparse, "wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(OSError, match="too large"):
        digest(sparse)
