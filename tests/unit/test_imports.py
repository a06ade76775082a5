"""The libraries that an adapter's own program imports: seen in its files, never guessed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from pytest_otmcp.subject.imports import libraries_used


def write(folder: Path, **files: str) -> None:
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_dot_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def test_the_file_that_the_command_names_is_read(tmp_path: Path) -> None:
    write(tmp_path, server_dot_py="import os\nfrom pymodbus.client import ModbusTcpClient\nimport mcp.server\n")
    assert libraries_used([sys.executable, str(tmp_path / "server.py")], None) == {
        "mcp": "server.py",
        "pymodbus": "server.py",
    }
    assert libraries_used([sys.executable, "server.py"], tmp_path).keys() == {"mcp", "pymodbus"}


def test_the_adapters_own_files_beside_it_are_read_too(tmp_path: Path) -> None:
    write(tmp_path, server_dot_py="import plc\n", plc_dot_py="import asyncua\n", other_dot_py="import pymodbus\n")
    assert libraries_used([sys.executable, "server.py"], tmp_path) == {"asyncua": "plc.py"}


def test_a_module_and_a_console_script_lead_to_their_package_alone(tmp_path: Path) -> None:
    site = tmp_path / "lib" / "python3.11" / "site-packages"
    write(site, acme____init___dot_py="", acme__server_dot_py="import paho.mqtt.client\nimport helper\n")
    write(site, helper_dot_py="import pymodbus\n", pymodbus_dot_py="import asyncua\n")
    write(tmp_path, bin__python="", bin__acme="#!/usr/bin/python\nfrom acme.server import main\nmain()\n")
    for program in ("python", "acme"):
        (tmp_path / "bin" / program).chmod(0o755)
    assert libraries_used([str(tmp_path / "bin" / "python"), "-P", "-m", "acme"], None) == {"paho-mqtt": "server.py"}
    assert libraries_used([str(tmp_path / "bin" / "acme")], None) == {"paho-mqtt": "server.py"}


@pytest.mark.parametrize(
    "text",
    [
        '"""Unlike others it does not\nimport pymodbus\n"""\n',
        "# import pymodbus\n",
        "print('import pymodbus')\n",
        "import pymodbus_mock\n",
        "import pymodbus (\n",
        "\0",
        "(" * 10_000,
    ],
)
def test_words_about_a_library_and_files_that_are_no_program_prove_nothing(tmp_path: Path, text: str) -> None:
    write(tmp_path, server_dot_py=text)
    assert libraries_used([sys.executable, "server.py"], tmp_path) == {}


def test_a_program_that_cannot_be_read_uses_nothing_known(tmp_path: Path) -> None:
    assert libraries_used(["no-such-program"], tmp_path) == {}
    assert libraries_used(["docker", "run", "acme/adapter"], tmp_path) == {}


@pytest.mark.parametrize(
    "text",
    [
        'import mqtt from "mqtt";',
        "import * as mqtt from 'mqtt';",
        'import {\n  connect, // the client\n  type MqttClient,\n} from "mqtt";',
        'import{connect}from"mqtt";',
        'import "mqtt";',
        'export { connect } from "mqtt";',
        'const mqtt = require("mqtt");',
        "const { connect } = require( 'mqtt/dist/mqtt.js' );",
        'const mqtt = await import("mqtt");',
        'const url = "http://127.0.0.1"; const mqtt = require("mqtt");',
        '#!/usr/bin/env node\n/* from */ import mqtt from "mqtt";',
    ],
)
@pytest.mark.parametrize("name", ["server.js", "server.mjs", "server.cjs", "server.ts", "server.mts", "server.cts"])
def test_a_program_for_node_imports_a_package_in_any_form(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    assert libraries_used(["node", "--import", "tsx", name, "--verbose"], tmp_path) == {"mqtt": name}


@pytest.mark.parametrize(
    "text",
    [
        '// import mqtt from "mqtt";',
        '/*\n * import mqtt from "mqtt";\n */',
        '/* import mqtt from "mqtt";',
        "console.log('import mqtt from \"mqtt\"');",
        'const help = `\nimport mqtt from "mqtt";\n`;',
        'import mqtt from "mqtt-mock";',
        'import mqtt from "@acme/mqtt";',
        'import mqtt from "acme/mqtt";',
        'const kinds = Array.from("mqtt"); plc.import("mqtt"); own_require("mqtt");',
        'import mqtt from "./mqtt";',
        'import mqtt from "./node_modules/mqtt/index.js";',
        'import mqtt from "node:mqtt',
        'import "./' + "x" * 300 + '";',
        "/*" * 100_000,
        "import " + " " * 100_000,
        "`" * 99_999,
        "\0",
    ],
)
def test_words_about_a_package_of_node_prove_nothing(tmp_path: Path, text: str) -> None:
    write(tmp_path, server_dot_js=text, node_modules__mqtt__index_dot_js='import "mqtt";')
    assert libraries_used(["node", "server.js"], tmp_path) == {}


def test_a_program_for_node_is_followed_to_the_adapters_own_files_alone(tmp_path: Path) -> None:
    write(tmp_path, dist__index_dot_js='import "../src/plc.js"; import "./tags";\nconst { log } = require("./log");')
    write(tmp_path, src__plc_dot_ts='import "modbus-serial";\nimport "../dist/index.js";')
    write(tmp_path, dist__tags__index_dot_js='import "mqtt";', dist__log_dot_cjs='require("node-opcua");')
    write(tmp_path, src__other_dot_ts='import "@modelcontextprotocol/sdk";', node_modules__mqtt__index_dot_js="")
    assert libraries_used(["node", "dist/index.js"], tmp_path) == {
        "modbus-serial": "plc.ts",
        "mqtt": "index.js",
        "node-opcua": "log.cjs",
    }


def test_a_program_that_npm_has_linked_leads_to_its_package(tmp_path: Path) -> None:
    modules = tmp_path / "node_modules"
    write(modules, acme__index_dot_js='#!/usr/bin/env node\nimport "modbus-serial";\n', modbus_dot_js='import "mqtt";')
    (modules / "acme" / "index.js").chmod(0o755)
    (modules / ".bin").mkdir()
    (modules / ".bin" / "acme").symlink_to("../acme/index.js")
    assert libraries_used(["node_modules/.bin/acme"], tmp_path) == {"modbus-serial": "index.js"}


@pytest.mark.parametrize("name", ["as-first-written.ts", "adapter.ts"])
@pytest.mark.parametrize(
    ("protocol", "library"), [("modbus", "modbus-serial"), ("mqtt", "mqtt"), ("opcua", "node-opcua")]
)
def test_the_adapters_of_the_documentation_are_seen_to_use_their_libraries(
    protocol: str, library: str, name: str
) -> None:
    folder = Path(__file__).parents[2] / "docs" / "first-adapter" / "typescript" / protocol
    used = libraries_used(["node", "--import", "tsx", name], folder)
    assert used.keys() == {"@modelcontextprotocol/sdk", "zod", library}
    assert used[library] == name
