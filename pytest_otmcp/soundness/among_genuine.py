"""A bench with one adapter that may be defective, between reference adapters that are not."""

from __future__ import annotations

from dataclasses import replace

from ..plant.devices import Plant
from ..record.schema import AdapterFacts, Device
from ..subject import Adapter, Subject, Variant
from ..trial.adapter_under_test import AdapterUnderTest, BenchOptions
from ..trial.bench import Bench

__all__ = ["AmongGenuine", "sooner", "with_command"]

_WAITS = ("_TIMEOUT_S", "_WATCHDOG_S")
"""How the names of those variables of the reference adapters end that hold for how long they wait for one answer, in seconds."""

_WHOLE_CALLS = ("_DEADLINE_S",)
"""The same for what a whole call may take. Other settings decide what a call needs: a scan of a PROFIBUS line waits the slot time at each
address."""


def with_command(subject: Subject, protocol: str, command: tuple[str, ...]) -> Subject:
    """Return the subject with another program for the adapter of one protocol."""
    genuine = subject.adapters[protocol]
    variants = {name: replace(variant, command=command, cwd=None) for name, variant in genuine.variants.items()}
    adapters = {**subject.adapters, protocol: replace(genuine, variants=variants)}
    return Subject(name="defective", version="0", adapters=adapters, source=subject.source)


def sooner(subject: Subject, factor: float, *, whole_calls: bool) -> Subject:
    """Return the subject with reference adapters that wait so much shorter for what does not come.

    Args:
        whole_calls: the time that a whole call may take is shortened, too.
    """
    shortened = _WAITS + _WHOLE_CALLS if whole_calls else _WAITS

    def variant(genuine: Variant) -> Variant:
        waits = {name: f"{float(text) * factor:g}" for name, text in genuine.env.items() if name.endswith(shortened)}
        return replace(genuine, env={**genuine.env, **waits})

    def adapter(genuine: Adapter) -> Adapter:
        return replace(genuine, variants={name: variant(one) for name, one in genuine.variants.items()})

    return replace(subject, adapters={protocol: adapter(genuine) for protocol, genuine in subject.adapters.items()})


class AmongGenuine(Bench):
    """A bench on which only the adapter of one protocol has other deadlines; the others have their usual ones.

    The others end with the bench: an adapter that connects to a device again after an outage would be taken for the
    next adapter of that device.
    """

    def __init__(self, subject: Subject, plant: Plant, protocol: str, time_scale: float) -> None:
        super().__init__(subject, BenchOptions(time_scale=time_scale), plant)
        self._protocol = protocol
        self._genuine = Bench(subject, BenchOptions(), plant)

    async def adapter(self, name: str) -> AdapterUnderTest:
        if name.partition("@")[0] == self._protocol:
            return await super().adapter(name)
        return await self._genuine.adapter(name)

    async def close(self) -> None:
        await self._genuine.close()
        await super().close()

    def adapters(self) -> dict[str, AdapterFacts]:
        return self._genuine.adapters() | super().adapters()

    def devices(self) -> dict[str, Device]:
        return self._genuine.devices() | super().devices()
