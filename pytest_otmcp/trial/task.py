"""A task: an item of the suite, its steps for one repetition, and what it needs around them.

Modules of the suite declare tasks with :meth:`Tasks.task`; nothing here runs them.
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass

from ..core.capability import Capability
from ..core.matrix import CROSS_PROTOCOL, KNOWN_SUITES, WARMED_UP
from ..protocols.protocol import GUARD, LAUNCHES, SECURE, WRITE
from ..protocols.registry import protocols
from ..subject.model import READ_WRITE
from .repetition import Repetition

__all__ = ["Steps", "Task", "Tasks", "execute"]

Steps = Callable[..., Awaitable[None]]
"""``async def steps(run, rig, …)``: the repetition, then the rigs that the steps name.

A parameter has the name of the adapter that it stands for: ``modbus`` for the variant with writes enabled, ``modbus_ro`` for
the variant with writes disabled, which is None where the subject claims no such variant.
"""


@dataclass(slots=True, kw_only=True)
class Task:
    """One item of the suite.

    Attributes:
        id: as the paper has it, such as ``M3``.
        suite: one of :data:`~pytest_otmcp.core.matrix.KNOWN_SUITES`.
        title: the paper's sentence for it, printed in its tables.
        capabilities: the capabilities that the item is about.
        adapters: the adapters it needs: ``protocol``, or ``protocol@ro`` for the variant with writes disabled.
        needs: facets that the subject must claim, such as ``modbus.write_holding`` or ``modbus.guard``; a protocol alone stands for an
            adapter that claims nothing of it.
        guards: facets that are launches, such as ``modbus.guard``, whose variants take part when the subject claims them.
        requirements: ids of the requirement catalogue that it exercises.
        steps: the steps of one repetition.
        keys: keys of the subject file that may be why it fails, with their protocol, such as ``modbus.probes.missing_address``.
        position: its place in the suite, where it does not follow the items that its module declares before it.
        begin: steps run once before the repetitions, with the role ``setup``; or None.
        end: steps run once after the repetitions, with the role ``control``; or None.
    """

    id: str
    suite: str
    title: str
    capabilities: tuple[Capability, ...]
    adapters: tuple[str, ...]
    needs: tuple[str, ...]
    guards: tuple[str, ...]
    requirements: tuple[str, ...]
    steps: Steps
    keys: tuple[str, ...] = ()
    position: int | None = None
    begin: Steps | None = None
    end: Steps | None = None

    @property
    def protocols(self) -> tuple[str, ...]:
        """Keys of the protocols that the task is about."""
        return tuple(dict.fromkeys(name.partition("@")[0] for name in self.adapters))

    @property
    def family(self) -> str:
        """Name of its protocol, as tables print it; for a task about several protocols, the name of such tasks."""
        only, *others = self.protocols
        return CROSS_PROTOCOL if others else protocols()[only].name

    @property
    def writing(self) -> set[str]:
        """Names of the adapters through which the task may write; a guard that does not hold writes as well. Over the secure form of a protocol
        nothing is written."""
        facets = [facet.partition(".") for facet in self.needs]
        writing = {
            key
            for key, _, name in facets
            if name == WRITE or (name in (known := protocols()[key].operations) and known[name].writes)
        }
        launched = {*_launched(self.needs), *_launched(self.guards)}
        return writing | {name for name in launched if not name.endswith(f"@{LAUNCHES[SECURE]}")}

    @property
    def warm_up(self) -> bool:
        """Its steps run once unmeasured first."""
        return self.suite in WARMED_UP

    def before(self, steps: Steps) -> Steps:
        """Register the decorated steps, which run once before the repetitions; ValueError where there are some already."""
        self._check(steps, replacing=self.begin)
        self.begin = steps
        return steps

    def after(self, steps: Steps) -> Steps:
        """Register the decorated steps, which run once after the repetitions; ValueError where there are some already."""
        self._check(steps, replacing=self.end)
        self.end = steps
        return steps

    def _check(self, steps: Steps, *, replacing: Steps | None = None) -> None:
        if replacing is not None:
            raise ValueError(f"{self.id}: the steps {steps.__name__} would replace {replacing.__name__}")
        known = {name.replace("@", "_") for name in (*self.adapters, *_launched(self.guards))}
        for name in _rig_names(steps):
            if name not in known:
                raise ValueError(f"{self.id}: the steps {steps.__name__} name {name!r}, the task has {sorted(known)}")


def _launched(facets: Iterable[str]) -> list[str]:
    """Return the names of the adapters that facets are launches of, such as ``modbus@ro``."""
    parts = (facet.partition(".") for facet in facets)
    return [f"{protocol}@{LAUNCHES[name]}" for protocol, _, name in parts if name in LAUNCHES]


def _rig_names(steps: Steps) -> list[str]:
    _, *rigs = inspect.signature(steps).parameters
    return rigs


def _adapter_of(name: str) -> tuple[str, str]:
    """Return protocol and variant of the adapter that a parameter names: ``modbus``, or ``modbus_ro`` for another variant."""
    for variant in LAUNCHES.values():
        if name.endswith(f"_{variant}"):
            return name.removesuffix(f"_{variant}"), variant
    return name, READ_WRITE


async def execute(task: Task, steps: Steps, run: Repetition) -> None:
    """Run steps with the rigs that their parameters name.

    Adapters through which the task writes have to be proven to talk to their mock devices first.
    """
    rigs = {name: run.rig(*_adapter_of(name)) for name in _rig_names(steps)}
    for rig in rigs.values():
        if rig is not None and rig.name in task.writing:
            await rig.prove_first()
    await steps(run, **rigs)


class Tasks(list[Task]):
    """The tasks of one module, in the order of their declaration."""

    def task(
        self,
        id: str,
        suite: str,
        title: str,
        *,
        needs: str,
        capability: str | None,
        guards: str = "",
        requirements: str = "",
        keys: str = "",
        position: int | None = None,
    ) -> Callable[[Steps], Task]:
        """Return a decorator that turns the steps of one repetition into a task.

        Args:
            id, suite, title, position: see :class:`Task`.
            needs: facets, each with its protocol, separated by blanks. With a ``guard`` the task also has the read-only
                variant of that adapter, as ``protocol@ro``.
            capability: the capability that the steps are about, or None; ``guards`` add write protection to one.
            guards: see :class:`Task`, separated by blanks; a protocol alone stands for its read-only variant.
            requirements: catalogue ids, separated by blanks.

        Raises:
            ValueError: the suite or the capability is unknown, or the steps name an adapter that the task does not have.
        """
        if suite not in KNOWN_SUITES:
            raise ValueError(f"{id}: unknown suite {suite!r}")

        def declare(steps: Steps) -> Task:
            facets = tuple(needs.split())
            named = dict.fromkeys(facet.partition(".")[0] for facet in facets)
            about = dict.fromkeys(
                []
                if capability is None
                else [Capability(capability), *([Capability.WRITE_PROTECTION] if guards else [])]
            )
            declared = Task(
                id=id,
                suite=suite,
                title=title,
                capabilities=tuple(about),
                adapters=(*named, *_launched(facets)),
                needs=facets,
                guards=tuple(name if "." in name else f"{name}.{GUARD}" for name in guards.split()),
                requirements=tuple(requirements.split()),
                steps=steps,
                keys=tuple(keys.split()),
                position=position,
            )
            declared._check(steps)
            self.append(declared)
            return declared

        return declare
