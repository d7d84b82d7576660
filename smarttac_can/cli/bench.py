"""Commands for a stimulator: status, reset, watch, panel, selftest and calibrate."""

from __future__ import annotations

import asyncio
import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from datetime import UTC, datetime
from functools import partial
from importlib.util import find_spec
from ipaddress import IPv6Address, ip_address
from math import inf, isfinite
from pathlib import Path
from secrets import token_urlsafe
from socket import AI_PASSIVE, SOCK_STREAM, getaddrinfo
from typing import Any, Final

import click
import numpy as np

from smarttac_can import __version__
from smarttac_can.bench import FaultError, State, Stimulator, plate_od, stimulator_od
from smarttac_can.bench.calibration import (
    POSITIONS,
    Calibration,
    mean_gauges,
    require_two_directions,
    weigh,
    write_calibration,
)
from smarttac_can.bench.errors import in_shell_words
from smarttac_can.bench.plate_loads import STANDARD_GRAVITY, Placing, Weighing, read_plan
from smarttac_can.bench.remote_device import RemoteDevice
from smarttac_can.bench.self_test import Check
from smarttac_can.bench.self_test import selftest as judge
from smarttac_can.bench.status import plate_of, read_status, supervised
from smarttac_can.bench.watch.listener import Listener
from smarttac_can.bench.watch.watcher import Watcher
from smarttac_can.canopen.device.nmt import UNKNOWN
from smarttac_can.canopen.od import cia
from smarttac_can.cli.shared import (
    OLD_FILE,
    FiniteRange,
    StimulatorChoice,
    WholeRange,
    closing_network,
    force_option,
    in_steps,
    json_options,
    lockstep_option,
    naming,
    one_line,
    plain_errors,
    reporting,
    result_path,
    stimulator_options,
    timeout_option,
)
from smarttac_can.host.files import result_file
from smarttac_can.vocabulary.meanings import LIFTED
from smarttac_can.vocabulary.states import Status
from smarttac_can.vocabulary.watchdogs import WATCHDOGS, Watchdog


@click.command(
    epilog="\b\nExamples:\n  smarttac status --interface socketcan --channel can0\n"
    "  smarttac status --interface socketcan --channel can0 --json | jq .state"
)
@stimulator_options
@timeout_option
@json_options(bare=True)
def status(*, at: StimulatorChoice, timeout: float, json_file: Path | None) -> None:
    """Show NMT state, faults, message, commander and levels of the watchdogs of a stimulator.

    The commander is the node that drives. This command only reads: it starts no node, and a
    running drive continues. The exit code is 0,
    also if the stimulator is in FAULT.
    """
    with reporting(json_file) as write_results:
        with closing_network(at.bus) as network:
            report = read_status(
                network,
                at.node_id,
                plate_node_id=at.plate_node,
                where=at.bus.where,
                timeout=timeout,
            )
        write_results(report, _lines(report))


@click.command(epilog="\b\nExample:\n  smarttac reset --interface socketcan --channel can0")
@stimulator_options
@timeout_option
@lockstep_option
def reset(*, at: StimulatorChoice, timeout: float, lockstep: bool) -> None:
    """Reset the latched fault of a stimulator.

    This command starts the nodes. It is refused while another bench drives. Without a latched
    fault it does nothing. The exit code is 1 if the cause of the fault is still there.
    """
    with (
        plain_errors(),
        _cure_of_silence(at, timeout),
        at.connect(timeout=timeout, lockstep=lockstep) as stimulator,
    ):
        name = f"stimulator {at.node_id}"
        state = stimulator.state
        if state is not State.FAULT:
            click.echo(f"{name} has no fault: its state is {_plain(state)}")
            return
        why = stimulator.message
        stimulator.reset_fault()
        click.echo(one_line(f"{name} is reset ({why}): {_plain(stimulator.state)}"))


@contextmanager
def _cure_of_silence(at: StimulatorChoice, timeout: float) -> Iterator[None]:
    """Add the node whose lost heartbeat refuses a reset, and what to do, to the error's notes."""
    try:
        yield
    except FaultError as error:
        if WATCHDOGS[Watchdog.HEARTBEAT].text in str(error):
            with closing_network(at.bus) as network:
                device = RemoteDevice(network, stimulator_od(at.node_id), at.bus.where, timeout)
                for watch in supervised(network, device, at.plate_node or plate_of(device)):
                    if not watch.heard:
                        error.add_note(
                            f"node {watch.node_id} is supervised and silent: start it again, or "
                            f"write 0 to {cia.HEARTBEAT_CONSUMER:X}h sub-index {watch.entry} of "
                            f"node {at.node_id}, or reset node {at.node_id} (NMT)"
                        )
        raise


def _plain(state: State) -> str:
    return state.name.lower().replace("_", " ")


def _lines(report: dict[str, Any]) -> Iterator[str]:
    plate = report["plate"]
    nodes = [f"stimulator {report['node_id']} {_heard(report['nmt'])}"]
    if plate is not None:
        nodes.append(f"plate {plate['node_id']} {_heard(plate['nmt'])}")
    yield _named("nodes", f"{', '.join(nodes)}, on {report['bus']}")
    flags = f" ({', '.join(report['flags'])})" if report["flags"] else ""
    yield _named("state", f"{report['state'].replace('_', ' ')}, mode {report['mode']}{flags}")
    for fault in report["latched"]:
        present = fault in report["present"]
        next_step = fault["remedy"] if present else "no longer present: smarttac reset"
        yield _named("fault", f"{fault['code']:04X}h {fault['text']}; {next_step}")
    for fault in report["present"]:
        if fault not in report["latched"]:
            yield _named("present", f"{fault['code']:04X}h {fault['text']}, not latched")
    if report["message"]:
        yield _named("message", report["message"])
    yield _named("driven by", _drivers(report))
    if "live" not in report["flags"]:
        yield _named("no cycles", "the values below are of the last cycle, if any")
    for name, now in report["levels"].items():
        share = "" if now["level"] is None else f", {now['level']:.0%}"
        yield _named(name, f"{now['value']:g} of {now['limit']:g} {now['unit']}{share}")


def _heard(nmt: str) -> str:
    return "in an unknown NMT state (no heartbeat)" if nmt == UNKNOWN else nmt


def _named(name: str, text: str) -> str:
    return f"{name:<15}{one_line(text)}"


def _drivers(report: dict[str, Any]) -> str:
    there = [
        f"{'a bench script' if who['bench'] else 'a master'}, heartbeat of node {who['node_id']}"
        for who in report["driven_by"]
        if who["heard"]
    ]
    silent = [str(who["node_id"]) for who in report["driven_by"] if not who["heard"]]
    if not there:
        drives = report["state"] in ("armed", "running")
        there = ["a commander whose heartbeat is not supervised" if drives else "nobody"]
    if silent:
        there.append(f"node {' and '.join(silent)} supervised and silent")
    return "; ".join(there)


_BIT_RATE: Final = 1_000_000


@contextmanager
def _watching(
    at: StimulatorChoice, drive: bool, *, reads: bool = True
) -> Iterator[tuple[Watcher, Listener, Stimulator | None]]:
    plate = None if at.plate_node is None else plate_od(at.plate_node)
    bit_rate = at.bus.bitrate or _BIT_RATE
    watcher = Watcher(stimulator_od(at.node_id), plate, bit_rate=bit_rate, reads=reads)
    with ExitStack() as stack:
        listener = stack.enter_context(Listener(at.bus.open))
        stimulator = stack.enter_context(at.connect()) if drive else None
        yield watcher, listener, stimulator


@click.command(
    epilog="\b\nExamples:\n  smarttac watch --interface socketcan --channel can0\n"
    "  smarttac watch --interface socketcan --channel can0 --plate-node 33 --drive"
)
@stimulator_options
@click.option(
    "--drive",
    is_flag=True,
    help="Start the nodes, and let you enter set-points and stop the drive with a key.",
)
@click.option(
    "--no-sdo",
    is_flag=True,
    help="Send no frame; then set-points, counts and latched faults are not shown.",
)
def watch(*, at: StimulatorChoice, drive: bool, no_sdo: bool) -> None:
    """Show a stimulator live in the terminal: friction, drive, state, faults, counts and bus.

    The values come from the TPDOs of the nodes. Objects that are in no TPDO are read by SDO, one
    at a time. With --drive the command also drives: the stimulator supervises the heartbeat of the
    command, and Esc disarms.
    """
    if drive and no_sdo:
        raise click.UsageError("--drive writes by SDO: leave out --no-sdo")
    if find_spec("textual") is None:
        raise click.ClickException("watch needs Textual: pip install 'smarttac-can[watch]'")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise click.ClickException("watch needs a terminal; to get a file, log the bus")
    from smarttac_can.bench.watch.screen import WatchScreen  # noqa: PLC0415 - Textual is an extra

    with plain_errors(), _watching(at, drive, reads=not no_sdo) as watched:
        watcher, listener, stimulator = watched
        WatchScreen(watcher, listener, at.bus.where, stimulator).run()


@click.command(
    epilog="\b\nExamples:\n  smarttac panel\n"
    "  smarttac panel --interface socketcan --channel can0 --plate-node 33 --drive"
)
@stimulator_options
@click.option("--drive", is_flag=True, help="Start the nodes, and let one page drive them.")
@click.option(
    "--host",
    default="127.0.0.1",
    show_default=True,
    help="Address of this computer on which the panel accepts connections.",
)
@click.option(
    "--port",
    type=WholeRange(0, 65535),
    default=8033,
    show_default=True,
    help="TCP port; 0 takes any free port.",
)
@click.option(
    "--record",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Folder on this computer into which the page that drives may record.",
)
def panel(*, at: StimulatorChoice, drive: bool, host: str, port: int, record: Path | None) -> None:
    """Show a stimulator live in a browser: plate, charts, state and faults.

    Without --interface the command simulates a bench in this process, and the mouse is the finger.
    The printed address contains a token: a page with this token may drive. One page drives at a
    time. If this page sends nothing for 0.8 s, the plate goes to 0 V.
    """
    bus = at.bus
    if bus.interface is None and (drive or bus.options or at.plate_node is not None):
        raise click.UsageError("a bus needs --interface; without one a bench is simulated")
    if find_spec("aiohttp") is None:
        raise click.ClickException("panel needs aiohttp: pip install 'smarttac-can[panel]'")
    from smarttac_can.bench.panel.instrument import BusInstrument, SimulatedBench  # noqa: PLC0415
    from smarttac_can.bench.panel.server import Panel, serve  # noqa: PLC0415 - aiohttp is an extra

    _require_one_address(host)
    with plain_errors():
        _prepare_records(record, drives=drive or bus.interface is None)
    token = token_urlsafe(16)

    def listening(port: int) -> None:
        place = f"[{host}]" if ":" in host else host
        click.echo(f"panel of {instrument.where}: http://{place}:{port}/#{token}")
        click.echo("Ctrl-C ends it")

    with plain_errors(), ExitStack() as stack:
        instrument: SimulatedBench | BusInstrument
        if bus.interface is None:
            instrument = SimulatedBench(record)
        else:
            watched = stack.enter_context(_watching(at, drive))
            instrument = BusInstrument(bus.where, stimulator_od(at.node_id), *watched, record)
        stack.enter_context(instrument)
        with suppress(KeyboardInterrupt):
            asyncio.run(serve(Panel(instrument, token, host), host, port, listening))
            raise click.ClickException("the panel has failed; the plate is at 0 V")


def _prepare_records(folder: Path | None, *, drives: bool) -> None:
    if folder is None:
        return
    if not drives:
        raise click.UsageError("--record needs --drive: without it no page may record")
    from smarttac_can.bench.recording_file import require_h5py  # noqa: PLC0415 - loads numpy

    require_h5py()
    folder.mkdir(parents=True, exist_ok=True)


def _require_one_address(host: str) -> None:
    """Refuse a host that the system takes for all addresses of this computer, in any spelling."""
    try:
        found = getaddrinfo(host or None, 0, type=SOCK_STREAM, flags=AI_PASSIVE)
    except (OSError, UnicodeError):
        return  # the server says that it cannot listen there
    for *_, (address, *_) in found:
        ip = ip_address(str(address).partition("%")[0])
        mapped = ip.ipv4_mapped if isinstance(ip, IPv6Address) else None
        if (mapped or ip).is_unspecified:
            raise click.BadParameter(f"--host {host or repr(host)} is every address: name one")


@click.command(
    epilog="\b\nExamples:\n  smarttac selftest --interface socketcan --channel can0\n"
    "  smarttac selftest --interface socketcan --channel can0 --plate-node 33 --json selftest.json"
)
@stimulator_options
@lockstep_option
@json_options()
def selftest(*, at: StimulatorChoice, lockstep: bool, json_file: Path | None) -> None:
    """Check timing, gauges, pick-up, resonance and delay of a stimulator.

    Nothing may rest on the plate, which vibrates with 0.5 um at most. At the end the plate is at
    0 V, also after an error or Ctrl-C. Each check is printed on stderr as soon as it is done. The
    exit code is 1 if a check fails.
    """
    with reporting(json_file) as write_results, ExitStack() as stack:
        stimulator = stack.enter_context(at.connect(lockstep=lockstep))
        serial = round(stimulator.get("Calibration.Plate serial number"))
        touched = _touched(stimulator)
        checks = judge(stimulator, lambda check: click.echo(_check_line(check), err=True))
        touched |= _touched(stimulator)
        failed = [check for check in checks if not check.passed]
        results = {
            "version": __version__,
            "node_id": at.node_id,
            "plate_serial_number": serial,
            "passed": not failed,
            "checks": [check.as_json() for check in checks],
        }
        write_results(results, [_verdict(checks, failed)])
        if failed and touched:
            click.echo("a finger touches the plate: lift it, and repeat", err=True)
    if failed:
        raise click.exceptions.Exit(1)


def _touched(stimulator: Stimulator) -> bool:
    return bool(round(stimulator.get("Statusword")) & Status.TOUCHING)


def _verdict(checks: list[Check], failed: list[Check]) -> str:
    if not failed:
        return f"passed: {len(checks)} checks"
    names = ", ".join(check.name for check in failed)
    return f"FAILED: {len(failed)} of {len(checks)} checks: {names}"


_OF_LIMITS: Final = 0.01
"""Step in which the value of a check is shown, as a fraction of what its limits leave open."""


def _check_line(check: Check) -> str:
    verdict = "ok    " if check.passed else "FAILED"
    if check.value is None:
        return one_line(f"{verdict}  {check.name}: {in_shell_words(check.text)}")
    low, high = (f"{bound:g}" if isfinite(bound) else "" for bound in (check.low, check.high))
    limits = low if low == high else f"{low}..{high}"
    return f"{verdict}  {check.name:<28} {_digits(check):>10} {check.unit:<5} ({limits})"


def _digits(check: Check) -> str:
    """Return the value of a check in hundredths of what its limits allow, or in more decimals.

    What failed is shown outside its limits.
    """
    assert check.value is not None
    step = _OF_LIMITS * (check.high - check.low)
    if not 0.0 < step < inf:
        return f"{check.value:g}"
    while check._replace(value=float(text := in_steps(check.value, step))).passed > check.passed:
        step *= 0.1
    return text


_LEVEL: Final = Placing(0.0, 0.0, 0.0, 0.0)


@click.command(
    epilog="\b\nExample:\n  smarttac calibrate weights.csv --certificate plate-1.json"
    " --interface socketcan --channel can0 --write"
)
@click.argument("plan", type=OLD_FILE)
@click.option("--certificate", type=result_path, required=True, help="JSON file for the results.")
@force_option()
@stimulator_options
@click.option(
    "--gravity",
    type=FiniteRange(9.7, 9.9),
    default=STANDARD_GRAVITY,
    show_default=True,
    help="Gravity at the place of the weighings in m/s^2.",
)
@click.option(
    "--rehearse",
    is_flag=True,
    help="Use a simulated plate, which puts the weights on by itself; nothing is asked.",
)
@lockstep_option
@click.option("--write", is_flag=True, help="Set the calibration in the stimulator, and tare.")
def calibrate(
    *,
    plan: Path,
    certificate: Path,
    at: StimulatorChoice,
    gravity: float,
    rehearse: bool,
    lockstep: bool,
    write: bool,
) -> None:
    """Calibrate the tribometer with the weights of PLAN; the command asks for each weight in turn.

    PLAN is CSV with mass_g,angle_deg,azimuth_deg,x_mm: a weight, the tilt of the plate, the
    direction in which it slopes down (0 along x, 90 along y), and where the weight is. If the
    remaining error of the fit is too large, the exit code is 1, and the stimulator keeps its
    calibration; the certificate has the reason.
    """
    _refuse_the_plan(certificate, plan)
    with plain_errors(), ExitStack() as stack:
        with plain_errors(ValueError):
            placings = read_plan(plan)
            with naming(plan, ValueError):
                require_two_directions(placings)
        file = stack.enter_context(result_file(certificate))
        stimulator = stack.enter_context(at.connect(lockstep=lockstep))
        stimulator.claim()
        before = [stimulator.get(f"Calibration.{name}", "mm") for name in POSITIONS]
        weighings, nulls = _weighed(stimulator, placings, gravity if rehearse else None)
        with plain_errors(ValueError):
            calibration = Calibration.fit(weighings, before, gravity)
        temperature = stimulator.get("Plate temperature", "degC")
        results: dict[str, Any] = {
            "version": __version__,
            "time": datetime.now(UTC).isoformat(timespec="seconds"),
            "plate_serial_number": round(stimulator.get("Calibration.Plate serial number")),
            "temperature_degC": temperature,
            "gravity_m_s2": gravity,
            "weighings": [weighing.as_json() for weighing in weighings],
            "nulls_mN": [round(float(null) * 1e3, 3) for null in nulls],
            "calibration": calibration.as_json(),
            "budget": calibration.budget(temperature),
            "written": {},
        }
        shortcomings = calibration.shortcomings()
        if write and not shortcomings:
            results["written"] = write_calibration(stimulator, calibration, nulls)
            stimulator.tare()
        file.write(json.dumps(results, indent=2) + "\n")
        _show(calibration, temperature)
    if shortcomings:
        raise click.ClickException(
            one_line(f"not to be used: {'; '.join(shortcomings)}; {certificate} has all of it")
        )


def _weighed(
    stimulator: Stimulator, placings: Sequence[Placing], gravity: float | None
) -> tuple[list[Weighing], np.ndarray[Any, Any]]:
    """Return the weighings and the nulls of the bare plate.

    With a gravity, a simulated plate puts the weights on itself; otherwise the user is asked.
    """

    def do(placing: Placing, number: str = "") -> None:
        text = f"{number}{placing}"
        if gravity is None:
            _ask(text)
        else:
            click.echo(text, err=True)
            stimulator.finger.put(placing, gravity)

    weighings: list[Weighing] = []
    try:
        if gravity is not None and stimulator.get("Finger.Motion") != LIFTED:
            stimulator.finger.lift()
            stimulator.start_run()
        for number, placing in enumerate(placings, 1):
            weighings.append(weigh(stimulator, placing, partial(do, number=f"{number}: ")))
        do(_LEVEL)
        return weighings, mean_gauges(stimulator)
    except (click.Abort, KeyboardInterrupt) as error:
        raise click.ClickException(
            f"interrupted after {len(weighings)} of {len(placings)} weighings: none is kept, "
            "and nothing was set in the stimulator"
        ) from error


def _refuse_the_plan(certificate: Path, plan: Path) -> None:
    """Refuse a certificate that would overwrite the plan, under any name."""
    if certificate.exists() and certificate.samefile(plan):
        raise click.UsageError(f"--certificate {certificate} is the plan: name another file")


def _ask(what: str) -> None:
    click.prompt(f"{what}; Enter", default="", show_default=False, prompt_suffix=" ", err=True)


def _show(calibration: Calibration, temperature: float) -> None:
    od = stimulator_od()
    for name, value in calibration.objects().items():
        unit = od[name].unit
        click.echo(f"{name}: {in_steps(value, float(unit.number))} {unit.symbol}".rstrip())
    *forces, position = calibration.rms
    for name, rms in zip(("Fx", "Fy", "Fn"), forces, strict=True):
        if not np.isnan(rms):
            click.echo(f"residual of {name}: {1e3 * rms:.1f} mN rms")
    if not np.isnan(position):
        click.echo(f"residual of x: {position:.3f} mm rms")
    for line in calibration.unchecked():
        click.echo(line)
    click.echo(f"S3 to S6 show {calibration.scale:.4f} of the weights")
    for row in calibration.budget(temperature):
        click.echo(
            f"COF {row['COF']:g} at {row['Fn_N']:g} N and {row['temperature_degC']:g} degC: "
            f"+- {row['expanded']:.3f} (k = 2)"
        )
