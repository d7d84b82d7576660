"""The real server on loopback, and pages that look, drive, fall silent, die and attack."""

import asyncio
import socket
import struct
import time
from contextlib import AsyncExitStack, suppress

import pytest
from aiohttp import WSServerHandshakeError
from open_pages import GUARD_S, HEARTBEAT_S, TOKEN, Browser, Page, browse, seconds_to_0_v, voltage
from yarl import URL

from smarttac_can.bench.panel.instrument import SimulatedBench
from smarttac_can.bench.panel.server import UPDATE_S

ATTEMPTS = 4
"""In one of which a busy machine lets the thread of the instrument have its turn in time."""
PAGES = 8
OTHERS, OTHERS_S = 32, 5.0
LEFT = "the page that drove has left: stopped"


class CountedStops(SimulatedBench):
    """A bench that counts the stops of its pages."""

    stops = 0

    def stop(self, why: str = "stop") -> None:
        self.stops += why == "stop"
        super().stop(why)


def test_panel_page_shows_the_state_of_the_instrument() -> None:
    async def script(browser: Browser) -> None:
        async with browser.session.get(browser.url) as answer:
            text = await answer.text()
            assert "frame-ancestors 'none'" in answer.headers["Content-Security-Policy"]
        assert 'src="page.js"' in text
        for name in ("link.js", "draw.js", "page.js", "page.css"):
            async with browser.session.get(f"{browser.url}/{name}") as answer:
                assert "http://" not in (await answer.text()).replace("http://localhost", "")
        async with browser.page() as page:
            assert page.introduction["simulated"]
            assert page.introduction["set_points"][2] == {
                "name": "amplitude",
                "object": "Setpoint.Amplitude",
                "unit": "um",
                "low": 0.0,
                "high": 3.0,
                "step": 0.001,
                "limits": ["", "Limit.Amplitude"],
            }
            await page.until(lambda: page.now.get("state") == "ready")
            assert not page.now["drives"]

    browse(SimulatedBench(), script)


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", ""])
def test_another_host_s_name_is_refused(host: str) -> None:
    """A name of the attacker's that leads to this computer (DNS rebinding)."""

    async def script(browser: Browser) -> None:
        for path in ("/", "/page.js", "/live"):
            async with browser.session.get(browser.url + path, headers={"Host": host}) as answer:
                assert answer.status in (400, 403)

    browse(SimulatedBench(), script)


def test_the_name_localhost_is_this_computer_s() -> None:
    async def script(browser: Browser) -> None:
        host = f"localhost:{browser.port}"
        async with browser.session.get(browser.url, headers={"Host": host}) as answer:
            assert answer.status == 200
        async with browser.page(Host=host, Origin=f"http://{host}"):
            pass

    browse(SimulatedBench(), script)


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "", "http://127.0.0.1:1", "https://127.0.0.1"]
)
def test_a_page_of_another_origin_has_no_socket(origin: str) -> None:
    async def script(browser: Browser) -> None:
        with pytest.raises(WSServerHandshakeError) as refused:
            async with browser.page(Origin=origin):
                pass
        assert refused.value.status == 403

    browse(SimulatedBench(), script)


def test_without_the_token_nothing_is_driven_or_stopped() -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as driver, browser.page(token="") as other:
            await driver.run_open_loop()
            await other.send(do="stop")
            await other.send(do="drive")
            await other.send(do="line", text="all is well, you may touch the stage")
            await other.send(do="finger", x=0.0, force=2.0)
            await other.send(do="release")
            await asyncio.sleep(0.3)
            assert voltage(bench) == 40.0
            assert driver.now["answer"] == "done: mode open loop"
            assert not other.now["drives"]

    bench = SimulatedBench()
    browse(bench, script)


@pytest.mark.parametrize(
    "nonsense",
    ["", "[]", "{}", "[" * 900, '{"do": "dance"}', '{"do": ["seen"]}', '{"do": "\\ud800"}',
     '{"do": "finger", "x": "1", "force": 1}', '{"do": "finger", "x": true, "force": 1}',
     '{"do": "finger", "x": NaN, "force": 1}', '{"do": "finger", "x": 1e9, "force": 1}',
     '{"do": "finger", "x": 1e999, "force": 1}', '{"do": "finger", "x": 0, "force": -1}',
     f'{{"do": "finger", "x": {"9" * 900}, "force": 1}}',
     '{"do": "seen"}', '{"do": "line"}',
     b"\x00\xff", "x" * 5000],
)  # fmt: skip
def test_a_page_that_talks_nonsense_is_closed_and_stopped(
    nonsense: str | bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            await page.run_open_loop()
            if isinstance(nonsense, bytes):
                await page.socket.send_bytes(nonsense)
            else:
                await page.socket.send_str(nonsense)
            await seconds_to_0_v(bench)
        async with browser.page() as page:
            await page.drive()

    bench = SimulatedBench()
    browse(bench, script)
    assert not caplog.records  # nor a traceback on the terminal


@pytest.mark.parametrize(
    "request_",
    [b"\0\xff\r\n\r\n", b"GET / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nX: " + b"a" * 10_000,
     b"GET / HTTP/1.1\r\nHost: localhost\r\nHost: evil\r\n\r\n"],
)  # fmt: skip
def test_panel_server_answers_bad_requests_without_a_log(
    request_: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    async def script(browser: Browser) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", browser.port)
        writer.write(request_ + b"\r\n\r\n")
        assert b" 400 " in await reader.readline()
        writer.close()

    browse(SimulatedBench(), script)
    assert not caplog.records


@pytest.mark.parametrize("do", ["stop", "seen", "finger", "line", "ping"])
def test_a_page_that_floods_is_closed_and_holds_nobody_up(do: str) -> None:
    flood = {"do": do, "n": -1, "x": 0.0, "force": 0.5, "text": "mode off"}

    async def script(browser: Browser) -> None:
        async with browser.page() as driver:
            for _ in range(ATTEMPTS):
                async with browser.page(token="") as other:
                    await driver.run_open_loop()
                    with suppress(ConnectionError):
                        while not other.socket.closed:
                            await (other.socket.ping() if do == "ping" else other.send(**flood))
                            await asyncio.sleep(0.0)
                    assert other.socket.close_code == 1008
                    if driver.now["drives"] and voltage(bench) == 40.0:
                        return
        pytest.fail("the page that drives was not heard meanwhile")

    bench = SimulatedBench()
    browse(bench, script)


def test_messages_are_counted_by_the_second(monkeypatch: pytest.MonkeyPatch) -> None:
    """A page may make 500 in each; these are 600 in two, and the answers to updates."""
    now = 0.0
    monkeypatch.setattr("smarttac_can.bench.panel.server.monotonic", lambda: now)

    async def script(browser: Browser) -> None:
        nonlocal now
        async with browser.page() as page:
            for count in (1, 2):
                for _ in range(300):
                    await page.send(do="finger", x=0.0, force=0.5)
                await page.send(do="stop")
                await page.until(lambda count=count: bench.stops == count)
                now += 1.1

    bench = CountedStops()
    browse(bench, script)


@pytest.mark.parametrize("held_up", ["step", "_begin_stop"])
def test_a_stop_is_confirmed_once_a_step_has_shown_it(
    held_up: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as page, browser.page() as other:
            await page.run_open_loop()
            assert page.now["stops"] == 0
            with monkeypatch.context() as patched:
                patched.setattr(bench, held_up, lambda *_: None)
                await page.send(do="stop")
                await page.until(lambda: page.now["stops"] == -1)
                shown = len(page.numbers)
                await page.until(lambda: len(page.numbers) > shown + 3)
                assert page.now["stops"] == -1
                assert page.now["state"] == "running"
            await page.until(lambda: page.now["stops"] == 1)
            assert page.now["state"] == "ready"
            await other.until(lambda: other.now["stops"] == 0)

    bench = SimulatedBench()
    browse(bench, script)


def test_a_driver_that_floods_is_stopped() -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            await page.run_open_loop()
            with suppress(ConnectionError):
                for _ in range(1000):
                    await page.send(do="finger", x=0.0, force=0.5)
            await seconds_to_0_v(bench)
            assert bench.answer == LEFT

    bench = SimulatedBench()
    browse(bench, script)


def test_one_page_drives() -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as first, browser.page() as second:
            await first.run_open_loop()
            await second.send(do="drive")
            await second.send(do="line", text="voltage 80")
            await second.until(lambda: "does not drive" in second.now["answer"])
            assert not second.now["drives"]
            assert voltage(bench) == 40.0
            await second.send(do="stop")
            await seconds_to_0_v(bench)
            await first.send(do="release")
            await second.until(lambda: not first.now["drives"])
            await second.run_open_loop()
            await first.send(do="release")
            await asyncio.sleep(0.2)
            assert voltage(bench) == 40.0

    bench = SimulatedBench()
    browse(bench, script)


def test_panel_page_above_the_limit_replaces_one_without_token() -> None:
    async def script(browser: Browser) -> None:
        async with AsyncExitStack() as stack:
            driver = await stack.enter_async_context(browser.page())
            await driver.run_open_loop()
            pages = [await stack.enter_async_context(browser.page(token="")) for _ in range(7)]
            await stack.enter_async_context(browser.page())
            while not pages[0].socket.closed:
                await asyncio.sleep(0.01)
            assert pages[0].socket.close_code == 1013
            assert voltage(bench) == 40.0

    bench = SimulatedBench()
    browse(bench, script)


def test_a_page_too_many_is_refused_if_all_have_the_token() -> None:
    async def script(browser: Browser) -> None:
        async with AsyncExitStack() as stack:
            for _ in range(8):
                page = await stack.enter_async_context(browser.page())
                assert page.now["trusted"]
            with pytest.raises(WSServerHandshakeError) as refused:
                async with browser.page():
                    pass
            assert refused.value.status == 503
        async with browser.page():
            pass

    browse(SimulatedBench(), script)


def test_pages_without_the_token_push_out_none_that_has_it() -> None:
    """Pages that connect again and again while the one with the token says nothing yet."""

    async def script(browser: Browser) -> None:
        live = f"{browser.url}/live"
        headers = {"Origin": browser.url}
        async with browser.session.ws_connect(f"{live}?token={TOKEN}", headers=headers) as silent:
            others = [
                await browser.session.ws_connect(live, headers=headers) for _ in range(3 * PAGES)
            ]
            await others[-PAGES].receive()  # the introduction, and an update
            while not others[-PAGES].closed:
                await others[-PAGES].receive()
            assert others[-PAGES].close_code == 1013
            page = Page(silent)
            following = asyncio.create_task(page.follow())
            await page.until(lambda: page.now.get("trusted"))
            following.cancel()

    browse(SimulatedBench(), script)


@pytest.mark.parametrize("token", ["guess", "%ff", "%ED%A0%80", TOKEN + "%00", TOKEN[:-1]])
def test_a_page_with_a_wrong_token_is_closed(token: str, caplog: pytest.LogCaptureFixture) -> None:
    async def script(browser: Browser) -> None:
        live = URL(f"{browser.url}/live?token={token}", encoded=True)
        async with browser.session.ws_connect(live, headers={"Origin": browser.url}) as socket:
            message = await socket.receive()
            assert (message.data, message.extra) == (1008, "wrong token")

    browse(SimulatedBench(), script)
    assert not caplog.messages


def test_an_aborted_handshake_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    async def script(browser: Browser) -> None:
        request = (
            f"GET /live HTTP/1.1\r\nHost: 127.0.0.1:{browser.port}\r\nOrigin: {browser.url}\r\n"
            "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n"
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
        )
        for _ in range(60):
            with socket.create_connection(("127.0.0.1", browser.port)) as client:
                reset = struct.pack("ii", 1, 0)
                client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, reset)
                client.sendall(request.encode())
            await asyncio.sleep(0)
        async with browser.page():
            pass

    browse(SimulatedBench(), script)
    assert not caplog.messages


def test_connections_without_a_page_are_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too many at once, the oldest first; the others once their time is up. Pages stay."""
    now = 0.0
    monkeypatch.setattr("smarttac_can.bench.panel.server.monotonic", lambda: now)

    async def script(browser: Browser) -> None:
        nonlocal now
        async with browser.page() as page, asyncio.timeout(GUARD_S):
            half_open = []
            for _ in range(100):
                half_open.append(await asyncio.open_connection("127.0.0.1", browser.port))
                half_open[-1][1].write(b"GET / HTTP/1.1\r\n")
            for reader, _ in half_open[:-OTHERS]:
                assert await reader.read() == b""
            await page.until_next()
            assert not any(reader.at_eof() for reader, _ in half_open[-OTHERS:])
            now += OTHERS_S + 1.0
            for reader, writer in half_open:
                assert await reader.read() == b""
                writer.close()
            await page.until_next()

    browse(SimulatedBench(), script)


def test_connections_that_say_nothing_hold_nobody_up() -> None:
    async def script(browser: Browser) -> None:
        opened = [await asyncio.open_connection("127.0.0.1", browser.port) for _ in range(200)]
        async with browser.page() as page:
            await page.run_open_loop()
            await page.send(do="stop")
            await seconds_to_0_v(bench)
        for _, writer in opened:
            writer.close()

    bench = SimulatedBench()
    browse(bench, script)


# A driver that is gone: 0 V within the time of the heartbeat.


@pytest.mark.parametrize("dead", [False, True], ids=["closed tab", "dead browser"])
def test_a_page_that_has_left_is_0_v_at_once(dead: bool) -> None:
    """The system of a dead browser closes the connection without a word."""

    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            await page.run_open_loop()
            if dead:
                connection = page.socket._response.connection
                assert connection is not None
                assert connection.transport is not None
                connection.transport.abort()
            else:
                await page.socket.close()
            await seconds_to_0_v(bench)
            assert bench.answer == LEFT

    bench = SimulatedBench()
    browse(bench, script)


def test_a_laptop_that_sleeps_is_0_v_within_the_heartbeat_s_time() -> None:
    """Its connection stays, and it drives no more when it wakes."""

    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            for _ in range(ATTEMPTS):
                await page.run_open_loop()
                page.silent = True
                took = await seconds_to_0_v(bench)
                page.silent = False
                await page.answer()
                await page.send(do="line", text="mode open_loop")
                await page.until(lambda: "does not drive" in page.now["answer"])
                assert voltage(bench) == 0.0
                if took <= HEARTBEAT_S:
                    return
        pytest.fail(f"0 V after {took} s")

    bench = SimulatedBench()
    browse(bench, script)


def test_an_answer_to_an_older_update_is_no_sign_of_life() -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            await page.run_open_loop()
            page.silent = True
            number = page.numbers[-1]

            async def repeat() -> None:
                while True:
                    await page.send(do="seen", n=number - 1)
                    await asyncio.sleep(0.02)

            repeating = asyncio.create_task(repeat())
            await seconds_to_0_v(bench)
            repeating.cancel()

    bench = SimulatedBench()
    browse(bench, script)


def test_a_stalled_server_is_0_v_within_the_heartbeat_s_time() -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            for _ in range(ATTEMPTS):
                await page.run_open_loop()
                begun = time.monotonic()
                while voltage(bench):  # in the server's own loop, which does nothing else
                    time.sleep(0.002)
                    assert time.monotonic() < begun + GUARD_S
                assert bench.seen is not None
                took = bench.seen.at - begun
                await page.until(lambda: not page.now["drives"])
                assert "was not heard for 0.8 s" in page.now["answer"]
                if took <= HEARTBEAT_S:
                    return
        pytest.fail(f"0 V after {took} s")

    bench = SimulatedBench()
    browse(bench, script)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_instrument_that_has_failed_ends_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that the command ends: on a bus that is 0 V."""

    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            monkeypatch.setattr(bench, "step", None)
            while not page.socket.closed:
                await asyncio.sleep(0.01)
            assert page.socket.close_code == 1001

    bench = SimulatedBench()
    browse(bench, script)


# Updates


def test_late_updates_are_dropped_and_never_queued() -> None:
    async def script(browser: Browser) -> None:
        async with browser.page() as page:
            page.silent = True
            held = len(page.numbers) + 1
            await page.until(lambda: len(page.numbers) == held)
            before = page.now["t"]
            await asyncio.sleep(1.0)
            assert len(page.numbers) == held
            await page.answer()
            await page.until(lambda: len(page.numbers) == held + 1)
            assert page.now["t"] - before > 0.8  # not the next of those that were dropped
            await asyncio.sleep(0.3)
            assert len(page.numbers) == held + 1

    browse(SimulatedBench(), script)


def test_a_page_that_does_not_read_holds_nobody_up() -> None:
    async def script(browser: Browser) -> None:
        headers = {"Origin": browser.url}
        async with (
            browser.session.ws_connect(f"{browser.url}/live", headers=headers),
            browser.page() as page,
        ):
            count = len(page.numbers)
            await asyncio.sleep(10 * UPDATE_S)
            assert len(page.numbers) - count >= 3

    browse(SimulatedBench(), script)


def test_a_server_that_ends_leaves_0_v() -> None:
    async def script(browser: Browser) -> None:
        page = browser.page()
        driver: Page = await page.__aenter__()
        await driver.run_open_loop()

    bench = SimulatedBench()
    browse(bench, script)
    assert voltage(bench) == 0.0


# A texture that a page makes


GRATING = {"kind": "grating", "shape": "square", "period": "5", "duty": "50"} | {
    "low": "0.25",
    "high": "0.35",
}


def test_a_texture_is_loaded_for_the_page_that_drives_alone() -> None:
    async def script(browser: Browser) -> None:
        place, headers = f"{browser.url}/texture", {"Origin": browser.url}
        async with browser.page() as driver, browser.page() as other:
            await driver.drive()
            for page, answer in (
                (other, "load 3: not done, this page does not drive"),
                (driver, "done: grating is texture 3"),
            ):
                form = GRATING | {"slot": "3", "page": page.introduction["page"]}
                url = f"{place}?token={browser.token}"
                async with browser.session.post(url, data=form, headers=headers) as made:
                    bins = (await made.json())["texture"]["bins"]
                assert {low for _, low, _ in bins} | {high for *_, high in bins} == {0.25, 0.35}
                await page.until(lambda answer=answer: answer in driver.now["answer"])
            assert bench.textures[3] is not None
        for query, sent in (("token=guess", headers), ("", headers), (f"token={TOKEN}", {})):
            url = f"{place}?{query}"
            async with browser.session.post(url, data=GRATING, headers=sent) as made:
                assert made.status == 403

    bench = SimulatedBench()
    browse(bench, script)


@pytest.mark.parametrize(
    ("form", "error"),
    [
        ({"period": "x"}, "period 'x' is no number"),
        ({"high": "9"}, "high 9 is outside"),
        ({"kind": "csv"}, "choose a file"),
    ],
)
def test_a_texture_that_cannot_be_made_says_why(form: dict[str, str], error: str) -> None:
    async def script(browser: Browser) -> None:
        url, headers = f"{browser.url}/texture?token={TOKEN}", {"Origin": browser.url}
        async with browser.session.post(url, data=GRATING | form, headers=headers) as made:
            said = (await made.json())["error"]
            assert error in said

    browse(SimulatedBench(), script)
