"""One adapter variant at its device: its session, and abstract operations turned into tool calls.

A session that broke is replaced. Tasks are not known here, and nothing is judged.
"""

from __future__ import annotations

import socket
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .. import __version__
from ..core.errors import KitError, SubjectError, UsageError
from ..core.strict_json import parse_strict
from ..plant.device import Device
from ..plant.endpoint import Endpoint, first_port
from ..protocols.envelope import check_result
from ..protocols.registry import protocols
from ..session.session import Exchange, McpSession, SessionOptions
from ..subject.answers import interpret, read_answer
from ..subject.functions import Refused, ToolAnswer, checked_outputs
from ..subject.model import (
    READ_WRITE,
    Adapter,
    Answering,
    Binding,
    Function,
    replace_placeholders,
    replace_template,
)
from .reply import Reply, Wire, observe, performed

__all__ = ["AdapterUnderTest", "BenchOptions", "NoBindingError", "endpoint_values"]

_EXIT_GRACE_S = 5.0
"""From the end of its stdin to the exit (requirement MCP-009)."""


def endpoint_values(scheme: str, endpoints: Mapping[str, Endpoint]) -> dict[str, str]:
    """Return what stands for a device's endpoints in a subject file.

    ``host``, ``port`` and ``url`` are those of its first port, ``NAME_port`` is any further port, ``serial`` is the path of its
    first pseudo terminal, which is also the ``url`` of a device without a port.

    Args:
        scheme: of the URL.
        endpoints: by name, the main one first.
    """
    main = first_port(endpoints)
    lines = [endpoint.path for endpoint in endpoints.values() if endpoint.kind == "pty"]
    values: dict[str, str] = {}
    if main is not None:
        values = {"host": main.host, "port": str(main.port), "url": f"{scheme}://{main.host}:{main.port}"}
    elif lines:
        values = {"url": f"{scheme}://{lines[0]}"}
    if lines:
        values["serial"] = lines[0]
    further = (endpoint for endpoint in endpoints.values() if endpoint.kind != "pty" and endpoint is not main)
    return values | {f"{endpoint.name}_port": str(endpoint.port) for endpoint in further}


class NoBindingError(Exception):
    """The subject claims something but does not say how to ask for it: not testable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchOptions:
    """Settings of a run that the bench needs.

    Attributes:
        era: MCP protocol era, ``auto`` or ``legacy``.
        time_scale: factor on deadlines and windows, for slow machines.
    """

    era: str = "auto"
    time_scale: float = 1.0


class AdapterUnderTest:
    """One adapter variant, its session, and the device it talks to.

    Attributes:
        tools: what the adapter last listed, name to its entry; None as long as no session was opened.
        mark: sequence number in the device's journal at which the next slice begins.
        looked_through: everything before ``mark`` has been looked at, and since then nobody has called the adapter.
        unmet: requirements of the envelope that the adapter's own answers do not meet, where it does not claim to have one.
    """

    def __init__(self, adapter: Adapter, variant: str, device: Device, options: BenchOptions) -> None:
        self.adapter = adapter
        self.variant = variant
        self.device = device
        self.session: McpSession | None = None
        self.tools: Mapping[str, Mapping[str, Any]] | None = None
        self.unmet: set[str] = set()
        self._options = options
        self._start_failure: SubjectError | None = None
        self._work: tempfile.TemporaryDirectory[str] | None = None
        self.mark = 0
        self.looked_through = False
        self.session_mark = 0

    @property
    def deadline_s(self) -> float:
        """Seconds within which every call must have answered."""
        return self.adapter.deadline_s * self._options.time_scale

    @property
    def endpoint(self) -> dict[str, str]:
        """What the placeholders of a subject file stand for, by name."""
        return endpoint_values(protocols()[self.adapter.protocol].scheme, self.device.endpoints)

    # -- life ---------------------------------------------------------------------------------------------

    def new_session(self) -> McpSession:
        """A session that has not been opened yet, with a process of its own."""
        if self._work is None:
            self._work = tempfile.TemporaryDirectory(prefix="otmcp-", ignore_cleanup_errors=True)
        values = {
            **self.endpoint,
            "python": sys.executable,
            "kit_version": __version__,
            "dir": str(self.adapter.directory),
            "work": self._work.name,
            "http_port": str(_free_port()) if self.adapter.url is not None else "",
        }
        launch = self.adapter.variants[self.variant].for_endpoint(values)
        for name, content in launch.files.items():
            file = Path(self._work.name, name)
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(content, encoding="utf-8")
        options = SessionOptions(
            era=self.adapter.era or self._options.era,
            start_timeout_s=self.adapter.start_timeout_s * self._options.time_scale,
            exit_grace_s=_EXIT_GRACE_S * self._options.time_scale,
            url=None if self.adapter.url is None else str(replace_placeholders(self.adapter.url, values)),
        )
        return McpSession(launch.command, launch.env, launch.cwd, options)

    async def open(self) -> None:
        """Make sure that there is a usable session.

        Raises:
            SubjectError: the adapter cannot be started. Said again at once when it was found before: a start that
                runs into its deadline must not be waited for by every item.
        """
        if self._start_failure is not None:
            raise self._start_failure
        if self.session is not None and not self.session.died:
            return
        await self.close()
        # Everything that this session will ever do to its device is on the journal from here on.
        self.session_mark = await self.device.mark()
        session = self.new_session()
        try:
            await session.open()
            self.session, self.tools = session, session.tools
            await self._connect()
        except SubjectError as failure:
            self._start_failure = failure
            await self.close()
            raise

    async def _connect(self) -> None:
        failure = await self.connect()
        if failure is not None:
            tool = self.adapter.connect.tool if self.adapter.connect is not None else ""
            raise SubjectError("connect_step", f"the connect step {tool!r} failed: {failure[:400]}")

    async def connect(self) -> str | None:
        """Perform the subject's connect step, if it has one; returns the words of its failure, or None."""
        step = self.adapter.connect
        if step is None:
            return None
        arguments = replace_template(step.arguments, {}, self.endpoint)
        exchange = await self._current(None).call(step.tool, arguments, timeout_s=1.2 * self.deadline_s)
        if exchange.response is None:
            return f"no reply ({exchange.failure})"
        try:
            answer = interpret(parse_strict(exchange.response), self.adapter.answering)
        except ValueError as error:
            return f"the response is not strict JSON: {error}"
        return None if answer.success else answer.text

    async def close(self) -> None:
        """Close the session, if there is one."""
        session, self.session = self.session, None
        if session is not None:
            await session.close()
        work, self._work = self._work, None
        if work is not None:
            work.cleanup()

    def _current(self, session: McpSession | None) -> McpSession:
        session = session or self.session
        if session is None:
            raise KitError(f"the {self.adapter.protocol} session was used before it was opened")
        return session

    # -- calls --------------------------------------------------------------------------------------------

    async def call(self, operation: str, *, role: str, session: McpSession | None = None, **inputs: Any) -> Reply:
        """Perform an abstract operation through the adapter's own tools.

        Args:
            operation: name of the operation.
            role: see :class:`~pytest_otmcp.trial.reply.Reply`.
            session: a session other than the station's.
            inputs: the operation's inputs.

        Raises:
            NoBindingError: the subject does not say how it is performed.
        """
        bound = self.adapter.operations.get(operation)
        session = self._current(session)
        if isinstance(bound, Function):
            return await self._perform(bound, session, role, inputs)
        binding = next((case for case in bound or () if case.fits(inputs)), None)
        if binding is None:
            asked = ", ".join(f"{name}={value!r}" for name, value in inputs.items()) if bound else "any input"
            raise NoBindingError(
                f"{self.adapter.protocol}: the subject binds no tool to the operation {operation!r} for {asked}"
            )
        arguments = binding.fill(inputs, self.endpoint)
        # The client gives up a little later than the deadline, so that a late answer is seen to be late.
        timeout_s = 1.2 * self.deadline_s
        if binding.resource:
            exchange = await session.read_resource(binding.tool, timeout_s=timeout_s)
        else:
            exchange = await session.call(binding.tool, arguments, timeout_s=timeout_s)
        reply = self._observed(
            operation,
            role,
            _wire([exchange]),
            tool=binding.tool,
            arguments=arguments,
            answering=binding.answering,
            binding=binding,
            listed=self.variant == READ_WRITE or binding.resource or binding.tool in session.tools,
        )
        if not binding.answering.native:
            self._note_unmet(exchange)
        return reply

    def _observed(
        self,
        operation: str,
        role: str,
        wire: Wire,
        *,
        tool: str,
        arguments: Mapping[str, Any],
        answering: Answering,
        binding: Binding | None,
        listed: bool,
    ) -> Reply:
        return observe(
            wire,
            adapter=self.adapter.protocol,
            variant=self.variant,
            operation=operation,
            tool=tool,
            arguments=arguments,
            role=role,
            deadline_s=self.deadline_s,
            answering=answering,
            outputs=binding.outputs if binding is not None else {},
            listed=listed,
        )

    def _note_unmet(self, exchange: Exchange) -> None:
        try:
            result = parse_strict(exchange.response or b"null")
        except ValueError:
            return
        if isinstance(result, dict) and isinstance(result.get("result"), dict):
            self.unmet |= {fault.requirement for fault in check_result(result["result"]) if fault.requirement}

    async def _perform(self, function: Function, session: McpSession, role: str, inputs: dict[str, Any]) -> Reply:
        tools = _Tools(self, session)
        outputs: Mapping[str, Any] = {}
        refusal: Refused | None = None
        try:
            outputs = checked_outputs(function, self.adapter.protocol, await function.call(tools, **inputs))
        except Refused as stated:
            refusal = stated
        except _NoAnswerError:
            pass
        except UsageError as error:
            raise NoBindingError(str(error)) from None
        except Exception as error:
            raise NoBindingError(
                f"the binding function {function.name} failed: {type(error).__name__}: {error}"
            ) from error
        if not tools.exchanges:
            raise NoBindingError(f"the binding function {function.name} called no tool")
        reply = self._observed(
            function.name,
            role,
            _wire(tools.exchanges),
            tool="+".join(exchange.tool for exchange in tools.exchanges),
            arguments=inputs,
            answering=Answering(form="text"),
            binding=None,
            listed=True,
        )
        performed(reply, outputs, None if refusal is None else (refusal.code, str(refusal)))
        return reply


class _NoAnswerError(Exception):
    """A tool gave no answer, or one that nobody can read, so the function cannot go on; the exchange says why."""


class _Tools:
    """What a function of the bindings file is given: the adapter's tools, every exchange recorded."""

    def __init__(self, station: AdapterUnderTest, session: McpSession) -> None:
        self.host = station.device.host
        self.port = station.device.port
        self.url = station.endpoint["url"]
        self.state = session.state
        self.exchanges: list[Exchange] = []
        self._session = session
        self._timeout_s = 1.2 * station.deadline_s

    async def call(self, tool: str, /, **arguments: Any) -> ToolAnswer:
        return self._answer(await self._session.call(tool, arguments, timeout_s=self._timeout_s))

    async def read_resource(self, uri: str) -> ToolAnswer:
        return self._answer(await self._session.read_resource(uri, timeout_s=self._timeout_s))

    def _answer(self, exchange: Exchange) -> ToolAnswer:
        self.exchanges.append(exchange)
        if exchange.response is None:
            raise _NoAnswerError
        try:
            message = parse_strict(exchange.response)
        except ValueError:
            # What is wrong with it is found where every response is read.
            raise _NoAnswerError from None
        structured, text, is_error = read_answer(message, "structured")
        return ToolAnswer(text=text, structured=structured, is_error=is_error)


def _free_port() -> int:
    # A server has to be told its port before it exists; on loopback nobody takes it in between but by chance.
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _wire(exchanges: list[Exchange]) -> Wire:
    """The exchanges of one operation as one: from the first request to the last reply."""
    first, last = exchanges[0], exchanges[-1]
    return Wire(
        request=b"\n".join(exchange.request for exchange in exchanges),
        response=last.response,
        sent_ns=first.sent_ns,
        received_ns=last.received_ns,
        failure=last.failure,
        client_complaint=last.client_complaint,
        asked_ns=first.asked_ns,
        returned_ns=last.returned_ns,
    )
