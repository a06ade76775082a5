"""The machine controller that ``pyprofibus-linuxcnc-hal`` wants to serve: it has constant outputs and prints the inputs that it gets.

The program is started as a process of its own and finds this module by PYTHONPATH.
"""

from __future__ import annotations

import json
import os
from typing import Any

HAL_BIT = HAL_U32 = HAL_S32 = HAL_FLOAT = HAL_IN = HAL_OUT = HAL_RO = HAL_RW = 0


class component:
    """Pins and parameters by name. The variable PROFIBUS_PINS holds those with a value, as JSON; what else is asked for is 0."""

    def __init__(self, name: str) -> None:
        self._held: dict[str, Any] = {"config.ready": True, **json.loads(os.environ["PROFIBUS_PINS"])}

    def newpin(self, *described: Any) -> None:
        """Accept a pin."""

    newparam = newpin

    def ready(self) -> None:
        """Begin."""

    def __getitem__(self, name: str) -> Any:
        return self._held.get(name, 0)

    def __setitem__(self, name: str, value: Any) -> None:
        if self._held.get(name) != value:
            self._held[name] = value
            print(json.dumps({name: value}), flush=True)
