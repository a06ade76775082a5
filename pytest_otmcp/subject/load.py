"""Loading of a subject file (TOML) into a :class:`~pytest_otmcp.subject.model.Subject`.

``grammar`` checks the shape of the file. This module checks and adds what needs several tables or things outside of the
file: directories, environment variables, the bindings file, the defaults of the reference adapters.
"""

from __future__ import annotations

import hashlib
import os
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import urlsplit

from .. import __version__
from ..core import files
from ..core.errors import UsageError
from ..protocols.bounds import Bounds, Governance, Scopes, Times
from ..protocols.protocol import LAUNCHES, RECOVERY
from ..protocols.registry import protocols
from .addressing import check_addresses
from .bindings import output_rule, read_answering, read_bindings
from .command_tables import declared_by, with_commands
from .functions import load_functions, named_functions
from .grammar import subject_file
from .handles import check_handles
from .kinds import Refusal
from .model import (
    BOUNDED,
    GOVERNED,
    READ_ONLY,
    READ_WRITE,
    RETIMED,
    SECURE_FORM,
    WITH_TOKENS,
    Adapter,
    Answering,
    Binding,
    CallLimit,
    Connect,
    Deviation,
    Function,
    Governed,
    Openings,
    OutcomeRule,
    Ready,
    Subject,
    Tokens,
    Variant,
    environment_names,
)
from .placeholder_check import check_placeholders
from .reading_tables import with_readings

__all__ = ["load_subject", "named_subject", "reference_subject"]


@cache
def reference_subject() -> Subject:
    """Load the description of the shipped reference adapters; it is a subject file like that of any vendor."""
    with resources.as_file(resources.files(__package__) / "reference.toml") as path:
        return load_subject(path)


@cache
def named_subject() -> Subject:
    """Load the description of the reference adapters with vocabularies of their own."""
    with resources.as_file(resources.files(__package__) / "named.toml") as path:
        return load_subject(path)


def load_subject(path: Path, *, run: bool = True) -> Subject:
    """Read and check ``path``.

    Args:
        path: the file.
        run: False for a subject that is only compared, because the file is somebody else's: its bindings file is not imported,
            and it need not be possible to start its adapters here.

    An adapter that says nothing about its tools (no ``bind``, ``bindings`` or ``answer``) gets the reference bindings: it
    has the same tools as a reference adapter.

    Raises:
        UsageError: the file cannot be read or says something that the kit does not understand.
    """
    try:
        content = files.read(path)
        document = tomllib.loads(content.decode("utf-8"))
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no such subject file") from None
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise UsageError(f"{path}: the subject file cannot be read ({reason})") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not valid TOML: {error}") from None
    try:
        return _subject(subject_file(protocols()).read(document, ""), path, content, run=run)
    except Refusal as refusal:
        raise UsageError(f"{path}: {refusal}") from None


def _subject(document: Mapping[str, Any], path: Path, content: bytes, *, run: bool) -> Subject:
    adapters = {protocol: _adapter(protocol, table, path, run=run) for protocol, table in document["adapter"].items()}
    digest = hashlib.sha256(content)
    for table in document["adapter"].values():
        if "bindings" in table:
            source = path.parent / table["bindings"]
            digest.update(b"\0" + source.name.encode() + b"\0" + files.read(source))
    return Subject(
        name=document["subject"]["name"],
        version=document["subject"]["version"].replace("{kit_version}", __version__),
        adapters=adapters,
        source=path,
        deviations=_deviations(document["deviation"]),
        digest=f"sha256:{digest.hexdigest()}",
    )


def _deviations(tables: list[dict[str, Any]]) -> tuple[Deviation, ...]:
    items = Counter(table["item"] for table in tables)
    if twice := sorted(item for item, count in items.items() if count > 1):
        raise Refusal("deviation", f"more than one for the item {', '.join(twice)}")
    return tuple(Deviation(**table) for table in tables)


def _adapter(protocol: str, table: Mapping[str, Any], path: Path, *, run: bool) -> Adapter:
    key, known = f"adapter.{protocol}", protocols()[protocol]
    answering = read_answering(table, key, Answering())
    operations, connect = _operations(protocol, table, key, answering, path, run=run), _connect(table)
    added = declared_by(operations, known)
    lists = {name: (*table[name], *added.get(name, ())) for name in known.lists}
    try:
        known.presets(lists)
    except ValueError as error:
        raise Refusal(key, str(error)) from None
    _check_placeholders(table, key, operations)
    check_addresses(protocol, operations, connect, f"{key}.bind")
    check_handles(operations, connect, table.get("ready", {}).get("arguments"), key)
    return Adapter(
        protocol=protocol,
        directory=path.parent.resolve(),
        variants={name: _variant(table, name, key, path.parent, run=run) for name in _launches(table)},
        operations=operations,
        answering=answering,
        unclaimed=_unclaimed(protocol, table, operations),
        connect=connect,
        recovery=table["recovery"],
        recovery_s=float(table["recovery_s"]),
        call_limit=CallLimit(**table["call_limit"]) if "call_limit" in table else None,
        lists=lists,
        probes={**known.probes, **table["probes"]},
        secrets=tuple(table["secrets"]),
        secret_env=_secret_env(table, key),
        transport=table["transport"],
        url=_url(table, key),
        era=table.get("era"),
        deadline_s=float(table["deadline_s"]),
        start_timeout_s=float(table["start_timeout_s"]),
        bounds=Bounds.of_record(table[BOUNDED]) if BOUNDED in table else None,
        times=Times.of_record(table[RETIMED]) if RETIMED in table else None,
        governed=_governed(table[GOVERNED]) if GOVERNED in table else None,
        secured={
            member: table[SECURE_FORM][name] for name, member in _TOLD_OF.items() if name in table.get(SECURE_FORM, {})
        },
        tokens=_tokens(table[WITH_TOKENS], f"{key}.{WITH_TOKENS}") if WITH_TOKENS in table else None,
        ready=_ready(table, key, answering),
        openings=_openings(table["isolation"], path.parent),
    )


_TOLD_OF = {"policy": "version", "mode": "cipher"}
"""Keys of a launch for the secure form, to the members of a handshake in the journal."""


def _governed(table: Mapping[str, Any]) -> Governed:
    audit, approval = table.get("audit"), table.get("approval")
    told = Governance(
        bounds=Bounds.of_record(table),
        viewer="viewer" in table,
        audit=audit
        and {
            **{name: audit[name] for name in ("fields", "anchor", "digest")},
            "is_file": "path" in audit,
            "verifies": "verify" in audit,
        },
        approval=approval and {name: value for name, value in approval.items() if name not in ("approve", "decline")},
    )
    log = audit or {}
    return Governed(
        told=told,
        viewer=table.get("viewer"),
        log=log.get("path", ""),
        records=tuple(log.get("records", ())),
        verify=tuple(log.get("verify", ())),
        approve=tuple((approval or {}).get("approve", ())),
        decline=tuple((approval or {}).get("decline", ())),
    )


def _tokens(table: Mapping[str, Any], key: str) -> Tokens:
    url = _url(table, key)
    assert url is not None
    return Tokens(url=url, scopes=Scopes.of_record(table))


def _openings(table: Mapping[str, Any], directory: Path) -> Openings:
    def paths(name: str) -> tuple[Path, ...]:
        return tuple(Path(os.path.abspath(directory / entry)) for entry in table.get(name, ()))

    return Openings(
        why_outside=f"the adapter needs the network of the machine: {table['reason']}"
        if table.get("network") == "host"
        else "",
        reads=paths("read"),
        writes=paths("write"),
    )


_GIVEN = "{password}"
"""The value of a setting that takes the password of the device's account."""


def _secret_env(table: Mapping[str, Any], key: str) -> tuple[str, ...]:
    names: list[str] = table["secret_env"]
    for name in names:
        parts = (table, *(table[variant] for variant in _launches(table)))
        # The password of the device's account is a random value of the kit, too.
        if any(part["env"].get(name, _GIVEN) != _GIVEN for part in parts):
            raise Refusal(
                f"{key}.secret_env",
                f"{name} has a value in 'env'; a secret that must have that value belongs into 'secrets'",
            )
    return tuple(names)


def _check_placeholders(
    table: Mapping[str, Any], key: str, operations: Mapping[str, tuple[Binding, ...] | Function]
) -> None:
    for variant in ("", *(f".{name}" for name in _launches(table))):
        within = table if not variant else table[variant[1:]]
        for name in ("command", "args", "env"):
            check_placeholders(within.get(name), f"{key}{variant}.{name}")
    check_placeholders(table.get("url"), f"{key}.url")
    check_placeholders(table.get(WITH_TOKENS, {}).get("url"), f"{key}.{WITH_TOKENS}.url")
    for step in ("connect", "ready"):
        check_placeholders(table.get(step, {}).get("arguments"), f"{key}.{step}.arguments")
    known = protocols()[key.rpartition(".")[2]].operations
    for name, bound in operations.items():
        for binding in bound if not isinstance(bound, Function) else ():
            if binding.command is None:
                check_placeholders(binding.arguments, f"{key}.bind.{name}.arguments", known[name].accepted)


def _unclaimed(
    protocol: str, table: Mapping[str, Any], operations: Mapping[str, tuple[Binding, ...] | Function]
) -> dict[str, str]:
    unclaimed: dict[str, str] = {}
    known = protocols()[protocol]
    other = [name for name, operation in known.operations.items() if not operation.voluntary and name not in operations]
    if table["commands"]:
        # The file has said how the adapter writes.
        unclaimed |= {name: "the adapter writes by named commands" for name in other if known.operations[name].writes}
    if table.get("readings"):
        unclaimed |= {name: "the adapter reads by named readings" for name in other if name in known.places}
    for choice in protocols()[protocol].choices:
        unbound = choice.unbound.get(table[choice.key], {})
        unclaimed |= {name: reason for name, reason in unbound.items() if name not in operations}
        unclaimed |= choice.unclaims[table[choice.key]]
    if table["recovery"] == "new_session":
        unclaimed[RECOVERY] = "needs a new session after an outage"
    unclaimed |= table["unclaimed"]
    return unclaimed


def _launches(table: Mapping[str, Any]) -> list[str]:
    """Return the names of the variants that a table describes."""
    return [READ_WRITE, *(name for name in LAUNCHES.values() if name in table)]


def _variant(adapter: Mapping[str, Any], name: str, adapter_key: str, directory: Path, *, run: bool) -> Variant:
    table, key = adapter[name], f"{adapter_key}.{name}"
    if name not in (READ_WRITE, READ_ONLY):
        enabled = adapter[READ_WRITE]
        table = {
            "command": table.get("command", enabled.get("command", adapter.get("command", ()))),
            "args": [*enabled["args"], *table["args"]],
            "env": enabled["env"] | table["env"],
            "files": enabled["files"] | table["files"],
        }
    command = (*table.get("command", adapter.get("command", ())), *table["args"])
    env, files = adapter["env"] | table["env"], adapter["files"] | table["files"]
    for file in files:
        if PurePosixPath(file).is_absolute() or ".." in PurePosixPath(file).parts:
            raise Refusal(f"{adapter_key}.files", f"{file!r} must be a name below {{work}}")
    if not run:
        return Variant(command=command, env=env, cwd=None, files=files)
    for text in (*command, *env.values(), *files.values()):
        if unset := sorted(environment_names(text) - os.environ.keys()):
            raise Refusal(key, f"the environment variable {unset[0]} is not set; {{env:{unset[0]}}} needs it")
    return Variant(command=command, env=env, cwd=_directory(adapter, adapter_key, directory), files=files)


def _directory(table: Mapping[str, Any], key: str, within: Path) -> Path | None:
    if "cwd" not in table:
        return None
    # Absolute: what starts the adapter is not where the kit is.
    cwd: Path = (within / table["cwd"]).resolve()
    if not cwd.is_dir():
        raise Refusal(f"{key}.cwd", f"{cwd} is not a directory")
    return cwd


def _url(table: Mapping[str, Any], key: str) -> str | None:
    if "url" not in table:
        return None
    url: str = table["url"]
    parts = urlsplit(url.replace("{http_port}", "1"))
    if parts.scheme != "http" or parts.hostname not in ("127.0.0.1", "localhost", "::1"):
        raise Refusal(f"{key}.url", f"expected http:// with a loopback address, found {url!r}")
    return url


def _connect(table: Mapping[str, Any]) -> Connect | None:
    if "connect" not in table:
        return None
    step = table["connect"]
    keep = {name: output_rule(rule) for name, rule in step["keep"].items()}
    return Connect(tool=step["tool"], arguments=step["arguments"], again=table["recovery"] == "connect_step", keep=keep)


def _ready(table: Mapping[str, Any], key: str, answering: Answering) -> Ready | None:
    if "ready" not in table:
        return None
    told = table["ready"]
    read = read_answering({"answer": told["answer"]} if "answer" in told else {}, f"{key}.ready", answering)
    if told.keys() & {"text", "path"}:
        says_so = OutcomeRule(success=True, text=told.get("text"), path=told.get("path"))
        # The kit's own envelope is structured content, which a path can search.
        form = "structured" if read.native else read.form
        read = Answering(form=form, outcome=(says_so, OutcomeRule(success=False)))
    return Ready(tool=told["tool"], arguments=told["arguments"], answering=read)


def _operations(
    protocol: str, table: Mapping[str, Any], key: str, answering: Answering, path: Path, *, run: bool
) -> dict[str, tuple[Binding, ...] | Function]:
    operations: dict[str, tuple[Binding, ...] | Function] = {}
    if "bind" in table:
        operations |= read_bindings(table["bind"], f"{key}.bind", answering)
    if "bindings" in table:
        source = path.parent / table["bindings"]
        load = load_functions if run else named_functions
        functions = load(source, protocol, f"{path}: {key}.bindings")
        if both := sorted(functions.keys() & operations.keys()):
            raise Refusal(f"{key}.bind.{both[0]}", f"{source.name} has a function for this operation as well")
        operations |= functions
    known = protocols()[protocol]
    if table["commands"]:
        operations = with_commands(operations, table["commands"], f"{key}.commands", answering, known)
    if readings := table.get("readings"):
        operations = with_readings(operations, readings, f"{key}.readings", answering, known)
    if not (table["commands"] or readings or {"bind", "bindings"} & table.keys()):
        if not answering.native:
            raise Refusal(key, "expected 'bind' tables, which say what tool performs which operation")
        operations |= _without_voluntary(protocol, reference_subject().adapters[protocol].operations)
    return operations


def _without_voluntary(
    protocol: str, operations: Mapping[str, tuple[Binding, ...] | Function]
) -> dict[str, tuple[Binding, ...] | Function]:
    """Return what every adapter with these operations claims, whether it says so or not."""
    known, found = protocols()[protocol].operations, dict[str, tuple[Binding, ...] | Function]()
    for name, bound in operations.items():
        if known[name].voluntary or isinstance(bound, Function):
            continue
        inputs = [f"${voluntary}" for voluntary in known[name].voluntary_inputs]
        found[name] = tuple(
            replace(
                binding,
                arguments={key: value for key, value in binding.arguments.items() if value not in inputs},
                outputs={key: rule for key, rule in binding.outputs.items() if key in known[name].outputs},
            )
            for binding in bound
        )
    return found
