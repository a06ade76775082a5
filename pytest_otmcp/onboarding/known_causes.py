"""Known causes why an adapter does not start, with remedies; recognised by the last lines that it wrote. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

__all__ = ["Advice", "KnownCause", "find_advice", "find_library_advice"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """A cause and what to do about it, a sentence each."""

    cause: str
    remedy: str


@dataclass(frozen=True, slots=True, kw_only=True)
class KnownCause:
    """A cause that is recognised by words in the adapter's last lines.

    Attributes:
        group: of several causes of one group only the first is named.
        pattern: matches the words; its group ``what``, if it has one, stands for ``{what}`` in the sentences.
        cause, remedy: a sentence each, as a template.
    """

    group: str
    pattern: str
    cause: str
    remedy: str


_NO_NAMES = (
    r"Temporary failure in name resolution|Name or service not known|EAI_AGAIN|ENOTFOUND|Could not resolve host|dns error|"
    r"failed to lookup address"
)
# Most of these causes were seen with adapters from the package index; the most specific come first.
_CAUSES = (
    KnownCause(
        group="network",
        pattern=r"Cannot connect to the Docker daemon|Cannot connect to Podman|connect: no such file or directory.*docker\.sock",
        cause="Its command starts a container, and it has neither the network nor the sockets of the machine.",
        remedy="Say --isolation=off here, and isolation = { network = 'host', reason = '...', read = ['/run/docker.sock'] } in the subject file.",
    ),
    KnownCause(
        group="network",
        pattern=_NO_NAMES,
        cause="It asked for a name of the network, and it has no network but its device's.",
        remedy="Install beforehand what it loads when it starts, as 'uvx' and 'npx' do; or say --isolation=off here, and isolation.network = 'host' with a reason in the subject file.",
    ),
    KnownCause(
        group="sdk",
        pattern=r"No module named 'mcp\.server\.fastmcp'|cannot import name 'FastMCP' from 'mcp",
        cause="It was written for version 1 of the MCP SDK, and version 2 is installed, which has no mcp.server.fastmcp.",
        remedy="Install it into an environment of its own with 'mcp<2'.",
    ),
    KnownCause(
        group="sdk",
        pattern=r"'Server' object has no attribute '(list_tools|call_tool|list_resources)'",
        cause="It uses the decorators of version 1 of the MCP SDK's low-level server, and version 2 is installed.",
        remedy="Install it into an environment of its own with 'mcp<2'.",
    ),
    KnownCause(
        group="sdk",
        pattern=r"No module named 'fastmcp\.[\w.]+'",
        cause="It was written for an earlier version of FastMCP than the one that is installed.",
        remedy="Install it into an environment of its own with 'fastmcp<3'.",
    ),
    KnownCause(
        group="module",
        pattern=r"No module named '(?P<what>[\w.]+)'",
        cause="The module {what} is not installed in the adapter's environment.",
        remedy="Install the package that has it, or launch the adapter with the interpreter of its own environment.",
    ),
    KnownCause(
        group="module",
        pattern=r"ImportError: cannot import name '(?P<what>\w+)'",
        cause="A package that it imports {what} from is there in another version than it was written for.",
        remedy="Install the versions that the adapter's documentation names.",
    ),
    KnownCause(
        group="python",
        pattern=r"SyntaxError|requires a different Python|requires-python",
        cause="It does not run on this version of Python.",
        remedy="Launch it with a Python that it supports: put that interpreter's path into the command.",
    ),
    KnownCause(
        group="await",
        pattern=r"coroutine '(?P<what>[\w.]+)' was never awaited",
        cause="Its console script calls {what} without awaiting it, so that nothing runs.",
        remedy="Launch the module instead, with 'python -m …'.",
    ),
    KnownCause(
        group="port",
        pattern=r"[Aa]ddress already in use|EADDRINUSE|only one usage of each socket address",
        cause="A port that it wants to listen on is in use.",
        remedy="Give it a free one: {{http_port}} in command, env or url of the subject file stands for one.",
    ),
    KnownCause(
        group="endpoint",
        pattern=r"[Cc]onnection refused|ConnectionRefusedError|ECONNREFUSED|Connect call failed",
        cause="It could not connect while it started; the mock device is running, so it tried another address.",
        remedy="Say in env, args or files where the device is: {{host}}, {{port}} and {{url}} stand for it.",
    ),
    KnownCause(
        group="command",
        pattern=r"the command '(?P<what>[^']+)' was not found",
        cause="There is no program {what} on the PATH.",
        remedy="Install the adapter, or give the program's path; the PATH is the one that this command runs with.",
    ),
    KnownCause(
        group="options",
        pattern=r"(?m)^usage: |error: (unrecognized|the following) arguments|No such option|Missing option",
        cause="It does not understand its command line.",
        remedy="Compare the command with what the adapter prints for --help.",
    ),
    KnownCause(
        group="permission",
        pattern=r"[Pp]ermission denied|EACCES",
        cause="It may not read or execute something that it needs.",
        remedy="See the last lines it wrote for the file's name.",
    ),
    KnownCause(
        group="configuration",
        pattern=r"(?i)config(uration)?[ _]?(file)?[^\n]{0,60}(not found|missing|required|no such file)|FileNotFoundError",
        cause="A file that it needs is not there.",
        remedy="'files' in the subject file writes files below {{work}} before the launch.",
    ),
    KnownCause(
        group="silent",
        pattern=r"did not finish its handshake",
        cause="It runs but does not speak MCP on its standard output.",
        remedy="If it serves HTTP, say transport = \"http\" and its url; else look whether it waits for something, such as its device.",
    ),
)  # fmt: skip


def find_advice(words: str, causes: Iterable[KnownCause] = ()) -> list[Advice]:
    """Return the advice for an adapter that failed with these words, most specific first; empty when no cause is known.

    Args:
        causes: further known causes, such as those of a protocol's libraries; they are more specific than the others.
    """
    return list(_advice(words, (*causes, *_CAUSES)))


def find_library_advice(words: str, causes: Iterable[KnownCause]) -> list[Advice]:
    """Return the advice for an adapter that started, and whose calls failed with these words: causes in its protocol's libraries alone."""
    return list(_advice(words, causes))


def _advice(words: str, causes: Iterable[KnownCause]) -> Iterator[Advice]:
    named: set[str] = set()
    for known in causes:
        # A more specific cause also explains a missing module or an unfinished handshake; these are not named then.
        if known.group in named or (known.group in ("module", "silent") and named):
            continue
        match = re.search(known.pattern, words)
        if match is not None:
            named.add(known.group)
            what = {"what": match.groupdict().get("what") or ""}
            yield Advice(cause=known.cause.format(**what), remedy=known.remedy.format(**what))
