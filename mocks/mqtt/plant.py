"""The values of the simulated plant and their changes: all are functions of the number of ticks and of commands."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

__all__ = ["Plant", "Tag"]

_PERIOD = 60


@dataclass(slots=True, kw_only=True)
class Tag:
    """One metric of a device. ``datatype`` is a Sparkplug name; a ``writable`` metric follows DCMD."""

    datatype: str
    value: Any
    writable: bool = False

    def accepts(self, value: Any) -> bool:
        """Tell whether a value is of the tag's type."""
        if self.datatype in ("Float", "Double"):
            return isinstance(value, float)
        if self.datatype == "Boolean":
            return isinstance(value, bool)
        if self.datatype == "String":
            return isinstance(value, str)
        return isinstance(value, int) and not isinstance(value, bool)


class Plant:
    """Two devices and three plain sensors; sine waves with a period of a minute, one tick a second."""

    def __init__(self) -> None:
        self.ticks = 0
        self.devices = {
            "device-1": {
                "temperature": Tag(datatype="Double", value=20.0),
                "pressure": Tag(datatype="Double", value=1.0),
                "setpoint": Tag(datatype="Double", value=50.0, writable=True),
                "running": Tag(datatype="Boolean", value=True, writable=True),
            },
            "device-2": {
                "level": Tag(datatype="Float", value=50.0),
                "count": Tag(datatype="Int64", value=0),
                "speed": Tag(datatype="Int32", value=-10, writable=True),
                "recipe": Tag(datatype="String", value="standard", writable=True),
            },
        }

    def tick(self) -> dict[str, dict[str, Tag]]:
        """Advance by one second; return the tags that changed, by device."""
        self.ticks += 1
        self._set("device-1", temperature=20 + 5 * self._wave(), pressure=1 + 0.2 * self._wave())
        self._set("device-2", level=50 + 30 * self._wave(), count=self.ticks)
        return {
            "device-1": self._tags("device-1", "temperature", "pressure"),
            "device-2": self._tags("device-2", "level", "count"),
        }

    def sensors(self) -> dict[str, dict[str, Any]]:
        """Return the plain sensors' messages, as they are published."""
        return {
            "temperature": {"value": round(20 + 5 * self._wave(), 3), "unit": "degC"},
            "pressure": {"value": round(1 + 0.2 * self._wave(), 3), "unit": "bar"},
            "humidity": {"value": round(45 + 10 * self._wave(), 3), "unit": "%"},
        }

    def command(self, device: str, name: str | None, datatype: str | None, value: Any) -> Tag | None:
        """Execute a command; return the tag with its new value, or None when there is no such tag, or it is not
        writable or of another type."""
        tag = None if name is None else self.devices.get(device, {}).get(name)
        if tag is None or not tag.writable or datatype not in (None, tag.datatype) or not tag.accepts(value):
            return None
        tag.value = value
        return tag

    def _wave(self) -> float:
        return math.sin(self.ticks * 2 * math.pi / _PERIOD)

    def _set(self, device: str, **values: Any) -> None:
        for name, value in values.items():
            self.devices[device][name].value = value

    def _tags(self, device: str, *names: str) -> dict[str, Tag]:
        return {name: self.devices[device][name] for name in names}
