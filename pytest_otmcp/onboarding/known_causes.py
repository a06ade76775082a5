"""Why an adapter does not start, and what helps: known causes, recognised by what it last said. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

__all__ = ["Advice", "advice"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """A cause and what to do about it, a sentence each."""

    cause: str
    remedy: str


# Seen with adapters from the package index, in the order of how specific they are; the first of each group speaks.
_CAUSES: tuple[tuple[str, str, str, str], ...] = (
    (
        "sdk",
        r"No module named 'mcp\.server\.fastmcp'|cannot import name 'FastMCP' from 'mcp",
        "It was written for version 1 of the MCP SDK, and version 2 is installed, which has no mcp.server.fastmcp.",
        "Install it into an environment of its own with 'mcp<2'.",
    ),
    (
        "sdk",
        r"'Server' object has no attribute '(list_tools|call_tool|list_resources)'",
        "It uses the decorators of version 1 of the MCP SDK's low-level server, and version 2 is installed.",
        "Install it into an environment of its own with 'mcp<2'.",
    ),
    (
        "sdk",
        r"No module named 'fastmcp\.[\w.]+'",
        "It was written for an earlier version of FastMCP than the one that is installed.",
        "Install it into an environment of its own with 'fastmcp<3'.",
    ),
    (
        "library",
        r"unexpected keyword argument '(slave|unit)'",
        "It was written for an earlier version of pymodbus, whose argument of that name is gone.",
        "Install it with 'pymodbus<3.10'.",
    ),
    (
        "module",
        r"No module named '(?P<what>[\w.]+)'",
        "The module {what} is not installed in the adapter's environment.",
        "Install the package that has it, or launch the adapter with the interpreter of its own environment.",
    ),
    (
        "module",
        r"ImportError: cannot import name '(?P<what>\w+)'",
        "A package that it imports {what} from is there in another version than it was written for.",
        "Install the versions that the adapter's documentation names.",
    ),
    (
        "python",
        r"SyntaxError|requires a different Python|requires-python",
        "It does not run on this version of Python.",
        "Launch it with a Python that it supports: put that interpreter's path into the command.",
    ),
    (
        "await",
        r"coroutine '(?P<what>[\w.]+)' was never awaited",
        "Its console script calls {what} without awaiting it, so that nothing runs.",
        "Launch the module instead, with 'python -m …'.",
    ),
    (
        "port",
        r"[Aa]ddress already in use|EADDRINUSE|only one usage of each socket address",
        "A port that it wants to listen on is in use.",
        "Give it a free one: {{http_port}} in command, env or url of the subject file stands for one.",
    ),
    (
        "endpoint",
        r"[Cc]onnection refused|ConnectionRefusedError|ECONNREFUSED|Connect call failed",
        "It could not connect while it started; the mock device is running, so it tried another address.",
        "Say in env, args or files where the device is: {{host}}, {{port}} and {{url}} stand for it.",
    ),
    (
        "command",
        r"the command '(?P<what>[^']+)' was not found",
        "There is no program {what} on the PATH.",
        "Install the adapter, or give the program's path; the PATH is the one that this command runs with.",
    ),
    (
        "options",
        r"(?m)^usage: |error: (unrecognized|the following) arguments|No such option|Missing option",
        "It does not understand its command line.",
        "Compare the command with what the adapter prints for --help.",
    ),
    (
        "permission",
        r"[Pp]ermission denied|EACCES",
        "It may not read or execute something that it needs.",
        "See the last lines it wrote for the file's name.",
    ),
    (
        "configuration",
        r"(?i)config(uration)?[ _]?(file)?[^\n]{0,60}(not found|missing|required|no such file)|FileNotFoundError",
        "A file that it needs is not there.",
        "'files' in the subject file writes files below {{work}} before the launch.",
    ),
    (
        "silent",
        r"did not finish its handshake",
        "It runs but does not speak MCP on its standard output.",
        "If it serves HTTP, say transport = \"http\" and its url; else look whether it waits for something, such as its device.",
    ),
)  # fmt: skip


def advice(words: str) -> list[Advice]:
    """What is known about an adapter that failed with these words, most specific first; empty when nothing is."""
    return list(_advice(words))


def _advice(words: str) -> Iterator[Advice]:
    said: set[str] = set()
    for group, pattern, cause, remedy in _CAUSES:
        # A handshake that ended with an exception says more than that it did not end well.
        if group in said or (group in ("module", "silent") and said):
            continue
        match = re.search(pattern, words)
        if match is not None:
            said.add(group)
            what = {"what": match.groupdict().get("what") or ""}
            yield Advice(cause=cause.format(**what), remedy=remedy.format(**what))
