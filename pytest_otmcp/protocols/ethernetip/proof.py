"""The proof that a session talks to the mock Logix controller: random bytes come back."""

from __future__ import annotations

import random
from collections.abc import Mapping

from ..journal import Entries, Image
from ..proof import Call, Proof, Question, Way, exchanged

__all__ = ["PROOF"]

_TAG = "BatchTarget"
_ARRAY = "Counts"
_ELEMENTS = 4
_ASKED = {"tag": _TAG}
_ALIAS = "otmcp_level"


def _number(rng: random.Random) -> Question:
    value = rng.randrange(-(2**31), 2**31)

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 32 if outputs.get("value") == value else 0

    return Question(inputs=_ASKED, pokes=({"tag": _TAG, "value": value},), bits=bits)


def _array(rng: random.Random) -> Question:
    values = [rng.randrange(-(2**15), 2**15) for _ in range(_ELEMENTS)]
    pokes = tuple({"tag": f"{_ARRAY}[{index}]", "value": value} for index, value in enumerate(values))

    def bits(outputs: Mapping[str, object], entries: Entries) -> int:
        return 16 * _ELEMENTS if outputs.get("values") == values else 0

    return Question(inputs={"tag": f"{_ARRAY}[0]", "count": _ELEMENTS}, pokes=pokes, bits=bits)


def _restore(image: Image) -> tuple[Mapping[str, object], ...]:
    changed = (_TAG, *(f"{_ARRAY}[{index}]" for index in range(_ELEMENTS)))
    return tuple({"tag": tag, "value": image["points"][tag]} for tag in changed)


PROOF = Proof(
    ways=(
        Way(operation="read_tag", ask=_number),
        Way(operation="read_array", ask=_array),
        Way(operation="ping", ask=lambda rng: Question(inputs={}, bits=exchanged), weak=True),
    ),
    restore=_restore,
    unreachable=(
        Call("read_tag", _ASKED),
        Call("read_array", {"tag": f"{_ARRAY}[0]", "count": _ELEMENTS}),
        Call("read_tags", {"tags": [_TAG]}),
        Call("read_alias", {"name": _ALIAS}),
        Call("read_clock"),
        Call("ping"),
    ),
)
