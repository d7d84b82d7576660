"""A bench script where the modules and names of POSIX are missing, as on Windows.

It shows what this package itself needs. How the libraries behave on Windows, only Windows shows:
the workflow runs the tests there. The libraries are imported before, and ``AF_UNIX`` stays, which
asyncio needs on this system.
"""

import subprocess
import sys
from pathlib import Path

import pytest
from nodes_on_a_bus import GUARD_S

WITHOUT = """
import asyncio, logging.handlers, multiprocessing, os, signal, socket, subprocess, sys, threading
import aiohttp.web, canopen, can, h5py, numpy, pandas, PIL.Image
import can.interfaces.socketcan, can.interfaces.udp_multicast, can.interfaces.virtual

MODULES = ("fcntl", "grp", "pwd", "pty", "readline", "resource", "syslog", "termios", "tty")
NAMES = {
    os: "fork forkpty register_at_fork geteuid getuid getgid getpgid setsid killpg nice mkfifo "
    "sched_setaffinity sched_getaffinity sched_setscheduler sched_yield uname sysconf pread pwrite "
    "O_NOFOLLOW O_DIRECTORY O_NONBLOCK O_CLOEXEC WNOHANG wait3 posix_fadvise posix_fallocate "
    "fchown chown getloadavg",
    signal: "SIGHUP SIGKILL SIGXCPU SIGALRM SIGUSR1 SIGUSR2 SIGQUIT SIGPIPE SIGTSTP SIGCHLD "
    "pthread_sigmask setitimer sigwait siginterrupt alarm pause",
    socket: "AF_CAN PF_CAN CAN_RAW CAN_RAW_FILTER AF_NETLINK AF_PACKET SO_REUSEPORT "
    "SO_RXQ_OVFL SO_TIMESTAMPNS MSG_DONTWAIT MSG_NOSIGNAL CMSG_SPACE CMSG_LEN if_nametoindex",
}
assert not [name for name in sys.modules if name.startswith("smarttac_can")]
for name in MODULES:
    sys.modules[name] = None
for module, names in NAMES.items():
    for name in names.split():
        if hasattr(module, name):
            delattr(module, name)
"""
SCRIPT = """
from smarttac_can.bench import Stimulator, Texture, read_csv, read_recording, write_csv

PIL.Image.fromarray(numpy.arange(100, dtype=numpy.uint8)[None]).save("row.png")
pandas.DataFrame({"x": range(20), "mu": [0.3, 0.4] * 10}).to_csv("lab.csv", index=False)
with Stimulator.simulate(link) as bench, bench.events() as events:
    bench.finger.stroke(2)
    bench.start_run()
    bench.tare()
    bench.texture = Texture.from_csv("lab.csv", position="x", cof="mu")
    bench.texture = Texture.from_png("row.png", row=0, low=0.3, high=0.4)
    bench.amplitude = 1.0
    bench.mode = "texture"
    with bench.record("run.h5", metadata={"sample": "glass"}) as recording:
        bench.mark("begin")
        trace = bench.run(0.3)
    heard = [event.text for event in events.within(0)]
write_csv("run.csv", trace)
(again,) = read_csv("run.csv")
assert (again.counts == trace.counts).all()
print(heard, recording.summary.rows, read_recording("run.h5").metadata["sample"])
"""
PANEL = """
from smarttac_can.bench.panel.instrument import SimulatedBench
from smarttac_can.bench.panel.server import Panel, serve

async def page(instrument):
    port = asyncio.get_running_loop().create_future()
    panel, host = Panel(instrument, "t", "127.0.0.1"), "127.0.0.1"
    server = asyncio.create_task(serve(panel, host, 0, port.set_result))
    async with aiohttp.ClientSession() as session:
        async with session.get(f"http://127.0.0.1:{await port}/") as answer:
            print(answer.status, "<html" in await answer.text())
    server.cancel()

with SimulatedBench() as instrument:
    asyncio.run(page(instrument))
"""


def without_posix(script: str, folder: Path) -> str:
    """Return what a script says in a process without the modules and names of POSIX."""
    ended = subprocess.run(
        [sys.executable, "-W", "default", "-c", WITHOUT + script],
        capture_output=True,
        text=True,
        timeout=GUARD_S,
        cwd=folder,
        check=False,
    )
    assert not ended.stderr, ended.stderr
    assert ended.returncode == 0
    return ended.stdout


@pytest.mark.parametrize("link", ["local", "bus"])
def test_a_bench_script_needs_no_posix(link: str, tmp_path: Path) -> None:
    said = without_posix(f"link = {link!r}\n{SCRIPT}", tmp_path)
    assert said == "['ready', 'armed', 'running'] 300 glass\n"


def test_the_page_of_the_panel_needs_no_posix(tmp_path: Path) -> None:
    assert without_posix(PANEL, tmp_path) == "200 True\n"


def test_the_names_that_windows_lacks_are_missing(tmp_path: Path) -> None:
    missing = "print(hasattr(os, 'fork'), hasattr(signal, 'SIGKILL'))\nimport fcntl"
    with pytest.raises(AssertionError, match="fcntl"):
        without_posix(missing, tmp_path)
