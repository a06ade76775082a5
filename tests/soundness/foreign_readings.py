"""An OPC UA adapter that reads under names of its own, and its lies; and a Modbus one, in sentences: no tool takes a node or a register.

``opcua-brewery``: sensors by a word, in Fahrenheit for one of them, and a pump that is on or off; structured content. It connects for each call.
``modbus-tank``: a level in percent with one decimal, and a state in a word.
"""

from __future__ import annotations

import asyncio
import math
import os
from typing import Any

from asyncua import Client, ua
from foreign import Failure, Result, Shape, prose, structured
from foreign_modbus import endpoint, transact

DEADLINE_S = 1.0
ANSWERED_S = 3.5
AT_ONCE = 4
"""Connections that it has at the same time."""
MOST = 24
"""Calls that it takes at the same time."""
NODES = {"temperature": "Temperature", "pressure": "Pressure", "level": "TankLevel"}
LEVEL, MIXER = 30, 7
FULL = 27648
"""An analog input of 100 percent."""


class Turns:
    """The turns of calls: so many at once, and not too many that wait."""

    def __init__(self) -> None:
        self._turns = asyncio.Semaphore(AT_ONCE)
        self._present = 0

    async def __aenter__(self) -> None:
        if self._present >= MOST:
            raise Failure("busy", "busy: too many calls")
        self._present += 1
        try:
            await self._turns.acquire()
        except BaseException:
            self._present -= 1
            raise

    async def __aexit__(self, *raised: object) -> None:
        self._present -= 1
        self._turns.release()


def opcua_brewery(lie: str | None, read_only: bool) -> Shape:
    remembered: dict[str, Any] = {}
    turns = Turns()

    async def read(name: str) -> Any:
        async with (
            asyncio.timeout(2 * DEADLINE_S),
            turns,
            Client(os.environ["PLANT_URL"], timeout=DEADLINE_S) as client,
        ):
            found = await client.get_node(f"ns=2;s={name}").read_data_value(raise_on_bad_status=lie != "any-quality")
            return 0.0 if lie == "any-quality" and found.Value.Value is None else found.Value.Value

    async def told(name: str, node: str, make: Any) -> Result:
        if lie == "from-memory" and name in remembered:
            return structured({"value": remembered[name]})
        try:
            # A client that closes its connection to a silent server takes its time as well.
            value = make(await asyncio.wait_for(asyncio.shield(asyncio.ensure_future(read(node))), ANSWERED_S))
        except (Failure, ArithmeticError) as failure:
            return structured({"error": str(failure)}, is_error=True)
        except (OSError, ua.UaError) as error:
            if lie == "the-last-one" and name in remembered:
                return structured({"value": remembered[name]})
            kind = "refused" if isinstance(error, ua.UaStatusCodeError) else "offline"
            return structured({"error": f"{kind}: {type(error).__name__}"}, is_error=True)
        remembered[name] = value
        return structured({"value": value})

    async def sensor(name: str) -> Result:
        meant = [known for known in NODES if (known in name if lie == "guesses-words" else known == name)]
        if not meant:
            return structured({"error": f"invalid: there is no sensor {name!r}"}, is_error=True)
        node = NODES["pressure" if lie == "one-for-another" and meant[0] == "level" else meant[0]]

        def value(held: float) -> float:
            if not math.isfinite(held):
                raise ArithmeticError("invalid: the sensor has no value")
            held = min(held, 60.0) if lie == "clamped" else held
            return round(held * 1.8 + 32, 1) if meant[0] == "temperature" else round(held, 2)

        return await told(meant[0], node, value)

    async def pump() -> Result:
        words = ("on", "off") if lie == "other-word" else ("off", "on")
        return await told("pump", "PumpEnabled", lambda held: words[bool(held)])

    return Shape(
        tools={"sensor": ({"name": "string"}, sensor), "pump": ({}, pump)},
        strict=True,
    )


def modbus_tank(lie: str | None, read_only: bool) -> Shape:
    turns = Turns()

    async def said(sentence: Any, work: Any) -> Result:
        try:
            async with asyncio.timeout(2 * DEADLINE_S), turns:
                return prose(sentence(await transact(*endpoint(), work)))
        except TimeoutError:
            return prose("Error: no answer in time", is_error=True)
        except Failure as failure:
            return prose(f"Error: {failure}", is_error=True)

    async def level() -> Result:
        def sentence(answer: Any) -> str:
            (held,) = answer.registers
            percent = held / (27000 if lie == "another-scale" else FULL) * 100
            return f"The tank is {percent:.1f} % full"

        address = LEVEL + 1 if lie == "neighbour" else LEVEL
        return await said(sentence, lambda client: client.read_holding_registers(address, count=1))

    async def mixer() -> Result:
        return await said(
            lambda answer: "The mixer runs" if answer.bits[0] else "The mixer stands still",
            lambda client: client.read_coils(MIXER, count=1),
        )

    return Shape(tools={"level": ({}, level), "mixer": ({}, mixer)}, strict=True)
