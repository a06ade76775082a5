"""A check: the task that judges one row of the requirement catalogue on one protocol.

Modules of the requirement suite declare checks with :class:`Checks`. A check that holds for every protocol is written once, with
:meth:`Checks.every_protocol`, and asks the protocol's description what to read and what to write
(:class:`~pytest_otmcp.protocols.exercise.Exercise`).
"""

from __future__ import annotations

import inspect
from collections.abc import Awaitable, Callable, Sequence
from functools import wraps
from typing import Any

from ..core.matrix import REQUIREMENTS
from ..protocols.protocol import GUARD, LAUNCHES, READ, READ_OR_STATUS, WRITE
from ..protocols.registry import protocols
from .task import Steps, Task, Tasks

__all__ = ["Checks", "Generic", "on_protocol"]

Generic = Callable[..., Awaitable[None]]
"""``async def steps(run, at)`` or, for a check with the read-only variant, ``async def steps(run, at, guarded)``."""


class Checks(Tasks):
    """The checks of one area, in the order of their declaration. The id of a check is its row and its protocol: ``WR-003.modbus``."""

    def check(self, row: str, title: str, *, needs: str, guards: str = "", keys: str = "") -> Callable[[Steps], Task]:
        """Return a decorator that turns steps into the check of a row on the protocol of its first facet.

        Args:
            row: id of the requirement.
            title: one sentence.
            needs, guards, keys: as of :meth:`~pytest_otmcp.trial.task.Tasks.task`.
        """
        protocol = needs.partition(".")[0]
        return self.task(
            f"{row}.{protocol}",
            REQUIREMENTS,
            title,
            needs=needs,
            guards=guards,
            capability=None,
            requirements=row,
            keys=keys,
        )

    def every_protocol(
        self,
        row: str,
        title: str,
        *,
        reads: bool = True,
        writes: bool = False,
        guard: bool = False,
        launch: str = "",
        beside: str = "",
        facets: str = "",
        having: str = "",
        apart: str = "",
        status: bool = False,
        prompt: bool = False,
    ) -> Callable[[Generic], Generic]:
        """Return a decorator that turns steps into a check of a row on each protocol that has an exercise.

        Args:
            row, title: as of :meth:`check`.
            reads, writes: the steps use the operation that the protocol's exercise reads, or writes, with. Without either, and without
                facets, they ask for what the subject has: every adapter of the protocol is asked.
            guard: the steps also get the read-only variant.
            launch: a facet that is a launch of its own, whose variant the steps get as well.
            beside: another such facet, whose variant they get where the subject claims it, else None; on a protocol without this facet they
                are called without it.
            facets: further facets, without their protocol, separated by blanks; a protocol that does not have one that is voluntary has no
                such check.
            having: member of the exercise that the steps use, and that not every protocol has.
            apart: keys of protocols that have a check of this row of their own, separated by blanks.
            status: a status that the device has to answer is as good as the read.
            prompt: the steps read many times, or at once: a call that waits for what it answers is none for them.
        """

        def declare(steps: Generic) -> Generic:
            for key, protocol in protocols().items():
                exercise = protocol.exercise
                if exercise is None or key in apart.split() or (having and not getattr(exercise, having)):
                    continue
                launched = [*[launch] * bool(launch), *filter(protocol.is_voluntary, facets.split())]
                if not set(launched) <= {*protocol.facets}:
                    continue
                launches = [*[GUARD] * guard, *[launch] * bool(launch)]
                instead = READ if exercise.waiting is not None and not prompt else exercise.reading
                reading = READ_OR_STATUS if status else instead
                writing = WRITE if exercise.otherwise else exercise.writing
                wanted = [*[reading] * reads, *[writing] * writes, *launches, *facets.split()]
                needs = " ".join(f"{key}.{facet}" for facet in wanted) or key
                optional = [beside] if beside in protocol.facets else []
                guards = " ".join(f"{key}.{facet}" for facet in optional)
                self.check(row, title, needs=needs, guards=guards)(on_protocol(key, steps, [*launches, *optional]))
            return steps

        return declare


def on_protocol(protocol: str, steps: Generic, launches: Sequence[str] = ()) -> Steps:
    """Return the steps with parameters that are named like the adapters of a protocol.

    Args:
        launches: facets whose variants the steps get beside the usual one, such as ``guard``.
    """
    names = ["run", protocol, *(f"{protocol}_{LAUNCHES[facet]}" for facet in launches)]

    @wraps(steps)
    async def steps_on_protocol(run: Any, **rigs: Any) -> None:
        await steps(run, *(rigs[name] for name in names[1:]))

    steps_on_protocol.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]
    )
    return steps_on_protocol
