"""The making of golden records: an adapter performs the items of its recipe, and its record is stored if it shows what it must."""

from __future__ import annotations

import gzip
import json
import os
import re
import shlex
import socket
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pytest_otmcp import __version__
from pytest_otmcp.core.matrix import SUITES
from pytest_otmcp.core.verdict import Status
from pytest_otmcp.plant.devices import Plant
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.record.reader import load
from pytest_otmcp.replay.rejudge import rejudge
from pytest_otmcp.session.loop import LoopThread
from pytest_otmcp.soundness.among_genuine import AmongGenuine, sooner, with_command
from pytest_otmcp.soundness.judging import IMPATIENT, failing, measured, noted
from pytest_otmcp.soundness.warm_start import WarmStart
from pytest_otmcp.subject import Subject
from pytest_otmcp.suite.catalogue import KIT, all_tasks, identity, kit_digest, suite_digest
from pytest_otmcp.trial.bench import Bench
from tests.soundness.sentences import untrue
from tests.stored_runs import run_of, store
from tests.trials import as_read

from .files import COMMAND, MACHINE_PATH, path_of
from .recipes import Recipe

__all__ = ["UnusableError", "make"]

_CHECKOUT = Path(__file__).parents[2]


class UnusableError(Exception):
    """A record does not show what it must, or tells something of its machine; the message says what."""


def make(loop: LoopThread, plant: Plant, warm: WarmStart, recipe: Recipe) -> int:
    """Perform the items of a recipe and store the record.

    Args:
        loop: in which devices and adapters are spoken to.
        plant: the devices; their adapters have ended.
        warm: starts the adapters.

    Returns:
        The size of the record in bytes, before it was compressed.

    Raises:
        UnusableError: the record must not be stored.
        KitError: a mock device could not be started.
    """
    record = loop.run(_performed(plant, warm, recipe))
    _check(record, recipe)
    return _store(record, recipe)


async def _performed(plant: Plant, warm: WarmStart, recipe: Recipe) -> dict[str, Any]:
    bench = AmongGenuine(_subject(recipe, warm), plant, recipe.protocol, IMPATIENT if recipe.waits else 1.0)
    tasks = all_tasks()
    try:
        items = [await measured(bench, tasks[name]) for name in recipe.items]
        return _record(bench, items, recipe, warm)
    finally:
        await bench.close()


def _subject(recipe: Recipe, warm: WarmStart) -> Subject:
    subject = warm.subject(recipe.subject())
    if recipe.program is None:
        return subject
    python = (sys.executable,) if recipe.cold else warm.python
    subject = with_command(subject, recipe.protocol, (*python, *recipe.program))
    if recipe.waits:
        subject = sooner(subject, 0.5, whole_calls=True)
    adapter = recipe.described(subject.adapters[recipe.protocol])
    return replace(subject, adapters={**subject.adapters, recipe.protocol: adapter})


def _record(bench: Bench, items: Sequence[Mapping[str, Any]], recipe: Recipe, warm: WarmStart) -> dict[str, Any]:
    took_part = {key for item in items for key in all_tasks()[item["id"]].protocols}
    adapters = {key: facts for key, facts in bench.adapters().items() if key in took_part}
    for facts in adapters.values():
        facts["command"] = shlex.split(_elsewhere(shlex.join(facts["command"]), warm))
    record = run_of(
        items,
        adapters=adapters,
        devices=bench.devices(),
        suite_digest=suite_digest(),
        time_scale=bench.options.time_scale,
        soak=bench.options.soak,
    )
    record["kit"] = {
        "name": KIT,
        "version": __version__,
        "digest": kit_digest(),
        "suite_digest": suite_digest(),
        "protocols": [identity(protocols()[key]) for key in adapters],
    }
    record["subject"]["name"] = recipe.name
    record["settings"]["suites"] = list(SUITES)
    record["settings"]["narrowed"] = [f"made by {COMMAND} {recipe.name}"]
    # As it is read from a file: an oracle must not depend on a tuple or on an integer as a key. A start that fails is told with its command.
    restored: dict[str, Any] = json.loads(_elsewhere(json.dumps(record, allow_nan=False), warm))
    return restored


def _elsewhere(text: str, warm: WarmStart) -> str:
    """Return a text with commands as they are in another checkout, where no other process has warmed up for the adapter."""
    for python in (shlex.join(warm.python), sys.executable):
        text = text.replace(python, "{python}")
    return text.replace(f"{_CHECKOUT}{os.sep}", "")


def _check(record: Mapping[str, Any], recipe: Recipe) -> None:
    items = record["items"]
    if (failed := failing(items)) != set(recipe.failing):
        told = "; ".join(f"{item['id']}: {item['reason']}" for item in items if item["status"] == Status.KIT_ERROR)
        raise UnusableError(
            f"other items fail than must: {' '.join(sorted(failed ^ set(recipe.failing)))} {told}".strip()
        )
    cited = noted(items)
    if recipe.cited is not None and cited != recipe.cited:
        raise UnusableError(
            f"findings cite other requirements than they must: {' '.join(sorted(cited ^ recipe.cited))}"
        )
    if sentences := [*untrue(items), *rejudge(as_read(record))]:
        raise UnusableError(f"the record does not bear out its own findings: {sentences[0]}")


def _store(record: Mapping[str, Any], recipe: Recipe) -> int:
    with tempfile.TemporaryDirectory() as directory:
        stored = store(Path(directory, "run.json"), record)
        if load(stored)["items"] != record["items"]:
            raise UnusableError("the record that is read has other entries than the devices have shown")
        content = stored.read_bytes()
    text = content.decode()
    if (found := MACHINE_PATH.search(text)) or (found := re.search(rf"\b{re.escape(socket.gethostname())}\b", text)):
        around = text[max(0, found.start() - 60) : found.end() + 60]
        raise UnusableError(f"the record tells something of this machine: …{around}…")
    path = path_of(recipe.name)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Without the time at which it was made: equal records have equal files.
    path.write_bytes(gzip.compress(content, mtime=0))
    return len(content)
