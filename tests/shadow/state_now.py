"""What the nodes of this tree know, by the names of `state_before`.

Who moves something writes here where it is now; the names, and what they stand for, stay.
"""

from __future__ import annotations

from typing import Any

import state_before
from state_before import Readers, State, fields, of_any

from smarttac_can.plant.faults import SOUND
from smarttac_can.vocabulary.modes import Law, VibrationLaw
from smarttac_can.vocabulary.textures import Axis

__all__ = ["of_any", "of_device", "of_plate", "of_stimulator"]


def of_stimulator(node: Any) -> State:
    """Return what a stimulator node knows beside its object dictionary."""
    return state_before.of_stimulator(node, _READERS)


def of_plate(node: Any) -> State:
    """Return what a plate node knows beside its object dictionary."""
    return state_before.of_plate(node, _READERS)


def of_device(device: Any) -> State:
    """Return what the services of a device know beside its object dictionary."""
    state = state_before.of_device(device)
    # What waits for SYNC was kept as values, and is kept as bytes now.
    state["rpdo"] = [
        (late, None if latch is None else pdo.mapping.read(latch), faults)
        for pdo, (late, latch, faults) in zip(device._rpdos.values(), state["rpdo"], strict=True)
    ]
    return state


def _of_controllers(c: Any) -> State:
    plan, now, i = c.plan, c.state, c.identification
    playing = now.playing
    state = {
        "control mode": c.mode,
        "control reason": c.reason,
        "control contact": c.contact,
        "control amplitude": c.amplitude,
        "control W_ref": now.W_ref,
        "control friction": (c.mu_ref, c.E),
        "control drive": now.drive,
        "control limited": c.limited,
        "control voltage integrator": now.loops.voltage,
        "control frequency integrator": now.loops.frequency,
        "control frequency": now.loops.held,
        "control cut": now.loops.cut,
        "control right": now.right,
        "control texture": _of_texture(plan.texture, playing.ticks),
        "control samples": c._nulls._samples,
        "control oldest sample": c._nulls._head,
        "control zero": (c.tared, plan.zero),
        "control touch": now.touch,
        "control line": playing.line if playing.touches else None,
        "control slide": playing.touch if playing.touches else None,
        "control slide known": playing.touch.known,
        "bound parameters": fields(c.parameters),
        "bound plate": fields(c.model),
        "bound gains": (
            plan.vibration_law == VibrationLaw.SCHEDULED, (plan.bare.amplitude, plan.bare.a),
        ),
        "bound drive": (plan.V_max, plan.f_min, plan.f_max, fields(c.parameters)),
        "bound friction": (
            plan.half, plan.ahead, plan.law, plan.law, plan.slope, plan.step_max,
        ),
        "bound gauging": plan.gauging,
    }  # fmt: skip
    if plan.vibration_law == VibrationLaw.PREDICTIVE:
        state["control predictive"] = now.learned
        state["bound predictive"] = plan.prior
    if plan.law == Law.PREDICTIVE:
        state["control map"] = (now.sliding.known, now.sliding if now.slides else None)
    if i is not None:
        model = None if i.model is None else fields(i.model)
        state["control identification"] = (i.state, i.failure, i.progress, i._started, model)
    return state


def _of_texture(texture: Any, ticks: int) -> Any:
    by_position, repeats, start, step, values = texture
    if not values:
        return None
    axis = Axis.POSITION if by_position else Axis.TIME
    return (0 if by_position else ticks), (axis, repeats, start, step, values)


def _of_simulated(plate: Any) -> State:
    fault = plate._failing
    gains = None if fault is None or fault._gains == SOUND else fault._gains
    return {
        "plate state": plate._state,
        "plate pickup": gains,
        "plate making": plate._plan.coefficients,
        "plate noise": (plate._noise._block, plate._noise._drawn),
        "plate sensor fault": None if fault is None or gains else (fault._held, fault._tick),
    }


def _of_watches(s: Any) -> State:
    plan, now, drives = s.plan, s.watch, s.in_force
    bound, vibration = plan.bound, now.vibration
    amplitude, saturated, gauges, excess, silent, lack, resonance, unseen = now.counts
    drive = drives.drive
    return {
        "watch saturated": saturated,
        "watch gauges": gauges,
        "watch gauges, zero": now.zero,
        "watch stuck": (now.rests, now.rests_at),
        "watch tick": now.tick,
        "watch amplitude": amplitude,
        "watch excess": excess,
        "watch silent": silent,
        "watch lack": lack,
        "watch resonance": resonance,
        "watch unseen": unseen,
        "watch vibration, most": (vibration.E, vibration.most),
        "watch vibration, least": (vibration.E_least, vibration.least),
        "watch voltage": (
            drive.voltage, drives.most, drives.most_before, drives.least, drives.least_before,
        ),
        "watch voltage held": (drives.held_most, drives.held_least, drives.late),
        "watch frequency": (drive.frequency, drives.turning),
        "bound finger": (vibration.damping, vibration.touching),
        "bound resonance": (vibration.low, vibration.high),
        "bound drive now": (tuple(drives.response), drives.most, tuple(drives.held)),
        "bound serial": plan.serial,
        "bound temperature": plan.temperature_max,
        "bound forces": (plan.Fn_max, plan.Ft_max, plan.mismatch),
        "bound vibration": (plan.W_trip, bound.limit, bound.bare_limit),
        "bound model": (
            bound.gain, bound.most_gain, bound.tau, bound.believed_tau, bound.decay,
        ),
    }  # fmt: skip


def _of_commander(node: Any) -> State:
    commander = node._commander
    return {
        "masters late": sorted(commander._late),
        "masters gone": sorted(commander._gone),
        "masters seen": sorted(commander._seen),
        "masters resting": commander._resting,
        "next parameters": fields(node.block._plans.parameters),
    }


def _of_counts(node: Any) -> State:
    hardware = node._hardware
    return {
        "watch wrong checks": node._sender._wrong,
        "watch read-back": (hardware._wrong, hardware._wrong_cycles),
    }


_READERS = Readers(_of_controllers, _of_simulated, _of_watches, _of_commander, _of_counts)
