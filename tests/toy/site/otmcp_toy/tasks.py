"""The tasks on the toy: the usual ones, over TCP and over UDP."""

from __future__ import annotations

from pytest_otmcp.conformance.tasks import further

from otmcp_toy.protocol import WITNESS, register

TCP, UDP = (further.Further(key, witness=WITNESS) for key in ("toy", "toyudp"))
for tasks, letter in ((TCP, "T"), (UDP, "U")):
    further.usual(tasks, letter, sensors=[register(3), register(4)], target=register(1))

TASKS = [*TCP, *UDP]
