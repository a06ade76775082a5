"""Audit records as a subject file describes them, and the limit that fills a log."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from pytest_otmcp.protocols.bounds import Bounds, Governance, Limit
from pytest_otmcp.session.footprint import limit_file
from pytest_otmcp.trial.audit import records_of

FIELDS = {"time": "at", "principal": "who.name", "tool": "call.tool"}
RECORD = {"at": "2026-11-26T07:00:00.123Z", "who": {"name": "alice"}, "call": {"tool": "write"}}
WRITER = """
import sys
with open(sys.argv[1], "ab", buffering=0) as log:
    for line in sys.stdin:
        try:
            print(log.write(line.encode()), flush=True)
        except OSError as error:
            print(error.strerror, flush=True)
"""


def test_a_record_has_what_the_subject_file_says_where() -> None:
    good, local, prose, listed = records_of(
        [json.dumps(RECORD), json.dumps(RECORD | {"at": "2026-11-26T07:00:00"}), "started", "[1]"], FIELDS
    )
    assert good.fields == {"time": RECORD["at"], "principal": "alice", "tool": "write"}
    assert (good.in_utc, local.in_utc, prose.in_utc) == (True, False, False)
    assert prose.fields == listed.fields == {}


def test_what_is_told_of_security_is_the_same_from_a_record() -> None:
    told = Governance(
        bounds=Bounds(allowed=("a", "b/1..2"), limits={"c": Limit(lowest=0, highest=8)}),
        viewer=True,
        audit={"fields": FIELDS, "anchor": "meta.audit_id", "digest": False, "is_file": True, "verifies": False},
        approval=None,
    )
    assert Governance.of_record(json.loads(json.dumps(told.as_record()))) == told


def test_a_file_with_a_limit_takes_a_part_and_then_no_more_until_the_limit_is_gone(tmp_path: Path) -> None:
    log = tmp_path / "audit.jsonl"
    marker = f"AUDITED_BY_TEST={tmp_path}"
    name, _, value = marker.partition("=")
    with subprocess.Popen(
        [sys.executable, "-c", WRITER, str(log)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, name: value},
    ) as writer:
        assert writer.stdin is not None
        assert writer.stdout is not None

        def write(text: str) -> str:
            writer.stdin.write(text + "\n")  # type: ignore[union-attr]
            writer.stdin.flush()  # type: ignore[union-attr]
            return writer.stdout.readline().strip()  # type: ignore[union-attr]

        assert write("x" * 99) == "100"
        assert limit_file(None, marker.encode(), log, 40)
        assert write("x" * 99) == "40"
        assert write("x") == os.strerror(27)
        assert not limit_file(None, marker.encode(), log, None)
        assert write("x") == "2"
        assert not limit_file(None, b"NOBODY=has this", log, 40)
        writer.stdin.close()
