"""``python -m pytest_otmcp.reference_adapters.defects ID [PROTOCOL]``: the reference adapter with the defect of this id.

A defect that is the same change of any adapter can be had at that of another protocol.

With ``--list`` in place of the id it prints the declarations of all defects as JSON. An id has to be given, and the adapter says
in its introduction and on stderr that it is defective: nobody gets one by accident, or takes it for the reference adapter.
"""

from __future__ import annotations

import json
import sys
from importlib import import_module
from typing import Any

from mcp.types import SERVER_INFO_META_KEY

from ..core import AdapterServer, ConfigError
from ..core.run import serve
from .defect import Defect
from .listing import listing
from .table import DEFECTS, PROTOCOLS


def main() -> int:
    """Build the adapter, give it its defect, serve, and return the exit code."""
    match sys.argv[1:]:
        case ["--list"]:
            print(json.dumps(listing()))
            return 0
        case [asked] if asked in DEFECTS:
            protocol = DEFECTS[asked].protocol
        case [asked, protocol] if asked in DEFECTS and DEFECTS[asked].anywhere and protocol in PROTOCOLS:
            pass
        case _:
            known = "ID, such as MU-13 | ID PROTOCOL, such as MU-47 s7, where any adapter may have the defect"
            print(f"usage: python -m pytest_otmcp.reference_adapters.defects {{--list | {known}}}", file=sys.stderr)
            return 2
    defect = DEFECTS[asked]
    if defect.before is not None:
        defect.before()
    try:
        module = f"..{protocol}.named" if defect.named else f"..{protocol}"
        server: AdapterServer = import_module(module, __package__).build()
    except ConfigError as error:
        print(f"configuration: {error}", file=sys.stderr)
        return 2
    introduce(server, defect)
    defect.change(server)
    return serve(server)


def introduce(server: AdapterServer, defect: Defect) -> None:
    """Let everything that names the server say that it is defective."""
    server.name = server.mcp.name = f"{server.name} with defect {defect.id}"
    meta: Any = server._completion["_meta"]
    meta[SERVER_INFO_META_KEY]["name"] = server.name
    print(f"{server.name}, for the kit's mock devices only: {defect.sentence}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
