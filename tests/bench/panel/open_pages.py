"""Pages of a panel without a browser: the frames of one, on the real server on loopback."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from time import monotonic
from typing import Any

from aiohttp import ClientSession, ClientWebSocketResponse
from nodes_on_a_bus import GUARD_S

from smarttac_can.bench.panel.instrument import Instrument
from smarttac_can.bench.panel.server import Panel, serve
from smarttac_can.bench.watch.commands import in_words

HEARTBEAT_S = 1.0
"""Time of the heartbeat of a bench, in which a driver that is gone must be missed."""
TOKEN = "secret"


def refuse(constant: str) -> None:
    raise AssertionError(f"a browser does not read {constant}")


class Page:
    """An open page that answers each update, unless it is told to fall silent."""

    def __init__(self, socket: ClientWebSocketResponse) -> None:
        self.socket = socket
        self.silent = False
        self.numbers: list[int] = []
        self.introduction: dict[str, Any] = {}
        self.now: dict[str, Any] = {}

    async def follow(self) -> None:
        async for message in self.socket:
            update = json.loads(message.data, parse_constant=refuse)
            if "n" not in update:
                self.introduction = update
                continue
            self.now = update
            self.numbers.append(update["n"])
            if not self.silent:
                await self.answer()

    async def answer(self) -> None:
        with suppress(ConnectionError):
            await self.send(do="seen", n=self.numbers[-1])

    async def send(self, **message: Any) -> None:
        await self.socket.send_str(json.dumps(message))

    async def drive(self) -> None:
        await self.send(do="drive")
        await self.until(lambda: self.now.get("drives"))

    async def line(self, text: str) -> None:
        """Have a line obeyed."""
        await self.send(do="line", text=text)
        await self.until(lambda: self.now.get("answer") == f"done: {in_words(text)}")

    async def run_open_loop(self) -> None:
        """Drive the plate with 40 V."""
        await self.drive()
        await self.line("voltage 40")
        await self.line("mode open_loop")
        await self.until(lambda: self.now["values"].get("Vibration.Voltage") == 40.0)

    async def until_next(self) -> None:
        """Wait for two more updates, one of which was made after this call."""
        seen = len(self.numbers)
        await self.until(lambda: len(self.numbers) > seen + 1)

    async def until(self, true: Callable[[], object]) -> None:
        guard = monotonic() + GUARD_S
        while not true():
            assert monotonic() < guard, self.now
            assert not self.socket.closed, (self.socket.close_code, self.now)
            await asyncio.sleep(0.01)


class Browser:
    """Opens pages of one panel."""

    def __init__(self, session: ClientSession, port: int, token: str = TOKEN) -> None:
        self.session = session
        self.port = port
        self.token = token
        self.url = f"http://127.0.0.1:{port}"

    @asynccontextmanager
    async def page(self, token: str | None = None, **headers: str) -> AsyncIterator[Page]:
        """Open a page with the token of the panel, or another one."""
        live = f"{self.url}/live?token={self.token if token is None else token}"
        asked = {"Origin": self.url} | headers
        async with self.session.ws_connect(live, headers=asked) as socket:
            page = Page(socket)
            following = asyncio.create_task(page.follow())
            try:
                await page.until(lambda: page.now)
                yield page
            finally:
                following.cancel()


def browse(instrument: Instrument, script: Callable[[Browser], Awaitable[None]]) -> None:
    """Serve an instrument that runs, on a free port, while a script looks at it."""

    async def run() -> None:
        port: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        panel = Panel(instrument, TOKEN, "127.0.0.1")
        server = asyncio.create_task(serve(panel, "127.0.0.1", 0, port.set_result))
        try:
            async with ClientSession() as session:
                await script(Browser(session, await port))
        finally:
            server.cancel()
            with suppress(asyncio.CancelledError):
                await server

    with instrument:
        asyncio.run(run())


def voltage(instrument: Instrument) -> float:
    assert instrument.seen is not None
    return instrument.seen.view.values["Vibration.Voltage"]


async def seconds_to_0_v(instrument: Instrument) -> float:
    begun = monotonic()
    while voltage(instrument):
        assert monotonic() < begun + GUARD_S
        await asyncio.sleep(0.002)
    assert instrument.seen is not None
    return instrument.seen.at - begun
