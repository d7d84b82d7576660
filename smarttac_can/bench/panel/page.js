"use strict";
// One WebSocket to the server that this page came from. Each update is answered when it has been
// drawn: the server sends no other one before, and takes the answer for the sign of life of a driver.
//
// The page does not wait for an update to tell that there is none: its own clock calls `judge`. An
// update was made after the answer to the one before, so it is no older than that, however long the
// network has kept it. What was live is dimmed and dated when it is older than `OLD_S`.

const $ = id => document.getElementById(id);
const HALF_MM = 38, WINDOW_S = 60, KEPT_S = 600;
const GAP_S = .5;                        // without an update is a gap of the charts
const OLD_S = 1, JUDGE_MS = 100;
const token = location.hash.slice(1);
const CHARTS = [
  ["COF", "", [["Contact.COF", "#1565c0"], ["Contact.COF reference", "#e07b00"]]],
  ["amplitude", "um", [["Vibration.Amplitude", "#1565c0"], ["Setpoint.Amplitude", "#e07b00"]]],
  ["voltage", "V", [["Vibration.Voltage", "#1565c0"]]],
  ["frequency", "Hz", [["Vibration.Frequency", "#1565c0"]]],
  ["force", "N", [["Contact.Normal force", "#1565c0"], ["Contact.Tangential force", "#2e7d32"]]],
];
const COLUMNS = CHARTS.flatMap(([, unit, lines]) => lines.map(([name]) => [name, unit]))
  .concat([["Contact.Position", "mm"]]);
const LEFT = 52, RIGHT = 8;              // of a chart, beside its curves
const CLOSED = [1008, 1013];             // with a reason: no page that comes again by itself

let socket, about, update = null;
let answeredAt = 0;                      // of the last update: by performance.now, as all times in ms
let newsAt = -Infinity, newsDate = "";   // of what is shown, at the latest
let gone = "Connecting.";                // why there is no connection
let stops = 0, stopAt = null;            // stops sent on this connection; the first not confirmed
let samples = [];                        // {t, values}
let span = WINDOW_S, end = null;         // of the charts in s; the newest sample if null
let pausedAt = null, cursor = null;      // the cursor as a share of the width
let finger = null, sentFinger = "";      // {x, force} while the mouse is on the plate

const send = message => socket.readyState === 1 && socket.send(JSON.stringify(message));
const line = text => send({do: "line", text});
const drive = () => token && send({do: "drive"});
const shown = (value, digits = 3) => value === undefined ? "-" : value.toFixed(digits);

function connect() {
  socket = new WebSocket(`ws://${location.host}/live?token=${encodeURIComponent(token)}`);
  answeredAt = performance.now();
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (!("n" in message)) {
      stops = 0;
      introduce(message);
      drive();
      if (stopAt !== null) stop();  // it was meant, and may not have arrived
      return;
    }
    show(message);
    send({do: "seen", n: message.n});
    answeredAt = performance.now();
  };
  socket.onclose = event => {
    const closed = CLOSED.includes(event.code);
    gone = closed ? `The panel has closed this page: ${event.reason}. Open the address that smarttac panel printed.` :
      "No connection. Does smarttac panel still run?";
    newsAt = -Infinity;
    judge();
    if (!closed) setTimeout(connect, 1000);
  };
}

function stop() {
  if ($("stop").hidden) { stopAt = null; return; }  // a page that only looks on
  stopAt ??= performance.now();
  stops += 1;
  send({do: "stop"});
  judge();
}

const isOld = () => performance.now() - newsAt > 1e3 * OLD_S;
const drives = () => !isOld() && update.drives;

// Show what is known now, whether an update has come or not.
function judge() {
  const old = isOld(), words = [];
  document.body.classList.toggle("old", old);
  $("dated").textContent = old && newsDate ? `as of ${newsDate}` : "";
  $("state").textContent = gone ? "no connection" : old ? "no news" : update.state || "nothing heard";
  $("state").className = `badge ${old ? "fault" : update.state}`;
  $("drive").disabled = old;
  $("driving").disabled = !drives();
  if (stopAt !== null && (old || performance.now() - stopAt > 1e3 * OLD_S))
    words.push("STOP IS NOT CONFIRMED: cut the supply of the power stage.");
  if (gone) words.push(gone);
  else if (old) words.push("No news: the panel, its computer or the network stands still. What is dimmed is old.");
  else {
    for (const [text, remedy] of update.faults || [])
      words.push(`FAULT: ${text}. The plate is at 0 V.\nTo do: ${remedy}${about.simulated ? "; here, click Mend" : ""}. ` +
        "Then click Reset fault, and a mode.");
    words.push(...update.notes || []);
  }
  const alarm = words.join("\n");
  // A screen reader says what is written anew.
  if ($("alarm").textContent !== alarm) $("alarm").textContent = alarm;
  $("alarm").hidden = !alarm;
}

function introduce(message) {
  about = message;
  $("where").textContent = about.where;
  $("stop").hidden = $("drive").hidden = !about.drives || !token;
  $("simulation").hidden = !about.simulated;
  fill("modes", about.modes.map(mode =>
    button(mode, () => line(`mode ${mode.replaceAll(" ", "_")}`))));
  for (const [id, laws] of [["law", about.laws], ["vibration", about.vibration_laws]])
    fill(id, ["", ...laws].map(law => new Option(law.replaceAll("_", " "), law)));
  fill("slot", ["", 1, 2, 3, 4].map(slot => {
    const texture = about.textures[slot - 1] ?? (slot && about.simulated ? "empty" : "");
    return new Option(texture ? `${slot}: ${texture}` : slot, slot);
  }));
  fill("subject", [1, 2, 3, 4, 5, 6, 7, 8, 9].map(number => new Option(number, number)));
  fill("faults", about.faults.map(fault => button(fault, () => line(`break ${fault}`))));
  fill("set_points", about.set_points.map(setPoint));
}

const fill = (id, children) => $(id).replaceChildren(...children);

function button(text, act) {
  const made = document.createElement("button");
  made.textContent = text;
  made.onclick = act;
  return made;
}

const setPointOf = name => $(`set ${name}`);

function showUnlessFocused(input, value) {
  if (document.activeElement !== input) input.value = value;
}

function setPoint({name, unit, low, high, step}) {
  const label = document.createElement("label"), input = document.createElement("input");
  Object.assign(input, {type: "number", id: `set ${name}`, min: low, max: high, step});
  const before = {"cof left": "cof ", "cof right": "cof - "}[name] ?? `${name} `;
  input.onchange = () => {
    if (input.value) line(before + input.value + (name === "cof left" ? " -" : ""));
    input.blur();  // it shows again what is set
  };
  const [caption, limits] = [name.replace("cof", "COF"), `${unit} (${low} to ${high})`].map(text => {
    const made = document.createElement("span");
    made.textContent = text;
    return made;
  });
  limits.className = "limits";
  label.append(caption, input, limits);
  return label;
}

function show(now) {
  update = now;
  gone = "";
  const values = now.values || {};
  if (now.t !== undefined && now.t !== samples.at(-1)?.t) samples.push({t: now.t, values});
  while (samples.length && samples[0].t < now.t - KEPT_S) samples.shift();
  newsAt = now.age === undefined ? -Infinity : answeredAt - 1e3 * now.age;
  if (now.age !== undefined) newsDate = new Date(Date.now() - performance.now() + newsAt).toLocaleTimeString();
  if (now.stops === stops) stopAt = null;
  judge();
  $("mode").textContent = now.mode ? `mode ${now.mode}` : "";
  $("flags").textContent = (now.flags || []).join(", ");
  $("answer").textContent = now.answer;
  $("drive").textContent = now.drives ? "Release" : "Drive";
  $("drive").title = now.drives ? "You drive. Release it, at 0 V, for another page" : "Take the stimulator, if no other page drives";
  for (const made of $("modes").children)
    made.className = made.textContent === now.mode ? "on" : "";
  for (const {name, object} of about.set_points)
    if (values[object] !== undefined) showUnlessFocused(setPointOf(name), +values[object].toFixed(4));
  for (const [id, object, laws] of [["law", "Friction law", about.laws],
    ["vibration", "Controller.Vibration law", about.vibration_laws]])
    showUnlessFocused($(id), laws[values[object]] ?? "");
  showUnlessFocused($("slot"), values["Texture.Slot"] ?? "");
  const rate = now.cycle_rate ?? cyclesPerSecond();
  $("counts").textContent = Object.entries(values).filter(([name]) => name.startsWith("Cycle."))
    .map(([name, count]) => name.slice(6).padEnd(22) + count +
      (name === "Cycle.Cycles" && rate ? ` (${rate.toFixed(0)}/s)` : "")).join("\n") +
    `\nplate                 ${shown(values["Plate temperature"], 1)} degC` +
    (now.bus_load == null ? "\nno bus" :
      `\nbus load ${(100 * now.bus_load).toFixed(1)} %, ${now.frame_rate.toFixed(0)} frames/s`) +
    (now.peers || []).map(([name, id, nmt]) => `\n${name} ${id}: ${nmt || "not heard"}`).join("");
  $("emergencies").textContent = (now.emergencies || [])
    .map(([ago, node, text]) => `${ago} s ago, node ${node}: ${text}`).join("\n") || "none";
  draw();
}

function cyclesPerSecond() {
  const last = samples.at(-1), before = samples.at(-11);
  return before && (last.values["Cycle.Cycles"] - before.values["Cycle.Cycles"]) / (last.t - before.t);
}

// Pictures

function canvas(element) {
  const ratio = devicePixelRatio, width = element.clientWidth, height = +element.dataset.height;
  element.style.height = `${height}px`;
  if (element.width !== Math.round(width * ratio)) element.width = Math.round(width * ratio);
  if (element.height !== height * ratio) element.height = height * ratio;
  const pen = element.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = "#fff";
  pen.fillRect(0, 0, width, height);
  pen.font = "12px sans-serif";
  pen.lineWidth = 1.5;
  return [pen, width, height];
}

// Points of [x, y]; a y of null lifts the pen.
function stroke(pen, color, points) {
  pen.strokeStyle = color;
  pen.beginPath();
  let down = false;
  for (const [x, y] of points) {
    if (y === null) down = false;
    else { down ? pen.lineTo(x, y) : pen.moveTo(x, y); down = true; }
  }
  pen.stroke();
}

function text(pen, color, words, x, y, align = "left") {
  pen.fillStyle = color;
  pen.textAlign = align;
  pen.fillText(words, x, y);
}

function arrow(pen, color, x, y, dx, dy) {
  if (Math.hypot(dx, dy) < 3) return;
  const angle = Math.atan2(dy, dx), [x1, y1] = [x + dx, y + dy];
  stroke(pen, color, [[x, y], [x1, y1], [x1 - 8 * Math.cos(angle - .5), y1 - 8 * Math.sin(angle - .5)],
    [x1, y1], [x1 - 8 * Math.cos(angle + .5), y1 - 8 * Math.sin(angle + .5)]]);
}

const plateX = (mm, width) => 30 + (mm + HALF_MM) / (2 * HALF_MM) * (width - 60);
const plateMm = (x, width) =>
  Math.max(-HALF_MM, Math.min(HALF_MM, (x - 30) / (width - 60) * 2 * HALF_MM - HALF_MM));

function drawPlate() {
  const [pen, width, height] = canvas($("plate"));
  const values = update?.values || {}, top = 90, base = height - 18, scale = base - top - 30;
  const [left, right] = ["left", "right"].map(side => values[`Setpoint.COF ${side}`]);
  const most = Math.max(.5, left ?? 0, right ?? 0) * 1.2;
  const at = mm => plateX(mm, width), cofY = cof => base - Math.min(cof / most, 1) * scale;
  pen.fillStyle = "#cfd8e0";
  pen.fillRect(at(-HALF_MM), top, at(HALF_MM) - at(-HALF_MM), 12);
  const boundary = values["Setpoint.Boundary"] ?? 0;
  stroke(pen, "#8896a3", [[at(boundary), top - 6], [at(boundary), base]]);
  stroke(pen, "#d5dbe1", [[at(-HALF_MM), base], [at(HALF_MM), base]]);
  if (left !== undefined)
    stroke(pen, "#e07b00", [[at(-HALF_MM), cofY(left)], [at(boundary), cofY(left)],
      [at(boundary), cofY(right)], [at(HALF_MM), cofY(right)]]);
  for (const mm of [-30, -20, -10, 0, 10, 20, 30])
    text(pen, "#7a8793", `${mm}`, at(mm), height - 4, "center");
  text(pen, "#7a8793", "mm", at(HALF_MM), height - 4, "center");
  text(pen, "#4d5b69", "COF (blue) over the plate, and its set-point", at(-HALF_MM), top + 26);
  const recent = samples.filter(({t}) => t > (samples.at(-1)?.t ?? 0) - 5);
  pen.fillStyle = "#1565c0";
  for (const {values: {"Contact.Position": x, "Contact.COF": cof}} of recent)
    if (x !== undefined && cof !== undefined) pen.fillRect(at(x) - 2, cofY(cof) - 2, 4, 4);
  const touching = values["Contact.Position"], mm = touching ?? finger?.x;
  if (touching === undefined && about?.simulated)
    text(pen, "#4d5b69", "Press on the plate and stroke it: the mouse is the finger.", width / 2, 20, "center");
  if (mm === undefined) return;
  const x = at(mm), y = touching === undefined ? top - 25 : top;
  pen.fillStyle = "#e8b89a";
  pen.beginPath();
  pen.ellipse(x, y - 28, 17, 28, 0, 0, 2 * Math.PI);
  pen.fill();
  const [normal, tangential] = ["Normal", "Tangential"].map(name => values[`Contact.${name} force`] ?? 0);
  arrow(pen, "#1565c0", x, y - 28, 0, 45 * Math.min(normal, 1.5));
  arrow(pen, "#2e7d32", x, y, 120 * Math.max(-1, Math.min(tangential, 1)), 0);
  text(pen, "#1565c0", `${shown(normal, 2)} N`, x + 22, y - 40);
  text(pen, "#2e7d32", `${shown(tangential, 2)} N`, x + 22, y - 24);
}

function drawPlane() {
  const [pen, width, height] = canvas($("plane"));
  const [cx, cy, radius] = [width / 2, height / 2 + 6, height / 2 - 24];
  const values = update?.values || {};
  const amplitude = values["Vibration.Amplitude"] ?? 0, most = Math.max(1, Math.ceil(amplitude));
  for (const share of [.5, 1]) {
    pen.strokeStyle = "#d5dbe1";
    pen.beginPath();
    pen.arc(cx, cy, radius * share, 0, 2 * Math.PI);
    pen.stroke();
  }
  text(pen, "#7a8793", "d", cx + radius + 5, cy + 4);
  text(pen, "#7a8793", `ring: ${most} um`, width - 6, height - 8, "right");
  text(pen, "#7a8793", "q", cx, 18, "center");
  const [d, q] = ["d", "q"].map(axis => (values[`Vibration.W_${axis}`] ?? 0) / most * radius);
  arrow(pen, "#1565c0", cx, cy, d, -q);
  text(pen, "#4d5b69", "vibration W", 8, 18);
  text(pen, "#1565c0", `${shown(amplitude)} um`, 8, 34);
  if (about && !about.simulated) text(pen, "#7a8793", "read once a second", 8, height - 8);
}

const newest = () => pausedAt ?? samples.at(-1)?.t ?? 0;
const windowNow = () => [(end ?? newest()) - span, end ?? newest()];

function zoom(share, factor) {
  const [begin, last] = windowNow(), t = begin + share * (last - begin);
  const longer = Math.max(1, Math.min(WINDOW_S, span * factor));
  // What moves keeps its newest end; what is held, what is under the cursor.
  if (pausedAt !== null) end = Math.min(pausedAt, t + (last - t) * longer / span);
  span = longer;
}

// A step of 1, 2 or 5 by powers of ten that is at least a value.
function step(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return [1, 2, 5, 10].find(times => times * power >= least * .9999) * power;
}
const visible = () => {
  const [begin, end] = windowNow();
  return samples.filter(({t}) => t >= begin && t <= end);
};

function drawChart(element, [title, unit, lines], rows, [begin, end]) {
  const [pen, width, height] = canvas(element);
  const [left, right, top, base] = [LEFT, width - RIGHT, 18, height - 16];
  const all = rows.flatMap(({values}) => lines.map(([name]) => values[name])).filter(Number.isFinite);
  let [low, high] = [Math.min(...all), Math.max(...all)];
  if (!all.length) [low, high] = [0, 1];
  const least = title === "frequency" ? 10 : unit === "V" ? 1 : .05;
  if (high - low < least) { const middle = (low + high) / 2; low = middle - least / 2; high = middle + least / 2; }
  const tick = step((high - low) / 2), digits = Math.max(0, -Math.floor(Math.log10(tick) + 1e-9));
  [low, high] = [Math.floor(low / tick + 1e-9) * tick, Math.ceil(high / tick - 1e-9) * tick];
  const x = t => left + (t - begin) / (end - begin) * (right - left);
  const y = value => base - (value - low) / (high - low) * (base - top);
  for (let count = Math.round(low / tick); count <= Math.round(high / tick); count++) {
    const value = count * tick;
    stroke(pen, "#e6eaee", [[left, y(value)], [right, y(value)]]);
    text(pen, "#7a8793", value.toFixed(digits), left - 4, y(value) + 4, "right");
  }
  for (const [share, align] of [[0, "left"], [.25, "center"], [.5, "center"], [.75, "center"], [1, "right"]])
    text(pen, "#7a8793", `${(end - (1 - share) * span - newest()).toFixed(span < 10 ? 1 : 0)} s`,
      left + share * (right - left), height - 3, align);
  let place = left;
  text(pen, "#1c2733", unit ? `${title} (${unit})` : title, place, 13);
  place += 110;
  for (const [name, color] of lines) {
    stroke(pen, color, rows.flatMap(({t, values: {[name]: value}}, number) => [
      ...(t - rows[number - 1]?.t > GAP_S ? [[x(t), null]] : []),
      [x(t), value === undefined ? null : y(value)]]));
    const words = name.replace("Contact.", "").replace("Vibration.", "").replace("Setpoint.", "set ");
    text(pen, color, words, place, 13);
    place += 130;
  }
  if (cursor !== null) {
    const px = left + cursor * (right - left), t = begin + cursor * (end - begin);
    stroke(pen, "#8896a3", [[px, top], [px, base]]);
    const near = rows.reduce((best, row) => Math.abs(row.t - t) < Math.abs((best?.t ?? 1e9) - t) ? row : best, null);
    if (near) text(pen, "#1c2733", lines.map(([name]) => shown(near.values[name])).join("  "), right, 13, "right");
  }
}

function draw() {
  drawPlate();
  drawPlane();
  const rows = visible(), ends = windowNow();
  $("cursor").textContent = cursor === null ? "" :
    `cursor at ${(ends[1] - (1 - cursor) * span - newest()).toFixed(1)} s`;
  CHARTS.forEach((chart, number) => drawChart($("charts").children[number], chart, rows, ends));
}

// What a person does

function save(name, url) {
  Object.assign(document.createElement("a"), {download: name, href: url}).click();
}

function savePng() {
  const charts = [...$("charts").children], whole = document.createElement("canvas");
  const pen = whole.getContext("2d"), plate = $("plate"), plane = $("plane");
  whole.width = charts[0].width;
  whole.height = charts.reduce((sum, chart) => sum + chart.height, plate.height);
  pen.fillStyle = "#fff";
  pen.fillRect(0, 0, whole.width, whole.height);
  pen.drawImage(plate, 0, 0);
  pen.drawImage(plane, whole.width - plane.width, 0);
  let top = plate.height;
  for (const chart of charts) { pen.drawImage(chart, 0, top); top += chart.height; }
  save("panel.png", whole.toDataURL());
}

function csv() {
  const rows = visible(), first = rows[0]?.t ?? 0;
  const head = ["time (s)", ...COLUMNS.map(([name, unit]) => unit ? `${name} (${unit})` : name)];
  return [head, ...rows.map(({t, values}) =>
    [(t - first).toFixed(3), ...COLUMNS.map(([name]) => values[name] ?? "")])]
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

function begin() {
  for (const _ of CHARTS) {
    const chart = document.createElement("canvas");
    chart.dataset.height = 98;
    const share = event => Math.max(0, Math.min(1, (event.offsetX - LEFT) / (chart.clientWidth - LEFT - RIGHT)));
    chart.onmousemove = event => { cursor = share(event); draw(); };
    chart.onmouseleave = () => { cursor = null; draw(); };
    chart.onwheel = event => {
      event.preventDefault();
      zoom(share(event), event.deltaY > 0 ? 1.25 : .8);
      draw();
    };
    $("charts").append(chart);
  }
  $("stop").onclick = stop;
  for (const kind of ["keydown", "keyup"])
    addEventListener(kind, event => {
      if (event.code !== "Space") return;
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
  $("png").onclick = savePng;
  $("csv").onclick = () => save("panel.csv", `data:text/csv,${encodeURIComponent(csv())}`);
  for (const name of ["law", "vibration", "slot"])
    $(name).onchange = () => {
      if ($(name).value) line(`${name} ${$(name).value}`);
      $(name).blur();  // it shows again what is set
    };
  $("reset").onclick = () => line("reset");
  $("mend").onclick = () => line("mend");
  $("hand").onclick = () => line("hand");
  $("stroke").onclick = () => line(`stroke ${$("subject").value} ${$("force").value} ${$("speed").value || 50}`);
  $("force").oninput = () => $("force_shown").textContent = `${$("force").value} N`;
  $("plate").onpointerdown = event => { $("plate").setPointerCapture(event.pointerId); point(event); };
  $("plate").onpointermove = point;
  $("plate").onpointerup = $("plate").onpointercancel = $("plate").onpointerleave = lift;
  addEventListener("blur", lift);
  addEventListener("resize", draw);
  connect();
  draw();
  sendFinger();
  setInterval(judge, JUDGE_MS);
}

begin();
