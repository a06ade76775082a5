"""What the sentences of findings say of replies, held against the calls of the same record.

A finding is read as a reader reads it: where it says that the adapter claimed success, was never answered or said that nothing was sent, the
record has a reply that does so. The reply is that of the call whose name begins the sentence, else any of the part of the item in which the
finding is. A sentence about a reply that no rule here knows is untrue until somebody has written its rule.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any

__all__ = ["untrue"]

Call = Mapping[str, Any]
Told = Callable[[Call, str], bool]
"""Whether a call is what a sentence says; the text is what the sentence quotes."""

_ABOUT_REPLIES = re.compile(r"\b(?:said|says|reported|succeeded|succeeds|claims?|claimed|answered|refused|cancelled)\b")
_LABEL_LETTERS = 160


def _envelope(call: Call) -> Mapping[str, Any]:
    envelope = call.get("envelope")
    return envelope if isinstance(envelope, Mapping) else {}


def _error(call: Call) -> Mapping[str, Any]:
    error = _envelope(call).get("error")
    return error if isinstance(error, Mapping) else {}


def _success(call: Call, quoted: str = "") -> bool:
    return _envelope(call).get("success") is True


def _failure(call: Call, quoted: str = "") -> bool:
    return _envelope(call).get("success") is False


def _silent(call: Call, quoted: str = "") -> bool:
    return call["received_ns"] is None and not _cancelled(call)


def _cancelled(call: Call, quoted: str = "") -> bool:
    return (call.get("frames") or {}).get("failure") == "cancelled"


def _no_success(call: Call, quoted: str = "") -> bool:
    return not _success(call)


def _not_sent(call: Call, quoted: str = "") -> bool:
    return _error(call).get("outcome") == "not_sent" or _error(call).get("code") == "writes_disabled"


def _answered(call: Call, quoted: str = "") -> bool:
    return call["received_ns"] is not None


def _quotes(call: Call, quoted: str) -> bool:
    """The reply has what the sentence quotes of it, in its envelope, its outputs or its frame."""
    frames = call.get("frames") or {}
    texts = [
        json.dumps(call.get(name), ensure_ascii=False, default=repr) for name in ("envelope", "outputs", "arguments")
    ]
    texts += [repr(call.get(name)) for name in ("envelope", "outputs")] + [str(frames.get("response"))]
    return any(quoted[:60] in text for text in texts) or quoted.split(" ")[0] in ("None", "null", "none", "nothing")


def _has_list(call: Call, quoted: str) -> bool:
    """An output is a list of that many."""
    return any(isinstance(value, list) and len(value) == int(quoted) for value in (call.get("outputs") or {}).values())


def _error_code(call: Call, quoted: str) -> bool:
    return repr(call["error_code"]) == quoted


def _outcome(call: Call, quoted: str) -> bool:
    return repr(_error(call).get("outcome")) == quoted


def _any(call: Call, quoted: str) -> bool:
    return True


_RULES: Sequence[tuple[re.Pattern[str], Told]] = [
    (re.compile(pattern), told)
    for pattern, told in (
        (r"claims? success|claimed success", _success),
        (r"a read succeeded after", _success),
        (r"still succeeds|succeeded, but", _success),
        (r"before the reply says success", _success),
        (r"it was reported as failed|was reported as failed", _failure),
        (r"it was refused|: refused\b|a call without it is refused|the adapter refuses further calls", _failure),
        (r"expected success, got no reply", _silent),
        (r"expected success, got", _no_success),
        (r"it was never answered|no reply within|no reply, the session", _silent),
        (r"the kit cancelled the call|a call that was cancelled", _cancelled),
        (r"it says that nothing was sent", _not_sent),
        (r"error code should be .*, it is ('[^']*'|None)$", _error_code),
        (r"error outcome should be .*, it is ('[^']*'|None)$", _outcome),
        (r"the error code is ('[^']*'|None), it was", _error_code),
        (r"the adapter said (?:success|that it wrote )", _success),
        (r"the reply (?:says|tells) .*\bwith success|the reply says success", _success),
        (r"answered after \d+ ms|answered with a", _answered),
        # A reading of the reply, not its words.
        (r"the reply says (?:\[.*\] of \[|source |that it is |.* by the subject file$)", _answered),
        (r"the reply says a list of (\d+)$", _has_list),
        (r"the reply says (.*?)(?:….*)?$", _quotes),
        (r"says itself that it is not the device's: (.*)", _quotes),
    )
]
"""What a sentence says of a reply; a group is what it quotes."""

_OTHER = re.compile(
    # About the list of tools, what an envelope says of itself, the wire, or the session: judged by other means, and from other parts.
    r"tools/list|inputSchema|annotation|\bmeta\b|\btrace\b|isError|structuredContent|stdout|stdin|its own words|"
    r"should have (?:seen|refused|received|granted|been asked|reached|answered|delivered|acknowledged|stayed)|a response carries|answered more than once|"
    r"nothing was written|the kit itself|was reported dead|success is True while|exited with|last stderr lines|the connect step|that the adapter is ready|its text is|"
    r"refused in a result|refused as rate_limited|data types is refused|class \w+ is refused|have the error code|says something else|"
    r"which the broker refused|said to be dropped|an answer .* says|which the reply should say|says how old it is|"
    # What a client cannot see: the recorder of the session has it.
    r"by HTTP status \d+|"
    # What the device answered, and how an oracle reads it.
    r"the adapter said .*; .* holds|it answered|the server refused|was not answered"
)


def untrue(items: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return every sentence of a finding that the record contradicts, with its item."""
    return [f"{item['id']}: {message}" for item in items for message in _untrue(item)]


def _untrue(item: Mapping[str, Any]) -> Iterator[str]:
    everywhere = [call for part in _parts(item) for call in part["calls"]]
    for part in item["samples"]:
        for finding in part["findings"]:
            if not _holds(finding, part["calls"]):
                yield finding["message"]
    for finding in item["findings"]:
        if not _holds(finding, everywhere):
            yield finding["message"]


def _parts(item: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    return [*item["around"], *item["samples"]]


def _holds(finding: Mapping[str, Any], calls: Sequence[Call]) -> bool:
    message = re.sub(r"^(?:setup|warmup|control): ", "", finding["message"])
    if re.match(r"(?:\w+: )?as [\w.-]+: ", message):
        # It repeats what another item has found, with the calls of that one.
        return True
    named = [call for call in calls if message.startswith(f"{_label(call)}: ")]
    about = named or calls
    said = message.removeprefix(f"{_label(named[0])}: ") if named else message
    rules = [(found, told) for pattern, told in _RULES if (found := pattern.search(said))]
    # Of several that match, the most particular stands first.
    if rules and not any(rules[0][1](call, _quoted(rules[0][0])) for call in about):
        return False
    if finding["requirement"] == "ERR-006" and finding["code"] in _OF_THE_DEVICE:
        return any(_not_sent(call) or _error(call).get("outcome") == "rejected" for call in about)
    return bool(rules) or not _ABOUT_REPLIES.search(said) or _OTHER.search(said) is not None


_OF_THE_DEVICE = {"wrote", "unexpected_packet", "unasked_write", "device_differs"}
"""Codes of findings about what reached the device: as findings about ERR-006 they say that the reply told otherwise."""


def _quoted(found: re.Match[str]) -> str:
    return found[1] if found.re.groups else ""


def _label(call: Call) -> str:
    arguments = ", ".join(f"{name}={value!r}" for name, value in call["arguments"].items())
    return f"{call['tool']}({arguments})"[:_LABEL_LETTERS]
