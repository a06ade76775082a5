"""A small fleet: an adapter that reads one table of registers, its subject file, and the plan."""

from __future__ import annotations

from pathlib import Path

__all__ = ["SUBJECT", "plan", "subject"]

SUBJECT = """
[subject]
name = "reader"
version = "0"

[adapter.modbus]
command = {command}
env = {{ MODBUS_HOST = "{{host}}", MODBUS_PORT = "{{port}}", MODBUS_TIMEOUT_S = "2.4", MODBUS_DEADLINE_S = "2.8" }}
deadline_s = 5.0

[adapter.modbus.bind.ping]
tool = "ping"
result.reachable = "data.reachable"

[adapter.modbus.bind.read_holding]
tool = "read_multiple_holding_registers"
arguments = {{ address = "$address", count = "$count" }}
result.values = "data.values"

[adapter.modbus.unclaimed]
read_input = "reads holding registers alone"
write_holding = "reads alone"
guard = "writes nothing"
"""
HONEST = '["{python}", "-P", "-m", "pytest_otmcp.reference_adapters", "modbus"]'


def subject(directory: Path, name: str, command: str = HONEST) -> None:
    """Write a subject file into a folder of its own."""
    folder = directory / name
    folder.mkdir()
    (folder / "otmcp.toml").write_text(SUBJECT.format(command=command), encoding="utf-8")


def plan(directory: Path, *rows: str, settings: str = "reps = 1") -> Path:
    """Write the plan of rows, each an id, a version, the folder of its subject file and further lines."""
    lines = ['name = "A small fleet"', settings]
    for row in rows:
        name, version, folder, *more = row.split(" ", 3)
        lines += ["[[row]]", f'id = "{name}"', f'version = "{version}"', f'subject = "{folder}/otmcp.toml"', *more]
    file = directory / "fleet.toml"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file
