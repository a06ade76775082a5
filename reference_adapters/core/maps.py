"""The map of names that a user gives in a JSON file: tags, or aliases, that stand for places in the device."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, TypeVar

from pydantic import BaseModel, ConfigDict, Field

from .arguments import Arguments
from .errors import AdapterError

__all__ = ["AliasName", "NameMap", "Named"]


class Named(BaseModel):
    """Base of what a name stands for; the place is the protocol's.

    Attributes:
        unit: of the value, for people.
        writable: it may be written by its name.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False, frozen=True)

    unit: str | None = None
    writable: bool = False


class AliasName(Arguments):
    """An alias of the alias map."""

    alias: Annotated[str, Field(min_length=1, max_length=200, description="a name of the alias map")]


N = TypeVar("N", bound=Named)


class NameMap(dict[str, N]):
    """A map of names.

    Args:
        entries: by their names.
        kind: what users call an entry, ``tag`` or ``alias``.
        argument: of tools, that is a name.
        listed_by: the tool that lists the names.
    """

    def __init__(self, entries: Mapping[str, N], *, kind: str, argument: str, listed_by: str | None = None) -> None:
        super().__init__(entries)
        self._kind = kind
        self._field = f"/{argument}"
        self._hint = "" if listed_by is None else f"; {listed_by} lists them"

    def known(self, name: str) -> N:
        """Return what a name stands for.

        Raises:
            AdapterError: the map has no such name.
        """
        if name not in self:
            message = f"the {self._kind} map has no such {self._kind}{self._hint}"
            raise AdapterError("illegal_address", message, field=self._field, outcome="not_sent")
        return self[name]

    def writable(self, name: str) -> N:
        """Return what a name stands for that may be written.

        Raises:
            AdapterError: the map has no such name, or does not allow writing it.
        """
        entry = self.known(name)
        if not entry.writable:
            message = f"the {self._kind} map does not allow writing this {self._kind}"
            raise AdapterError("not_writable", message, outcome="not_sent")
        return entry
