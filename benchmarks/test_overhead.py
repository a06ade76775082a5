"""The cost of an adapter call, beside a call that does nothing and the bare protocol. Run with ``pytest benchmarks``.

No time is asserted. The number of service calls that the device saw is asserted: no machine's load can change it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from .measurement import ENUMERATION_SERVICES, measure, ratios, table
from .probes import NAMES, bench

Measured = tuple[dict[str, list[int]], list[str]]


class _Replay:
    """A clock that advances by the recorded samples.

    pytest-benchmark measures one function after the other; floors and calls must be measured in interleaved rounds to be
    comparable. So the rounds are measured first and then shown to it, for its table and its ``--benchmark-json``.
    """

    def __init__(self) -> None:
        self._now_ns = 0
        self._samples: Iterator[int] = iter(())

    def load(self, samples: list[int]) -> None:
        self._samples = iter(samples)

    def advance(self) -> None:
        self._now_ns += next(self._samples)

    def __call__(self) -> float:
        return self._now_ns / 1e9


_CLOCK = _Replay()


@pytest.fixture(scope="module")
def measured() -> Measured:
    """The samples of every probe, and the service calls of one enumeration."""
    with bench() as running:
        return measure(running.probes), running.enumeration_services


@pytest.mark.benchmark(timer=_CLOCK, group="one call")
@pytest.mark.parametrize("name", NAMES)
def test_latency(name: str, measured: Measured, benchmark: BenchmarkFixture) -> None:
    samples, services = measured
    _CLOCK.load(samples[name])
    benchmark.extra_info["what"] = NAMES[name]
    for ratio in ratios(samples):
        if ratio.probe == name:
            benchmark.extra_info |= {
                "ratio": ratio.formula,
                "measured": round(ratio.value, 3),
                "target": ratio.target,
                "verdict": ratio.verdict,
            }
    if name == "O4":
        benchmark.extra_info["service_calls"] = services
    pedantic: Callable[..., None] = benchmark.pedantic
    pedantic(_CLOCK.advance, rounds=len(samples[name]))


def test_an_enumeration_makes_few_service_calls(measured: Measured, capsys: pytest.CaptureFixture[str]) -> None:
    samples, services = measured
    with capsys.disabled():
        print(table(samples, services))
    assert len(services) <= ENUMERATION_SERVICES, services
