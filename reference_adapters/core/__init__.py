"""What every adapter needs and no protocol knows: settings, envelope, errors, strict arguments, guard, deadline, run.

An adapter is a list of async functions::

    class ReadRegister(Arguments):
        address: Annotated[int, Field(ge=0, le=65535, description="PDU address, from 0")]


    server = AdapterServer(name="modbus-reference", protocol="modbus-tcp", endpoint=..., guard=...)


    @server.tool(operation="modbus.read_holding")
    async def read_register(call: Call, arguments: ReadRegister) -> dict[str, Any]:
        '''Read one holding register.'''
        ...

Whatever the function returns becomes ``data``; whatever it raises becomes ``error``. The order is always the same:
arguments are checked, then the write guard, then the function runs under the deadline.
"""

from __future__ import annotations

from .arguments import Arguments, BoundsCode
from .call import Call
from .errors import AdapterError
from .server import AdapterServer
from .settings import ConfigError, Environment

__all__ = ["AdapterError", "AdapterServer", "Arguments", "BoundsCode", "Call", "ConfigError", "Environment"]
