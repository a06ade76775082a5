// The page of the console. What an adapter or a device says is shown by textContent alone, after plain(): it never becomes markup,
// and no character in it turns the reading direction.
const $ = (id) => document.getElementById(id);
const KEY = "otmcp";
const MOST_ROWS = 500;
const RETRY_MS = 1000;

const plain = (text) =>
  String(text ?? "").replace(/[^\P{C}\n]|[\u2028\u2029]/gu, (c) => `\\u{${c.codePointAt(0).toString(16)}}`);
const show = (node, text) => { node.textContent = plain(text); };
const made = (name, text, kind) => {
  const node = document.createElement(name);
  if (text !== undefined) show(node, text);
  if (kind) node.className = kind;
  return node;
};
const seconds = (ms) => ((ms - began) / 1000).toFixed(3);

// The token comes in the fragment, which is never sent. It stays in the storage of this tab, which other ports cannot read.
if (location.hash.length > 1) {
  sessionStorage.setItem(KEY, location.hash.slice(1));
  history.replaceState(null, "", "/");
}
const token = sessionStorage.getItem(KEY) ?? "";
const headers = { Authorization: `Bearer ${token}` };

const benches = new Map();
let chosen = 0; // the adapter that is shown
let records = [];
let began = 0; // when the console was started, on the clock of all times here

async function post(path, asked) {
  let answer;
  try {
    answer = await fetch(`/api/${path}`, {
      method: "POST",
      headers: { ...headers, "Content-Type": "application/json" },
      body: JSON.stringify(asked),
    });
  } catch {
    return { problem: "The console does not answer." };
  }
  return answer.headers.get("content-type") === "application/json" ? answer.json() : { problem: `refused: ${answer.status}` };
}

// -- events ---------------------------------------------------------------------------------------------------------

const fresh = (state) => ({ state, rows: [], changes: [], calls: [], shown: 0, tool: "" });

function take(event) {
  const bench = benches.get(event.bench);
  switch (event.kind) {
    case "console":
      benches.clear();
      began = event.began_ms;
      return;
    case "records":
      records = event.records;
      drawRecords();
      return;
    case "run":
      drawRun(event);
      return;
    case "assistant":
      drawAssistant(event);
      return;
    case "line":
      drawLines([event.line]);
      return;
    case "ready":
      show($("connection"), "connected");
      $("main").hidden = false;
      drawBenches();
      return;
    case "lost":
      show($("connection"), `this page was too slow: ${event.count} events are missing; load it again`);
      return;
    case "bench":
      if (bench) bench.state = event;
      else benches.set(event.bench, fresh(event));
      break;
    case "new":
      benches.set(event.bench, fresh(bench.state));
      break;
    case "rows":
      bench.rows.push(...event.rows);
      bench.rows.splice(0, bench.rows.length - MOST_ROWS);
      break;
    case "image":
      bench.changes.push(...event.changed);
      bench.changes.splice(0, bench.changes.length - MOST_ROWS);
      break;
    case "call":
      bench.calls.push(event);
      bench.shown = event.call;
      break;
  }
  if (event.bench === chosen && !$("main").hidden) draw(event);
}

async function follow() {
  for (;;) {
    try {
      const answer = await fetch("/api/events", { headers });
      if (answer.status === 401) {
        show($("connection"), "This page has no key, or an old one. Open the address that otmcp console has printed.");
        return;
      }
      const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
      for (let rest = ""; ; ) {
        const { value, done } = await reader.read();
        if (done) break;
        const lines = (rest + value).split("\n");
        rest = lines.pop();
        for (const line of lines) take(JSON.parse(line));
      }
    } catch { /* the console has ended, or is about to be back */ }
    show($("connection"), "The console does not answer; trying again …");
    await new Promise((later) => setTimeout(later, RETRY_MS));
  }
}

// -- drawing --------------------------------------------------------------------------------------------------------

const here = () => benches.get(chosen);

function draw(event) {
  if (event.kind === "rows") return drawRows(event.rows);
  if (event.kind === "image") return drawChanges(event.changed);
  if (event.kind === "call") return drawCall();
  drawBench();
  if (event.kind === "new") drawAll();
}

function drawBenches() {
  $("bench").replaceChildren(...[...benches.values()].map(({ state }) => new Option(plain(state.name), state.bench)));
  $("bench").closest("section").hidden = benches.size === 0;
  for (const part of [".try", ".seen"]) document.querySelector(part).hidden = benches.size === 0;
  $("h-copy").parentElement.hidden = benches.size === 0;
  if (!benches.has(chosen)) chosen = 0;
  if (!benches.size) return;
  $("bench").value = String(chosen);
  drawAll();
}

function drawAll() {
  $("journal").replaceChildren();
  $("changes").replaceChildren();
  $("tool").replaceChildren();
  $("variant").replaceChildren();
  $("poke").value = $("fault").value = "";
  show($("decided"), "");
  drawBench();
  drawRows(here().rows);
  drawChanges(here().changes);
  drawCall();
}

function drawBench() {
  const { state } = here();
  show($("source"), `${state.source}: ${state.command}`);
  show($("problem"), state.problem);
  if (!$("variant").options.length) $("variant").append(...state.variants.map((name) => new Option(name)));
  if (state.started) $("variant").value = state.variant;
  $("variant").disabled = state.started;
  $("start").disabled = state.started;
  $("end").disabled = !state.started && state.device === "none";
  $("call").disabled = $("as-is").disabled = !state.started;
  const faults = state.faults ? `, with faults ${state.faults}` : "";
  show($("device"), `${state.device === "running" && state.network !== "open" ? "paused" : state.device}${faults}`);
  $("device").dataset.state = state.device;
  const possible = { stop: state.device === "running", start: state.device === "stopped" };
  for (const button of document.querySelectorAll("[data-do]"))
    button.disabled = !(possible[button.dataset.do] ?? state.device === "running");
  if (!$("poke").value && state.poke !== "{}") $("poke").value = state.poke;
  if (!$("fault").value) $("fault").value = state.rules;
  drawTools();
  drawApprovals();
}

// An answer that is being edited stays as long as the same requests wait.
function drawApprovals() {
  const waiting = here().state.approvals;
  const told = JSON.stringify([chosen, waiting]);
  if ($("waiting").dataset.told === told) return;
  $("waiting").dataset.told = told;
  if (waiting.length) show($("decided"), "");
  $("waiting").replaceChildren(...waiting.map(request));
  $("approvals").hidden = !waiting.length && !$("decided").textContent;
}

function request(one) {
  const item = made("li");
  item.append(made("p", one.outside ? `Request ${one.outside}, outside of MCP` : "The adapter asks its client", "soft"));
  const text = made("pre", one.text);
  text.tabIndex = 0;
  text.ariaLabel = "What is to be decided";
  item.append(text);
  const answer = made("textarea", one.content);
  answer.rows = 1;
  answer.spellcheck = false;
  if (one.content !== null) {
    const label = made("label", "Answer of a yes, as it is sent ");
    label.append(answer);
    item.append(label);
  }
  for (const [name, what] of [["Accept", "accept"], ["Decline", "decline"]]) {
    const button = made("button", name);
    button.type = "button";
    button.addEventListener("click", async () => {
      const asked = { bench: chosen, number: one.number, do: what, content: answer.value };
      const { said } = await busy(button, () => post("decide", asked), $("problem"));
      if (!said) return;
      show($("decided"), said);
      $("approvals").hidden = false;
    });
    item.append(button);
  }
  return item;
}

const kind = (tool) => (tool.wrote && !tool.writes ? "Said to read, wrote at the device" : tool.writes ? "May write" : "Reads");

function drawTools() {
  const bench = here();
  const told = JSON.stringify(bench.state.tools.map((tool) => [tool.name, kind(tool)]));
  if ($("tool").dataset.told === told && $("tool").options.length) return;
  $("tool").dataset.told = told;
  const groups = Map.groupBy(bench.state.tools, kind);
  $("tool").replaceChildren(
    ...["Said to read, wrote at the device", "Reads", "May write"].filter((name) => groups.has(name)).map((name) => {
      const group = made("optgroup");
      group.label = name;
      group.append(...groups.get(name).map((tool) => new Option(plain(tool.name), tool.name)));
      return group;
    }),
  );
  if (bench.state.tools.some((tool) => tool.name === bench.tool)) $("tool").value = bench.tool;
  drawForm();
}

const tool = () => here().state.tools.find((one) => one.name === $("tool").value);

function drawForm() {
  const one = tool();
  here().tool = one?.name ?? "";
  $("mark").className = `soft mark ${one ? (one.writes || one.wrote ? "writes" : "reads") : ""}`;
  show($("mark"), one ? `${kind(one)} (${one.by})` : "Start the adapter to see its tools.");
  show($("described"), one?.description);
  // A form that is filled in stays so when its tool only moves to another group.
  const told = JSON.stringify([one?.name, one?.fields]);
  if ($("fields").dataset.told === told) return;
  $("fields").dataset.told = told;
  $("fields").replaceChildren(...(one?.fields ?? []).map(field));
  show($("invalid"), "");
  fill();
}

function field(one) {
  const label = made("label", `${one.name}${one.required ? "" : " (optional)"}`);
  let input;
  if (one.kind === "boolean" || one.kind === "choice") {
    input = made("select");
    const choices = one.kind === "boolean" ? ["true", "false"] : one.choices;
    input.append(...(one.required ? [] : [new Option("left out", "")]), ...choices.map((text) => new Option(plain(text), text)));
  } else if (one.kind === "json") {
    input = made("textarea");
    input.rows = 2;
    input.placeholder = "JSON";
  } else {
    input = made("input");
    input.type = one.kind === "text" ? "text" : "number";
    if (one.kind !== "text") input.step = one.kind === "integer" ? "1" : "any";
    for (const [name, bound] of Object.entries({ min: one.lowest, max: one.highest, minLength: one.shortest, maxLength: one.longest }))
      if (bound !== null) input.setAttribute(name, bound);
  }
  input.required = one.required;
  input.dataset.name = one.name;
  input.dataset.kind = one.kind;
  if (one.default && "placeholder" in input) input.placeholder = plain(`left out: ${one.default}`);
  input.addEventListener("input", fill);
  label.append(input);
  if (one.description) label.append(made("small", one.description));
  return label;
}

// Numbers go as they were typed: a browser would round those of more than 53 bits.
const written = (input) => (input.dataset.kind === "text" ? JSON.stringify(input.value) : input.value);

function fill() {
  const given = [...$("fields").querySelectorAll("[data-name]")].filter((input) => input.value !== "");
  $("arguments").value = `{${given.map((input) => `${JSON.stringify(input.dataset.name)}: ${written(input)}`).join(", ")}}`;
}

function drawRows(rows) {
  const list = $("journal");
  const whose = owners();
  const atEnd = list.scrollTop + list.clientHeight >= list.scrollHeight - 4;
  for (const row of rows) {
    const previous = list.lastElementChild?.dataset.generation;
    if (previous !== undefined && previous !== String(row.generation)) {
      const restart = made("li", "the device was started again", "restart");
      restart.dataset.generation = row.generation;
      list.append(restart);
    }
    const foreign = row.origin === "client" ? "" : ` (${row.origin})`;
    const item = made("li");
    item.append(made("time", seconds(row.at_ms)), made("b", ` ${row.towards ? "→" : "←"} ${row.what}${foreign} `), made("span", row.text));
    if (row.changes) item.append(made("em", " asks for a change"));
    item.dataset.name = row.name;
    item.dataset.generation = row.generation;
    item.classList.toggle("changes", row.changes);
    item.classList.toggle("bad", row.bad);
    mark(item, whose);
    list.append(item);
  }
  while (list.children.length > MOST_ROWS) list.firstElementChild.remove();
  if (atEnd) list.scrollTop = list.scrollHeight;
}

// The rows of the call that is shown, and those by which the console made sure, before a write, that the adapter talks to this device.
const owners = () => ({
  own: new Set(shownCall()?.own),
  proof: new Set(here().calls.flatMap((call) => call.proof)),
});

function mark(item, { own, proof }) {
  const name = item.dataset.name;
  item.classList.toggle("own", own.has(name));
  item.classList.toggle("proof", proof.has(name));
  item.querySelector(".whose")?.remove();
  if (own.has(name)) item.append(made("span", " (of this call)", "whose unseen"));
  if (proof.has(name)) item.append(made("span", " (asked by the console before a write)", "whose"));
}

function drawChanges(changed) {
  const list = $("changes");
  for (const one of changed) list.prepend(made("li", one));
  while (list.children.length > MOST_ROWS) list.lastElementChild.remove();
  if ($("all").open && changed.length) drawImage();
}

async function drawImage() {
  const { text, problem } = await post("image", { bench: chosen });
  show($("image"), text ?? problem);
}

const shownCall = () => here().calls.find((call) => call.call === here().shown);

function drawCall() {
  const bench = here();
  $("calls").replaceChildren(
    ...bench.calls.toReversed().map((call) => {
      const button = made("button", `${call.tool} ${call.arguments}: ${call.claim}`);
      button.type = "button";
      button.setAttribute("aria-current", call.call === bench.shown);
      button.classList.toggle("contradicts", call.contradicts);
      button.addEventListener("click", () => { bench.shown = call.call; drawCall(); });
      const item = made("li");
      item.append(button);
      return item;
    }),
  );
  const call = shownCall();
  $("says").classList.toggle("contradicts", call?.contradicts ?? false);
  show($("says"), call ? `${call.contradicts ? "They contradict each other. " : ""}${call.says}` : "No call yet.");
  show($("claim"), call && `${call.claim}${call.latency_ms === null ? "" : `, after ${call.latency_ms.toFixed(2)} ms`}`);
  $("claim").dataset.success = call?.success ?? "";
  show($("reply"), call?.reply);
  show($("text"), call?.text);
  show($("h-request"), call ? `Request, at ${seconds(call.at_ms)} s` : "Request");
  show($("h-response"), call?.latency_ms != null ? `Response, at ${seconds(call.at_ms + call.latency_ms)} s` : "Response");
  show($("request"), call?.request);
  show($("response"), call?.response);
  const whose = owners();
  for (const item of $("journal").children) mark(item, whose);
  $("journal").querySelector(".own")?.scrollIntoView({ block: "nearest" });
}

function drawRecords() {
  $("none").hidden = records.length > 0;
  $("records-box").hidden = records.length === 0;
  $("records").replaceChildren(
    ...records.map(({ record, name, written: when }) => {
      const label = made("label");
      const box = made("input");
      box.type = "checkbox";
      box.value = record;
      label.append(box, made("span", ` ${name} ${when ? `(${when})` : "(gone)"}`));
      const item = made("li");
      item.append(label);
      return item;
    }),
  );
}

function drawRun({ subjects, suites, running, lines }) {
  $("suite").hidden = subjects.length === 0;
  if (!$("subject").options.length) {
    $("subject").append(...subjects.map((name, number) => new Option(plain(name), number)));
    $("suites").append(...suites.map((name) => new Option(name)), new Option("all", suites.join(",")));
  }
  $("run").disabled = running;
  $("interrupt").disabled = !running;
  $("rows").replaceChildren();
  show($("verdict"), "");
  drawLines(lines);
}

function drawAssistant({ where, said }) {
  $("assistant").hidden = !where;
  show($("where"), `${where} gets the tools of the adapter above. Its calls show up there like any other.`);
  $("said-by").replaceChildren(
    ...said.map(({ who, text }) => {
      const item = made("li");
      item.append(made("b", `${who}: `), made("span", text));
      return item;
    }),
  );
}

function drawLines(lines) {
  const rows = $("rows");
  const atEnd = rows.scrollTop + rows.clientHeight >= rows.scrollHeight - 4;
  for (const line of lines) {
    rows.append(`${plain(line)}\n`);
    // A line that repeats an adapter's words never begins like this.
    if (line.startsWith("VERDICT: ")) {
      show($("verdict"), line);
      $("verdict").classList.toggle("contradicts", line.startsWith("VERDICT: NOT"));
    }
  }
  if (atEnd) rows.scrollTop = rows.scrollHeight;
}

// -- what a person does ---------------------------------------------------------------------------------------------

const busy = async (button, work, problem) => {
  button.setAttribute("aria-busy", "true");
  show(problem, "");
  const answer = await work();
  button.removeAttribute("aria-busy");
  if (answer.problem) show(problem, answer.problem);
  return answer;
};

$("bench").addEventListener("change", () => { chosen = Number($("bench").value); drawAll(); });
$("tool").addEventListener("change", drawForm);
for (const [id, what] of [["start", "start"], ["end", "stop"]])
  $(id).addEventListener("click", () =>
    busy($(id), () => post("adapter", { bench: chosen, do: what, variant: $("variant").value }), $("problem")));

const call = (button) =>
  busy(button, () => post("call", { bench: chosen, tool: $("tool").value, arguments: $("arguments").value }), $("invalid"));
$("form").addEventListener("submit", (event) => {
  event.preventDefault();
  const wrong = [...$("fields").querySelectorAll("[data-name]")].find((input) => !input.checkValidity());
  if (wrong) {
    show($("invalid"), `${wrong.dataset.name}: ${wrong.validationMessage} "Send as is" sends it nevertheless.`);
    wrong.focus();
    return;
  }
  call($("call"));
});
$("as-is").addEventListener("click", () => call($("as-is")));

for (const button of document.querySelectorAll("[data-do]"))
  button.addEventListener("click", () => {
    const what = button.dataset.do;
    let value = null;
    try {
      if (what === "no-fault") value = [];
      if (what === "poke" || what === "fault") value = JSON.parse($(what).value);
    } catch {
      show($("problem"), "This is not JSON.");
      return;
    }
    busy(button, () => post("device", { bench: chosen, do: what === "no-fault" ? "fault" : what, value }), $("problem"));
  });
$("all").addEventListener("toggle", () => { if ($("all").open) drawImage(); });

for (const button of document.querySelectorAll("[data-copy]"))
  button.addEventListener("click", async () => {
    const asked = { bench: chosen, form: button.dataset.copy, calls: Number($("copied").value) };
    const { text, problem } = await post("copy", asked);
    show($("copy"), text ?? problem);
    if (text) await navigator.clipboard.writeText(text).catch(() => {});
  });

$("run").addEventListener("click", () => {
  const asked = { do: "start", subject: Number($("subject").value), suites: $("suites").value.split(","), reps: Number($("reps").value) };
  busy($("run"), () => post("run", asked), $("run-problem"));
});
$("interrupt").addEventListener("click", () => busy($("interrupt"), () => post("run", { do: "stop" }), $("run-problem")));

$("ask").addEventListener("click", () =>
  busy($("ask"), () => post("ask", { bench: chosen, prompt: $("prompt").value }), $("ask-problem")));

$("open").addEventListener("click", async () => {
  const numbers = [...$("records").querySelectorAll(":checked")].map((box) => Number(box.value));
  $("report").hidden = true;
  const { said, page } = await busy($("open"), () => post("report", { records: numbers }), $("said"));
  if (!page) return;
  show($("said"), said.join("\n"));
  $("report").href = page;
  $("report").hidden = false;
  $("report").focus();
});

follow();
