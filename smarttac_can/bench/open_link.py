"""Links to a stimulator: over any CAN bus, or to one simulated inside this process.

What needs python-canopen is imported where a link over CAN is opened: it takes about as long as the
rest of the bench, and a simulation on the local link has no use for it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Final, Literal, get_args

from smarttac_can.bench.errors import bounds
from smarttac_can.bench.link import Link
from smarttac_can.bench.local_link import LocalLink
from smarttac_can.bench.named_objects import find_number, raw_value, truth
from smarttac_can.bench.simulation import (
    PLATE_ID,
    STIMULATOR_ID,
    attach_nodes,
    plate_od,
    simulated_block,
    stimulator_od,
)
from smarttac_can.host.bus import LogHook
from smarttac_can.host.drivers import opening, unknown_options
from smarttac_can.host.local_bus import LocalBus
from smarttac_can.master.errors import BenchError
from smarttac_can.od.cia import Abort, AbortCode
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.od.entry import Entry

if TYPE_CHECKING:
    from smarttac_can.bench.tapped_network import TappedNetwork

LinkName = Literal["local", "bus"]

_CLOSING_S: Final = 0.02
_OWN_ARGUMENTS: Final = ("node_id", "plate_node_id", "lockstep")
_NEAR: Final = 0.7
"""Likeness of a misspelt argument to what was meant, at least; 1 is the same."""


def open_can_link(
    *,
    interface: str | None,
    channel: str | None,
    node_id: int,
    plate_node_id: int | None,
    lockstep: bool,
    timeout: float | None,
    options: Mapping[str, Any],
) -> tuple[Link, ObjectDictionary]:
    """Open a link over a CAN bus; the arguments are those of `Stimulator.connect`.

    Returns
    -------
    link : Link
        The nodes have been started.
    od : ObjectDictionary
        EDS of the stimulator.

    Raises
    ------
    BenchError
        If the bus cannot be opened, no node answers, or it is another device.
    ValueError
        If `lockstep` is neither True nor False, `interface` no name, or a node-ID outside 1..127.
    TypeError
        If an option is a misspelt argument, or one that the interface would ignore.
    """
    from smarttac_can.bench.tapped_network import TappedNetwork  # noqa: PLC0415 - only over CAN

    truth("lockstep", lockstep)
    if not isinstance(interface, str | None):
        raise ValueError(f"interface {interface!r} is no name")
    _refuse_misspelt(interface, options)
    where = f"{interface or 'the configured bus'}:{channel or 'default'}"
    if "port" in options:
        where += f" port {options['port']}"
    network = TappedNetwork()
    # How long closing the bus may take; python-canopen waits for up to 1 s.
    network.NOTIFIER_CYCLE = _CLOSING_S
    with opening(interface, channel, BenchError):
        network.connect(interface=interface, channel=channel, **options)
    return _over_can(
        network, node_id, plate_node_id, where=where, lockstep=lockstep, timeout=timeout
    )


def _refuse_misspelt(interface: str | None, options: Iterable[str]) -> None:
    for option in options:
        if near := get_close_matches(option, _OWN_ARGUMENTS, 1, _NEAR):
            raise TypeError(f"connect has no argument {option!r}, perhaps {near[0]!r}")
    for text in unknown_options(interface, [name for name in options if name != "bitrate"]):
        raise TypeError(text)


def open_simulated_link(
    link: LinkName,
    *,
    seed: int,
    subject: int,
    plate_inside: bool,
    presets: Mapping[str, int | str],
    log: LogHook | None,
) -> tuple[Link, ObjectDictionary]:
    """Open a link to a simulation; the arguments are those of `Stimulator.simulate`.

    Raises
    ------
    ValueError
        If there is no such link, `plate_inside` is neither True nor False, a preset is not a
        value of its object, or not at power-on, or `log` cannot be called or has no bus.
    BenchError
        If there is no such object.
    """
    truth("plate_inside", plate_inside)
    raw = raw_presets(presets, seed=seed, subject=subject)
    if link not in get_args(LinkName):
        raise ValueError(f"link {link!r} is none of {', '.join(get_args(LinkName))}")
    if log is not None and not callable(log):
        raise ValueError(f"log {log!r} is no function of a time stamp and a frame")
    if log is not None and link == "local":
        raise ValueError("there is no bus whose frames could go to log: simulate('bus')")
    bus = LocalBus(log=log)
    try:
        if link == "local":
            block = simulated_block(raw)
            return LocalLink(block), block.od
        attach_nodes(bus, plate_inside=plate_inside, presets=raw)
    except Abort as error:
        raise ValueError(f"presets {dict(presets)} are refused at power-on: {error}") from error
    from smarttac_can.bench.local_network import LocalNetwork  # noqa: PLC0415 - only over CAN

    return _over_can(
        LocalNetwork(bus),
        STIMULATOR_ID,
        None if plate_inside else PLATE_ID,
        where="the local bus",
        lockstep=True,
        timeout=0.0,
    )


def raw_presets(presets: Mapping[str, int | str], *, seed: int, subject: int) -> dict[str, int]:
    """Return the raw values of presets of a stimulator, of which some may be texts with units.

    Parameters
    ----------
    presets
        Values by name.
    seed, subject
        Those of the simulated plate, unless they are among the presets.

    Raises
    ------
    ValueError
        If they are no mapping, or one is no value of its object or outside its limits.
    BenchError
        If there is no such object, or it is no number.
    """
    if not isinstance(presets, Mapping):
        raise ValueError(f"presets {presets!r} are no mapping of names to values")
    od = stimulator_od()
    simulated = {"Simulation.Seed": seed, "Simulation.Subject": subject}
    given = {**simulated, **presets}
    return {name: _raw_preset(find_number(od, name), value) for name, value in given.items()}


def _raw_preset(entry: Entry, given: int | str) -> int:
    raw, wrong, within = given, "no raw value in", f"{entry.low}..{entry.high}"
    if isinstance(given, str):
        raw, wrong, within = raw_value(entry, given), "outside", bounds(entry)
    try:
        if not isinstance(raw, int):
            raise Abort(AbortCode.LENGTH)
        entry.check(raw)
    except Abort as error:
        raise ValueError(f"preset {entry.name!r} is {given!r}, {wrong} {within}") from error
    return raw


def _over_can(
    network: TappedNetwork,
    node_id: int,
    plate_node_id: int | None,
    *,
    where: str,
    lockstep: bool,
    timeout: float | None,
) -> tuple[Link, ObjectDictionary]:
    from smarttac_can.bench.can_link import CanLink  # noqa: PLC0415 - only over CAN

    try:
        od = stimulator_od(node_id)
        plate = None if plate_node_id is None else plate_od(plate_node_id)
        link = CanLink(network, od, plate, where=where, lockstep=lockstep, timeout=timeout)
    except BaseException:
        network.disconnect()
        raise
    return link, od
