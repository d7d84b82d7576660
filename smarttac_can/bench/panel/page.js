"use strict";
// What a person reads and does: readings, controls, and files to save.

const NEAR = .8;                         // share of a limit from which a reading is near it
const OFF = .1, HELD_S = 1, MEAN_S = 2, GROWN_S = 10;
const RATE = 1000, BUS_LOAD = .5;        // cycles per second that are due; share of a bus that is much
const NUDGE_MM = 1;                      // of the finger, by an arrow key
const STEPS = "With nothing on the plate: Tare, then Identify. A mode arms by itself. " +
  "To calibrate with weights: smarttac calibrate, in a terminal.";
const between = (low, high) => low === undefined ? "" : `limits ${low.toFixed(0)} to ${high.toFixed(0)}`;
const atMost = (limit, digits = 0) => limit === undefined ? "" : `limit ${limit.toFixed(digits)}`;
// Each reading: its object, digits, what is asked for in a mode, and its limit.
const CHANNELS = [
  {title: "COF", object: "Contact.COF", digits: 3,
    asked: values => values["Contact.COF reference"],
    limit: values => askedCof(values).length ?
      `left ${shown(values["Setpoint.COF left"], 2)}, right ${shown(values["Setpoint.COF right"], 2)}` : ""},
  {title: "Amplitude", object: "Vibration.Amplitude", unit: "µm", digits: 3, most: "Limit.Amplitude",
    asked: (values, mode) => mode.startsWith("amplitude") ? values["Setpoint.Amplitude"] : undefined,
    limit: values => atMost(values["Limit.Amplitude"], 1)},
  {title: "Voltage", object: "Vibration.Voltage", unit: "V", digits: 1, most: "Limit.Voltage",
    asked: (values, mode) => mode === "open loop" ? values["Setpoint.Voltage"] : undefined,
    limit: values => atMost(values["Limit.Voltage"])},
  {title: "Frequency", object: "Vibration.Frequency", unit: "Hz", digits: 0,
    asked: (values, mode) => mode === "open loop" || mode === "amplitude" ? values["Setpoint.Frequency"] : undefined,
    limit: values => between(values["Limit.Lowest frequency"], values["Limit.Highest frequency"])},
  {title: "Normal force", object: "Contact.Normal force", unit: "N", digits: 2, most: "Limit.Normal force",
    limit: values => atMost(values["Limit.Normal force"], 1)},
  {title: "Tangential force", object: "Contact.Tangential force", unit: "N", digits: 2, most: "Limit.Lateral force",
    limit: values => atMost(values["Limit.Lateral force"], 1)},
  {title: "Temperature", object: "Plate temperature", unit: "°C", digits: 1, most: "Limit.Temperature",
    limit: values => atMost(values["Limit.Temperature"])},
];

let sentFinger = "", marks = 0;
const limitedAt = {};                    // by object: the words of its limit, and when it was last in the way

const fill = (id, children) => $(id).replaceChildren(...children);
const capital = name => name.replace("cof", "COF").replace(/^pi$/, "PI").replaceAll("_", " ").replace(/^./, letter => letter.toUpperCase());

function made(tag, properties, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

const button = (text, act) => made("button", {textContent: text, onclick: act});

function introduce() {
  write("where", about.where);
  $("stop").hidden = $("drive").hidden = !about.drives || !token;
  $("finger").hidden = $("breaking").hidden = !about.simulated;
  $("plate").setAttribute("aria-label", "Plate with the finger, COF over position" +
    (about.simulated ? ". Arrow keys: move the finger, press less and more; Escape: lift it" : ""));
  fill("modes", about.modes.map(mode => button(mode, () => line(`mode ${mode.replaceAll(" ", "_")}`))));
  for (const [id, laws] of [["law", about.laws], ["vibration", about.vibration_laws]])
    fill(id, ["", ...laws].map(law => new Option(capital(law), law)));
  fill("subject", [1, 2, 3, 4, 5, 6, 7, 8, 9].map(number => new Option(number, number)));
  fill("faults", about.faults.map(fault => button(printed(fault), () => line(`break ${fault}`))));
  fill("set_points", about.set_points.map(setPoint));
  fill("channels", CHANNELS.map(({title, object}) => made("section", {className: "channel", id: `channel ${object}`},
    made("h2", {textContent: title}), made("span", {className: "reading"}),
    ...["asked", "limit", "condition"].map(className => made("span", {className})))));
}

function nameTextures() {
  const shown = $("slot").value;
  fill("slot", ["", ...textures.map((_, number) => number + 1)].map(slot => {
    const texture = textures[slot - 1]?.label ?? (slot && about.simulated ? "empty" : "");
    return new Option(texture ? `${slot}: ${texture}` : slot, slot);
  }));
  $("slot").value = shown;
}

// Make what the form says on the server, and draw it; with a slot, load it there.
async function makeTexture(slot) {
  const form = new FormData($("maker")), file = form.get("file")?.name;
  if (!file) form.delete("file");
  form.set("page", about.page);
  form.set("slot", slot ?? "");
  form.set("label", file || `${form.get("shape")}, ${form.get("period")} mm`);
  const answer = await fetch(`texture?token=${encodeURIComponent(token)}`, {method: "POST", body: form});
  const {texture, warned, error} = await answer.json();
  $("preview").hidden = $("load").hidden = !texture;
  write("preview_words", printed(error ?? warned ?? ""));
  if (texture) drawPreview(texture);
}

function showKind() {
  const kind = $("maker").elements.kind.value;
  for (const label of $("maker").querySelectorAll("[data-kind]")) label.hidden = !label.dataset.kind.split(" ").includes(kind);
  $("preview").hidden = $("load").hidden = true;
  write("preview_words", "");
}

const setPointOf = name => $(`set ${name}`);

function showUnlessFocused(input, value) {
  if (document.activeElement !== input) input.value = value;
}

function setPoint({name, step}) {
  const input = made("input", {type: "number", id: `set ${name}`, step});
  const command = {"cof left": value => `cof ${value} -`, "cof right": value => `cof - ${value}`}[name];
  input.onchange = () => {
    if (input.value) line(command ? command(input.value) : `${name} ${input.value}`);
    input.blur();  // it shows again what is set
  };
  return made("label", {}, made("span", {textContent: capital(name)}), input, made("small", {}));
}

// The limits in force: those of the object, and those that the limits of the device leave.
function showSetPoint({name, object, unit, low, high, limits}, values) {
  const input = setPointOf(name);
  input.min = Math.max(low, values[limits[0]] ?? low);
  input.max = Math.min(high, values[limits[1]] ?? high);
  const words = `${printed(unit)} (${+input.min} to ${+input.max})`;
  if (input.nextSibling.textContent !== words) input.nextSibling.textContent = words;
  if (values[object] !== undefined) showUnlessFocused(input, +values[object].toFixed(4));
}

function show(now) {
  const values = now.values || {};
  write("mode", now.mode ? `mode ${now.mode}` : "");
  write("flags", (now.flags || []).join(", "));
  write("answer", printed(now.answer));
  write("message", now.message === undefined || now.message === null ? "Its message is not known." :
    printed(now.message || "No message."));
  write("model", printed(now.model || STEPS));
  $("drive").textContent = now.drives ? "Release" : "Drive";
  $("drive").title = now.drives ? "You drive. Stop driving, at 0 V, so that another page can drive" : "Drive the stimulator, if no other page drives it";
  for (const each of $("modes").children) {
    each.className = each.textContent === now.mode ? "on" : "";
    each.ariaPressed = each.textContent === now.mode;
  }
  for (const each of about.set_points) showSetPoint(each, values);
  for (const [id, object, laws] of [["law", "Friction law", about.laws],
    ["vibration", "Controller.Vibration law", about.vibration_laws]])
    showUnlessFocused($(id), laws[values[object]] ?? "");
  showUnlessFocused($("slot"), values["Texture.Slot"] ?? "");
  showRecording(now.recording);
  for (const [object, words] of now.limited || []) limitedAt[object] = [words, now.t];
  for (const channel of CHANNELS) showChannel(channel, values, now);
  showCounts(values, now);
  fill("emergencies", (now.emergencies || []).map(([ago, node, text]) =>
    made("li", {textContent: `${ago.toFixed(0)} s ago, ${node === null ? "stimulator" : `node ${node}`}: ${printed(text)}`})));
  if (!$("emergencies").children.length) fill("emergencies", [made("li", {textContent: "none"})]);
  draw();
}

function showRecording(recording) {
  $("recorder").hidden = !recording;
  if (!recording) return;
  const {folder, file, cycles, making} = recording;
  $("record").textContent = file ? "Stop recording" : "Start recording";
  $("record").className = file ? "on" : "";
  $("record").disabled = making;
  $("mark").disabled = !file || making;
  write("recorded", file ? `${file}: ${Math.floor(cycles / RATE)} s` : `into ${folder}`);
}

function mark() {
  marks += 1;
  line(`record mark ${$("marker").value || `marker ${marks}`}`);
  $("marker").value = "";
}

function showChannel({object, unit = "", digits, most, asked, limit}, values, now) {
  const card = $(`channel ${object}`), [, reading, set, bound, condition] = card.children;
  const value = values[object], goal = asked?.(values, now.mode || "");
  const [kind, words] = conditionOf(object, value, goal, values[most], now.t);
  card.className = `channel ${kind}`;
  reading.replaceChildren(value === undefined ? "–" : value.toFixed(digits), made("small", {textContent: unit}));
  set.textContent = goal === undefined ? "" : `set ${goal.toFixed(digits)} ${unit}`;
  const limits = limit(values);
  bound.textContent = limits && `${limits} ${unit}`;
  condition.textContent = words;
}

// How a reading stands: a class of the page, and the words for it.
function conditionOf(object, value, goal, most, t) {
  const [words, at] = limitedAt[object] ?? [];
  if (t - at < HELD_S) return ["warn", printed(t === at ? words : `in the last second: ${words}`)];
  if (value === undefined) return ["", object === "Contact.COF" ? "no finger" : "not known"];
  if (most && Math.abs(value) > most) return ["bad", "above its limit"];
  if (most && Math.abs(value) > NEAR * most) return ["warn", "near its limit"];
  const off = object === "Contact.COF" ? meanError() : 0;
  if (goal && Math.abs(off) > OFF) return ["warn", `off by ${(100 * off).toFixed(0)} %`];
  return ["", goal === undefined ? "" : "as set"];
}

// Mean of the relative error of the COF for a while: it starts anew with each stroke.
function meanError() {
  const errors = samples.slice(-30).filter(({t}) => t > samples.at(-1).t - MEAN_S)
    .map(({values}) => values["Contact.COF"] / values["Contact.COF reference"] - 1).filter(Number.isFinite);
  return errors.length ? errors.reduce((sum, error) => sum + error) / errors.length : 0;
}

// One count with its name, and how much it matters: "", "warn" or "bad".
function showCounts(values, now) {
  const rate = now.cycle_rate ?? cyclesPerSecond(), rows = [];
  for (const [name, count] of Object.entries(values).filter(([name]) => name.startsWith("Cycle."))) {
    const cycles = name === "Cycle.Cycles", grown = !cycles && count > countBefore(name, count);
    rows.push([name.slice(6), cycles && rate ? `${count} (${rate.toFixed(0)} of ${RATE} a second)` :
      grown ? `${count}, ${count - countBefore(name, count)} of them in ${GROWN_S} s` : `${count}`,
    cycles && rate ? severity(RATE - rate, .02 * RATE, .2 * RATE) : grown ? "warn" : ""]);
  }
  if (now.bus_load == null) rows.push(["Bus", about.simulated ? "none: simulated" : "not heard", ""]);
  else rows.push(["Bus load", `${(100 * now.bus_load).toFixed(1)} %, ${now.frame_rate.toFixed(0)} frames/s`,
    severity(now.bus_load, BUS_LOAD, NEAR)]);
  for (const [name, id, nmt] of now.peers || [])
    rows.push([capital(`${name} ${id}`), nmt || "not heard", nmt ? "" : "bad"]);
  fill("counts", rows.flatMap(([name, words, className]) =>
    [made("dt", {textContent: name}), made("dd", {textContent: words, className})]));
}

const severity = (value, warn, bad) => value > bad ? "bad" : value > warn ? "warn" : "";

function countBefore(name, count) {
  const before = samples.find(({t}) => t >= samples.at(-1).t - GROWN_S);
  return before?.values[name] ?? count;
}

function cyclesPerSecond() {
  const last = samples.at(-1), before = samples.at(-11);
  return before && (last.values["Cycle.Cycles"] - before.values["Cycle.Cycles"]) / (last.t - before.t);
}

// What a person does

function save(name, url) {
  made("a", {download: name, href: url}).click();
}

function csv() {
  const rows = visible(), first = rows[0]?.t ?? 0;
  const facts = {"format": "SMARTTAC panel 1", "made by": `smarttac-can ${about.version}`,
    "instrument": about.where, "saved": new Date().toISOString(), "mode": update.mode};
  const head = ["time_s", ...about.channels.map(([name]) => name)];
  return Object.entries(facts).map(([name, fact]) => `# ${name}: ${fact}\n`).join("") +
    [head, ...rows.map(({t, values}) =>
      [(t - first).toFixed(3), ...about.channels.map(([, object]) => values[object] ?? "")])]
      .map(row => row.join(",")).join("\n") + "\n";
}

function point(event) {
  finger = {x: plateMm(event.offsetX, $("plate").clientWidth), force: event.buttons & 1 ? +$("force").value : 0};
}

function lift() {
  if (finger) finger.force = 0;
}

function sendFinger() {
  const goal = finger && JSON.stringify({do: "finger", x: finger.x, force: finger.force});
  if (goal && goal !== sentFinger && drives() && about.simulated) {
    socket.send(goal);
    sentFinger = goal;
  }
  requestAnimationFrame(sendFinger);
}

function nudge(event) {
  const by = {ArrowLeft: [-NUDGE_MM, 0], ArrowRight: [NUDGE_MM, 0], ArrowUp: [0, -.05], ArrowDown: [0, .05]}[event.key];
  if (event.key === "Escape") lift();
  if (!by) return;
  event.preventDefault();
  $("force").valueAsNumber += by[1];
  showForce();
  finger = {x: Math.max(-HALF_MM, Math.min(HALF_MM, (finger?.x ?? 0) + by[0])), force: +$("force").value};
}

const showForce = () => write("force_shown", `${(+$("force").value).toFixed(2)} N`);

function addChart([title, unit]) {
  const chart = made("canvas", {tabIndex: 0});
  chart.setAttribute("role", "img");
  chart.setAttribute("aria-label", `${title}${unit && ` in ${unit}`} over time. Arrow keys: cursor, + and -: zoom`);
  const share = event => Math.max(0, Math.min(1, (event.offsetX - LEFT) / (chart.clientWidth - LEFT - RIGHT)));
  chart.onpointermove = event => { cursor = share(event); draw(); };
  chart.onpointerleave = () => { cursor = null; draw(); };
  chart.onwheel = event => {
    event.preventDefault();
    zoom(share(event), event.deltaY > 0 ? 1.25 : .8);
    draw();
  };
  chart.onkeydown = event => {
    const by = {ArrowLeft: -.01, ArrowRight: .01}[event.key], factor = {"+": .8, "-": 1.25}[event.key];
    if (by) cursor = Math.max(0, Math.min(1, (cursor ?? 1) + by));
    if (factor) zoom(cursor ?? 1, factor);
    if (by || factor) { event.preventDefault(); draw(); }
  };
  chart.onblur = chart.onpointerleave;
  $("charts").append(chart);
}

function begin() {
  readColors();
  matchMedia("(prefers-color-scheme: dark)").onchange = () => { readColors(); draw(); };
  CHARTS.forEach(addChart);
  $("stop").onclick = stop;
  for (const kind of ["keydown", "keyup"])
    addEventListener(kind, event => {
      // Shift and the space bar write a space in a text.
      if (event.code !== "Space" || event.shiftKey && event.target.matches("input:not([type])")) return;
      event.preventDefault();
      if (kind === "keydown" && !event.repeat) stop();
    }, true);
  $("drive").onclick = () => drives() ? send({do: "release"}) : drive();
  $("pause").onclick = () => {
    pausedAt = pausedAt === null ? samples.at(-1)?.t ?? null : null;
    end = null;
    $("pause").textContent = pausedAt === null ? "Pause" : "Go on";
    draw();
  };
  $("whole").onclick = () => { span = WINDOW_S; end = null; draw(); };
  $("png").onclick = () => save("panel.png", picture());
  $("csv").onclick = () => save("panel.csv", `data:text/csv,${encodeURIComponent(csv())}`);
  for (const name of ["law", "vibration", "slot"])
    $(name).onchange = () => {
      if ($(name).value) line(`${name} ${$(name).value}`);
      $(name).blur();  // it shows again what is set
    };
  $("maker").onsubmit = event => { event.preventDefault(); makeTexture(); };
  $("maker").onchange = event => { if (event.target.name === "kind") showKind(); };
  $("load").onclick = () => makeTexture($("slot").value);
  showKind();
  $("record").onclick = () => line(update.recording.file ? "record stop" : `record start ${$("notes").value}`);
  $("mark").onclick = mark;
  $("marker").onkeydown = event => { if (event.key === "Enter") mark(); };
  for (const name of ["reset", "tare", "identify", "arm", "mend", "hand"]) $(name).onclick = () => line(name);
  $("stroke").onclick = () => line(`stroke ${$("subject").value} ${$("force").value} ${$("speed").value || 50}`);
  $("force").oninput = showForce;
  $("plate").onpointerdown = event => { $("plate").setPointerCapture(event.pointerId); point(event); };
  $("plate").onpointermove = point;
  $("plate").onpointerup = $("plate").onpointercancel = $("plate").onpointerleave = lift;
  $("plate").onkeydown = nudge;
  $("plate").onblur = lift;
  addEventListener("blur", lift);
  addEventListener("resize", draw);
  connect();
  draw();
  sendFinger();
  setInterval(judge, JUDGE_MS);
}

begin();
