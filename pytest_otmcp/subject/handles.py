"""Handles: members of an answer that later calls of the same session take as arguments. Pure.

A file writes them ``"$step.name"``; the step is ``connect`` or the operation whose binding keeps the handle.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from .kinds import Refusal, nearest
from .model import CONNECT, Binding, Connect, Function, handles

__all__ = ["Handles", "check_handles"]


def check_handles(
    operations: Mapping[str, tuple[Binding, ...] | Function], connect: Connect | None, ready: object, key: str
) -> None:
    """Refuse a handle that no call keeps.

    Args:
        ready: the arguments of the tool that says whether the adapter is ready; the connect step alone comes before it.
        key: of the adapter's table.

    Raises:
        Refusal: nothing keeps it, or nothing that comes before.
    """
    cases = [(name, case) for name, bound in operations.items() if isinstance(bound, tuple) for case in bound]
    first = {f"{CONNECT}.{name}" for name in (connect.keep if connect is not None else ())}
    every = first | {f"{operation}.{name}" for operation, case in cases for name in case.keep}
    _check(connect.arguments if connect is not None else {}, set(), f"{key}.connect.arguments")
    _check(ready, first, f"{key}.ready.arguments")
    for operation, case in cases:
        place = f"bind.{operation}" if case.command is None else f"{case.command.table}.{case.command.name}"
        _check(case.arguments, every, f"{key}.{place}.arguments")


def _check(template: object, kept: set[str], key: str) -> None:
    for name in sorted(handles(template) - kept):
        known = (
            nearest(f"${name}", [f"${one}" for one in kept])
            if kept
            else "'keep' of none says where in the answer a handle is"
        )
        raise Refusal(key, f"${name} is a handle that no call before this one keeps; {known}")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Kept:
    step: str
    tool: str
    inputs: Mapping[str, object]
    values: Mapping[str, object]


class Handles:
    """The handles of one session.

    Args:
        covers: tells whether a call with one value of an input is about all that another one with another value is about.
    """

    def __init__(self, covers: Callable[[str, object, object], bool]) -> None:
        self._covers = covers
        self._kept: list[_Kept] = []

    def keep(self, step: str, tool: str, inputs: Mapping[str, object], values: Mapping[str, object]) -> None:
        """Keep what a call has answered; a value is None where the answer has none."""
        self._kept.append(_Kept(step=step, tool=tool, inputs=inputs, values=values))

    def take(self, wanted: Iterable[str], inputs: Mapping[str, object]) -> dict[str, object]:
        """Return the handles that a call with these inputs takes, each from the newest call that was about the same.

        Raises:
            LookupError: there is no such handle; the argument says why, in words that follow "takes".
        """
        return {name: self._taken(name, inputs) for name in sorted(wanted)}

    def _taken(self, wanted: str, inputs: Mapping[str, object]) -> object:
        step, _, name = wanted.partition(".")
        newest = [one for one in reversed(self._kept) if one.step == step and name in one.values]
        alike = next(
            (one for one in newest if all(inputs[key] == one.inputs[key] for key in inputs.keys() & one.inputs)), None
        )
        found = alike or next((one for one in newest if self._is_wider(one.inputs, inputs)), None)
        if found is None:
            said = ", ".join(f"{key}={value!r}" for key, value in inputs.items())
            raise LookupError(f"${wanted}, and no successful {step} of this session was for {said or 'it'}")
        if found.values[name] is None:
            raise LookupError(f"${wanted}, and the answer of {found.tool} has nothing where 'keep' looks for it")
        return found.values[name]

    def _is_wider(self, kept: Mapping[str, object], asked: Mapping[str, object]) -> bool:
        shared = kept.keys() & asked.keys()
        return all(kept[key] == asked[key] or self._covers(key, kept[key], asked[key]) for key in shared)
