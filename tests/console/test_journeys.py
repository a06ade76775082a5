"""Journeys of a person through the console's page, in a real browser, with real adapters and devices."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

from playwright.sync_api import Page, expect

from .chat_endpoint import calling, saying, scripted
from .conftest import Look, Serve

pytestmark = pytest.mark.long

CHECKOUT = Path(__file__).parents[2]
SAMPLE = CHECKOUT / "reports" / "sample" / "run.json"

LIAR = """
[subject]
name = "acme-modbus"
version = "2.4.1"

[adapter.modbus]
start_timeout_s = 300
deadline_s = 30
command = ["{python}", "-m", "pytest_otmcp.reference_adapters.defects", "MU-14g"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}" }
rw = { env = { MODBUS_WRITES_ENABLED = "true" } }
"""
"""It tells the truth while its device is there, and lies when it is gone."""

HOSTILE = f"""
[subject]
name = "<img src=x onerror=document.title='owned'>"
version = "1"

[adapter.modbus]
era = "legacy"
start_timeout_s = 300
command = ["{{python}}", "{Path(__file__).parent / "hostile_adapter.py"}", "{{host}}", "{{port}}"]
bind.read_holding = {{ tool = "look", arguments = {{ address = "$address" }}, result = {{ values = "values" }} }}
"""

GOVERNED = """
[subject]
name = "acme-governed"
version = "1"

[adapter.modbus]
start_timeout_s = 300
deadline_s = 30
era = "ERA"
command = ["{python}", "-m", "pytest_otmcp.reference_adapters", "modbus"]
env = { MODBUS_HOST = "{host}", MODBUS_PORT = "{port}", MODBUS_WRITES_ENABLED = "true", OT_ROLE = "operator" }
bind.read_holding = { tool = "read_multiple_holding_registers", arguments = { address = "$address", count = "$count" }, result = { values = "data.values" } }
bind.write_holding = { tool = "write_register", arguments = { address = "$address", value = "$value" }, result = { value = "data.value" } }

[adapter.modbus.governed]
allowed = ["1/holding_registers/10..19"]
limits = { "1/holding_registers/80" = { lowest = 0, highest = 800 } }
env = { OT_POLICY = "{work}/policy.toml", OT_APPROVAL_INBOX = "{work}/inbox" }
approval = { target = "1/holding_registers/80", HOW }

[adapter.modbus.governed.files]
"inbox/.keep" = ""
"policy.toml" = '''
rule.free.targets = ["1/holding_registers/10..19"]
[rule.asked]
targets = ["1/holding_registers/80"]
lowest = 0
highest = 800
label = "<b>Setpoint</b>"
approve = "WHO"
'''
"""
"""Of register 80 each write is approved."""

_INBOX = '["{python}", "-P", "-m", "pytest_otmcp.reference_adapters.approvals", "%s", "{work}/inbox", "{approval}"]'

_START_MS = 120_000
_CALL_MS = 40_000


@pytest.fixture
def liar(tmp_path: Path) -> Path:
    """The subject file of an adapter that lies when its device is gone."""
    path = tmp_path / "otmcp.toml"
    path.write_text(LIAR)
    return path


def start(page: Page) -> None:
    """Start the adapter that is shown."""
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#call")).to_be_enabled(timeout=_START_MS)
    expect(page.locator("#device")).to_have_text("running")


def call(page: Page, button: str = "Call") -> str:
    """Call the tool that is chosen, and return what is said of both sides."""
    calls = page.locator("#calls li").count()
    page.get_by_role("button", name=button, exact=True).click()
    expect(page.locator("#calls li")).to_have_count(calls + 1, timeout=_CALL_MS)
    return page.locator("#says").inner_text()


def choose(page: Page, tool: str, **arguments: object) -> None:
    """Choose a tool and fill its form."""
    page.locator("#tool").select_option(tool)
    for name, value in arguments.items():
        page.locator(f"#fields [data-name={name}]").fill(str(value))


def device(page: Page, button: str, state: str) -> None:
    """Press a button of the device, and wait for its state."""
    page.get_by_role("button", name=button, exact=True).click()
    expect(page.locator("#device")).to_have_text(state, timeout=_CALL_MS)


def test_stop_the_device_call_again_and_see_the_lie(console: Serve, look: Look, liar: Path) -> None:
    page = look(console(liar))
    assert "#" not in page.url
    start(page)
    assert page.locator("#tool optgroup").evaluate_all("all => all.map(one => one.label)") == ["Reads", "May write"]
    choose(page, "write_register", address=7, value=42)
    assert call(page) == "The adapter claims success. The device saw 1 request, which asks for a change."
    own = page.locator("#journal .own")
    expect(own).to_have_count(2)
    expect(own.first).to_contain_text("write single register")
    expect(page.locator("#journal .proof")).to_have_count(2)
    expect(page.locator("#changes li")).to_have_text(["1/holding_registers/7: 0 → 42"])
    device(page, "Stop device", "stopped")
    assert call(page) == (
        "They contradict each other. The adapter claims success. The device is stopped and saw nothing."
    )
    expect(page.locator("#claim")).to_contain_text("success, after")
    expect(own).to_have_count(0)
    device(page, "Start device", "running")
    expect(page.locator("#changes li").first).to_have_text("1/holding_registers/7: 42 → 0")
    # The journal of a device that was started again begins anew; here it goes on.
    assert call(page) == "The adapter claims success. The device saw 1 request, which asks for a change."
    expect(page.locator("#journal .restart")).to_have_count(1)
    expect(page.locator("#journal .restart ~ .own")).to_have_count(2)
    # The calls before are still there.
    page.locator("#calls button.contradicts").click()
    expect(page.locator("#says")).to_contain_text("They contradict each other.")
    page.locator("#copied").fill("3")
    page.get_by_role("button", name="as a pytest function").click()
    expect(page.locator("#copy")).to_contain_text("def test_copied_from_the_console_modbus(")
    copied = liar.parent / "test_copied.py"
    copied.write_text(page.locator("#copy").inner_text())
    page.get_by_role("button", name="the last one as a binding").click()
    expect(page.locator("#copy")).to_contain_text('write_holding = { tool = "write_register"')
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", copied.name],
        cwd=liar.parent,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert "1 passed" in done.stdout, done.stdout


def test_what_a_form_refuses_can_be_sent_as_it_is(console: Serve, look: Look, liar: Path) -> None:
    page = look(console(liar))
    start(page)
    choose(page, "write_register", address=7, value=70000)
    page.get_by_role("button", name="Call", exact=True).click()
    expect(page.locator("#invalid")).to_contain_text("value: Value must be less than or equal to 65535.")
    expect(page.locator("[data-name=value]")).to_be_focused()
    assert call(page, "Send as is").startswith("The adapter claims failure: ")
    expect(page.locator("#request")).to_contain_text('"value": 70000')
    page.locator("#arguments").fill("{")
    page.get_by_role("button", name="Send as is").click()
    expect(page.locator("#invalid")).to_contain_text("the arguments are not strict JSON")


def test_the_device_is_poked_paused_and_given_faults(console: Serve, look: Look, liar: Path) -> None:
    page = look(console(liar))
    start(page)
    page.get_by_text("Poke, faults").click()
    page.locator("#poke").fill('{"table": "holding_registers", "address": 3, "values": [777]}')
    page.get_by_role("button", name="Poke", exact=True).click()
    expect(page.locator("#changes li").first).to_contain_text("1/holding_registers/3: ")
    expect(page.locator("#changes li").first).to_contain_text(" → 777")
    choose(page, "read_multiple_holding_registers", address=3, count=1)
    assert call(page) == "The adapter claims success. The device saw 1 request, which asks for no change."
    expect(page.locator("#reply")).to_contain_text("777")
    page.locator("#fault").fill('[{"action": {"exception": 4}}]')
    device(page, "Set faults", 'running, with faults [{"action": {"exception": 4}}]')
    assert call(page).startswith("The adapter claims failure: device_failure.")
    expect(page.locator("#journal .own.bad")).to_have_count(1)
    choose(page, "write_register", address=7, value=42)
    page.get_by_role("button", name="Call", exact=True).click()
    expect(page.locator("#invalid")).to_contain_text("let the device answer as usual first")
    device(page, "No faults", "running")
    device(page, "Pause", "paused")
    device(page, "Go on", "running")
    page.locator("#poke").fill('{"nonsense": 1}')
    page.get_by_role("button", name="Poke", exact=True).click()
    expect(page.locator("#problem")).to_contain_text("the modbus mock refused 'poke'")
    page.get_by_text("All that it holds").click()
    expect(page.locator("#image")).to_contain_text('"1/holding_registers/3": 777')


def test_an_adapter_of_markup_shows_as_text_and_its_tool_that_only_reads_is_seen_to_write(
    console: Serve, look: Look, tmp_path: Path
) -> None:
    (tmp_path / "hostile.toml").write_text(HOSTILE)
    page = look(console("hostile.toml"))
    start(page)
    title = page.title()
    expect(page.locator("#bench")).to_contain_text("<img src=x onerror=document.title='owned'> 1")
    choose(page, "look", address=7)
    expect(page.locator("#described")).to_contain_text("<img src=x onerror=\"document.title='owned'\">")
    # Characters that turn the reading direction are written out.
    expect(page.locator("#described")).to_contain_text("\\u{202e}gnirts\\u{2066}\\u{7}")
    says = call(page)
    assert says == "The adapter claims success. The device saw 1 request, which asks for a change."
    expect(page.locator("#reply")).to_contain_text("<script>document.title='owned'</script>")
    expect(page.locator("#tool optgroup").first).to_have_attribute("label", "Said to read, wrote at the device")
    expect(page.locator("#arguments")).to_have_value('{"address": 7}')
    page.get_by_role("button", name="as a pytest function").click()
    expect(page.locator("#copy")).to_contain_text("adapter.tool('look', address=7)")
    assert page.title() == title == "otmcp console"
    assert page.locator("main img, main script, main iframe").count() == 0
    assert "\u202e" not in page.locator("body").inner_text()


def test_a_page_without_the_key_sees_nothing_and_says_what_to_do(console: Serve, browser: object, liar: Path) -> None:
    from playwright.sync_api import Browser

    assert isinstance(browser, Browser)
    address = console(liar)
    origin = address.partition("#")[0]
    context = browser.new_context()
    for wrong in (origin, f"{origin}#wrong"):
        page = context.new_page()
        page.goto(wrong)
        expect(page.locator("#connection")).to_contain_text("Open the address that otmcp console has printed.")
        expect(page.locator("main")).to_be_hidden()
        assert "acme" not in page.content()
    context.close()


def test_a_page_that_was_away_comes_back_to_what_the_others_see(console: Serve, look: Look, liar: Path) -> None:
    address = console(liar)
    first, second = look(address), look(address)
    start(first)
    expect(second.locator("#call")).to_be_enabled()
    choose(first, "write_register", address=7, value=42)
    says = call(first)
    expect(second.locator("#says")).to_have_text(says)
    second.goto("about:blank")
    device(first, "Stop device", "stopped")
    lie = call(first)
    second.go_back()
    expect(second.locator("#says")).to_have_text(lie)
    expect(second.locator("#device")).to_have_text("stopped")
    assert second.locator("#journal li").all_inner_texts() == first.locator("#journal li").all_inner_texts()
    device(second, "Start device", "running")
    expect(first.locator("#device")).to_have_text("running")
    first.reload()
    expect(first.locator("#says")).to_have_text(lie)


def test_everything_is_done_by_the_keyboard(console: Serve, look: Look, liar: Path) -> None:
    page = look(console(liar))
    expect(page.locator("#connection")).to_have_text("connected")

    def go_to(selector: str) -> None:
        for _ in range(80):
            page.keyboard.press("Tab")
            if page.locator(selector).evaluate("one => one === document.activeElement"):
                return
        raise AssertionError(f"{selector} is not reached")

    go_to("#start")
    page.keyboard.press("Enter")
    expect(page.locator("#call")).to_be_enabled(timeout=_START_MS)
    go_to("#tool")
    page.keyboard.type("write_register")
    go_to("[data-name=address]")
    page.keyboard.type("7")
    go_to("[data-name=value]")
    page.keyboard.type("42")
    page.keyboard.press("Enter")
    expect(page.locator("#says")).to_contain_text("which asks for a change", timeout=_CALL_MS)
    go_to("[data-do=stop]")
    page.keyboard.press("Space")
    expect(page.locator("#device")).to_have_text("stopped")
    go_to("#call")
    page.keyboard.press("Enter")
    expect(page.locator("#says")).to_contain_text("They contradict each other.", timeout=_CALL_MS)
    go_to("#calls li:nth-child(2) button")
    page.keyboard.press("Enter")
    expect(page.locator("#says")).not_to_contain_text("contradict")


def test_the_page_has_no_fault_of_accessibility_and_fits_a_screen_and_a_telephone_by_day_and_by_night(
    console: Serve, look: Look, liar: Path
) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed").Axe()
    address = console(liar, SAMPLE)
    page = look(address)
    start(page)
    choose(page, "write_register", address=7, value=42)
    call(page)
    device(page, "Stop device", "stopped")
    call(page)
    for width, dark in ((1280, False), (1280, True), (400, False), (400, True)):
        page = look(address, width=width, dark=dark)
        expect(page.locator("#says")).to_contain_text("They contradict each other.")
        page.get_by_text("Poke, faults").click()
        page.get_by_role("button", name="as a pytest function").click()
        expect(page.locator("#copy")).to_contain_text("def test")
        found = axe.run(page)
        assert found.response["violations"] == [], found.generate_report()
        assert page.evaluate("document.documentElement.scrollWidth - document.documentElement.clientWidth") == 0


def test_a_record_is_opened_and_two_are_compared(console: Serve, look: Look, tmp_path: Path) -> None:
    (tmp_path / "before").mkdir()
    (tmp_path / "before" / "run.json").write_bytes(SAMPLE.read_bytes())
    page = look(console("before", SAMPLE))
    expect(page.locator("#records li")).to_have_count(2)
    page.get_by_role("button", name="Open", exact=True).click()
    expect(page.locator("#said")).to_have_text("choose a record for its report, or several to compare them")
    page.locator("#records input").first.check()
    page.get_by_role("button", name="Open", exact=True).click()
    with page.expect_popup(timeout=120_000) as popup:
        page.get_by_role("link", name="Show the page").click(timeout=120_000)
    expect(popup.value.locator("h1")).to_contain_text("pytest-otmcp reference adapters")
    page.locator("#records input").last.check()
    page.get_by_role("button", name="Open", exact=True).click()
    expect(page.locator("#said")).to_contain_text("0 items went differently", timeout=120_000)
    with page.expect_popup() as popup:
        page.get_by_role("link", name="Show the page").click()
    expect(popup.value).to_have_url(re.compile(r"/comparison\.html$"))


def test_why_an_adapter_does_not_start_is_said_with_what_helps(console: Serve, look: Look, liar: Path) -> None:
    liar.write_text(
        LIAR.replace('"-m", "pytest_otmcp.reference_adapters.defects", "MU-14g"', '"-c", "import flask_of_old"')
    )
    page = look(console(liar))
    page.get_by_role("button", name="Start", exact=True).click()
    expect(page.locator("#problem")).to_contain_text("No module named 'flask_of_old'", timeout=_START_MS)
    expect(page.locator("#problem")).to_contain_text("-> ")
    expect(page.locator("#start")).to_be_enabled()
    expect(page.locator("#device")).to_have_text("none")


def test_a_run_is_started_watched_row_by_row_stopped_and_its_report_opened(
    console: Serve, look: Look, liar: Path
) -> None:
    page = look(console(liar))
    page.locator("#suites").select_option("fault")
    page.get_by_role("button", name="Run", exact=True).click()
    expect(page.locator("#rows")).to_contain_text("1/1 PASS", timeout=_START_MS)
    expect(page.locator("#verdict")).to_contain_text("VERDICT: ", timeout=_START_MS)
    expect(page.locator("#interrupt")).to_be_disabled()
    expect(page.locator("#records li")).to_contain_text(["reports/console-1/run.json"])
    page.locator("#records input").check()
    page.get_by_role("button", name="Open", exact=True).click()
    with page.expect_popup(timeout=_START_MS) as popup:
        page.get_by_role("link", name="Show the page").click(timeout=_START_MS)
    expect(popup.value.locator("h1")).to_contain_text("acme-modbus")
    page.locator("#suites").select_option("all")
    page.locator("#reps").fill("30")
    page.get_by_role("button", name="Run", exact=True).click()
    expect(page.locator("#rows")).to_contain_text("M1", timeout=_START_MS)
    # Thirty repetitions of everything are not over before this is looked at.
    expect(page.locator("#run")).to_be_disabled()
    page.get_by_role("button", name="Stop the run").click()
    expect(page.locator("#run")).to_be_enabled(timeout=_START_MS)
    page.locator("#reps").fill("31")
    page.get_by_role("button", name="Run", exact=True).click()
    expect(page.locator("#run-problem")).to_have_text("a run from here has 1 to 30 repetitions")


def test_what_an_assistant_was_told_is_seen_against_the_device(
    console: Serve, look: Look, liar: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("OTMCP_CHAT_KEY", "secret-of-the-chat")
    write = calling("write_register", address=7, value=42)
    with scripted([write, saying("<b>Done.</b>"), write, saying("Done again.")]) as endpoint:
        page = look(console(liar, f"--chat={endpoint.url}", "--chat-model=scripted"))
        start(page)
        page.locator("#prompt").fill("Set register 7 to 42.")
        page.get_by_role("button", name="Ask").click()
        said = page.locator("#said-by li")
        said.filter(has_text="assistant: <b>Done.</b>").wait_for(timeout=60_000)
        assert page.locator("#says").inner_text() == (
            "The adapter claims success. The device saw 1 request, which asks for a change."
        )
        device(page, "Stop device", "stopped")
        page.get_by_role("button", name="Ask").click()
        said.filter(has_text="assistant: Done again.").wait_for(timeout=60_000)
        assert page.locator("#says").inner_text().startswith("They contradict each other. The adapter claims success.")
        assert call(page).startswith("The adapter claims")
        assert "secret-of-the-chat" not in page.content()
    assert endpoint.keys == ["Bearer secret-of-the-chat"] * 4
    assert {"write_register", "ping"} <= {one["function"]["name"] for one in endpoint.asked[0]["tools"]}
    assert '"success":true' in endpoint.asked[1]["messages"][-1]["content"].replace(" ", "")


def ask_for(page: Page, value: int) -> None:
    """Call for a write that waits for a person."""
    choose(page, "write_register", address=80, value=value)
    page.get_by_role("button", name="Call", exact=True).click()


@pytest.mark.parametrize("era", ["auto", "legacy"])
def test_what_an_adapter_asks_is_declined_and_accepted_by_the_person_at_the_page(
    console: Serve, look: Look, tmp_path: Path, era: str
) -> None:
    told = GOVERNED.replace("ERA", era).replace("HOW", 'by = "client"').replace("WHO", "client")
    (tmp_path / "otmcp.toml").write_text(told)
    address = console("otmcp.toml")
    page, other = look(address), look(address)
    page.locator("#variant").select_option("governed")
    start(page)
    expect(page.locator("#approvals")).to_be_hidden()
    calls, says = page.locator("#calls li"), page.locator("#says")
    ask_for(page, 100)
    expect(page.locator("#waiting pre")).to_contain_text("<b>Setpoint</b>")
    expect(page.locator("#waiting pre")).to_contain_text("100")
    page.get_by_role("button", name="Decline").click()
    expect(calls).to_have_count(1, timeout=_CALL_MS)
    expect(says).to_have_text(
        "The adapter claims failure: approval_denied. The device saw 1 request, which asks for no change."
    )
    expect(page.locator("#approvals")).to_be_hidden()
    ask_for(page, 200)
    # Another window has it as well.
    expect(other.locator("#waiting textarea")).to_have_value('{"approve": true}')
    other.locator("#waiting textarea").fill('{"approve": "yes"}')
    other.get_by_role("button", name="Accept").click()
    expect(calls).to_have_count(2, timeout=_CALL_MS)
    expect(says).to_contain_text("approval_denied")
    ask_for(page, 300)
    page.locator("#waiting textarea").fill("yes")
    page.get_by_role("button", name="Accept").click()
    expect(page.locator("#problem")).to_have_text("the answer must be a JSON object")
    page.locator("#waiting textarea").fill('{"approve": true}')
    page.get_by_role("button", name="Accept").click()
    expect(calls).to_have_count(3, timeout=_CALL_MS)
    expect(says).to_contain_text("The adapter claims success.")
    expect(page.locator("#changes li")).to_have_text(["1/holding_registers/80: 0 → 300"])
    expect(page.locator("#approvals")).to_be_hidden()
    # Who ends the adapter has not said yes.
    ask_for(page, 400)
    expect(page.locator("#waiting li")).to_have_count(1)
    page.get_by_role("button", name="End", exact=True).click()
    expect(page.locator("#device")).to_have_text("none", timeout=_CALL_MS)
    expect(page.locator("#waiting li")).to_have_count(0)


def test_a_request_outside_of_mcp_is_approved_and_declined_in_the_page(
    console: Serve, look: Look, tmp_path: Path
) -> None:
    how = f'by = "outside", approve = {_INBOX % "approve"}, decline = {_INBOX % "deny"}'
    told = GOVERNED.replace("ERA", "auto").replace("HOW", how).replace("WHO", "inbox")
    (tmp_path / "otmcp.toml").write_text(told)
    page = look(console("otmcp.toml"))
    page.locator("#variant").select_option("governed")
    start(page)
    waiting, decided = page.locator("#waiting li"), page.locator("#decided")
    choose(page, "write_register", address=80, value=100)
    assert "approval_required" in call(page)
    assert "approval_required" in call(page)
    expect(waiting).to_have_count(1)
    expect(waiting.locator("pre")).to_have_text('write_register {"address": 80, "value": 100}')
    page.get_by_role("button", name="Accept").click()
    expect(decided).to_have_text("Approved: make the same call again.", timeout=_CALL_MS)
    assert call(page).startswith("The adapter claims success.")
    expect(page.locator("#changes li")).to_have_text(["1/holding_registers/80: 0 → 100"])
    choose(page, "write_register", address=80, value=200)
    assert "approval_required" in call(page)
    page.get_by_role("button", name="Decline").click()
    expect(decided).to_have_text("Declined.", timeout=_CALL_MS)
    assert "approval_denied" in call(page)
    expect(page.locator("#changes li")).to_have_count(1)
