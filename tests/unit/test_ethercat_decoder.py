"""The codec and the decoder of EtherCAT, with frames as SOEM and a slave sent them."""

from __future__ import annotations

import pytest

from pytest_otmcp.protocols.ethercat.decoder import EthercatConversation
from pytest_otmcp.wire.ethercat import Datagram, Sdo, encoded, parse, sdo_of
from pytest_otmcp.wire.framing import MalformedError

ETHERNET = bytes.fromhex("ffffffffffff 010101010101 88a4")


def mailbox(text: str) -> bytes:
    return bytes.fromhex(text).ljust(0x80, b"\0")


def frame(head: str, data: bytes, counter: int = 0) -> bytes:
    return ETHERNET + bytes.fromhex(head) + data + counter.to_bytes(2, "little")


DOWNLOAD = frame("8c10 05 07 0210 0010 8000 0000", mailbox("0a000000 00 23 0020 2b 0080 01 fa00 0000"))
STORED = frame("8c10 04 09 0210 8010 8000 0000", mailbox("0a000000 00 23 0030 60 0080 01 0000 0000"), 1)
ABORTED = frame("8c10 04 0a 0210 8010 8000 0000", mailbox("0a000000 00 23 0020 80 0080 01 31000906"), 1)


def test_a_frame_is_read_and_written_byte_by_byte() -> None:
    [one] = parse(DOWNLOAD)
    assert (one.command, one.index, one.position, one.offset, one.counter) == (5, 7, 0x1002, 0x1000, 0)
    assert encoded(ETHERNET, [one]) == DOWNLOAD
    two = [one, Datagram(command=7, index=8, position=0, offset=0x130, data=b"\0\0", counter=2)]
    assert parse(encoded(ETHERNET, two)) == two


@pytest.mark.parametrize("cut", [0, 13, 15, 20, 60, len(DOWNLOAD) - 1])
def test_what_is_cut_off_is_malformed(cut: int) -> None:
    with pytest.raises(MalformedError):
        parse(DOWNLOAD[:cut])
    [message] = EthercatConversation().decode("in", DOWNLOAD[:cut])
    assert message.kind == "malformed"


@pytest.mark.parametrize(
    "data", [b"", b"\x07", b"\x01\x02", b"\x01\x02\x03\x04", b"eight by", b"a text of more than four bytes"]
)
def test_the_answer_to_an_upload_has_its_value(data: bytes) -> None:
    answer = Sdo(service="sdo_upload", index=0x2001, subindex=3, data=data, counter=5)
    told = sdo_of(mailbox(answer.mailbox().hex()))
    assert told is not None
    assert (told.service, told.index, told.subindex, told.counter) == ("response", 0x2001, 3, 5)
    assert told.data == data


def test_a_download_and_its_answer_belong_together() -> None:
    conversation = EthercatConversation()
    [asked] = conversation.decode("in", DOWNLOAD)
    assert asked.request
    assert asked.state_changing
    told = {name: asked.fields[name] for name in ("service", "station", "index", "subindex", "data")}
    assert told == {"service": "sdo_download", "station": 0x1002, "index": 0x8000, "subindex": 1, "data": "fa00"}
    # The frame of the download comes back before there is an answer.
    [stored] = conversation.decode("out", STORED)
    assert stored.answers is asked
    assert stored.fields["abort"] is None


def test_a_download_with_the_counter_of_the_one_before_is_sent_once_more_and_no_second_one() -> None:
    conversation = EthercatConversation()
    [asked] = conversation.decode("in", DOWNLOAD)
    [again] = conversation.decode("in", DOWNLOAD)
    assert (again.kind, again.request, again.state_changing) == ("repeat", False, False)
    [stored] = conversation.decode("out", STORED)
    assert stored.answers is asked
    [another] = conversation.decode("in", DOWNLOAD.replace(bytes([0x23]), bytes([0x33])))
    assert another.request


def test_a_download_without_a_counter_is_one_each_time() -> None:
    conversation = EthercatConversation()
    found = [conversation.decode("in", DOWNLOAD.replace(bytes([0x23]), bytes([0x03]))) for _ in range(2)]
    assert [message.request for [message] in found] == [True, True]


def test_an_abort_is_told_with_its_code() -> None:
    conversation = EthercatConversation()
    [asked] = conversation.decode("in", DOWNLOAD)
    [aborted] = conversation.decode("out", ABORTED)
    assert aborted.answers is asked
    assert aborted.fields["abort"] == 0x06090031


def test_process_data_are_a_cycle_until_the_mock_says_otherwise() -> None:
    frame = encoded(ETHERNET, [Datagram(command=12, index=3, position=0, offset=0, data=b"\1\2\3\4")])
    [cycle] = EthercatConversation().decode("in", frame)
    assert (cycle.kind, cycle.request, cycle.state_changing) == ("cycle", False, False)
    assert "state_changing" in cycle.unsure


def test_how_a_master_sets_slaves_up_is_no_matter_of_the_journal() -> None:
    fmmu = encoded(ETHERNET, [Datagram(command=5, index=1, position=0x1001, offset=0x600, data=bytes(16))])
    assert EthercatConversation().decode("in", fmmu) == []
