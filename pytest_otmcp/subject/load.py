"""Reads a subject file (TOML) into a :class:`~pytest_otmcp.subject.model.Subject`."""

from __future__ import annotations

import hashlib
import os
import tomllib
from functools import cache
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from .. import __version__
from ..core.errors import UsageError
from ..protocols.protocol import RECOVERY
from ..protocols.registry import protocols
from .functions import load_functions
from .load_bindings import BindingReader
from .model import Adapter, Answering, Binding, Connect, Deviation, Function, Subject, Variant, environment_names
from .reading import Reader, kind

__all__ = ["load_subject", "reference_subject"]

_DEADLINE_S = 5.0
_START_TIMEOUT_S = 30.0

_ADAPTER_KEYS = (
    "command cwd env files secrets transport url era start_timeout_s deadline_s rw ro unclaimed connect recovery answer "
    "outcome errors probes bindings bind"
).split()
_RECOVERY = ("same_session", "connect_step", "new_session")


@cache
def reference_subject() -> Subject:
    """The shipped reference adapters, described the way a vendor describes his."""
    with resources.as_file(resources.files(__package__) / "reference.toml") as path:
        return load_subject(path)


def load_subject(path: Path) -> Subject:
    """Read and check ``path``.

    An adapter that says nothing about its tools (no ``bind``, ``bindings`` or ``answer``) gets the reference bindings: it
    has the same tools as a reference adapter.

    Raises:
        UsageError: the file cannot be read or says something that the kit does not understand.
    """
    try:
        content = path.read_bytes()
        document = tomllib.loads(content.decode("utf-8"))
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no such subject file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: the subject file cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not valid TOML: {error}") from None
    return _SubjectReader(path).subject(document, content)


class _SubjectReader(Reader):
    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._sources: list[Path] = []

    def subject(self, document: dict[str, Any], content: bytes) -> Subject:
        self.table(document, "", ("subject", "adapter", "deviation"))
        about = self.table(document.get("subject"), "subject", ("name", "version"))
        adapters = self.table(document.get("adapter"), "adapter", protocols())
        if not adapters:
            raise self.refuse("adapter", f"expected at least one of {', '.join(protocols())}")
        read = {protocol: self._adapter(protocol, table) for protocol, table in adapters.items()}
        digest = hashlib.sha256(content)
        for source in self._sources:
            digest.update(b"\0" + source.name.encode() + b"\0" + source.read_bytes())
        return Subject(
            name=self.text(about, "name", "subject"),
            version=self.text(about, "version", "subject").replace("{kit_version}", __version__),
            adapters=read,
            source=self.path,
            deviations=self._deviations(document.get("deviation", [])),
            digest=f"sha256:{digest.hexdigest()}",
        )

    def _deviations(self, value: Any) -> tuple[Deviation, ...]:
        if not isinstance(value, list):
            raise self.refuse("deviation", f"expected [[deviation]] tables, found {kind(value)}")
        deviations = []
        for index, entry in enumerate(value):
            key = f"deviation[{index}]"
            table = self.table(entry, key, ("item", "reason", "expires"))
            item, reason = self.text(table, "item", key), self.text(table, "reason", key)
            deviations.append(Deviation(item=item, reason=reason, expires=self.date(table, "expires", key)))
        if twice := {entry.item for entry in deviations if sum(other.item == entry.item for other in deviations) > 1}:
            raise self.refuse("deviation", f"more than one for the item {', '.join(sorted(twice))}")
        return tuple(deviations)

    def _adapter(self, protocol: str, value: Any) -> Adapter:
        key, known = f"adapter.{protocol}", protocols()[protocol]
        table = self.table(value, key, (*_ADAPTER_KEYS, *(choice.key for choice in known.choices)))
        recovery = self.choice(table.get("recovery", "same_session"), f"{key}.recovery", _RECOVERY)
        connect = self._connect(table["connect"], f"{key}.connect", recovery) if "connect" in table else None
        if recovery == "connect_step" and connect is None:
            raise self.refuse(f"{key}.recovery", "'connect_step' needs a 'connect' table")
        unclaimed = self.texts(table.get("unclaimed", {}), f"{key}.unclaimed")
        self.table(unclaimed, f"{key}.unclaimed", known.facets)
        for facet, reason in unclaimed.items():
            if not reason.strip():
                raise self.refuse(f"{key}.unclaimed.{facet}", "expected the reason")
        if recovery == "new_session":
            unclaimed = {RECOVERY: "needs a new session after an outage", **unclaimed}
        for choice in known.choices:
            chosen = self.choice(table.get(choice.key, choice.default), f"{key}.{choice.key}", choice.unclaims)
            unclaimed = {**choice.unclaims[chosen], **unclaimed}
        bindings = BindingReader(self, protocol)
        answering = bindings.answering(table, key)
        transport, url = self._transport(table, key)
        return Adapter(
            protocol=protocol,
            directory=self.path.parent.resolve(),
            variants={name: self._variant(table, name, key) for name in ("rw", "ro")},
            operations=self._operations(bindings, protocol, table, key, answering),
            answering=answering,
            unclaimed=unclaimed,
            connect=connect,
            recovery=recovery,
            probes={**known.probes, **self.table(table.get("probes", {}), f"{key}.probes", known.probes)},
            secrets=self.text_list(table.get("secrets", []), f"{key}.secrets", "names of environment variables"),
            transport=transport,
            url=url,
            era=self.choice(table["era"], f"{key}.era", ("auto", "legacy")) if "era" in table else None,
            deadline_s=self.seconds(table, "deadline_s", key, _DEADLINE_S),
            start_timeout_s=self.seconds(table, "start_timeout_s", key, _START_TIMEOUT_S),
        )

    def _variant(self, adapter: dict[str, Any], name: str, adapter_key: str) -> Variant:
        key = f"{adapter_key}.{name}"
        table = self.table(adapter.get(name, {}), key, ("command", "args", "env", "files"))
        owner, owner_key = (table, key) if "command" in table else (adapter, adapter_key)
        command = owner.get("command")
        if not isinstance(command, list) or not command or not all(isinstance(part, str) for part in command):
            raise self.refuse(f"{owner_key}.command", "expected a non-empty list of strings, the argument vector")
        more = self.text_list(table.get("args", []), f"{key}.args", "further arguments")
        env = self.texts(adapter.get("env", {}), f"{adapter_key}.env")
        files = self.texts(adapter.get("files", {}), f"{adapter_key}.files")
        files = files | self.texts(table.get("files", {}), f"{key}.files")
        for file in files:
            if PurePosixPath(file).is_absolute() or ".." in PurePosixPath(file).parts:
                raise self.refuse(f"{adapter_key}.files", f"{file!r} must be a name below {{work}}")
        env = env | self.texts(table.get("env", {}), f"{key}.env")
        for text in (*command, *more, *env.values(), *files.values()):
            if unset := sorted(environment_names(text) - os.environ.keys()):
                raise self.refuse(key, f"the environment variable {unset[0]} is not set; {{env:{unset[0]}}} needs it")
        return Variant(command=(*command, *more), env=env, cwd=self._directory(adapter, adapter_key), files=files)

    def _directory(self, table: dict[str, Any], key: str) -> Path | None:
        if "cwd" not in table:
            return None
        cwd = self.path.parent / self.text(table, "cwd", key)
        if not cwd.is_dir():
            raise self.refuse(f"{key}.cwd", f"{cwd} is not a directory")
        return cwd

    def _transport(self, table: dict[str, Any], key: str) -> tuple[str, str | None]:
        transport = self.choice(table.get("transport", "stdio"), f"{key}.transport", ("stdio", "http"))
        if transport == "stdio":
            if "url" in table:
                raise self.refuse(f"{key}.url", 'only an adapter with transport = "http" has a URL')
            return transport, None
        url = self.text(table, "url", key)
        parts = urlsplit(url.replace("{http_port}", "1"))
        if parts.scheme != "http" or parts.hostname not in ("127.0.0.1", "localhost", "::1"):
            raise self.refuse(f"{key}.url", f"expected http:// with a loopback address, found {url!r}")
        return transport, url

    def _connect(self, value: Any, key: str, recovery: str) -> Connect:
        table = self.table(value, key, ("tool", "arguments"))
        arguments = self.table(table.get("arguments", {}), f"{key}.arguments")
        return Connect(tool=self.text(table, "tool", key), arguments=arguments, again=recovery == "connect_step")

    def _operations(
        self, bindings: BindingReader, protocol: str, table: dict[str, Any], key: str, answering: Answering
    ) -> dict[str, tuple[Binding, ...] | Function]:
        operations: dict[str, tuple[Binding, ...] | Function] = {}
        if "bind" in table:
            operations |= bindings.operations(table["bind"], f"{key}.bind", answering)
        if "bindings" in table:
            path = self.path.parent / self.text(table, "bindings", key)
            functions = load_functions(path, protocol, f"{self.path}: {key}.bindings")
            if both := sorted(functions.keys() & operations.keys()):
                raise self.refuse(f"{key}.bind.{both[0]}", f"{path.name} has a function for this operation as well")
            operations |= functions
            self._sources.append(path)
        if not {"bind", "bindings"} & table.keys():
            if not answering.native:
                raise self.refuse(key, "expected 'bind' tables, which say what tool performs which operation")
            operations |= reference_subject().adapters[protocol].operations
        return operations
