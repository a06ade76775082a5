"""A record with one changed leaf is refused, unless its place is one that nothing else in a record can contradict.

What a forger changes is in ``forging``. Forgeries of structure, such as items of two runs, are in ``tests/plugin/test_forgeries``.
"""

from __future__ import annotations

import gzip
import json
import random
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from pytest_otmcp import __version__
from pytest_otmcp.cli import Refusal
from pytest_otmcp.cli.examination import examine
from pytest_otmcp.core.matrix import repetitions
from pytest_otmcp.core.verdict import Status, decide
from pytest_otmcp.protocols.registry import protocols
from pytest_otmcp.suite.catalogue import KIT, identity, kit_digest, suite_digest, tasks_by_id
from tests.stored_runs import store_as_it_is

from .files import path_of
from .forging import Forgery, forgeries

RECORDS = {
    "foreign-modbus-http": 2,
    "defect-MU-13": 1,
    "defect-MU-51": 1,
    "defect-MU-52g": 1,
    "defect-MU-52r": 1,
    "defect-MU-109m": 1,
    "foreign-mqtt-handle": 2,
    "defect-MU-62q": 1,
    "defect-MU-64u": 1,
    "defect-MU-77l": 1,
    "foreign-opcua-items": 2,
    "defect-MU-99e": 1,
    "defect-MU-92k": 1,
    "defect-MU-81dnp": 1,
    "honest-bacnet-reads-with-status-flags": 1,
    "defect-MU-61ei": 1,
    "defect-MU-10p": 1,
}
"""Golden records, and how many of their items are enough: together they have every protocol, outages, guards, foreign answers and
every kind of look but those of an adapter's own figures."""

SAMPLED = 60
"""Changes of each record that the fast lane makes; the weekly lane makes all."""

TRIED = 4
"""Changes of one kind that are made to find one that is believed."""

_CALL = "items[].parts[].calls[*]"
_ENVELOPE = "(envelope|judgement.envelope)"
_ENTRY = "items[].(parts[].device|devices.*.(before|missed))[*]"
_EVENT = "items[].(parts[].device|devices.*.(before|missed))[(BURST|PUBLISH|WILL)]"
_LOOK = "items[].parts[].observations[]"

BELIEVED: Mapping[str, tuple[str, ...]] = {
    "the subject file says it: verify --subject compares the file": (
        "subject.(name|version|digest)",
        "subject.adapters.*.(addressed_by|bindings|bounds|cached|call_limit|command|governance|lists|offered|probes|scopes|times|unclaimed)**",
        "subject.adapters.*.(deadline_s|recovery|recovery_s|transport)",
    ),
    "the server says it of itself, or its program shows it": (
        "subject.adapters.*.(server_name|server_version|protocol_version|tools|calls|libraries|listing|tested|unjudged|unmet)**",
    ),
    "it is about the machine, or what was asked of the run": (
        "environment.(python|platform|started_at)",
        "settings.(broker|era|narrowed|seed|soak|subject|suites|time_scale|xdist_workers)**",
        "devices.*.endpoints[].name",
    ),
    "only the kit has measured it": (
        "items[].timing_ms**",
        "items[].devices.*.accepting_ns",
        f"{_LOOK}.start.ms",
        f"{_LOOK}.fresh_session.(ended|seconds)",
    ),
    "it only tells one thing from another": (
        "items[].order",
        "items[].devices.*.session[]",
        f"{_LOOK}.session[]",
        f"{_LOOK}.fresh_session.opened",
        f"{_CALL}.{_ENVELOPE}.meta.request_id",
    ),
    "the adapter said it, and nothing else tells the same": (
        f"{_CALL}.{_ENVELOPE}.meta.(latency_ms|operation|trace|connection)**",
        f"{_CALL}.{_ENVELOPE}.error.(message|field|retryable|outcome)",
        f"defect-MU-51 items[].parts[].calls[task].{_ENVELOPE}.meta.(attempts|source|started_at)",
        f"defect-MU-(99e|52r) items[].parts[].calls[(control|task)].{_ENVELOPE}.meta.(attempts|source)",
        "items[].parts[].calls[(setup|recovery)].(envelope|judgement.envelope|frames.complaint)**",
        f"items[].parts[].calls[*].{_ENVELOPE}.data.*",
    ),
    "nothing is derived from it": (
        "items[].judgement.findings[].evidence",
        "items[].parts[].judgement.findings[].evidence",
        f"{_ENTRY}.(client_id|peer|process|reason|bytes)**",
    ),
    "only the kit has seen it of the adapter's processes": (
        f"{_LOOK}.(handshake_era.revision|line_sent|stderr|tools)**",
        "items[].sessions[]",
        "items[].sessions[].(first_stray|inspection|leaks[])",
    ),
    "the frames were cut off or had bytes that are no text, or a Python function performed the call": (
        f"defect-MU-(52g|77l) {_CALL}.(frames|frames_sha256)**",
        f"{_CALL}.frames.faults[].evidence",
        f"foreign-mqtt-handle {_CALL}.tool",
    ),
    "the device says it of itself, and no later look repeats it": (
        f"{_LOOK}.image**",
        f"{_LOOK}.changes**",
    ),
    "the device alone has seen it, and nothing that an item expects depends on it": (
        f"{_ENTRY}.(connection|direction|frame|origin)",
        f"{_ENTRY}.told**",
    ),
    "a message of the plant's own or of the kit's, which came from no client": (
        f"{_EVENT}.(client_id|count|dup|kind|packet_id|payload|qos|retain|sparkplug|topic)**",
    ),
    "a run that was ended before it has no other look": ("items[]",),
}
"""The places whose change alone is believed, by the reason; ``docs/certificate.md`` tells it. ``*`` stands for one name, ``**`` for the
place and everything below it, ``(a|b)`` for one of both."""


def _pattern(place: str) -> re.Pattern[str]:
    text = re.sub(r"[.\[\]]", lambda found: f"\\{found[0]}", place).replace("**", "\0").replace("*", r"[^\]]*")
    return re.compile(text.replace("\0", ".*"))


_PATTERNS = {place: _pattern(place) for places in BELIEVED.values() for place in places}


def believed(name: str, place: str) -> str | None:
    """Return the place on the list that a place of a record is; None for one whose change must be refused."""
    return next((known for known, pattern in _PATTERNS.items() if _matches(pattern, name, place)), None)


@cache
def _matches(pattern: re.Pattern[str], name: str, place: str) -> bool:
    return bool(pattern.fullmatch(place) or pattern.fullmatch(f"{name} {place}"))


@cache
def forged(name: str) -> dict[str, Any]:
    """Return the first items of a golden record as if this kit had just made them in a run that was ended then."""
    run: dict[str, Any] = json.loads(gzip.decompress(path_of(name).read_bytes()))
    run["items"] = items = run["items"][: RECORDS[name]]
    adapters, settings = run["subject"]["adapters"], run["settings"]
    run["kit"] |= {"name": KIT, "version": __version__, "digest": kit_digest(), "suite_digest": suite_digest()}
    run["kit"]["protocols"] = [identity(protocols()[key]) for key in adapters]
    used = {found["device"] for item in items for found in item["devices"].values()}
    run["devices"] = {device: facts for device, facts in run["devices"].items() if device in used}
    run["environment"] |= {
        "started_at": min(item["started_at"] for item in items),
        "finished_at": max(item["finished_at"] for item in items),
    }
    settings["repetitions"] = repetitions(settings["reps"])
    statuses = {item["id"]: Status(item["judgement"]["status"]) for item in items}
    run["footer"]["verdict"] = str(decide(statuses, tasks_by_id(adapters, settings["suites"])))
    return run


def _accepted(run: dict[str, Any], made: Iterable[Forgery], directory: Path) -> list[Forgery]:
    """Return the forgeries that ``otmcp verify`` does not refuse."""
    return [forgery for forgery in made if _is_verified(forgery.applied(run), directory)]


def _is_verified(run: dict[str, Any], directory: Path) -> bool:
    try:
        return examine(store_as_it_is(directory / "run.json", run)).said[0].startswith("verified: ")
    except Refusal:
        return False


def _refusable(name: str) -> Iterator[Forgery]:
    return (forgery for forgery in forgeries(forged(name)) if believed(name, forgery.place) is None)


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.long if number % 4 else ()) for number, one in enumerate(RECORDS)]
)
def test_a_record_with_one_of_some_leaves_changed_is_refused(name: str, tmp_path: Path) -> None:
    assert _is_verified(forged(name), tmp_path)
    by_place = {(forgery.place, forgery.what): forgery for forgery in _refusable(name)}
    made = random.Random(name).sample([*by_place.values()], SAMPLED)
    assert _accepted(forged(name), made, tmp_path) == []


@pytest.mark.weekly
@pytest.mark.parametrize("name", RECORDS)
def test_a_record_with_any_leaf_changed_is_refused(name: str, tmp_path: Path) -> None:
    assert _accepted(forged(name), _refusable(name), tmp_path) == []


@pytest.mark.weekly
def test_a_change_of_each_place_on_the_list_is_believed(tmp_path: Path) -> None:
    open_places = {*_PATTERNS}
    tried: Counter[tuple[str, str, str]] = Counter()
    for name in RECORDS:
        for forgery in forgeries(forged(name)):
            place = believed(name, forgery.place)
            tried[kind := (name, forgery.place, forgery.what)] += 1
            if place in open_places and tried[kind] <= TRIED and _is_verified(forgery.applied(forged(name)), tmp_path):
                open_places.remove(place)
    assert open_places == set()
