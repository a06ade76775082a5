"""What a tool with a vocabulary of its own does, found in calls whose arguments differ."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable
from typing import Any

import pytest

from pytest_otmcp.onboarding.commands import _saying
from pytest_otmcp.onboarding.effects import Call, Effect, effect_of
from pytest_otmcp.subject.command import Draw

COUNT = itertools.count()

Tool = Callable[..., dict[str, Any]]


def observed(
    tool: Tool, values: dict[str, list[Any]], ranges: dict[str, tuple[float, float, float]] | None = None
) -> Effect | None:
    """Return what is found when each argument is varied alone."""
    first = {name: some[0] for name, some in values.items()}
    others = [{**first, name: value} for name, some in values.items() for value in some[1:]]
    calls = [Call(arguments=one, operation="publish", inputs=tool(**one)) for one in (first, first, *others)]
    return effect_of("tool", calls, ranges or {}, ("payload",))


def effect(
    tool: Tool, values: dict[str, list[Any]], ranges: dict[str, tuple[float, float, float]] | None = None
) -> Effect:
    found = observed(tool, values, ranges)
    assert found is not None
    return found


def test_a_value_that_is_passed_on_is_drawn_from_its_whole_range() -> None:
    found = effect(lambda level: {"address": 4, "value": level}, {"level": [0, 25, 50, 100]}, {"level": (0, 100, 1)})
    assert found.arguments == {"level": "$level"}
    assert found.command.effect == {"address": 4, "value": "$level"}
    assert found.command.draws == {"level": Draw(lowest=0, highest=100)}
    assert found.calls == 5
    half = effect(lambda level: {"address": 4, "value": level}, {"level": [15, 21.5, 28]}, {"level": (15, 28, 0.5)})
    assert half.command.draws == {"level": Draw(lowest=15, highest=28, step=0.5)}


@pytest.mark.parametrize(
    ("scale", "offset", "template"),
    [(10, 0, "$percent * 10"), (-0.5, 3, "$percent * -0.5 + 3"), (1, -40, "$percent - 40")],
)
def test_a_number_is_computed_where_three_values_lie_on_a_line(scale: float, offset: float, template: str) -> None:
    found = effect(lambda percent: {"value": percent * scale + offset}, {"percent": [2, 4, 8, 16]})
    assert found.command.effect == {"value": template}


def test_what_no_line_explains_is_what_each_value_means() -> None:
    found = effect(lambda level: {"value": round(level * 254)}, {"level": [0.25, 0.5, 1.0]})
    assert found.command.draws == {"level": Draw(values=(0.25, 0.5, 1.0), means=(64, 127, 254))}


def test_values_that_mean_the_same_are_drawn_once() -> None:
    found = effect(lambda mired: {"value": max(mired, 150)}, {"mired": [1, 100, 300]})
    assert found.command.draws == {"mired": Draw(values=(1, 300), means=(150, 300))}


def test_a_choice_and_a_place_in_a_topic_are_found() -> None:
    def tool(lamp: str, on: bool) -> dict[str, Any]:
        return {"topic": f"home/{lamp}/set", "payload": json.dumps({"state": "ON" if on else "OFF"})}

    found = effect(tool, {"lamp": ["hall", "yard"], "on": [True, False]})
    assert found.command.effect == {"topic": "home/$lamp/set", "payload": {"state": "$on"}}
    assert found.command.draws["on"] == Draw(values=(True, False), means=("ON", "OFF"))


def test_a_number_in_a_text_is_what_each_value_means() -> None:
    found = effect(lambda level: {"payload": str(level)}, {"level": [1, 2, 10]})
    assert found.command.effect == {"payload": "$level"}
    assert found.command.draws["level"].means == ("1", "2", "10")


def test_members_that_are_the_adapters_own_are_left_out() -> None:
    count = iter(range(100))

    def tool(on: bool) -> dict[str, Any]:
        return {"topic": "a", "payload": json.dumps({"on": on, "id": next(count), "by": "me"})}

    assert effect(tool, {"on": [True, False]}).command.effect["payload"] == {"on": "$on", "by": "me"}


def test_a_value_that_does_something_of_another_kind_is_not_drawn() -> None:
    def tool(mode: str, level: int) -> dict[str, Any]:
        return {"payload": json.dumps({mode: level} if mode == "dim" else {mode: level, "x": 1})}

    found = effect(tool, {"mode": ["dim", "off"], "level": [1, 2, 3]})
    assert found.arguments == {"mode": "dim", "level": "$level"}


def test_a_command_without_arguments_does_the_same_each_time() -> None:
    found = effect(lambda: {"address": 1, "value": True}, {})
    assert found.command.effect == {"address": 1, "value": True}


@pytest.mark.parametrize(
    ("tool", "values"),
    [
        (lambda level: {"value": 7}, {"level": [1, 2, 3]}),
        (lambda a, b: {"value": a + b}, {"a": [1, 2, 3], "b": [1, 2, 3]}),
        (lambda a: {"value": [a, next(COUNT)]}, {"a": [1, 2, 3]}),
    ],
    ids=["no argument matters", "two arguments in one place", "another value each time"],
)
def test_what_the_arguments_do_not_explain_is_not_proposed(tool: Tool, values: dict[str, list[Any]]) -> None:
    assert observed(tool, values) is None


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        ({"now": "$level"}, {"level": {"path": "now"}}),
        ({"now": 0}, {}),
        ({"state": "$state"}, {"on": {"path": "state", "means": {"running": True, "stopped": False}}}),
        ({"state": "running"}, {}),
        ({"level": "low"}, {}),
        (
            {"pump": {"state": "$state"}, "now": "$level"},
            {
                "level": {"path": "now"},
                "on": {"path": "pump.state", "means": {"running": True, "stopped": False}},
            },
        ),
    ],
)
def test_what_every_answer_tells_of_an_argument_is_what_it_says(answer: Any, says: dict[str, Any]) -> None:
    def told(value: Any, level: int, on: bool) -> Any:
        if isinstance(value, dict):
            return {name: told(member, level, on) for name, member in value.items()}
        return {"$level": level, "$state": "running" if on else "stopped"}.get(value, value)

    first = {"level": 3, "on": True}
    calls = [
        Call(
            arguments=one,
            operation="publish",
            inputs={"payload": json.dumps(one)},
            answer={"result": {"content": [{"type": "text", "text": json.dumps(told(answer, **one))}]}},
        )
        for one in (first, first, {**first, "level": 7}, {**first, "level": 50}, {**first, "on": False})
    ]
    found = effect_of("tool", calls, {}, ("payload",))
    assert found is not None
    saying = _saying(found, calls)
    assert saying.says == says
    assert saying.form == "json"
