"""The services of PROFIBUS DP: their service access points, and what the journal has of their telegrams (EN 50170 volume 2, part 8)."""

from __future__ import annotations

from typing import Any

from .wire import Telegram

__all__ = ["MASTER_SAP", "NO_ACKNOWLEDGEMENT", "REPLY", "SERVICES", "describe", "service_of"]

MASTER_SAP = 62
"""SSAP of a master's requests to a slave (MS0)."""

_BY_SAP = {
    55: "set_slave_add",
    56: "rd_inp",
    57: "rd_outp",
    58: "global_control",
    59: "get_cfg",
    60: "slave_diag",
    61: "set_prm",
    62: "chk_cfg",
}
SERVICES = ("fdl_status", "data_exchange", *_BY_SAP.values(), "other")
"""Names of all services, as the journal and fault rules have them."""

NO_ACKNOWLEDGEMENT = frozenset({4, 6})
"""Functions of requests without acknowledgement: SDN with low and with high priority."""
REPLY = frozenset({12, 13})
"""Functions of requests with reply: SRD with low and with high priority."""
_FDL_STATUS = 9


def service_of(telegram: Telegram) -> str:
    """Return the name of the service that a request asks for."""
    if telegram.function == _FDL_STATUS:
        return "fdl_status"
    if telegram.function not in REPLY | NO_ACKNOWLEDGEMENT:
        return "other"
    if telegram.dsap is None and telegram.ssap is None:
        return "data_exchange" if telegram.function in REPLY else "other"
    service = _BY_SAP.get(telegram.dsap or 0, "other") if telegram.ssap == MASTER_SAP else "other"
    # Only the global control has no acknowledgement, and nothing else.
    return service if (service == "global_control") == (telegram.function in NO_ACKNOWLEDGEMENT) else "other"


def describe(telegram: Telegram) -> dict[str, Any]:
    """Return the members that the journal has of a request."""
    service = service_of(telegram)
    fields: dict[str, Any] = {
        "service": service,
        "station": telegram.destination,
        "master": telegram.source,
        "function": telegram.function,
        "dsap": telegram.dsap,
        "ssap": telegram.ssap,
        "data": telegram.data.hex(),
    }
    if telegram.count_is_valid:
        fields["count"] = telegram.count
    if service == "set_prm" and len(telegram.data) >= 7:
        fields["ident"] = telegram.data[4:6].hex()
    return fields
