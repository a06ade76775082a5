"""Reads a subject file (TOML) into a :class:`~pytest_otmcp.subject.model.Subject`.

Every objection is one sentence: file, key, what was expected, and the nearest known name.
"""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Iterable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import jmespath

from .. import __version__
from ..errors import UsageError
from .model import Adapter, Binding, Subject, Variant
from .operations import OPERATIONS, PROTOCOLS

__all__ = ["load_subject", "reference_subject"]

_DEFAULT_DEADLINE_S = 5.0


def reference_subject() -> Subject:
    """The shipped reference adapters, described the way a vendor describes his."""
    with resources.as_file(resources.files(__package__) / "reference.toml") as path:
        return load_subject(path)


def load_subject(path: Path) -> Subject:
    """Read and check ``path``.

    An adapter without a ``bind`` table gets the reference bindings: it has the same tools as a reference adapter.

    Raises:
        UsageError: the file cannot be read or says something that the kit does not understand.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UsageError(f"{path}: there is no such subject file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: the subject file cannot be read ({error})") from None
    except tomllib.TOMLDecodeError as error:
        raise UsageError(f"{path}: not valid TOML: {error}") from None
    return _Reader(path).subject(document)


class _Reader:
    def __init__(self, path: Path) -> None:
        self._path = path

    def _refuse(self, key: str, message: str) -> UsageError:
        return UsageError(f"{self._path}: {key}: {message}")

    def _table(self, value: Any, key: str, known: Iterable[str] | None = None) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise self._refuse(key, f"expected a table, found {_kind(value)}")
        for name in value if known is not None else ():
            if name not in (names := sorted(known or ())):
                near = difflib.get_close_matches(name, names, 1)
                hint = f"did you mean {near[0]!r}?" if near else f"known are {', '.join(names)}"
                raise self._refuse(f"{key}.{name}" if key else name, f"unknown key; {hint}")
        return value

    def _text(self, table: Mapping[str, Any], name: str, key: str) -> str:
        value = table.get(name)
        if not isinstance(value, str) or not value:
            raise self._refuse(f"{key}.{name}", f"expected a non-empty string, found {_kind(value)}")
        return value

    def _texts(self, value: Any, key: str) -> dict[str, str]:
        table = self._table(value, key)
        for name, entry in table.items():
            if not isinstance(entry, str):
                raise self._refuse(f"{key}.{name}", f"expected a string, found {_kind(entry)}")
        return table

    def subject(self, document: dict[str, Any]) -> Subject:
        self._table(document, "", ("subject", "adapter"))
        about = self._table(document.get("subject"), "subject", ("name", "version"))
        adapters = self._table(document.get("adapter"), "adapter", PROTOCOLS)
        if not adapters:
            raise self._refuse("adapter", f"expected at least one of {', '.join(PROTOCOLS)}")
        return Subject(
            name=self._text(about, "name", "subject"),
            version=self._text(about, "version", "subject").replace("{kit_version}", __version__),
            adapters={protocol: self._adapter(protocol, table) for protocol, table in adapters.items()},
            source=self._path,
        )

    def _adapter(self, protocol: str, value: Any) -> Adapter:
        key = f"adapter.{protocol}"
        known = ("command", "cwd", "env", "rw_env", "ro_env", "deadline_s", "bind")
        table = self._table(value, key, known)
        command = table.get("command")
        if not isinstance(command, list) or not command or not all(isinstance(part, str) for part in command):
            raise self._refuse(f"{key}.command", "expected a non-empty list of strings, the argument vector")
        cwd = self._path.parent / self._text(table, "cwd", key) if "cwd" in table else None
        if cwd is not None and not cwd.is_dir():
            raise self._refuse(f"{key}.cwd", f"{cwd} is not a directory")
        env = self._texts(table.get("env", {}), f"{key}.env")
        variants = {
            name: Variant(
                command=tuple(command),
                env=env | self._texts(table.get(f"{name}_env", {}), f"{key}.{name}_env"),
                cwd=cwd,
            )
            for name in ("rw", "ro")
        }
        deadline_s = table.get("deadline_s", _DEFAULT_DEADLINE_S)
        if isinstance(deadline_s, bool) or not isinstance(deadline_s, int | float) or not 0 < deadline_s <= 300:
            raise self._refuse(f"{key}.deadline_s", f"expected seconds above 0 and up to 300, found {deadline_s!r}")
        if "bind" in table:
            bindings = self._bindings(protocol, table["bind"], f"{key}.bind")
        else:
            bindings = dict(reference_subject().adapters[protocol].bindings)
        return Adapter(protocol=protocol, variants=variants, bindings=bindings, deadline_s=float(deadline_s))

    def _bindings(self, protocol: str, value: Any, key: str) -> dict[str, Binding]:
        operations = OPERATIONS[protocol]
        bindings = {}
        for name, entry in self._table(value, key, operations).items():
            table = self._table(entry, f"{key}.{name}", ("tool", "arguments", "result"))
            operation = operations[name]
            arguments = self._table(table.get("arguments", {}), f"{key}.{name}.arguments")
            self._check_template(arguments, operation.inputs, f"{key}.{name}.arguments")
            outputs = self._texts(table.get("result", {}), f"{key}.{name}.result")
            self._table(outputs, f"{key}.{name}.result", operation.outputs)
            for output, expression in outputs.items():
                try:
                    jmespath.compile(expression)
                except jmespath.exceptions.JMESPathError as error:
                    reason = str(error).splitlines()[0]
                    raise self._refuse(
                        f"{key}.{name}.result.{output}", f"not a JMESPath expression: {reason}"
                    ) from None
            bindings[name] = Binding(
                tool=self._text(table, "tool", f"{key}.{name}"), arguments=arguments, outputs=outputs
            )
        return bindings

    def _check_template(self, template: Any, inputs: tuple[str, ...], key: str) -> None:
        if isinstance(template, str) and template.startswith("$") and template[1:] not in inputs:
            known = ", ".join(f"${name}" for name in inputs) or "none"
            raise self._refuse(key, f"{template} is no input of this operation; its inputs are: {known}")
        if isinstance(template, dict):
            for name, value in template.items():
                self._check_template(value, inputs, f"{key}.{name}")
        elif isinstance(template, list):
            for value in template:
                self._check_template(value, inputs, key)


def _kind(value: Any) -> str:
    if value is None:
        return "nothing"
    return {dict: "a table", list: "a list", str: "a string", bool: "a boolean"}.get(type(value), "a number")
