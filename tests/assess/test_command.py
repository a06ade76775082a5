"""``otmcp assess``: any command is an assistant, over standard streams or HTTP; and Inspect's models are."""

from __future__ import annotations

import asyncio
import fcntl
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest

from pytest_otmcp.assess import results
from pytest_otmcp.assess.agent import Command
from pytest_otmcp.assess.campaign import Asked
from pytest_otmcp.cli import main
from pytest_otmcp.core.errors import UsageError

ROOT = Path(__file__).parents[2]

_SEED = 5
_SPEAKS_HTTP = """
import json, os, sys, urllib.request, urllib.error
sys.stdin.read()
def post(body, token):
    asked = urllib.request.Request(os.environ["OTMCP_MCP_URL"], json.dumps(body).encode(), {"Authorization": f"Bearer {token}"})
    try:
        with urllib.request.urlopen(asked) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, b""
token = os.environ["OTMCP_MCP_TOKEN"]
refused, _ = post({"jsonrpc": "2.0", "id": 1, "method": "tools/list"}, "guessed")
_, listed = post({"jsonrpc": "2.0", "id": 1, "method": "tools/list"}, token)
_, unknown = post({"jsonrpc": "2.0", "id": 2, "method": "resources/list"}, token)
accepted, _ = post({"jsonrpc": "2.0", "method": "notifications/initialized"}, token)
names = [tool["name"] for tool in json.loads(listed)["result"]["tools"]]
print(refused, "ping" in names, json.loads(unknown)["error"]["code"], accepted, "SECRET" in os.environ, os.environ.get("MY_KEY"))
print(json.dumps({"outcome": "unsure", "tokens": 12}))
"""


def assessed(out: Path, *words: str) -> results.Assessment:
    assert main(["assess", "--tries=1", f"--seed={_SEED}", f"--out={out}", *words]) == 0
    [found] = results.read([out / "assessment.json"])
    return found


@pytest.mark.long
def test_a_command_finds_the_adapters_in_an_mcp_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    chooser = [sys.executable, "-m", "tests.assess.choosers", "good", str(_SEED), "1"]
    found = assessed(tmp_path, "--task=modbus.range", "--task=cross.x2", "--name=good", "--", *chooser)
    assert [(told["task"], told["verdict"], told["honesty"]) for told in found["tries"]] == [
        ("modbus.range", "right", "true"),
        ("cross.x2", "right", "true"),
    ], found["tries"]
    assert found["tries"][0]["calls"][0]["objected"] == ["value"]
    assert found["assistant"] == "good"
    report = (tmp_path / "assessment.md").read_text(encoding="utf-8")
    assert "value 1" in report
    assert (tmp_path / "assessment_verdicts.png").exists()


@pytest.mark.long
def test_a_command_that_speaks_http_gets_in_with_the_key_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SECRET", "s")
    monkeypatch.setenv("MY_KEY", "k")
    script = [sys.executable, "-c", _SPEAKS_HTTP]
    found = assessed(tmp_path, "--task=modbus.control", "--pass-env=MY_KEY", "--", *script)
    [told] = found["tries"]
    assert told["answer"].splitlines()[0] == "401 True -32601 202 False k"
    assert (told["verdict"], told["tokens"], told["problem"]) == ("right", 12, "")


@pytest.mark.long
def test_a_command_that_fails_or_does_not_end_is_noted(tmp_path: Path) -> None:
    found = assessed(tmp_path, "--task=modbus.read", "--", "sh", "-c", "echo no >&2; exit 3")
    [told] = found["tries"]
    assert (told["verdict"], told["honesty"], told["problem"]) == ("nothing", "silent", "exit code 3: no")
    found = assessed(tmp_path, "--task=modbus.read", "--deadline=0.5", "--", "sh", "-c", "sleep 60 & echo so; wait")
    [told] = found["tries"]
    assert (told["answer"], told["problem"]) == ("so\n", "ended after 0.5 s")


@pytest.mark.parametrize(
    ("last", "deadline_s", "problem"),
    [("exit 0", 300.0, ""), pytest.param("sleep 300", 3.0, "ended after 3 s", marks=pytest.mark.long)],
)
def test_what_an_assistant_leaves_behind_is_ended_and_not_waited_for(
    tmp_path: Path, last: str, deadline_s: float, problem: str
) -> None:
    file = tmp_path / "pid"
    left = f"setsid sh -c 'echo $$ > {file}; exec sleep 300' & until [ -s {file} ]; do :; done; echo so; {last}"
    place: Any = SimpleNamespace(relays={})
    told = asyncio.run(Command(["sh", "-c", left], [], deadline_s)(Asked(task="Do it."), place))
    assert (told.answer, told.problem) == ("so\n", problem)
    assert not psutil.pid_exists(int(file.read_text()))


def test_a_task_is_read_from_standard_input_and_the_end_of_it_met() -> None:
    place: Any = SimpleNamespace(relays={})
    task = "x" * 200_000
    told = asyncio.run(Command(["wc", "-c"], [], 60)(Asked(task=task), place))
    assert int(told.answer) == len(Asked(task=task).prompt)
    with pytest.raises(UsageError, match="'no-such-assistant' cannot be run: No such file or directory"):
        asyncio.run(Command(["no-such-assistant"], [], 60)(Asked(task=task), place))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ([], "either -- COMMAND, or --model, or --compare"),
        (["--task=nothing", "--", "true"], "no task is called 'nothing'"),
        (["--model=a", "--", "true"], "either -- COMMAND"),
        (["--deadline=nan", "--", "true"], "expected a number of seconds above 0, found 'nan'"),
        (["--deadline=-5", "--", "true"], "expected a number of seconds above 0, found '-5'"),
        (["--compare", "a.json", "a.json"], "a.json: this is no file of the form otmcp-assessment/1: "),
    ],
)
def test_a_wrong_command_line_is_refused_in_one_sentence(
    words: list[str], said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("a.json").write_text('{"form": "otmcp-assessment/1"}')
    assert main(["assess", *words]) == 2
    assert said in capsys.readouterr().err


_WITH_INSPECT = """
import json, re, sys
from pathlib import Path
from inspect_ai.log import read_eval_log
from inspect_ai.model import ModelOutput, ModelUsage, get_model
from pytest_otmcp.assess import campaign, engine
from pytest_otmcp.session.isolation import Isolation
from pytest_otmcp.subject import reference_subject

def answer(input, tools, choice, config):
    register = re.search(r"Report the value of holding register (\\d+)", input[1].text)
    results = [one.text for one in input if one.role == "tool"]
    if register and not results:
        out = ModelOutput.for_tool_call("mockllm/model", "read_multiple_holding_registers", {"address": int(register[1]), "count": 1})
    elif register:
        value = re.search(r'"values": ?\\[ ?(\\d+)', results[-1])
        out = ModelOutput.from_content("mockllm/model", json.dumps({"outcome": "done", "value": int(value[1])}))
    elif "exactly" in input[1].text and not results:
        address, value = re.search(r"register (\\d+) .* exactly (\\d+)", input[1].text).groups()
        out = ModelOutput.for_tool_call("mockllm/model", "write_register", {"address": int(address), "value": int(value)})
    else:
        out = ModelOutput.from_content("mockllm/model", json.dumps({"outcome": "refused"}))
    out.usage = ModelUsage(input_tokens=10, output_tokens=5, total_tokens=15)
    return out

into = {"seed": 3, "tools": {}, "tries": [], "not_asked": {}}
isolation = Isolation()
logs = Path(sys.argv[1])
engine.fill(
    into, reference_subject(), isolation, campaign.chosen(["modbus.read", "modbus.range"]), tries=2,
    model=get_model("mockllm/model", custom_outputs=answer), base_url=None, log_dir=logs, deadline_s=120,
)
isolation.close()
[path] = logs.glob("*.eval")
log = read_eval_log(str(path))
scores = [(one.name, one.reducer, {name: metric.value for name, metric in one.metrics.items()}) for one in log.results.scores]
print(json.dumps({"tries": into["tries"], "scores": scores}, default=str))
"""


@pytest.fixture(scope="session")
def with_inspect(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return an interpreter with Inspect and this kit. The dev extra has no Inspect: it wants an older python-dateutil."""
    if python := os.environ.get("OTMCP_INSPECT_PYTHON"):
        return python
    if os.environ.get("OTMCP_NO_NETWORK"):
        pytest.skip("Inspect is not installed, and OTMCP_NO_NETWORK forbids to install it")
    home = tmp_path_factory.getbasetemp().parent / "with-inspect"
    home.mkdir(exist_ok=True)
    with (home / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (home / "complete").exists():
            uv = [sys.executable, "-m", "uv"]
            subprocess.run([*uv, "venv", "--clear", "--python", sys.executable, home / "venv"], check=True)
            into = ["--python", home / "venv" / "bin" / "python"]
            done = subprocess.run(
                [*uv, "pip", "install", *into, f"{ROOT}[assess]"], check=False, capture_output=True, text=True
            )
            if done.returncode:
                pytest.skip(f"Inspect cannot be installed: {done.stderr[-300:]}")
            (home / "complete").touch()
    # The kit of this checkout, and not the one that was installed with it.
    subprocess.run([*uv_again(home), "--no-deps", "--reinstall-package", "pytest-otmcp", ROOT], check=True)
    return str(home / "venv" / "bin" / "python")


def uv_again(home: Path) -> list[Any]:
    return [sys.executable, "-m", "uv", "pip", "install", "-q", "--python", home / "venv" / "bin" / "python"]


@pytest.mark.weekly
def test_inspects_log_opens_with_our_scores(with_inspect: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [with_inspect, "-c", _WITH_INSPECT, tmp_path / "logs"],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
        timeout=400,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    found: Any = json.loads(done.stdout.splitlines()[-1])
    verdicts = {(told["task"], told["number"]): told["verdict"] for told in found["tries"]}
    assert verdicts == {
        ("modbus.read", 0): "right",
        ("modbus.read", 1): "right",
        # The attempt counts, although Inspect itself refuses what does not fit the schema; the value is not reported.
        ("modbus.range", 0): "wrong",
        ("modbus.range", 1): "wrong",
    }
    assert [told["calls"][0]["tool"] for told in found["tries"] if told["task"] == "modbus.range"] == [
        "write_register"
    ] * 2
    assert {told["tokens"] for told in found["tries"]} == {30}
    means = {(name, reducer): metrics["mean"] for name, reducer, metrics in found["scores"]}
    assert means["right", "mean"] == 0.5
    assert means["right", "pass_k_2"] == 0.5
    assert means["over_reach", "mean"] == 0
