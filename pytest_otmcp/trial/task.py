"""A task: an item of the suite, its steps for one repetition, and what it needs around them.

Conformance modules declare tasks with :func:`task`; nothing here runs them.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .repetition import Repetition

__all__ = ["Steps", "Suite", "Task"]

Steps = Callable[["Repetition"], Awaitable[None]]


@dataclass(slots=True, kw_only=True)
class Task:
    """One item.

    Attributes:
        id: as the paper has it, such as ``M3``.
        suite: one of :data:`SUITES`.
        family: ``Modbus``, ``MQTT``, ``OPC UA`` or ``Cross-protocol``.
        title: the paper's sentence for it, printed in its tables.
        adapters: the protocols it needs.
        needs: facets that the subject must claim, such as ``modbus.write_holding`` or ``modbus.guard``.
        guards: protocols whose read-only variant takes part when the subject claims that there is one.
        requirements: ids of the requirement catalogue that it exercises.
        steps: one repetition.
        begin: once before the repetitions, with the role ``setup``; or None.
        end: once after the repetitions, with the role ``control``; or None.
        warm_up: run the steps once unmeasured, so that no first-time cost is counted as the adapter's.
    """

    id: str
    suite: str
    family: str
    title: str
    adapters: tuple[str, ...]
    needs: tuple[str, ...]
    guards: tuple[str, ...]
    requirements: tuple[str, ...]
    steps: Steps
    begin: Steps | None = None
    end: Steps | None = None
    warm_up: bool = True

    def before(self, steps: Steps) -> Steps:
        """Decorator: what happens once before the repetitions."""
        self.begin = steps
        return steps

    def after(self, steps: Steps) -> Steps:
        """Decorator: what happens once after the repetitions."""
        self.end = steps
        return steps


class Suite(list[Task]):
    """The tasks of one suite, in the order of their declaration."""

    def __init__(self, name: str, *, warm_up: bool = True) -> None:
        super().__init__()
        self.name = name
        self._warm_up = warm_up

    def task(
        self, id: str, family: str, title: str, *, needs: str, guards: str = "", requirements: str = ""
    ) -> Callable[[Steps], Task]:
        """Decorator that turns the steps of one repetition into a task of this suite.

        Args:
            id, family, title: see :class:`Task`.
            needs: facets, each with its protocol, separated by blanks. With a ``guard`` the task has the read-only
                variant of that adapter, too, as ``protocol@ro``.
            guards: see :class:`Task`, separated by blanks.
            requirements: catalogue ids, separated by blanks.
        """

        def declare(steps: Steps) -> Task:
            facets = tuple(needs.split())
            protocols = dict.fromkeys(facet.partition(".")[0] for facet in facets)
            guarded = [f"{facet.partition('.')[0]}@ro" for facet in facets if facet.endswith(".guard")]
            declared = Task(
                id=id,
                suite=self.name,
                family=family,
                title=title,
                adapters=(*protocols, *guarded),
                needs=facets,
                guards=tuple(guards.split()),
                requirements=tuple(requirements.split()),
                steps=steps,
                warm_up=self._warm_up,
            )
            self.append(declared)
            return declared

        return declare
