import pytest

from pytest_otmcp.trial.repetition import Repetition
from pytest_otmcp.trial.rig import Rig
from pytest_otmcp.trial.task import Task, Tasks


@pytest.fixture
def task() -> Task:
    @Tasks().task("T1", "stress", "A task.", needs="modbus.ping", capability=None)
    async def steps(run: Repetition, modbus: Rig) -> None: ...

    return steps


@pytest.mark.parametrize("when", ["before", "after"])
def test_steps_around_the_repetitions_are_not_replaced(task: Task, when: str) -> None:
    register = {"before": task.before, "after": task.after}[when]

    @register
    async def first(run: Repetition, modbus: Rig) -> None: ...

    with pytest.raises(ValueError, match="T1: the steps second would replace first"):

        @register
        async def second(run: Repetition, modbus: Rig) -> None: ...


def test_steps_name_adapters_of_their_task_alone(task: Task) -> None:
    with pytest.raises(ValueError, match=r"T1: the steps more name 'mqtt', the task has \['modbus'\]"):

        @task.after
        async def more(run: Repetition, mqtt: Rig) -> None: ...
