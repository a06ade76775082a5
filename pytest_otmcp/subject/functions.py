"""Operations that a subject performs by Python functions: several calls, captured values, polling.

A subject names a file, ``bindings = "otmcp_bindings.py"``, whose functions are called like the operations they perform::

    from pytest_otmcp.subject import Refused


    async def write(tools, *, node, value):
        prepared = await tools.call("prepare_write", node_id=node, value=value)
        if prepared.is_error:
            raise Refused("access_denied", prepared.text)
        await tools.call("commit_write", token=prepared.structured["token"])
        return {"value": value}

A function returns the operation's outputs. Every call that it makes is recorded; the operation's time counts from the first
request to the last reply.
"""

from __future__ import annotations

import ast
import inspect
import json
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import ModuleType
from typing import Any, NoReturn, Protocol

from ..core import files
from ..core.errors import UsageError
from ..protocols.registry import protocols
from .model import Function

__all__ = ["Refused", "ToolAnswer", "Tools", "load_functions", "named_functions"]


class Refused(Exception):
    """Raised by a function when the adapter answers that the operation was not performed.

    Args:
        code: of the error registry, or ``unclassified``.
        message: the adapter's own words.
    """

    def __init__(self, code: str, message: str) -> None:
        super().__init__(message)
        self.code = code


@dataclass(frozen=True, slots=True, kw_only=True)
class ToolAnswer:
    """The answer of a tool.

    Attributes:
        text: all text blocks, a line each; for a JSON-RPC error its message.
        structured: ``structuredContent``, or None.
        is_error: ``isError``, or the answer was a JSON-RPC error.
    """

    text: str
    structured: object
    is_error: bool


class Tools(Protocol):
    """The adapter's tools, as a binding function calls them.

    Attributes:
        host, port, url: endpoint of the mock device.
        state: values that are kept from call to call for as long as the session lasts, such as handles.
    """

    state: dict[str, object]
    host: str
    port: int
    url: str

    async def call(self, tool: str, /, **arguments: object) -> ToolAnswer:
        """Call a tool of the adapter."""

    async def read_resource(self, uri: str) -> ToolAnswer:
        """Read a resource of the adapter."""


class _Source(SourceFileLoader):
    """A loader of the file itself: byte code beside it may be somebody else's."""

    def get_data(self, path: str) -> bytes:
        return files.read(path)

    def path_stats(self, path: str) -> NoReturn:
        raise OSError


def load_functions(path: Path, protocol: str, key: str) -> dict[str, Function]:
    """Load the functions of a bindings file, by the operation of ``protocol`` that each performs.

    Functions whose name begins with an underscore, and imported functions, are helpers of the file and are ignored.

    Raises:
        UsageError: the file cannot be imported, or defines a function that is no operation.
    """
    name = f"otmcp_bindings_{protocol}"
    # A bindings file need not be named *.py, so the loader is chosen here.
    loader = _Source(name, str(path))
    module = ModuleType(name)
    module.__file__ = str(path)
    try:
        loader.exec_module(module)
    except FileNotFoundError:
        raise UsageError(f"{key}: {path}: there is no such file") from None
    except Exception as error:
        raise UsageError(f"{key}: {path} cannot be imported: {type(error).__name__}: {error}") from None
    functions: dict[str, Callable[..., object]] = {
        name: value
        for name, value in vars(module).items()
        if inspect.isfunction(value) and value.__module__ == module.__name__ and not name.startswith("_")
    }
    return {name: _checked(name, function, protocol, f"{key}: {path}") for name, function in functions.items()}


def named_functions(path: Path, protocol: str, key: str) -> dict[str, Function]:
    """Return the functions of a bindings file by the operations that they perform, without executing anything of it.

    Raises:
        UsageError: the file cannot be read as Python.
    """
    try:
        tree = ast.parse(files.read(path))
    except FileNotFoundError:
        raise UsageError(f"{key}: {path}: there is no such file") from None
    except (OSError, SyntaxError, ValueError, RecursionError) as error:
        raise UsageError(f"{key}: {path} cannot be read: {type(error).__name__}: {error}") from None
    known = protocols()[protocol].operations
    nodes = [node for node in ast.walk(tree) if isinstance(node, ast.AsyncFunctionDef) and node.name in known]
    return {
        node.name: Function(
            name=node.name,
            call=_never_called,
            parameters=frozenset(argument.arg for argument in (*node.args.args, *node.args.kwonlyargs)),
            uses=_used(node),
        )
        for node in nodes
    }


async def _never_called(*_: object) -> Mapping[str, Any]:
    raise AssertionError("this subject was loaded for a comparison")


def _checked(name: str, function: Callable[..., object], protocol: str, where: str) -> Function:
    operation = protocols()[protocol].operations.get(name)
    if operation is None:
        known = ", ".join(protocols()[protocol].operations)
        raise UsageError(f"{where}: {name} is no operation; they are {known} (begin helpers with an underscore)")
    if not inspect.iscoroutinefunction(function):
        raise UsageError(f"{where}: {name} must be an 'async def'")
    # Only tools that are bound as ``blocking`` are told how long to wait; a function returns what is there already.
    asked = [name for name in operation.inputs if name != operation.waits]
    try:
        inspect.signature(function).bind(None, **dict.fromkeys(asked))
    except TypeError:
        inputs = ", ".join(asked)
        expected = f"{name}(tools{', *, ' + inputs if inputs else ''})"
        raise UsageError(f"{where}: {name} must be callable as {expected}") from None
    parameters = frozenset(inspect.signature(function).parameters)
    try:
        uses = _used(ast.parse(textwrap.dedent(inspect.getsource(function))))
    except (OSError, SyntaxError):
        # One that the file has made otherwise may use them all.
        uses = parameters
    return Function(name=name, call=function, parameters=parameters, uses=uses)


def _used(node: ast.AST) -> frozenset[str]:
    """Return the names that a function, or a function within it, reads."""
    return frozenset(one.id for one in ast.walk(node) if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Load))


def checked_outputs(function: Function, protocol: str, returned: object) -> Mapping[str, Any]:
    """Return the outputs that a function returned, if the operation's needed ones are among them.

    Raises:
        UsageError: a needed output is missing, or JSON cannot express an output.
    """
    operation = protocols()[protocol].operations[function.name]
    if not isinstance(returned, Mapping) or not set(operation.needed) <= set(returned):
        wanted = ", ".join(operation.needed) or "nothing"
        raise UsageError(
            f"the binding function {function.name} must return a mapping of outputs (needed: {wanted}), "
            f"it returned {str(returned)[:100]!r}"
        )
    try:
        json.dumps(returned, allow_nan=False)
    except (TypeError, ValueError, RecursionError) as error:
        raise UsageError(f"the binding function {function.name} returned what JSON cannot say: {error}") from None
    return returned
