"""What every adapter needs and no protocol knows: settings, envelope, errors, strict arguments, guard, deadline, run.

An adapter is a ``build()`` that reads its settings and returns a server with its tools::

    class Cell(Arguments):
        address: Annotated[int, Field(ge=0, le=65535, description="PDU address, from 0")]


    class RegisterValue(TypedDict):  # of typing_extensions: before Python 3.12 pydantic refuses the standard one
        address: int
        value: int


    def build() -> AdapterServer:
        environment = Environment()
        link = Link(environment.text("MODBUS_HOST"), environment.whole("MODBUS_PORT", 502, 1, 65535))
        server = AdapterServer(
            name="modbus-reference",
            version="0.1.0",
            protocol="modbus-tcp",
            endpoint="modbus+tcp://…",
            writes_enabled=environment.writes_enabled("MODBUS_WRITES_ENABLED"),
            switch="MODBUS_WRITES_ENABLED",
            deadline_s=environment.seconds("MODBUS_DEADLINE_S", 3.0),
            close=link.close,
        )

        @server.tool("modbus.read_holding")
        async def read_register(call: Call, arguments: Cell) -> RegisterValue:
            '''Read one holding register.'''
            return {"address": arguments.address, "value": await link.read(call, arguments.address)}

        return server

Whatever the function returns becomes ``data``; whatever it raises becomes ``error``: an :class:`AdapterError` as it is,
anything else an ``internal_error`` whose traceback is on stderr. A tool that changes the plant says ``writes=True``. The
order is always the same: the arguments are checked, then the write guard, then the function runs under the deadline.

What only the function can know it tells the :class:`Call`: the connection it uses, each request that leaves, the answer.
From that the envelope takes ``attempts``, ``source`` and, when something goes wrong, whether a write may have happened.
"""

from __future__ import annotations

from .arguments import LEFT_OUT, Arguments, BoundsCode
from .call import Call
from .errors import AdapterError
from .server import AdapterServer
from .settings import ConfigError, Environment
from .text import device_text

__all__ = [
    "LEFT_OUT",
    "AdapterError",
    "AdapterServer",
    "Arguments",
    "BoundsCode",
    "Call",
    "ConfigError",
    "Environment",
    "device_text",
]
