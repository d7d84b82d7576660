"""The bench's stimulator: opened and closed, read, run and recorded, over any link."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self, cast

from smarttac_can.bench.link import ClosedLink, Link
from smarttac_can.bench.loop import Loop
from smarttac_can.bench.named_objects import NamedObjects
from smarttac_can.bench.of_part import of_part
from smarttac_can.bench.open_link import LinkName, open_can_link, open_simulated_link
from smarttac_can.bench.plate_loads import SimulatedFinger
from smarttac_can.bench.recording import Recording
from smarttac_can.bench.set_points import (
    BothSides,
    Choice,
    InUnit,
    choose_slot,
    read_texture,
    write_texture,
)
from smarttac_can.bench.simulation import STIMULATOR_ID
from smarttac_can.bench.state_control import StateControl
from smarttac_can.bench.textures import Texture
from smarttac_can.host.bus import LogHook
from smarttac_can.master.errors import BenchError
from smarttac_can.od.dictionary import ObjectDictionary
from smarttac_can.vocabulary.modes import Law, Mode, VibrationLaw
from smarttac_can.vocabulary.states import State


class Stimulator:
    """A SMARTTAC stimulator at the bench; a context manager that leaves it at 0 V.

    `connect` and `simulate` make one.

    Parameters
    ----------
    link
        How it is reached; closed with the stimulator.
    od
        EDS of the stimulator.

    Attributes
    ----------
    finger
        The finger of a simulated plate.
    """

    # A misspelt property is an error, not a new attribute.
    __slots__ = ("_control", "_loop", "_objects", "_recording", "finger")

    voltage = InUnit("Setpoint.Voltage", "V", "Set-point of mode OPEN_LOOP in V.")
    frequency = InUnit(
        "Setpoint.Frequency", "Hz", "Excitation frequency in Hz: fixed, or where its loop starts."
    )
    amplitude = InUnit("Setpoint.Amplitude", "um", "Set-point of the amplitude in um peak-to-peak.")
    boundary = InUnit("Setpoint.Boundary", "mm", "Boundary in mm from the middle of the plate.")
    cof = BothSides("Set-points of the COF left and right of the boundary; a number sets both.")
    law = Choice(
        "Friction law",
        Law,
        "Friction law: what the step of the amplitude is added to; set it by member or name.",
    )
    vibration_law = Choice(
        "Controller.Vibration law",
        VibrationLaw,
        "How amplitude and resonance are regulated; by member or name, also while running.",
    )

    get = of_part("_objects", NamedObjects.get)
    set = of_part("_objects", NamedObjects.set)
    nearest = of_part("_objects", NamedObjects.nearest)
    claim = of_part("_control", StateControl.claim)
    arm = of_part("_control", StateControl.arm)
    disarm = of_part("_control", StateControl.disarm)
    quick_stop = of_part("_control", StateControl.quick_stop)
    reset_fault = of_part("_control", StateControl.reset_fault)
    start_run = of_part("_control", StateControl.start_run)
    tare = of_part("_control", StateControl.tare)
    identify = of_part("_control", StateControl.identify)
    read = of_part("_loop", Loop.read)
    run = of_part("_loop", Loop.run)
    sample = of_part("_loop", Loop.sample)

    def __init__(self, link: Link, od: ObjectDictionary) -> None:
        self._objects = NamedObjects(link, od)
        self._control = StateControl(self._objects)
        self._loop = Loop(self._objects, self._control)
        self._recording: Recording | None = None
        self.finger = SimulatedFinger(self.get, self._objects.set_all)

    @property
    def _link(self) -> Link:
        return self._objects.link

    @property
    def mode(self) -> Mode:
        """Mode asked for; setting one arms the stimulator and runs it, OFF disarms it.

        Setting raises `FaultError` and `NotReadyError` as `arm` does.
        """
        return Mode(self._link.read("Mode"))

    @mode.setter
    def mode(self, mode: Mode | str) -> None:
        self._control.choose(mode)

    @property
    def state(self) -> State:
        """State of the device; who has read FAULT here gets no `FaultError` of `run` for it."""
        return self._control.state

    @property
    def message(self) -> str:
        """Why the stimulator turned itself off; empty if it did not."""
        return self._objects.message

    @property
    def texture_slot(self) -> int:
        """Slot that mode TEXTURE plays, 1 to 4, and that `texture` is of; also while running."""
        return self._link.read("Texture.Slot")

    @texture_slot.setter
    def texture_slot(self, slot: int) -> None:
        choose_slot(self._objects, slot)

    @property
    def texture(self) -> Texture | None:
        """Texture in the chosen slot, None if it is empty; also while it is played.

        Setting one raises `ValueError` if it has a COF beyond the bounds of the stimulator, and
        `RefusedError` if the stimulator refuses it; what was there stays then.
        """
        return read_texture(self._objects)

    @texture.setter
    def texture(self, texture: Texture | None) -> None:
        write_texture(self._objects, texture)

    @classmethod
    def connect(
        cls,
        *,
        interface: str | None = None,
        channel: str | None = None,
        node_id: int = STIMULATOR_ID,
        plate_node_id: int | None = None,
        lockstep: bool = False,
        timeout: float | None = None,
        **options: Any,
    ) -> Self:
        """Connect to a stimulator on a CAN bus and start it, and its plate node if it has one.

        Parameters
        ----------
        interface, channel, options
            As python-can has them; what is not given comes from python-can's configuration.
            Frames of udp_multicast stay on this computer unless ``hop_limit`` is given there.
        node_id
            Node-ID of the stimulator, 1..127.
        plate_node_id
            Node-ID of the plate node, 1..127; None with the plate inside the stimulator.
        lockstep
            Whether the nodes were started with ``--lockstep``: the bench then produces the SYNC.
        timeout
            Longest wait in s for an SDO answer, and in real time for the first values of `read`. By
            default 1, and 5 in lockstep, where a process that is slow misses nothing.

        Raises
        ------
        BenchError
            If the bus cannot be opened, no node answers, or it is another device.
        """
        return cls(
            *open_can_link(
                interface=interface,
                channel=channel,
                node_id=node_id,
                plate_node_id=plate_node_id,
                lockstep=lockstep,
                timeout=timeout,
                options=options,
            )
        )

    @classmethod
    def simulate(
        cls,
        link: LinkName = "bus",
        *,
        seed: int = 1,
        subject: int = 1,
        plate_inside: bool = False,
        presets: Mapping[str, int | str] | None = None,
        log: LogHook | None = None,
    ) -> Self:
        """Simulate a stimulator and its plate inside this process, without threads or waiting.

        Parameters
        ----------
        link
            ``bus`` for two CANopen nodes and this bench on a virtual CAN bus, in lockstep;
            ``local`` for their function blocks without CANopen: the same numbers, faster.
        seed
            Seed of noise and finger, 0..2^32 - 1.
        subject
            Number of the finger's subject: 1..5 the presets, 6..9 those fitted to Table I.
        plate_inside
            Whether the plate is inside the stimulator node; without a bus it always is.
        presets
            Values by name that replace defaults of the stimulator's EDS: raw integers, or texts
            with a unit as `set` takes them, such as ``800 nm``.
        log
            Called with the time stamp in us and the frame, for every frame on the bus; the local
            link has none.

        Raises
        ------
        ValueError
            If there is no such link, seed or subject, `plate_inside` is neither True nor False, a
            preset is no value of its object, or `log` cannot be called or has no bus.
        BenchError
            If there is no such object.
        """
        given = {} if presets is None else presets
        return cls(
            *open_simulated_link(
                link,
                seed=seed,
                subject=subject,
                plate_inside=plate_inside,
                presets=given,
                log=log,
            )
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            self.close()
        except BenchError:
            # The first failure is the one to report.
            if kind is None:
                raise

    def close(self) -> None:
        """Disarm, unless this bench only read, and leave the bus; may be called twice.

        A ``with`` does it. Where there is none, as in a notebook, the plate is driven for as long
        as the process lives, or until this is called. Whatever is asked of it afterwards raises
        `BenchError`.

        Raises
        ------
        BenchError
            If it could not be disarmed; the bus has been left all the same, and the heartbeat of
            this bench ends the drive within its time.
        """
        link = self._link
        if isinstance(link, ClosedLink):
            return
        try:
            if not link.only_read:
                self.disarm()
        finally:
            self._objects.link = cast("Link", ClosedLink(link.where))
            link.close()

    def __dir__(self) -> list[str]:
        return [name for name in super().__dir__() if not name.startswith("_")]

    def __repr__(self) -> str:
        return f"<Stimulator over {self._link.where}>"

    def record(
        self,
        path: Path | str,
        *,
        raw: Path | str | None = None,
        subject: str = "",
        operator: str = "",
        notes: str = "",
    ) -> Recording:
        """Record in the background, whatever else is done, while a ``with`` block lasts.

        Every cycle that comes, with what is set meanwhile, from here or by others, goes into a log;
        at the end of the block an HDF5 file is made of it. A process that is killed leaves the log,
        which lacks a second at most: ``smarttac record --recover``. An error that ends the block,
        Ctrl-C too, disarms first.

        Parameters
        ----------
        path
            The file, ``.h5`` or ``.hdf5``, which does not exist yet; `read_recording` reads it.
        raw
            File for all frames on the bus besides, in the format of python-can that its suffix
            stands for; it does not exist yet.
        subject, operator, notes
            What is to stand in the file of who was recorded, by whom and how: up to 1000
            characters each.

        Raises
        ------
        ValueError
            If one of these is no text, or too long.
        BenchError
            If another recording of this bench goes on; as the block begins, if the file exists,
            has another suffix or cannot be written, h5py is missing, the TPDOs do not carry the
            tick, or there is no such format or no bus.
        """
        if self._recording is not None and self._recording.goes_on:
            raise BenchError(f"{self._recording.path} is being recorded: one file at a time")
        self._recording = Recording(
            self._link,
            self._objects.od,
            Path(path),
            None if raw is None else Path(raw),
            {"subject": subject, "operator": operator, "notes": notes},
            self._control.stop_driving,
        )
        return self._recording

    def mark(self, text: str) -> None:
        """Put a marker into the recording that goes on.

        Parameters
        ----------
        text
            1 to 1000 characters.

        Raises
        ------
        BenchError
            If none goes on.
        """
        if self._recording is None:
            raise BenchError("nothing is being recorded: markers go into a recording")
        self._recording.mark(text)
