"use strict";
// One WebSocket to the server that this page came from. Each update is answered when it has been
// drawn: the server sends no other one before, and takes the answer for the sign of life of a driver.

const $ = id => document.getElementById(id);
const HALF_MM = 38, WINDOW_S = 60, KEPT_S = 600;
const token = location.hash.slice(1);
const CHARTS = [
  ["COF", "", [["Contact.COF", "#1565c0"], ["Contact.COF reference", "#e07b00"]]],
  ["amplitude", "um", [["Vibration.Amplitude", "#1565c0"], ["Setpoint.Amplitude", "#e07b00"]]],
  ["voltage", "V", [["Vibration.Voltage", "#1565c0"]]],
  ["frequency", "Hz", [["Vibration.Frequency", "#1565c0"]]],
  ["force", "N", [["Contact.Normal force", "#1565c0"], ["Contact.Tangential force", "#2e7d32"]]],
];
const COLUMNS = CHARTS.flatMap(([, unit, lines]) => lines.map(([name]) => [name, unit]));

let socket, about, update = null;
let samples = [];                        // {t, values}
let span = WINDOW_S, pausedAt = null, cursor = null;
let finger = null, sentFinger = "";      // {x, force} while the mouse is on the plate

const send = message => socket.readyState === 1 && socket.send(JSON.stringify(message));
const line = text => send({do: "line", text});
const drive = () => token && send({do: "drive", token});
const shown = (value, digits = 3) => value === undefined ? "-" : value.toFixed(digits);

function connect() {
  socket = new WebSocket(`ws://${location.host}/live`);
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (!("n" in message)) { introduce(message); drive(); return; }
    show(message);
    send({do: "seen", n: message.n});
  };
  socket.onclose = () => {
    update = null;
    $("state").textContent = "no connection";
    $("state").className = "badge fault";
    $("driving").disabled = true;
    setTimeout(connect, 1000);
  };
}

function introduce(message) {
  about = message;
  $("where").textContent = about.where;
  $("stop").hidden = $("drive").hidden = !about.drives || !token;
  $("simulation").hidden = !about.simulated;
  $("hint").textContent = about.simulated ?
    "Press on the plate and stroke it: the mouse is the finger." : "";
  fill("modes", about.modes.map(mode =>
    button(mode, () => line(`mode ${mode.replaceAll(" ", "_")}`))));
  fill("law", ["", ...about.laws].map(law => new Option(law.replaceAll("_", " "), law)));
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

function setPoint({name, unit, low, high, step}) {
  const label = document.createElement("label"), input = document.createElement("input");
  Object.assign(input, {type: "number", id: `set ${name}`, min: low, max: high, step});
  const before = {"cof left": "cof ", "cof right": "cof - "}[name] ?? `${name} `;
  input.onchange = () => {
    if (input.value) line(before + input.value + (name === "cof left" ? " -" : ""));
    input.blur();  // it shows again what is set
  };
  const [caption, limits] = [name, `${unit} (${low} to ${high})`].map(text => {
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
  const values = now.values || {};
  if (now.t !== undefined && now.t !== samples.at(-1)?.t) samples.push({t: now.t, values});
  while (samples.length && samples[0].t < now.t - KEPT_S) samples.shift();
  const stale = now.age === undefined || now.age > 1;
  $("state").textContent = stale ? "no news" : now.state || "nothing heard";
  $("state").className = `badge ${stale ? "fault" : now.state}`;
  $("mode").textContent = now.mode ? `mode ${now.mode}` : "";
  $("flags").textContent = (now.flags || []).join(", ");
  $("answer").textContent = now.answer;
  $("drive").disabled = now.drives;
  $("drive").textContent = now.drives ? "You drive" : "Drive";
  $("driving").disabled = !now.drives;
  for (const made of $("modes").children)
    made.className = made.textContent === now.mode ? "on" : "";
  const alarms = (now.latched || []).map(text =>
    `FAULT: ${text}. It is at 0 V. Remove the cause${about.simulated ? " (Mend)" : ""}, ` +
    "then Reset fault.");
  $("alarm").textContent = [...alarms, ...(now.notes || [])].join("\n");
  $("alarm").hidden = !$("alarm").textContent;
  for (const {name, object} of about.set_points) {
    const input = setPointOf(name), value = values[object];
    if (document.activeElement !== input && value !== undefined) input.value = +value.toFixed(4);
  }
  $("counts").textContent = Object.entries(values).filter(([name]) => name.startsWith("Cycle."))
    .map(([name, count]) => `${name.slice(6).padEnd(22)}${count}`).join("\n") +
    (now.bus_load == null ? "\nno bus" :
      `\nbus load ${(100 * now.bus_load).toFixed(1)} %, ${now.frame_rate.toFixed(0)} frames/s`) +
    (now.peers || []).map(([name, id, nmt]) => `\n${name} ${id}: ${nmt || "not heard"}`).join("");
  $("emergencies").textContent = (now.emergencies || [])
    .map(([ago, node, text]) => `${ago} s ago, node ${node}: ${text}`).join("\n") || "none";
  draw();
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
  const [cx, cy, radius] = [width / 2, height / 2, height / 2 - 14];
  const values = update?.values || {};
  const amplitude = values["Vibration.Amplitude"] ?? 0, most = Math.max(1, Math.ceil(amplitude));
  for (const share of [.5, 1]) {
    pen.strokeStyle = "#d5dbe1";
    pen.beginPath();
    pen.arc(cx, cy, radius * share, 0, 2 * Math.PI);
    pen.stroke();
  }
  text(pen, "#7a8793", `d, ${most} um`, cx + radius + 4, cy + 4);
  text(pen, "#7a8793", "q", cx, 12, "center");
  if (update?.plane)
    arrow(pen, "#1565c0", cx, cy, update.plane[0] / most * radius, -update.plane[1] / most * radius);
  else text(pen, "#7a8793", "no TPDO carries W on a bus", 8, height - 8);
  text(pen, "#1565c0", `${shown(amplitude)} um`, 8, 18);
}

const windowNow = () => {
  const end = pausedAt ?? samples.at(-1)?.t ?? 0;
  return [end - span, end];
};
const visible = () => {
  const [begin, end] = windowNow();
  return samples.filter(({t}) => t >= begin && t <= end);
};

function drawChart(element, [title, unit, lines], rows, [begin, end]) {
  const [pen, width, height] = canvas(element);
  const [left, right, top, base] = [64, width - 8, 18, height - 16];
  const all = rows.flatMap(({values}) => lines.map(([name]) => values[name])).filter(Number.isFinite);
  let [low, high] = [Math.min(...all), Math.max(...all)];
  if (!all.length) [low, high] = [0, 1];
  const least = title === "frequency" ? 10 : unit === "V" ? 1 : .05;
  if (high - low < least) { const middle = (low + high) / 2; low = middle - least / 2; high = middle + least / 2; }
  const x = t => left + (t - begin) / (end - begin) * (right - left);
  const y = value => base - (value - low) / (high - low) * (base - top);
  for (const share of [0, .5, 1]) {
    const value = low + share * (high - low);
    stroke(pen, "#e6eaee", [[left, y(value)], [right, y(value)]]);
    text(pen, "#7a8793", value.toFixed(title === "frequency" ? 1 : 3), left - 4, y(value) + 4, "right");
  }
  for (const share of [0, .25, .5, .75, 1])
    text(pen, "#7a8793", `${(-(1 - share) * span).toFixed(span < 10 ? 1 : 0)} s`,
      left + share * (right - left), height - 3, share === 1 ? "right" : "center");
  let place = left;
  text(pen, "#1c2733", unit ? `${title} (${unit})` : title, place, 13);
  place += 110;
  for (const [name, color] of lines) {
    stroke(pen, color, rows.map(({t, values}) => [x(t), values[name] === undefined ? null : y(values[name])]));
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
  CHARTS.forEach((chart, number) => drawChart($("charts").children[number], chart, rows, ends));
}

// What a person does

function save(name, url) {
  Object.assign(document.createElement("a"), {download: name, href: url}).click();
}

function savePng() {
  const parts = [$("plate"), ...$("charts").children], whole = document.createElement("canvas");
  whole.width = Math.max(...parts.map(part => part.width));
  whole.height = parts.reduce((sum, part) => sum + part.height, 0);
  let top = 0;
  for (const part of parts) { whole.getContext("2d").drawImage(part, 0, top); top += part.height; }
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
  if (goal && goal !== sentFinger && update?.drives && about.simulated) {
    socket.send(goal);
    sentFinger = goal;
  }
  requestAnimationFrame(sendFinger);
}

function begin() {
  for (const _ of CHARTS) {
    const chart = document.createElement("canvas");
    chart.dataset.height = 120;
    chart.onmousemove = event => { cursor = (event.offsetX - 64) / (chart.clientWidth - 72); draw(); };
    chart.onmouseleave = () => { cursor = null; draw(); };
    chart.onwheel = event => {
      event.preventDefault();
      span = Math.max(1, Math.min(WINDOW_S, span * (event.deltaY > 0 ? 1.25 : .8)));
      draw();
    };
    $("charts").append(chart);
  }
  const stop = () => send({do: "stop"});
  $("stop").onclick = stop;
  for (const kind of ["keydown", "keyup"])
    addEventListener(kind, event => {
      if (event.code !== "Space") return;
      event.preventDefault();
      if (kind === "keydown") stop();
    }, true);
  $("drive").onclick = drive;
  $("pause").onclick = () => {
    pausedAt = pausedAt === null ? samples.at(-1)?.t ?? null : null;
    $("pause").textContent = pausedAt === null ? "Pause" : "Go on";
    draw();
  };
  $("whole").onclick = () => { span = WINDOW_S; draw(); };
  $("png").onclick = savePng;
  $("csv").onclick = () => save("panel.csv", `data:text/csv,${encodeURIComponent(csv())}`);
  for (const name of ["law", "slot"])
    $(name).onchange = () => $(name).value && line(`${name} ${$(name).value}`);
  $("reset").onclick = () => line("reset");
  $("mend").onclick = () => line("mend");
  $("hand").onclick = () => line("hand");
  $("stroke").onclick = () => line(`stroke ${$("subject").value} ${$("force").value} ${$("speed").value}`);
  $("force").oninput = () => $("force_shown").textContent = `${$("force").value} N`;
  $("plate").onpointerdown = event => { $("plate").setPointerCapture(event.pointerId); point(event); };
  $("plate").onpointermove = point;
  $("plate").onpointerup = $("plate").onpointercancel = $("plate").onpointerleave = lift;
  addEventListener("blur", lift);
  addEventListener("resize", draw);
  connect();
  draw();
  sendFinger();
}

begin();
