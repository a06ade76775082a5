"""Fixtures of all tests of mocks: mock programs as real processes."""

from __future__ import annotations

from collections.abc import AsyncIterator, Awaitable, Callable

import pytest
import pytest_asyncio
from mock_program import MockProgram

StartMock = Callable[..., Awaitable[MockProgram]]


@pytest_asyncio.fixture
async def start_mock() -> AsyncIterator[StartMock]:
    """``await start_mock("modbus", "--port", "0")``: the program with its device ready and its simulation paused.

    Every program is ended with the test, and must have written nothing to standard error.
    """
    started: list[MockProgram] = []

    async def start(*arguments: str, paused: bool = True) -> MockProgram:
        program = await MockProgram.start(*arguments)
        started.append(program)
        await program.ready(paused=paused)
        return program

    yield start
    ended = [await program.end() for program in started]
    assert [stderr for _, stderr in ended] == [""] * len(ended)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def program(request: pytest.FixtureRequest) -> AsyncIterator[MockProgram]:
    """The mock that the test module names as ``MOCK``, paused, for all tests of the module."""
    started = await MockProgram.start(request.module.MOCK)
    try:
        await started.ready()
        yield started
    finally:
        _, stderr = await started.end()
    assert stderr == ""


@pytest_asyncio.fixture(loop_scope="module")
async def device(program: MockProgram) -> MockProgram:
    """The mock of the module with its start-up values, and a journal without entries."""
    await program.control.ask("reset")
    await program.control.forget()
    return program


@pytest_asyncio.fixture
async def modbus(start_mock: StartMock) -> MockProgram:
    """The Modbus mock, paused."""
    return await start_mock("modbus")
