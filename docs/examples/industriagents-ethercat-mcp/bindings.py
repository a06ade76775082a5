"""Process data and scans with industriagents-ethercat-mcp, which leaves it to its caller in which state a slave is."""

from pytest_otmcp.subject import Refused


def _checked(answer):
    if answer.is_error:
        message = answer.structured["error"]
        raise Refused("writes_disabled" if "are disabled" in message else "unclassified", message)
    return answer.structured["data"]


async def write_outputs(tools, *, slave, data):
    # With writes disabled, the refusal to write is what counts: so that comes first.
    told = await tools.call("write_pdo", target="address", slave_position=slave, offset=0, data=data)
    if told.is_error and "set_slave_state" in told.structured["error"]:
        for state in ("SAFEOP", "OP"):
            _checked(await tools.call("set_slave_state", slave_position=slave, state=state))
        told = await tools.call("write_pdo", target="address", slave_position=slave, offset=0, data=data)
    _checked(told)
    return {}


async def scan_network(tools):
    # While a slave has process data a scan is refused, because it would take them from it; the refusal says what to do.
    told = await tools.call("scan_network")
    if told.is_error and "Refusing to rescan" in told.structured["error"]:
        for slave in (0, 1):
            await tools.call("set_slave_state", slave_position=slave, state="PREOP")
        told = await tools.call("scan_network")
    return {"positions": [slave["position"] for slave in _checked(told)["slaves"]]}
