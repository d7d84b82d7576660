"""The server of a panel: one page, and a WebSocket for each that is open. Needs aiohttp.

The server sends a numbered update, and the next one only after the page has confirmed that it shows
this one. Updates are skipped meanwhile, so nothing queues. The confirmation is also the sign of
life of the driving page: see `Instrument`.

Who may do what:

* Any page of this server looks on. A request whose Host is not this server's, or a WebSocket whose
  Origin is not, is refused: it comes from a page of somebody else.
* A page with the token may stop the instrument, and drive it while no other page does.
* A page that talks nonsense, or more than a person makes it, is closed. If too many are open, the
  one that came first of those without the token is closed. A page shows its token as it connects,
  so that one that has it is never closed for another.
* A connection without a page is closed after a few seconds, or before that if there are too many.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Awaitable, Callable, Iterable, Mapping
from contextlib import suppress
from functools import partial
from hmac import compare_digest
from ipaddress import ip_address
from math import isfinite
from pathlib import Path
from secrets import token_urlsafe
from tempfile import TemporaryDirectory
from time import monotonic
from typing import Any, Final

from aiohttp import ClientConnectionError, WSMsgType, web
from aiohttp.http import HttpProcessingError

from smarttac_can import __version__
from smarttac_can.bench import BenchError, Texture
from smarttac_can.bench.panel.instrument import FAULTS, SLOTS, Instrument, Seen
from smarttac_can.bench.panel.textures import drawn, made, with_warnings
from smarttac_can.bench.recording_file import channel_name
from smarttac_can.bench.watch.watcher import PUBLISHED
from smarttac_can.bench.watch.wording import identification
from smarttac_can.vocabulary.meanings import spoken
from smarttac_can.vocabulary.states import Law, Mode, VibrationLaw

UPDATE_S: Final = 0.1
_MOST_PAGES: Final = 8
_MOST_OTHERS: Final = 32
"""Most connections without a page: a browser opens up to 6 for its files."""
_OTHERS_S: Final = 5.0
"""Longest time in s for which a connection without a page stays open."""
_MOST_BYTES: Final = 1000
"""Most bytes of a message from a page."""
_MOST_MESSAGES: Final = 500
"""Most messages of a page in a second: a mouse makes one a picture, 240 at most."""
_TOO_MANY: Final = 1013
"""Close code of a page that is not to connect again by itself (RFC 6455: try again later)."""
_PING_S: Final = 10.0
_SHUTDOWN_S: Final = 1.0
_MOST_UPLOADED: Final = 16 << 20
"""Most bytes of a picture or a table from a page."""
_LONGEST_LABEL: Final = 60
_KEY_BYTES: Final = 16
_DIGITS: Final = 6
_FILES: Final = {
    "/": ("page.html", "text/html"),
    "/page.css": ("page.css", "text/css"),
    **{f"/{name}.js": (f"{name}.js", "text/javascript") for name in ("link", "draw", "page")},
}
_HEADERS: Final = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "default-src 'self'; img-src 'self' data:; frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
_SET_POINTS: Final = (
    ("cof left", "Setpoint.COF left", "", ("", "")),
    ("cof right", "Setpoint.COF right", "", ("", "")),
    ("amplitude", "Setpoint.Amplitude", "um", ("", "Limit.Amplitude")),
    ("voltage", "Setpoint.Voltage", "V", ("", "Limit.Voltage")),
    (
        "frequency",
        "Setpoint.Frequency",
        "Hz",
        ("Limit.Lowest frequency", "Limit.Highest frequency"),
    ),
    ("boundary", "Setpoint.Boundary", "mm", ("", "")),
)
"""Command, object, unit, and the objects that narrow its limits, of each set-point."""
_CHANNELS: Final = (*(name for name in PUBLISHED), "Setpoint.Amplitude")
"""Objects in the CSV file of the page."""
_NO_MODES: Final = (Mode.OFF, Mode.IDENTIFY)
"""Modes that are no button: STOP is the one, a step of the preparation the other."""
_Handler = Callable[[web.Request], Awaitable[web.StreamResponse]]


class _Page:
    """An open page."""

    def __init__(self, *, trusted: bool) -> None:
        self.trusted = trusted
        """Whether it has shown the token."""
        self.key = token_urlsafe(_KEY_BYTES)
        """What it names itself by in a request of its own."""
        self.sent = 0
        self.seen = 0
        self.shown_to = monotonic()
        """Time in s of the state in its last update."""
        self.textures_shown = -1
        """Number of changes of the textures in its last update."""
        self.stops = 0
        self.stopped_at = 0.0
        """Time in s after its last stop was passed on."""

    def confirmed_stops(self, seen: Seen | None) -> int:
        """Return the number of its stops, or -1 before a step after the last one has shown it."""
        shown = seen is not None and seen.at > self.stopped_at and not seen.stopping
        return self.stops if shown else -1


class Panel:
    """Show an instrument to every page, and let one page with the token drive it.

    Parameters
    ----------
    instrument
        Running instrument.
    token
        Token that a page needs to stop and to drive.
    host
        Name or address with which pages reach the server.
    """

    def __init__(self, instrument: Instrument, token: str, host: str) -> None:
        self._instrument = instrument
        self._token = token.encode()
        self._hosts = {f"[{host}]" if ":" in host else host}
        if _is_loopback(host):
            self._hosts.add("localhost")
        folder = Path(__file__).parent
        self._files = {
            place: ((folder / name).read_text("utf-8"), kind)
            for place, (name, kind) in _FILES.items()
        }
        self._pages: dict[web.WebSocketResponse, _Page] = {}
        self._connected: set[web.RequestHandler] = set()
        """Connections of the pages."""
        self._others: dict[web.RequestHandler, float] = {}
        """Other connections, the oldest first, and the time in s at which each was first seen."""

    def close_others(self, connections: Iterable[web.RequestHandler]) -> None:
        """Close connections without a page that are too many or too old; oldest first."""
        now = monotonic()
        others = [each for each in connections if each not in self._connected]
        self._others = {each: self._others.get(each, now) for each in others}
        for after, (each, since) in enumerate(reversed(self._others.items())):
            if after >= _MOST_OTHERS or now - since > _OTHERS_S:
                each.force_close()

    @property
    def alive(self) -> bool:
        """Whether its instrument still runs."""
        return self._instrument.alive

    def app(self) -> web.Application:
        """Return the aiohttp application of the panel."""
        app = web.Application(middlewares=[self._check], client_max_size=_MOST_UPLOADED)
        for place in self._files:
            app.router.add_get(place, self._file)
        app.router.add_get("/live", self._live)
        app.router.add_post("/texture", self._texture)
        app.on_shutdown.append(self._close)
        return app

    @web.middleware
    async def _check(self, request: web.Request, handler: _Handler) -> web.StreamResponse:
        """Refuse requests with another host name, which may come from a foreign page."""
        host = request.headers.get("Host", "")
        name = host.rpartition(":")[0] if host[-1:] != "]" and ":" in host else host
        if name not in self._hosts:
            raise web.HTTPForbidden(text=f"Host {host!r} is not this panel's\n")
        return await handler(request)

    async def _file(self, request: web.Request) -> web.Response:
        text, kind = self._files[request.path]
        return web.Response(text=text, content_type=kind, headers=_HEADERS)

    async def _texture(self, request: web.Request) -> web.Response:
        """Make a texture of a form; return its drawing, or load it into the slot of the form."""
        self._require_origin(request)
        token = request.query.get("token", "").encode(errors="replace")
        if not compare_digest(token, self._token):
            raise web.HTTPForbidden(text="a texture needs the token of this panel\n")
        form = await request.post()
        fields = {name: value for name, value in form.items() if isinstance(value, str)}
        upload = form.get("file")
        content = upload.file.read() if isinstance(upload, web.FileField) else b""
        try:
            texture, warned = await asyncio.to_thread(_made, fields, content)
        except (ValueError, OSError, BenchError) as error:
            return web.json_response({"error": str(error)}, headers=_HEADERS)
        label = fields.get("label", "")[:_LONGEST_LABEL] or fields["kind"]
        drawing = await asyncio.to_thread(drawn, texture, label)
        asking = next(
            (page for page in self._pages.values() if page.key == fields.get("page")), None
        )
        if fields.get("slot", "") in map(str, SLOTS) and asking is not None:
            self._instrument.offer(asking, int(fields["slot"]), texture, label)
        return web.json_response({"texture": drawing, "warned": warned}, headers=_HEADERS)

    def _require_origin(self, request: web.Request) -> None:
        origin = request.headers.get("Origin", "")
        if origin != f"http://{request.headers['Host']}":
            raise web.HTTPForbidden(text=f"Origin {origin!r} is not this panel's\n")

    async def _live(self, request: web.Request) -> web.WebSocketResponse:
        self._require_origin(request)
        token = request.query.get("token", "").encode(errors="replace")
        page = _Page(trusted=compare_digest(token, self._token))
        if len(self._pages) >= _MOST_PAGES:
            self._make_room()
        socket = web.WebSocketResponse(
            heartbeat=_PING_S,
            max_msg_size=_MOST_BYTES,
            compress=False,
            timeout=_SHUTDOWN_S,
            autoping=False,  # a flood of pings is a flood
        )
        self._pages[socket] = page
        self._connected.add(request.protocol)
        try:
            await socket.prepare(request)
            if token and not page.trusted:
                await socket.close(code=1008, message=b"wrong token")
                return socket
            await socket.send_str(json.dumps(self._introduction(page)))
            sender = asyncio.create_task(self._send(socket, page))
            try:
                await self._hear(socket, page)
            finally:
                # First of all: what follows may wait for a page that is gone.
                self._instrument.leave(page)
                sender.cancel()
                with suppress(asyncio.CancelledError):
                    await sender
        finally:
            self._pages.pop(socket, None)
            self._connected.discard(request.protocol)
        return socket

    def _make_room(self) -> None:
        """Drop the oldest page without the token; its sender closes it."""
        for socket, page in self._pages.items():
            if not page.trusted:
                del self._pages[socket]
                return
        raise web.HTTPServiceUnavailable(text=f"{_MOST_PAGES} pages are open already\n")

    async def _hear(self, socket: web.WebSocketResponse, page: _Page) -> None:
        begun, count = monotonic(), 0
        async for message in socket:
            if message.type not in (WSMsgType.TEXT, WSMsgType.PING, WSMsgType.PONG):
                return
            now = monotonic()
            if now - begun > 1.0:
                begun, count = now, 0
            count += 1
            try:
                if count > _MOST_MESSAGES:
                    raise ValueError(f"more than {_MOST_MESSAGES} messages a second")
                if message.type is WSMsgType.TEXT:
                    self._do(page, _asked(message.data))
                elif message.type is WSMsgType.PING:
                    await socket.pong(message.data)
            except (ValueError, KeyError, RecursionError) as error:
                text = f"not understood: {error}".encode()[:100]
                await socket.close(code=1008, message=text)
                return

    def _do(self, page: _Page, asked: Mapping[str, Any]) -> None:
        """Execute a request of a page."""
        instrument = self._instrument
        do = asked["do"]
        if do == "seen":
            if asked["n"] == page.sent:
                page.seen = page.sent
                instrument.lease.renew(page, monotonic())
        elif do == "drive":
            if page.trusted and instrument.drives:
                instrument.lease.take(page, monotonic())
        elif do == "release":
            instrument.leave(page)
        elif do == "stop":
            if page.trusted:
                instrument.stop()
                page.stops += 1
                page.stopped_at = monotonic()
        elif do == "line":
            if page.trusted:
                instrument.command(page, str(asked["text"]))
        elif do == "finger":
            instrument.guide(page, _number(asked["x"]), _number(asked["force"]))
        else:
            raise ValueError(f"{do!r} is not a command of the page")

    async def _send(self, socket: web.WebSocketResponse, page: _Page) -> None:
        """Send an update each `UPDATE_S`, unless the one before is not shown yet."""
        with suppress(ClientConnectionError):
            while socket in self._pages and not socket.closed:
                if page.seen == page.sent:
                    page.sent += 1
                    await socket.send_str(json.dumps(self._update(page)))
                await asyncio.sleep(UPDATE_S)
            await socket.close(code=_TOO_MANY, message=b"too many pages")

    def _introduction(self, page: _Page) -> dict[str, Any]:
        """Return the first message, with everything that does not change."""
        instrument = self._instrument
        rows = []
        for name, of_object, unit, limits in _SET_POINTS:
            entry = instrument.od[of_object]
            low, high, step = (
                round(counts * entry.unit.in_unit(unit), _DIGITS)
                for counts in (entry.low, entry.high, 1)
            )
            rows.append(
                {
                    "name": name,
                    "object": of_object,
                    "unit": unit,
                    "low": low,
                    "high": high,
                    "step": step,
                    "limits": limits,
                }
            )
        return {
            "version": __version__,
            "page": page.key,
            "where": instrument.where,
            "simulated": instrument.simulated,
            "drives": instrument.drives,
            "set_points": rows,
            "modes": [spoken(mode) for mode in Mode if mode not in _NO_MODES],
            "channels": [(channel_name(name), name) for name in _CHANNELS],
            "laws": [law.name.lower() for law in Law],
            "vibration_laws": [law.name.lower() for law in VibrationLaw],
            "faults": FAULTS if instrument.simulated else (),
        }

    def _update(self, page: _Page) -> dict[str, Any]:
        instrument = self._instrument
        seen = instrument.seen
        update: dict[str, Any] = {
            "n": page.sent,
            "drives": instrument.lease.held_by(page),
            "trusted": page.trusted,
            "answer": instrument.answer,
            "stops": page.confirmed_stops(seen),
        }
        if instrument.recorder is not None:
            update["recording"] = instrument.recorder.shown()
        if page.textures_shown != instrument.texture_changes:
            page.textures_shown = instrument.texture_changes
            update["textures"] = list(instrument.textures.values())
        if seen is not None:
            view = seen.view
            update |= {
                "t": round(seen.at, 3),
                "age": round(monotonic() - seen.at, 3),
                "state": view.state,
                "mode": view.mode,
                "flags": view.flags,
                "faults": list(zip(view.latched, view.remedies, strict=True)),
                "notes": view.notes,
                "limited": list(view.limited.items()),
                "message": view.message,
                "model": identification(view.values, view.message),
                "values": {name: round(value, _DIGITS) for name, value in view.values.items()},
                "extremes": {
                    name: (round(low, _DIGITS), round(high, _DIGITS))
                    for name, (low, high) in instrument.extremes.since(page.shown_to).items()
                },
                "cycle_rate": view.cycle_rate and round(view.cycle_rate),
                "peers": [(peer.name, peer.node_id, peer.nmt) for peer in view.peers],
                "emergencies": [
                    (round(emergency.ago, 1), emergency.node_id, emergency.text)
                    for emergency in view.emergencies
                ],
                "bus_load": None if instrument.simulated else round(view.bus_load, 4),
                "frame_rate": view.frame_rate,
            }
            page.shown_to = seen.at
        return update

    async def _close(self, _app: web.Application) -> None:
        for socket in list(self._pages):
            await socket.close(code=1001, message=b"the panel ends")


async def serve(panel: Panel, host: str, port: int, listening: Callable[[int], None]) -> None:
    """Serve a panel until the task is cancelled, or its instrument has failed.

    Parameters
    ----------
    host, port
        Address and port to listen at; port 0 selects any free port.
    listening
        Function that is called with the port as soon as the server listens.

    Raises
    ------
    OSError
        The server cannot listen there.
    """
    logger = logging.getLogger(__name__)
    logger.addFilter(_is_defect)
    runner = web.AppRunner(
        panel.app(), access_log=None, logger=logger, shutdown_timeout=_SHUTDOWN_S
    )
    await runner.setup()
    try:
        await web.TCPSite(runner, host, port).start()
        listening(runner.addresses[0][1])
        while panel.alive:
            assert runner.server is not None
            panel.close_others(runner.server.connections)
            await asyncio.sleep(UPDATE_S)
    finally:
        await runner.cleanup()


def _is_defect(record: logging.LogRecord) -> bool:
    """Return whether to log an error: not of a malformed request, nor of a client that left."""
    error = record.exc_info and record.exc_info[1]
    return not isinstance(error, HttpProcessingError | ClientConnectionError)


def _made(fields: Mapping[str, str], content: bytes) -> tuple[Texture, str]:
    """Make a texture of fields and the content of a file; return it and what was warned of."""
    if not content:
        return with_warnings(partial(made, fields, None))
    with TemporaryDirectory() as folder:
        file = Path(folder, "upload")
        file.write_bytes(content)
        try:
            return with_warnings(partial(made, fields, file))
        except ValueError as error:
            # The name of the file on the server says nothing to who has chosen it.
            raise ValueError(str(error).replace(str(file), "the file")) from error


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _asked(data: str) -> Mapping[str, Any]:
    asked = json.loads(data)
    if not isinstance(asked, dict):
        raise ValueError("no object")
    return asked


def _number(value: object) -> float:
    with suppress(OverflowError):
        if isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value):
            return float(value)
    raise ValueError(f"{value!r} is no number")
