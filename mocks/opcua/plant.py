"""The address space and what moves behind it: sensors, actuators, status, methods in one namespace.

Node identifiers are the browse names: ``ns=2;s=Temperature``.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from typing import Any

from asyncua import ua

from .server import PlantServer

__all__ = ["NAMESPACE", "Plant"]

NAMESPACE = "urn:otmcp:plant"

SENSORS = {
    "Temperature": 25.0,
    "Pressure": 1.5,
    "FlowRate": 60.0,
    "TankLevel": 50.0,
    "Vibration": 1.0,
    "PhLevel": 7.0,
    "Humidity": 45.0,
    "MotorSpeed": 900.0,
}
ACTUATORS: dict[str, bool | float] = {
    "PumpEnabled": True,
    "ValvePosition": 50.0,
    "HeaterPower": 30.0,
    "FanSpeed": 40.0,
    "ConveyorSpeed": 60.0,
    "AlarmActive": False,
}
STATUS: dict[str, tuple[Any, ua.VariantType]] = {
    "Mode": ("RUNNING", ua.VariantType.String),
    "EmergencyStop": (False, ua.VariantType.Boolean),
    "ProductionCount": (0, ua.VariantType.UInt32),
    "ProductionRate": (100.0, ua.VariantType.Double),
    "Uptime": (0, ua.VariantType.UInt32),
    "BatchName": ("batch-1", ua.VariantType.String),
}

Method = Callable[..., Any]


class Plant:
    """The nodes of the plant and their values.

    Attributes:
        variables: node id to what is fixed about a data variable: browse name, parent, type, writable.
        folders: browse name to node id.
        methods: node id to the variant types of its input arguments and the function that performs it.
        calls: node id of a method to how often it was performed.
    """

    def __init__(self, server: PlantServer) -> None:
        self._server = server
        self.namespace = 0
        self.variables: dict[ua.NodeId, dict[str, Any]] = {}
        self.folders: dict[str, ua.NodeId] = {}
        self.methods: dict[ua.NodeId, tuple[list[ua.VariantType], Method]] = {}
        self.calls: dict[ua.NodeId, int] = {}
        self._start: dict[ua.NodeId, ua.Variant] = {}
        self._produced = 0.0

    async def build(self) -> None:
        """Create all nodes."""
        self.namespace = await self._server.register_namespace(NAMESPACE)
        plant = await self._server.nodes.objects.add_folder(self._id("Plant"), self._name("Plant"))
        self.folders["Plant"] = plant.nodeid
        for name in ("Sensors", "Actuators", "Status", "Methods"):
            folder = await plant.add_folder(self._id(name), self._name(name))
            self.folders[name] = folder.nodeid
        for name, start in SENSORS.items():
            await self._variable("Sensors", name, ua.Variant(start, ua.VariantType.Double), writable=False)
        for name, value in ACTUATORS.items():
            kind = ua.VariantType.Boolean if isinstance(value, bool) else ua.VariantType.Double
            await self._variable("Actuators", name, ua.Variant(value, kind), writable=True)
        for name, (value, kind) in STATUS.items():
            await self._variable("Status", name, ua.Variant(value, kind), writable=False)
        await self._method("StartProduction", self._start_production)
        await self._method("StopProduction", self._stop_production)
        await self._method("TriggerEmergencyStop", self._emergency_stop)
        await self._method("ResetAlarms", self._reset_alarms)
        await self._method("SetProductionRate", self._set_rate, ua.VariantType.Double, returns=ua.VariantType.Double)

    def _id(self, name: str) -> ua.NodeId:
        return ua.NodeId(name, self.namespace)

    def _name(self, name: str) -> ua.QualifiedName:
        return ua.QualifiedName(name, self.namespace)

    async def _variable(self, folder: str, name: str, value: ua.Variant, *, writable: bool) -> None:
        parent = self._server.get_node(self.folders[folder])
        node = await parent.add_variable(self._id(name), self._name(name), value)
        if writable:
            await node.set_writable()
        self._start[node.nodeid] = value
        self.variables[node.nodeid] = {
            "browse_name": name,
            "parent": self.folders[folder].to_string(),
            "data_type": value.VariantType.name,
            "writable": writable,
        }

    async def _method(
        self, name: str, function: Method, *inputs: ua.VariantType, returns: ua.VariantType | None = None
    ) -> None:
        parent = self._server.get_node(self.folders["Methods"])
        outputs = [] if returns is None else [returns]
        node = await parent.add_method(self._id(name), self._name(name), function, list(inputs), outputs)
        self.methods[node.nodeid] = (list(inputs), function)
        self.calls[node.nodeid] = 0

    # -- values -------------------------------------------------------------------------------------------

    def node(self, name: str) -> ua.NodeId:
        """The data variable with this browse name or node id.

        Raises:
            ValueError: there is none.
        """
        node = self._id(name)
        if node not in self.variables:
            with contextlib.suppress(ua.UaError):
                node = ua.NodeId.from_string(name)
        if node not in self.variables:
            raise ValueError(f"the plant has no variable {name!r}")
        return node

    def data_value(self, node: ua.NodeId) -> ua.DataValue:
        """What the server holds for a node now."""
        return self._server.iserver.aspace[node].attributes[ua.AttributeIds.Value].value

    def value(self, name: str) -> Any:
        """The value of a variable by its browse name."""
        return self.data_value(self._id(name)).Value.Value

    async def put(self, name: str, value: Any, status: int = ua.StatusCodes.Good) -> None:
        """Set a variable from inside, without a trace in the journal.

        Raises:
            ValueError: there is no such variable, or the value does not fit its type.
        """
        node = self.node(name)
        kind = self._start[node].VariantType
        if not _fits(value, kind):
            raise ValueError(f"{name} is {kind.name}, {value!r} does not fit")
        value = float(value) if kind == ua.VariantType.Double else value
        data = ua.DataValue(ua.Variant(value, kind), StatusCode=ua.StatusCode(status))
        await self._server.iserver.write_attribute_value(node, data)

    async def restore(self) -> None:
        """Start-up values everywhere."""
        for node, value in self._start.items():
            await self._server.iserver.write_attribute_value(node, ua.DataValue(value))
        self._produced = 0.0

    # -- methods ------------------------------------------------------------------------------------------

    async def _start_production(self, parent: ua.NodeId) -> None:
        if not self.value("EmergencyStop"):
            await self.put("Mode", "RUNNING")

    async def _stop_production(self, parent: ua.NodeId) -> None:
        await self.put("Mode", "STOPPED")

    async def _emergency_stop(self, parent: ua.NodeId) -> None:
        await self.put("EmergencyStop", True)
        await self.put("Mode", "EMERGENCY_STOP")

    async def _reset_alarms(self, parent: ua.NodeId) -> None:
        await self.put("EmergencyStop", False)
        await self.put("AlarmActive", False)
        await self.put("Mode", "STOPPED")

    async def _set_rate(self, parent: ua.NodeId, rate: ua.Variant) -> list[ua.Variant]:
        previous = self.value("ProductionRate")
        await self.put("ProductionRate", rate.Value)
        return [ua.Variant(previous, ua.VariantType.Double)]

    # -- dynamics -----------------------------------------------------------------------------------------

    async def tick(self) -> None:
        """One second: heater and fan to temperature, pump and valve to pressure, flow and level. Actuators are only
        read: what a client wrote stays."""
        seconds = self.value("Uptime") + 1
        await self.put("Uptime", seconds)
        running = self.value("Mode") == "RUNNING"
        pumping = running and self.value("PumpEnabled")
        valve = _percent(self.value("ValvePosition"))
        conveyor = _percent(self.value("ConveyorSpeed"))
        wave = math.sin(seconds / 10)
        heating = 80 * _percent(self.value("HeaterPower")) if running else 0.0
        target = 20.0 + heating - 10 * _percent(self.value("FanSpeed"))
        temperature = self.value("Temperature")
        await self.put("Temperature", temperature + (target - temperature) * 0.05)
        await self.put("Pressure", 1.0 + (0.5 if pumping else 0.0) + 0.05 * wave)
        await self.put("FlowRate", 120 * valve if pumping else 0.0)
        level = self.value("TankLevel") + (0.4 if pumping else 0.0) - 0.4 * valve
        await self.put("TankLevel", min(100.0, max(0.0, level)))
        await self.put("Vibration", 1.0 + 0.2 * wave if running else 0.0)
        await self.put("PhLevel", 7.0 + 0.05 * wave)
        await self.put("Humidity", 45.0 + 2 * wave)
        await self.put("MotorSpeed", 1500 * conveyor if running else 0.0)
        if running:
            self._produced += self.value("ProductionRate") / 60 * conveyor
            await self.put("ProductionCount", int(self._produced))


def _percent(value: float) -> float:
    return min(100.0, max(0.0, value)) / 100 if math.isfinite(value) else 0.0


def _fits(value: Any, kind: ua.VariantType) -> bool:
    if kind == ua.VariantType.Boolean:
        return isinstance(value, bool)
    if kind == ua.VariantType.String:
        return isinstance(value, str)
    if kind == ua.VariantType.Double:
        return isinstance(value, int | float) and not isinstance(value, bool)
    return isinstance(value, int) and not isinstance(value, bool)
