"""Which keys of the subject file may be the cause of a failure, with what they mean. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from ..core.finding_registry import finding_codes
from ..protocols.protocol import OtProtocol
from ..protocols.registry import protocols
from ..subject.grammar import adapter_table
from ..subject.tables import Table
from ..trial.task import Task

__all__ = ["keys_of_code", "keys_of_task"]


def keys_of_task(task: Task) -> Iterator[str]:
    """Describe the keys that a task declares to matter: table, key and meaning."""
    for name in task.keys:
        protocol, _, key = name.partition(".")
        yield f"[adapter.{protocol}] {key}: {meaning(protocols()[protocol], key)}"


def keys_of_code(code: str) -> Iterator[str]:
    """Describe the keys that may be the cause of a finding with this code: key and meaning, whatever the protocol."""
    known = list(protocols().values())
    for names in [finding_codes(), *(finding_codes(protocol.package) for protocol in known)]:
        for key in names[code].keys if code in names else ():
            # What follows a semicolon is for whoever writes the key for the first time.
            yield f"{key}: {meaning(known[0], key).partition(';')[0].rstrip('.')}."


def meaning(protocol: OtProtocol, key: str) -> str:
    """Return the sentence of the grammar for a key of ``[adapter.KEY]``, such as ``deadline_s`` or ``probes.missing_node``.

    Raises:
        KeyError: there is no such key.
    """
    first, _, inner = key.partition(".")
    found = adapter_table(protocol).keys[first]
    if inner:
        assert isinstance(found.kind, Table)
        found = found.kind.keys[inner]
    return found.meaning
