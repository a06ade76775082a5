"""What to change in which library: the hints of the registries, by the rule that a finding cites. Pure."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

from ..core.library_registry import Library, libraries
from ..protocols.registry import protocols

__all__ = ["PAGE", "advice", "known_libraries"]

PAGE = "by-library"


def known_libraries() -> Mapping[str, Library]:
    """Return every library of the registries, by name."""
    packages = [protocol.package for protocol in protocols().values()]
    return {**libraries(), **{name: one for package in packages for name, one in libraries(package).items()}}


def advice(requirement: str, used: Collection[str] | None = None, code: str | None = None) -> Iterator[str]:
    """Yield a sentence for each change that keeps a rule, with the place that explains it.

    Args:
        requirement: id of the rule.
        used: names of the libraries that the adapter was seen to use; None for every library.
        code: of the finding that is to be answered; None for every finding.
    """
    for name, library in known_libraries().items():
        if used is None or name in used:
            for hint in library.hints:
                if requirement in hint.requirements and (code is None or not hint.codes or code in hint.codes):
                    yield f"{name}: {hint.change} (otmcp docs {PAGE}#{library.anchor})"
