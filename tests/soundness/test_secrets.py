"""A secret that an adapter tells is in no record of the run, and the record is judged again without it."""

from __future__ import annotations

import asyncio
import json

import pytest

from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.record.redaction import REDACTED, Redactor
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.among_genuine import AmongGenuine, with_command
from pytest_otmcp.soundness.judging import measured
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import reference_subject
from pytest_otmcp.suite.catalogue import all_tasks
from tests.trials import as_read, recorded

from .conftest import DEFECT


@pytest.mark.parametrize(
    ("defect", "protocol", "variable"),
    [("MU-99b", "mqtt", "MQTT_PASSWORD"), ("MU-99c", "modbus", "OTMCP_CANARY_TOKEN")],
)
def test_a_told_secret_is_not_kept(
    loop: LoopThread, plant: Plant, warm_start: WarmStart, defect: str, protocol: str, variable: str
) -> None:
    async def run() -> tuple[str, list[str]]:
        subject = with_command(warm_start.subject(reference_subject()), protocol, (*warm_start.python, *DEFECT, defect))
        bench = AmongGenuine(subject, plant, protocol, 1.0)
        try:
            result = await measured(bench, all_tasks()[f"KEY-001.{protocol}"], 1)
            told = bench.told_secrets()
            kept = Redactor(told).apply(recorded(bench, [result]))
        finally:
            await bench.close()
        text = json.dumps(kept)
        assert told
        assert not any(secret in text for secret in told)
        return text, await asyncio.to_thread(rejudge, as_read(kept))

    text, objections = loop.run(run())
    assert objections == []
    assert REDACTED in text
    assert f"has the value of {variable}, as it is" in text
