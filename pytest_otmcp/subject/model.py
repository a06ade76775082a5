"""What a subject file says, as frozen data. Reading the file is ``load``'s job; running it is the session's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jmespath

__all__ = ["Adapter", "Binding", "Subject", "Variant"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Binding:
    """How one adapter performs one abstract operation.

    Attributes:
        tool: name of the MCP tool.
        arguments: template; a string ``"$name"`` stands for the operation's input of that name, keeping its type.
        outputs: output name to JMESPath expression over the envelope.
    """

    tool: str
    arguments: Mapping[str, Any]
    outputs: Mapping[str, str]

    def fill(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """The tool's arguments for these inputs."""
        filled: dict[str, Any] = _fill(self.arguments, inputs)
        return filled

    def read(self, envelope: Mapping[str, Any]) -> dict[str, Any]:
        """The operation's outputs from an envelope; an output that is not there is None."""
        return {name: jmespath.search(path, envelope) for name, path in self.outputs.items()}


def _fill(template: Any, inputs: Mapping[str, Any]) -> Any:
    if isinstance(template, str) and template.startswith("$"):
        return inputs[template[1:]]
    if isinstance(template, Mapping):
        return {key: _fill(value, inputs) for key, value in template.items()}
    if isinstance(template, list):
        return [_fill(value, inputs) for value in template]
    return template


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """One way to launch an adapter.

    Attributes:
        command: argument vector; ``{host} {port} {url} {python}`` are replaced.
        env: environment beyond the kit's allow-list, with the same replacements.
        cwd: working directory, or None for the kit's.
    """

    command: tuple[str, ...]
    env: Mapping[str, str]
    cwd: Path | None

    def for_endpoint(self, values: Mapping[str, str]) -> Variant:
        """This variant with the placeholders replaced."""

        def replace(text: str) -> str:
            for name, value in values.items():
                text = text.replace("{" + name + "}", value)
            return text

        return Variant(
            command=tuple(replace(part) for part in self.command),
            env={name: replace(value) for name, value in self.env.items()},
            cwd=self.cwd,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Adapter:
    """One adapter under test.

    Attributes:
        protocol: ``modbus``, ``mqtt`` or ``opcua``.
        variants: ``rw`` (writes enabled) and ``ro`` (writes disabled).
        bindings: abstract operation name to binding.
        deadline_s: the time within which every call must have answered.
    """

    protocol: str
    variants: Mapping[str, Variant]
    bindings: Mapping[str, Binding]
    deadline_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Subject:
    """The subject under test: one adapter for each protocol it speaks.

    Attributes:
        name, version: as printed in reports.
        adapters: protocol to adapter.
        source: where the description was read from.
    """

    name: str
    version: str
    adapters: Mapping[str, Adapter]
    source: Path
