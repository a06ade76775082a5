"""A guess: a tool that may perform an operation, and how it would be called. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import islice, product

from ..subject.addressing import mentions_address

__all__ = ["Guess"]

_MOST_TRIALS = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Guess:
    """A tool that may perform an operation.

    Attributes:
        score: higher is likelier.
        arguments: template as a subject file has it.
        convert: input to the type that the tool seems to expect.
        missing: required arguments for which no value is known.
        trials: further arguments, each with values to try.
        optional: arguments that the tool does not require, with values for the case that it does not work without them.
        stand_ins: arguments that the tool does not require, and that stand for a voluntary input, each with that.
        orders: other ways to give the inputs to the arguments, each a whole template: what names mean, the device decides.
    """

    operation: str
    tool: str
    score: float
    arguments: Mapping[str, object]
    convert: Mapping[str, str]
    missing: tuple[str, ...]
    trials: Mapping[str, tuple[str, ...]]
    optional: Mapping[str, object] = field(default_factory=dict)
    orders: tuple[Mapping[str, object], ...] = ()
    stand_ins: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of_tool(cls, tool: str, arguments: Iterable[str]) -> Guess:
        """Return the guess of a tool for which no operation stands, whose inputs are called like its arguments."""
        template = {name: f"${name}" for name in arguments}
        return cls(operation="", tool=tool, score=0.0, arguments=template, convert={}, missing=(), trials={})

    def variations(self) -> list[Guess]:
        """Return one guess for each combination of the values to try; only this guess when there are none to try.

        Arguments that the tool does not require come last, because what is not asked for need not be invented; among them
        those for the device's address, which may be the name of an entry of a configuration file as well. Other orders of the inputs come
        after all that the names of the arguments say.
        """
        ways = [replace(self, arguments=way, missing=(), optional={}, orders=()) for way in self.orders]
        named = [] if self.missing and ways else self._as_named()
        return [*named, *(one for way in ways for one in way._as_named())]

    def _as_named(self) -> list[Guess]:
        addressless = {name: value for name, value in self.optional.items() if not mentions_address(value)}
        added = [{}, *(more for more in (addressless, self.optional) if more)]
        names = list(self.trials)
        combinations = list(islice(product(*self.trials.values()), _MOST_TRIALS))
        return [
            replace(
                self,
                arguments={**self.arguments, **more, **dict(zip(names, values, strict=True))},
                trials={},
                optional={},
                orders=(),
            )
            for number, more in enumerate(added)
            if more not in added[:number]
            for values in combinations
        ]
