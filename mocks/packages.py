"""Mock packages: the built-in ones, which are the folders of this package, and any module by its dotted name.

A mock package offers

=============  ========================================================================================
``ENDPOINTS``  a tuple of :class:`~.endpoint.Endpoint`, at least one
``warm()``     runs once in the launcher, before any device process is forked: imports and everything else that is slow;
               it leaves no loop and no thread behind, because a fork carries neither over
``create()``   runs in the device process, before its loop, and returns a fresh :class:`~.device.Device`
=============  ========================================================================================

or, if it is no device that a launcher can stop and start, ``main(arguments)``: a program of its own, which gets the
rest of the command line and returns the exit code.
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Sequence
from typing import Any, Protocol, cast

from .device import Device
from .endpoint import Endpoint

__all__ = ["MockPackage", "MockProgram", "built_in", "load"]


class MockPackage(Protocol):
    """A package whose device the launcher runs."""

    ENDPOINTS: tuple[Endpoint, ...]

    def warm(self) -> None:
        """Prepare everything that takes time."""

    def create(self) -> Device:
        """Return a fresh device."""


class MockProgram(Protocol):
    """A package that is a program of its own."""

    def main(self, arguments: Sequence[str]) -> int:
        """Run it and return the exit code."""


def built_in() -> list[str]:
    """Return the names of the mock packages in this package."""
    room = importlib.import_module(__package__)
    return sorted(module.name for module in pkgutil.iter_modules(room.__path__) if module.ispkg)


def load(name: str) -> MockPackage | MockProgram:
    """Import a mock package: a built-in one by its name, any other by its dotted name.

    Raises:
        ValueError: there is no such package, or it offers no mock; the message says what is missing.
    """
    if name in built_in():
        module = importlib.import_module(f".{name}", __package__)
    elif "." in name.strip("."):
        try:
            module = importlib.import_module(name)
        except ModuleNotFoundError as error:
            raise ValueError(f"{name} cannot be imported: {error}") from None
    else:
        known = ", ".join(built_in())
        raise ValueError(f"there is no mock {name!r}; there are {known}, and modules by their dotted names")
    if _lacks(module, "main") and (missing := _lacks(module, "ENDPOINTS", "warm", "create")):
        raise ValueError(f"{name} offers no mock: it lacks {', '.join(missing)}")
    return cast("MockPackage | MockProgram", module)


def _lacks(module: Any, *names: str) -> list[str]:
    return [name for name in names if not hasattr(module, name)]
