"""The socket by which a device asks the kernel who has connected."""

from __future__ import annotations

import subprocess
import sys

ASKS = """
from pytest_otmcp.mocks.peer import socket_of
socket_of(("127.0.0.1", 1), ("127.0.0.1", 2))
"""


def test_a_process_that_has_asked_leaves_no_socket_open_at_its_end() -> None:
    # At the end of an interpreter a warning is printed, whatever the filters make of it.
    command = [sys.executable, "-W", "always::ResourceWarning", "-c", ASKS]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr == ""
