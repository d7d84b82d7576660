"use strict";
// One WebSocket to the server that this page came from. Each update is answered when it has been
// drawn: the server sends no other one before, and takes the answer for the sign of life of a driver.
//
// The page does not wait for an update to tell that there is none: its own clock calls `judge`. An
// update was made after the answer to the one before, so it is no older than that, however long the
// network has kept it. What was live is dimmed and dated when it is older than `OLD_S`.

const $ = id => document.getElementById(id);
const KEPT_S = 600, OLD_S = 1, JUDGE_MS = 100;
const CLOSED = [1008, 1013];             // with a reason: no page that comes again by itself
const token = location.hash.slice(1);

let socket, about, update = null;
let answeredAt = 0;                      // of the last update: by performance.now, as all times in ms
let newsAt = -Infinity, newsDate = "";   // of what is shown, at the latest
let gone = "Connecting.";                // why there is no connection
let stops = 0, stopAt = null;            // stops sent on this connection; the first not confirmed
let textures = [];                       // by slot: {label, over, bins}, or null
let samples = [];                        // {t, values, extremes, mode}

const send = message => socket.readyState === 1 && socket.send(JSON.stringify(message));
const line = text => send({do: "line", text});
const drive = () => token && send({do: "drive"});
// What the device and the server write in ASCII, as it is printed.
const printed = text => String(text).replace(/\bum\b/g, "µm").replace(/\bus\b/g, "µs").replace(/\bdegC\b/g, "°C");

function write(id, text) {
  // A screen reader says what is written anew.
  if ($(id).textContent !== text) $(id).textContent = text;
}

function connect() {
  socket = new WebSocket(`ws://${location.host}/live?token=${encodeURIComponent(token)}`);
  answeredAt = performance.now();
  socket.onmessage = event => {
    const message = JSON.parse(event.data);
    if (!("n" in message)) {
      stops = 0;
      about = message;
      introduce();
      drive();
      if (stopAt !== null) stop();  // it was meant, and may not have arrived
      return;
    }
    take(message);
    send({do: "seen", n: message.n});
    answeredAt = performance.now();
  };
  socket.onclose = event => {
    const closed = CLOSED.includes(event.code);
    gone = closed ? closing(event.reason) : "No connection. Is smarttac panel still running?";
    newsAt = -Infinity;
    judge();
    if (!closed) setTimeout(connect, 1000);
  };
}

const closing = reason => reason === "wrong token" ?
  "The token in this address is wrong: the panel makes a new token at each start. " +
    "Open the address that smarttac panel printed last." :
  `The panel has closed this page: ${reason}. Open the address that smarttac panel printed.`;

function stop() {
  if ($("stop").hidden) { stopAt = null; return; }  // a page that only looks on
  stopAt ??= performance.now();
  stops += 1;
  send({do: "stop"});
  judge();
}

const isOld = () => performance.now() - newsAt > 1e3 * OLD_S;
const drives = () => !isOld() && update.drives;

function take(now) {
  update = now;
  gone = "";
  if (now.textures) { textures = now.textures; nameTextures(); }
  if (now.t !== undefined && now.t !== samples.at(-1)?.t)
    samples.push({t: now.t, values: now.values, extremes: now.extremes, mode: now.mode});
  while (samples.length && samples[0].t < now.t - KEPT_S) samples.shift();
  newsAt = now.age === undefined ? -Infinity : answeredAt - 1e3 * now.age;
  if (now.age !== undefined) newsDate = new Date(Date.now() - performance.now() + newsAt).toLocaleTimeString();
  if (now.stops === stops) stopAt = null;
  judge();
  show(now);
}

// Show what is known now, whether an update has come or not.
function judge() {
  const old = isOld(), words = [];
  document.body.classList.toggle("old", old);
  write("dated", old && newsDate ? `as of ${newsDate}` : "");
  write("state", gone ? "no connection" : old ? "no news" : update.state || "nothing heard");
  $("state").className = `badge ${old ? "fault" : update.state}`;
  $("drive").disabled = old;
  $("driving").disabled = !drives();
  if (stopAt !== null && (old || performance.now() - stopAt > 1e3 * OLD_S))
    words.push("STOP IS NOT CONFIRMED: cut the supply of the power stage.");
  if (gone) words.push(gone);
  else if (old) words.push("No news: the panel, its computer or the network does not respond. Dimmed values are old.");
  else {
    for (const [text, remedy] of update.faults || [])
      words.push(`FAULT: ${text}. The plate is at 0 V.\nTo do: ${remedy}${about.simulated ? "; here, click Mend" : ""}. ` +
        "Then click Reset fault, and a mode.");
    words.push(...update.notes || []);
    if (about.drives && !token)
      words.push("This page only shows: its address has no token. To stop or drive, open the address that smarttac panel printed.");
  }
  const alarm = printed(words.join("\n"));
  write("alarm", alarm);
  $("alarm").hidden = !alarm;
}
