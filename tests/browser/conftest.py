"""The panel in Debian's Chromium; collected only where this folder is asked for by its path.

Without the browser it fails: run it as ``tools/with-browser tools/test tests/browser``. Pictures
of what was seen stay in ``build/browser``.
"""

from __future__ import annotations

import asyncio
import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic, sleep

import pytest
from nodes_on_a_bus import GUARD_S
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

from smarttac_can.bench.panel.instrument import Instrument
from smarttac_can.bench.panel.server import Panel, serve

HERE = Path(__file__).parent
PICTURES = HERE.parents[1] / "build" / "browser"
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--window-size=1280,1000",
    # No name leads anywhere: a page that needs a network would fail.
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
)


def pytest_ignore_collect(config: pytest.Config) -> bool | None:
    asked = [(config.invocation_params.dir / arg.split("::")[0]).resolve() for arg in config.args]
    return None if any(path.is_relative_to(HERE) for path in asked) else True


MEASURED: list[str] = []
"""Measurements of tests, a line each, for the end of the output."""


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    for line in MEASURED:
        terminalreporter.write_line(line)


@pytest.fixture(autouse=True)
def leaves_nothing() -> None:
    """Leave the browser of the session, a child of this process, where it is."""


class Tab:
    """A tab of a browser in which a panel is open."""

    def __init__(self, driver: webdriver.Chrome, downloads: Path) -> None:
        self.driver = driver
        self.downloads = downloads

    def open(self, url: str) -> None:
        self.driver.get("about:blank")
        self.driver.get(url)
        self.until(lambda: self.text("state") not in ("no connection", "no news", "nothing heard"))

    def text(self, name: str) -> str:
        return self.driver.find_element(By.ID, name).text

    def click(self, text: str) -> None:
        """Click the button with a text; it takes commands once the page drives."""
        button = self.driver.find_element(By.XPATH, f"//button[text()='{text}']")
        self.until(button.is_enabled)
        # Not below the header, which stays at the top.
        self.driver.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
        button.click()

    def enter(self, name: str, value: str) -> None:
        """Enter a set-point."""
        field = self.driver.find_element(By.ID, f"set {name}")
        self.until(field.is_enabled)
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(f"{value}\n")

    def values(self) -> dict[str, float]:
        """Return the last update of the page."""
        values: dict[str, float] = self.driver.execute_script("return update?.values ?? {}")
        return values

    def stroke(self, times: int) -> None:
        """Press the mouse on the plate, and go to and fro; it stays down."""
        mouse = ActionChains(self.driver, duration=60)
        plate = self.driver.find_element(By.ID, "plate")
        mouse.move_to_element_with_offset(plate, -150, 0).click_and_hold()
        for _ in range(times):
            for x in (-75, 0, 75, 150, 75, 0, -75, -150):
                mouse.move_to_element_with_offset(plate, x, 0)
        mouse.perform()

    def lift(self) -> None:
        ActionChains(self.driver).release().perform()

    def point(self, element: WebElement, x: int) -> None:
        """Move the mouse to the middle of an element's height, x pixels right of its left edge."""
        mouse = ActionChains(self.driver, duration=0)
        mouse.move_to_element_with_offset(element, x - element.size["width"] // 2, 0).perform()

    def touch(self, element: WebElement, shares: list[float]) -> None:
        """Touch an element at shares of its width, one after the other; lift if there are none."""
        box = self.driver.execute_script(
            "arguments[0].scrollIntoView({block: 'center'}); "
            "return arguments[0].getBoundingClientRect().toJSON()",
            element,
        )
        if not shares:
            self._touch("touchEnd", [])
        for number, share in enumerate(shares):
            at = {"x": box["x"] + share * box["width"], "y": box["y"] + box["height"] / 2}
            self._touch("touchMove" if number else "touchStart", [at])

    def _touch(self, kind: str, points: list[dict[str, float]]) -> None:
        self.driver.execute_cdp_cmd(
            "Input.dispatchTouchEvent", {"type": kind, "touchPoints": points}
        )

    @contextmanager
    def of_width(self, width: int, scheme: str) -> Iterator[None]:
        """Give the page a width in pixels, and a colour scheme, during a block."""
        feature = {"name": "prefers-color-scheme", "value": scheme}
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        self.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": width < 600})
        try:
            yield
        finally:
            self.driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
            self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
            self.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})

    def press_space(self) -> None:
        ActionChains(self.driver).send_keys(" ").perform()

    def run_open_loop(self) -> None:
        """Drive the plate with 40 V."""
        self.enter("voltage", "40")
        self.click("open loop")
        self.until(lambda: self.values().get("Vibration.Voltage") == 40.0)

    def until(self, true: Callable[[], object]) -> None:
        guard = monotonic() + GUARD_S
        while not true():
            assert monotonic() < guard, (self.text("state"), self.text("answer"), self.values())
            sleep(0.02)

    def saved(self, button: str) -> bytes:
        """Return the file that a button saves, once it is whole."""
        file = self.downloads / f"panel.{button.lower()}"
        self.click(button)
        self.until(file.exists)
        return file.read_bytes()

    def picture(self, name: str) -> None:
        PICTURES.mkdir(parents=True, exist_ok=True)
        self.driver.save_screenshot(str(PICTURES / f"{name}.png"))


@contextmanager
def chromium(folder: Path) -> Iterator[Tab]:
    """Run a browser with a profile of its own."""
    places = [os.environ.get(name) for name in ("CHROMIUM", "CHROMEDRIVER")]
    if None in places:
        pytest.fail("CHROMIUM and CHROMEDRIVER are not set: run this below tools/with-browser")
    options = webdriver.ChromeOptions()
    options.binary_location = os.environ["CHROMIUM"]
    for flag in (*FLAGS, f"--user-data-dir={folder}"):
        options.add_argument(flag)
    downloads = folder / "downloads"
    options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    libraries = os.environ.get("BROWSER_LIBRARIES")
    variables = {**os.environ, **({"LD_LIBRARY_PATH": libraries} if libraries else {})}
    driver = webdriver.Chrome(options, Service(os.environ["CHROMEDRIVER"], env=variables))
    try:
        yield Tab(driver, downloads)
    finally:
        driver.quit()


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with chromium(tmp_path_factory.mktemp("profile")) as tab:
        yield tab


@contextmanager
def served(instrument: Instrument) -> Iterator[str]:
    """Serve an instrument in a thread; yields the address with the token."""
    begun = threading.Event()
    ports: list[int] = []
    tasks: list[tuple[asyncio.AbstractEventLoop, asyncio.Task[None]]] = []

    def told(port: int) -> None:
        ports.append(port)
        begun.set()

    async def run() -> None:
        panel = Panel(instrument, "secret", "127.0.0.1")
        task = asyncio.create_task(serve(panel, "127.0.0.1", 0, told))
        tasks.append((asyncio.get_running_loop(), task))
        with suppress(asyncio.CancelledError):
            await task

    thread = threading.Thread(target=lambda: asyncio.run(run()))
    with instrument:
        thread.start()
        try:
            assert begun.wait(GUARD_S)
            yield f"http://127.0.0.1:{ports[0]}/#secret"
        finally:
            loop, task = tasks[0]
            loop.call_soon_threadsafe(task.cancel)
            thread.join(GUARD_S)
