"""An interruption of ``otmcp certify`` is no fault of the kit, whatever pytest does with it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

STUBBORN = (
    "import signal, time; signal.signal(signal.SIGINT, signal.SIG_IGN); print('deaf', flush=True); time.sleep(3600)"
)

PROGRAM = f"""
import os, sys
from pytest_otmcp.cli import certify
certify._GRACE_S = 0.2
try:
    certify._supervised([sys.executable, "-c", {STUBBORN!r}], dict(os.environ))
except KeyboardInterrupt:
    print("interrupted")
"""


def test_a_suite_that_does_not_close_in_time_is_ended_and_the_command_was_interrupted() -> None:
    with subprocess.Popen([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, text=True) as command:
        assert command.stdout is not None
        assert command.stdout.readline() == "deaf\n"
        os.kill(command.pid, signal.SIGTERM)
        # The suite has the same output: it ends when both have ended.
        assert command.stdout.read() == "interrupted\n"
    assert command.returncode == 0
