"""The core of every adapter, without protocol: settings, envelope, errors, strict arguments, guard, deadline, link, run.

An adapter is a sub-package with three modules to begin with. ``tools`` holds a class with one method per tool::

    class Cell(Arguments):
        address: Annotated[int, Field(ge=0, le=65535, description="PDU address, from 0")]


    class WriteRegister(Cell):
        value: Annotated[int, Field(ge=0, le=65535)]


    class RegisterValue(TypedDict):  # of typing_extensions: before Python 3.12 pydantic refuses the standard one
        address: int
        value: int


    class Tools:
        def __init__(self, link: Link) -> None:
            self._link = link

        @tool("modbus.read_holding")
        async def read_register(self, call: Call, arguments: Cell) -> RegisterValue:
            '''Read one holding register.'''
            return {"address": arguments.address, "value": await self._link.read(call, arguments.address)}

        @tool("modbus.write_holding", writes=True)
        async def write_register(self, call: Call, arguments: WriteRegister) -> RegisterValue:
            '''Write one holding register.'''
            await self._link.write(call, arguments.address, arguments.value)
            return {"address": arguments.address, "value": arguments.value}

``link`` holds the connection, a :class:`DeviceLink`. What it says of its library is how a connection is opened, whether it can be used and
how it ends; the core connects, explains outages, and decides what is repeated: no write is sent twice::

    class Link(DeviceLink[Connection]):
        async def read(self, call: Call, address: int) -> int:
            return await self.perform(call, lambda connection: connection.read(call, address))

        async def _open(self) -> Connection:
            return await Connection.to(self._host, self._port)

        def _is_usable(self, connection: Connection) -> bool:
            return not connection.lost

        def _end(self, connection: Connection) -> None:
            connection.close()

``adapter`` reads the settings and puts the server together; ``python -m pytest_otmcp.reference_adapters NAME`` runs the
``build`` of the sub-package of that name::

    def build() -> AdapterServer:
        environment = Environment()
        port = environment.whole("MODBUS_PORT", 502, 1, 65535)
        link = Link(environment.text("MODBUS_HOST"), port, environment.seconds("MODBUS_TIMEOUT_S", 1.0))
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
        server.add(Tools(link))
        return server

A method's name, docstring and annotations become the tool's name, description and schemas; ``tools/list`` has the tools in
the order of their definition. The value that a method returns becomes ``data``. An :class:`AdapterError` that it raises
becomes ``error``; any other exception becomes an ``internal_error``, with its traceback on stderr. A tool that changes the
plant says ``writes=True``, and by :meth:`Call.changes` what it is about to change, so that ``OT_WRITE_ALLOW`` (a JSON list of targets) and
``OT_WRITE_LIMITS`` (target to ``lowest``, ``highest``, ``step`` and ``every_s``) can forbid it, see ``bounds``. Names that users give to
places of the device are a :class:`NameMap`. The same words are those of ``policy``, ``audit`` and ``approval``: what may be written by whom, its
record on disk before it leaves, and the person who is asked. ``gates`` puts them around a call, and no adapter knows of them. Every call has the same steps: the arguments are checked, then the write guard, then the method
runs under the deadline.

The method and its link report to the :class:`Call` what only they can know: the connection they use, each request that they send, the
answer. From these the envelope takes ``attempts``, ``source`` and, after a failure, whether a write may have happened.
"""

from __future__ import annotations

from .addresses import resolve
from .arguments import LEFT_OUT, Arguments, BoundsCode, Nothing
from .call import Call
from .errors import AdapterError
from .link import BadReply, DeviceLink, Lost, repeat_once
from .maps import AliasName, Named, NameMap
from .numbers import EXACT_IN_JSON, exact_in_json, special_name
from .server import AdapterServer
from .settings import ConfigError, Environment
from .text import device_text
from .tls import client_context, handshake_failure
from .tools import tool

__all__ = [
    "EXACT_IN_JSON",
    "LEFT_OUT",
    "AdapterError",
    "AdapterServer",
    "AliasName",
    "Arguments",
    "BadReply",
    "BoundsCode",
    "Call",
    "ConfigError",
    "DeviceLink",
    "Environment",
    "Lost",
    "NameMap",
    "Named",
    "Nothing",
    "client_context",
    "device_text",
    "exact_in_json",
    "handshake_failure",
    "repeat_once",
    "resolve",
    "special_name",
    "tool",
]
