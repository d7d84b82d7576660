"use strict";
// Pictures: the plate with its finger, the vibration in the d-q plane, and the charts.

const HALF_MM = 38, WINDOW_S = 60;
const GAP_S = .5;                        // without an update is a gap of the charts
const LEFT = 52, RIGHT = 8;              // of a chart, beside its curves
const LEAST_SWING = {"frequency": 10, "voltage": 1};
const CHARTS = [
  ["COF", "", [["Contact.COF", "measured"], ["Contact.COF reference", "set"]]],
  ["amplitude", "µm", [["Vibration.Amplitude", "measured"], ["Setpoint.Amplitude", "set"]]],
  ["voltage", "V", [["Vibration.Voltage", "measured"]]],
  ["frequency", "Hz", [["Vibration.Frequency", "measured"]]],
  ["force", "N", [["Contact.Normal force", "measured"], ["Contact.Tangential force", "second"]]],
];
const WORDS = {
  "Contact.COF": "measured", "Contact.COF reference": "set", "Vibration.Amplitude": "measured",
  "Setpoint.Amplitude": "set", "Vibration.Voltage": "", "Vibration.Frequency": "",
  "Contact.Normal force": "normal", "Contact.Tangential force": "tangential",
};

let span = WINDOW_S, end = null;         // of the charts in s; the newest sample if null
let pausedAt = null, cursor = null;      // the cursor as a share of the width
let finger = null;                       // {x, force} while the page guides it
let colors = {};

const shown = (value, digits = 3) => value === undefined ? "-" : value.toFixed(digits);

function readColors() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["card", "ink", "quiet", "line", "grid", "measured", "set", "second", "skin", "plate"])
    colors[name] = style.getPropertyValue(`--${name}`).trim();
}

function canvas(element) {
  const ratio = devicePixelRatio, width = element.clientWidth, height = element.clientHeight;
  if (element.width !== Math.round(width * ratio)) element.width = Math.round(width * ratio);
  if (element.height !== Math.round(height * ratio)) element.height = Math.round(height * ratio);
  const pen = element.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = colors.card;
  pen.fillRect(0, 0, width, height);
  pen.font = "12px system-ui, sans-serif";
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
  pen.lineWidth = 2.5;
  stroke(pen, color, [[x, y], [x1, y1], [x1 - 8 * Math.cos(angle - .5), y1 - 8 * Math.sin(angle - .5)],
    [x1, y1], [x1 - 8 * Math.cos(angle + .5), y1 - 8 * Math.sin(angle + .5)]]);
  pen.lineWidth = 1.5;
}

const plateX = (mm, width) => 30 + (mm + HALF_MM) / (2 * HALF_MM) * (width - 60);
const plateMm = (x, width) =>
  Math.max(-HALF_MM, Math.min(HALF_MM, (x - 30) / (width - 60) * 2 * HALF_MM - HALF_MM));

// What the COF is set to over the plate, as points of [mm, COF].
function askedCof(values) {
  const [left, right] = ["left", "right"].map(side => values[`Setpoint.COF ${side}`]);
  const boundary = values["Setpoint.Boundary"] ?? 0;
  if (left === undefined) return [];
  return [[-HALF_MM, left], [boundary, left], [boundary, right], [HALF_MM, right]];
}

// The texture that is played, if it is known and goes over the plate.
function playedTexture(values) {
  const texture = update?.mode === "texture" ? textures[values["Texture.Slot"] - 1] : null;
  return texture?.over === "mm" ? texture : null;
}

// A texture as a band from the least to the greatest COF of each of its columns.
function drawTexture(pen, {bins}, x, y) {
  const width = x(bins[1][0]) - x(bins[0][0]);
  for (const [place, low, high] of bins)
    pen.fillRect(x(place), y(high) - 1, width + .5, y(low) - y(high) + 2);
}

// How much of the swing of the reference the COF has had in 5 s: the slope of the one over the other.
function gainOf(recent) {
  const pairs = recent.map(({values}) => [values["Contact.COF reference"], values["Contact.COF"]])
    .filter(pair => pair.every(Number.isFinite));
  const mean = side => pairs.reduce((sum, pair) => sum + pair[side], 0) / pairs.length;
  const [asked, had] = [mean(0), mean(1)];
  const spread = pairs.reduce((sum, [a]) => sum + (a - asked) ** 2, 0);
  return pairs.length > 10 && spread / pairs.length > 1e-5 ?
    pairs.reduce((sum, [a, b]) => sum + (a - asked) * (b - had), 0) / spread : undefined;
}

function drawPlate() {
  const [pen, width, height] = canvas($("plate"));
  const values = update?.values || {}, top = 90, base = height - 20, scale = base - top - 34;
  const texture = playedTexture(values), asked = update?.mode === "texture" ? [] : askedCof(values);
  const at = mm => plateX(mm, width);
  const recent = samples.filter(({t}) => t > (samples.at(-1)?.t ?? 0) - 5);
  const most = Math.max(.4, ...asked.map(([, cof]) => cof), ...(texture?.bins ?? []).map(([, , cof]) => cof)) * 1.2;
  const cofY = cof => base - Math.min(cof / most, 1) * scale;
  pen.fillStyle = colors.plate;
  pen.fillRect(at(-HALF_MM), top, at(HALF_MM) - at(-HALF_MM), 10);
  stroke(pen, colors.line, [[at(-HALF_MM), base], [at(HALF_MM), base]]);
  for (const mm of [-30, -20, -10, 0, 10, 20, 30])
    text(pen, colors.quiet, `${mm}`, at(mm), height - 5, "center");
  text(pen, colors.quiet, "mm", at(HALF_MM), height - 5, "center");
  text(pen, colors.measured, "COF of the last 5 s", at(-HALF_MM), top + 27);
  text(pen, colors.set, headOf(texture, values), at(-HALF_MM) + 120, top + 27);
  pen.fillStyle = colors.set;
  if (texture) drawTexture(pen, texture, at, cofY);
  pen.lineWidth = 2;
  stroke(pen, colors.set, asked.map(([mm, cof]) => [at(mm), cofY(cof)]));
  pen.lineWidth = 1.5;
  pen.fillStyle = colors.measured;
  for (const {values: {"Contact.Position": x, "Contact.COF": cof}} of recent)
    if (x !== undefined && cof !== undefined) pen.fillRect(at(x) - 2.5, cofY(cof) - 2.5, 5, 5);
  if (update?.mode === "texture") {
    const gain = gainOf(recent), reference = values["Contact.COF reference"];
    text(pen, colors.ink, [reference === undefined ? "" : `COF here ${reference.toFixed(3)}`,
      gain === undefined ? "" : `gain ${gain.toFixed(2)}`].filter(Boolean).join(", "),
    at(HALF_MM), top + 27, "right");
  }
  drawFinger(pen, width, top, at, values);
}

function headOf(texture, values) {
  if (update?.mode !== "texture") return "set";
  const slot = values["Texture.Slot"];
  return texture?.label ?? (textures[slot - 1] ? `${textures[slot - 1].label}, over time` : `texture ${slot}, not known`);
}

// The texture that was made on this page, before it plays.
function drawPreview({over, bins}) {
  const [pen, width, height] = canvas($("preview"));
  const high = Math.max(...bins.map(([, , cof]) => cof)) * 1.15, last = bins.at(-1)[0];
  const x = place => LEFT + (place - bins[0][0]) / (last - bins[0][0]) * (width - LEFT - RIGHT);
  const y = cof => height - 18 - cof / high * (height - 30);
  for (const cof of [0, step(high / 3), 2 * step(high / 3)].filter(cof => cof < high)) {
    stroke(pen, colors.grid, [[LEFT, y(cof)], [width - RIGHT, y(cof)]]);
    text(pen, colors.quiet, cof.toFixed(2), LEFT - 5, y(cof) + 4, "right");
  }
  pen.fillStyle = colors.set;
  drawTexture(pen, {bins}, x, y);
  text(pen, colors.quiet, `${bins[0][0]} ${over}`, LEFT, height - 4);
  text(pen, colors.quiet, `${last.toFixed(over === "s" ? 2 : 0)} ${over}`, width - RIGHT, height - 4, "right");
}

function drawFinger(pen, width, top, at, values) {
  const touching = values["Contact.Position"], mm = touching ?? finger?.x;
  if (touching === undefined && about?.simulated)
    text(pen, colors.quiet, width < 420 ? "Stroke the plate: you are the finger." :
      "Press on the plate and stroke it: the mouse is the finger.", width / 2, 20, "center");
  if (mm === undefined) return;
  const x = at(mm), y = touching === undefined ? top - 12 : top;
  const side = x > width - 110 ? -1 : 1, align = side < 0 ? "right" : "left";
  pen.fillStyle = colors.skin;
  pen.beginPath();
  pen.ellipse(x, y - 28, 17, 28, 0, 0, 2 * Math.PI);
  pen.fill();
  const [normal, tangential] = ["Normal", "Tangential"].map(name => values[`Contact.${name} force`] ?? 0);
  arrow(pen, colors.measured, x, y - 28, 0, 45 * Math.min(normal, 1.5));
  arrow(pen, colors.second, x, y, 120 * Math.max(-1, Math.min(tangential, 1)), 0);
  text(pen, colors.measured, `${shown(normal, 2)} N`, x + 24 * side, y - 42, align);
  text(pen, colors.second, `${shown(tangential, 2)} N`, x + 24 * side, y - 26, align);
}

function drawPlane() {
  const [pen, width, height] = canvas($("plane"));
  if (!width) return;
  const [cx, cy, radius] = [width / 2, height / 2 + 6, height / 2 - 24];
  const values = update?.values || {};
  const amplitude = values["Vibration.Amplitude"] ?? 0, most = Math.max(1, Math.ceil(amplitude));
  for (const share of [.5, 1]) {
    pen.strokeStyle = colors.line;
    pen.beginPath();
    pen.arc(cx, cy, Math.min(radius, width / 2 - 16) * share, 0, 2 * Math.PI);
    pen.stroke();
  }
  const ring = Math.min(radius, width / 2 - 16);
  stroke(pen, colors.grid, [[cx - ring, cy], [cx + ring, cy]]);
  stroke(pen, colors.grid, [[cx, cy - ring], [cx, cy + ring]]);
  text(pen, colors.quiet, "d", cx + ring + 5, cy + 4);
  text(pen, colors.quiet, "q", cx, cy - ring - 5, "center");
  text(pen, colors.quiet, `ring: ${most} µm`, width - 8, height - 8, "right");
  const [d, q] = ["d", "q"].map(axis => (values[`Vibration.W_${axis}`] ?? 0) / most * ring);
  arrow(pen, colors.measured, cx, cy, d, -q);
  text(pen, colors.ink, "vibration W", 8, 18);
  if (about && !about.simulated) text(pen, colors.quiet, "read by SDO", 8, height - 8);
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

// Least and greatest value since the sample before, or the value itself; null if there is none.
function extremesOf({values, extremes, mode}, name) {
  if (name === "Setpoint.Amplitude" && !mode.startsWith("amplitude")) return null;  // it is not in force
  return extremes[name] ?? (values[name] === undefined ? null : [values[name], values[name]]);
}

// A curve: each sample holds from the one before it, as a step of its value within a band from the
// least to the greatest value in between. So no chart joins by a slope what the loop did in steps.
function drawCurve(pen, color, rows, name, x, y) {
  const points = [];
  pen.fillStyle = color;
  pen.globalAlpha = .3;
  rows.forEach((row, rank) => {
    const found = extremesOf(row, name), before = rows[rank - 1]?.t ?? row.t;
    if (found === null || row.t - before > GAP_S) points.push([x(before), null]);
    if (found === null) return;
    const from = x(row.t - before > GAP_S ? row.t : before), value = y(row.values[name] ?? found[1]);
    pen.fillRect(from, y(found[1]), Math.max(1, x(row.t) - from), y(found[0]) - y(found[1]));
    points.push([from, value], [x(row.t), value]);
  });
  pen.globalAlpha = 1;
  stroke(pen, color, points);
}

function scaleOf(title, rows, lines) {
  const all = rows.flatMap(row => lines.flatMap(([name]) => extremesOf(row, name) ?? []));
  let low = all.length ? Math.min(...all) : 0, high = all.length ? Math.max(...all) : 1;
  const least = LEAST_SWING[title] ?? .05;
  if (high - low < least) { const middle = (low + high) / 2; low = middle - least / 2; high = middle + least / 2; }
  const tick = step((high - low) / 2);
  return [Math.floor(low / tick + 1e-9) * tick, Math.ceil(high / tick - 1e-9) * tick, tick];
}

function drawChart(element, [title, unit, lines], rows, [begin, end]) {
  const [pen, width, height] = canvas(element);
  const [left, right, top, base] = [LEFT, width - RIGHT, 22, height - 18];
  const [low, high, tick] = scaleOf(title, rows, lines);
  const digits = Math.max(0, -Math.floor(Math.log10(tick) + 1e-9));
  const x = t => left + (t - begin) / (end - begin) * (right - left);
  const y = value => base - (value - low) / (high - low) * (base - top);
  for (let count = Math.round(low / tick); count <= Math.round(high / tick); count++) {
    stroke(pen, colors.grid, [[left, y(count * tick)], [right, y(count * tick)]]);
    text(pen, colors.quiet, (count * tick).toFixed(digits), left - 5, y(count * tick) + 4, "right");
  }
  for (const [share, align] of [[0, "left"], [.25, "center"], [.5, "center"], [.75, "center"], [1, "right"]])
    text(pen, colors.quiet, `${(end - (1 - share) * span - newest()).toFixed(span < 10 ? 1 : 0)} s`,
      left + share * (right - left), height - 4, align);
  pen.font = "600 12px system-ui, sans-serif";
  const head = unit ? `${title} (${unit})` : title;
  text(pen, colors.ink, head, left, 15);
  let place = left + pen.measureText(head).width + 14;
  pen.font = "12px system-ui, sans-serif";
  for (const [name, color] of lines) {
    drawCurve(pen, colors[color], rows, name, x, y);
    text(pen, colors[color], WORDS[name], place, 15);
    place += pen.measureText(WORDS[name]).width + 12;
  }
  if (cursor === null) return;
  const px = left + cursor * (right - left), t = begin + cursor * (end - begin);
  stroke(pen, colors.quiet, [[px, top], [px, base]]);
  const near = rows.reduce((best, row) => Math.abs(row.t - t) < Math.abs((best?.t ?? 1e9) - t) ? row : best, null);
  if (near) text(pen, colors.ink, lines.map(([name]) => shown(near.values[name])).join("  "), right, 15, "right");
}

function draw() {
  drawPlate();
  drawPlane();
  const rows = visible(), ends = windowNow();
  write("cursor", cursor === null ? "" :
    `cursor at ${(ends[1] - (1 - cursor) * span - newest()).toFixed(1)} s`);
  CHARTS.forEach((chart, number) => drawChart($("charts").children[number], chart, rows, ends));
}

// All pictures in one, as they are shown.
function picture() {
  const charts = [...$("charts").children], whole = document.createElement("canvas");
  const pen = whole.getContext("2d"), plate = $("plate"), plane = $("plane");
  whole.width = Math.max(charts[0].width, plate.width + (plane.clientWidth && plane.width));
  whole.height = charts.reduce((sum, chart) => sum + chart.height, plate.height);
  pen.fillStyle = colors.card;
  pen.fillRect(0, 0, whole.width, whole.height);
  pen.drawImage(plate, 0, 0);
  if (plane.clientWidth) pen.drawImage(plane, whole.width - plane.width, 0);
  let top = plate.height;
  for (const chart of charts) { pen.drawImage(chart, 0, top); top += chart.height; }
  return whole.toDataURL();
}
