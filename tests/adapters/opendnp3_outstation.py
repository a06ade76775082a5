"""An outstation of opendnp3 as a program, at the port of its argument: it changes a binary input when a line comes, and ends with its stdin.

It is a program of its own because the threads of its C++ library must not outlive a test.
"""

# mypy: disable-error-code="attr-defined, import-untyped, misc, no-untyped-call"

from __future__ import annotations

import sys
from typing import Any

from opendnp3 import (
    AnalogOutputStatus,
    Binary,
    BinaryOutputStatus,
    CommandStatus,
    ControlRelayOutputBlock,
    DatabaseConfig,
    DNP3Manager,
    DNPTime,
    EventBufferConfig,
    Flags,
    ICommandHandler,
    IOutstationApplication,
    IPEndpoint,
    LogLevels,
    OperationType,
    OutstationStackConfig,
    ServerAcceptMode,
    UpdateBuilder,
)

MISSING = 4
"""From this index on there are no outputs."""


class Commands(ICommandHandler):
    """Operates the outputs, and tells their status."""

    def __init__(self) -> None:
        super().__init__()

    def Begin(self) -> None:
        pass

    def End(self) -> None:
        pass

    def Select(self, command: Any, index: int) -> Any:
        return CommandStatus.SUCCESS if index < MISSING else CommandStatus.NOT_SUPPORTED

    def Operate(self, command: Any, index: int, handler: Any, kind: Any) -> Any:
        if index >= MISSING:
            return CommandStatus.NOT_SUPPORTED
        if isinstance(command, ControlRelayOutputBlock):
            handler.Update(BinaryOutputStatus(command.opType == OperationType.LATCH_ON), index)
        else:
            handler.Update(AnalogOutputStatus(command.value), index)
        return CommandStatus.SUCCESS


def main(port: int) -> None:
    manager = DNP3Manager(1)
    channel = manager.AddTCPServer(
        "kit", LogLevels(0), ServerAcceptMode.CloseExisting, IPEndpoint("127.0.0.1", port), None
    )
    config = OutstationStackConfig(DatabaseConfig(16))
    config.link.LocalAddr, config.link.RemoteAddr = 10, 1
    config.outstation.eventBufferConfig = EventBufferConfig.AllTypes(100)
    # They have to live as long as the outstation, which does not keep them.
    commands, application = Commands(), IOutstationApplication()
    outstation = channel.AddOutstation("outstation", commands, application, config)
    outstation.Enable()
    print("ready", flush=True)
    for number, _ in enumerate(sys.stdin):
        builder = UpdateBuilder()
        builder.Update(Binary(number % 2 == 0, Flags(1), DNPTime(1767225600000 + number)), 3)
        outstation.Apply(builder.Build())
        print("changed", flush=True)
    manager.Shutdown()


if __name__ == "__main__":
    main(int(sys.argv[1]))
