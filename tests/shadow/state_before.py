"""What the old nodes know, by name: the list of what a shadow compares, tick by tick.

Each name is a promise: whatever holds the value in a later tree, it is the same at every tick. The
functions are of the old tree and stay as they are; `state_now` has those of this tree. A test finds
what changes in a node and is in neither list.

Names begin with what they belong to: ``watch`` counts of faulty cycles and what they are counted
from, ``bound`` what follows from parameters, ``control`` the controllers, ``bus`` the loop over the
bus, ``due`` deadlines in us of device time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple
from functools import lru_cache
from typing import Any, Final, NamedTuple

State = dict[str, Any]


class Readers(NamedTuple):
    """How a tree tells what has moved since the old one."""

    of_controllers: Callable[[Any], State]
    of_simulated: Callable[[Any], State]
    """Of a simulated plate."""
    of_watches: Callable[[Any], State]
    """Of a supervisor."""
    of_commander: Callable[[Any], State]
    """Of a stimulator node."""
    of_counts: Callable[[Any], State]
    """Of a plate node."""


RENAMED: Final = {
    "watched": ("supervised",),
    "_stands": ("_ignores_first",),
    "_held": ("_previous",),
    "_told": ("_reported", "_commanded", "_summary"),
    "told": ("commanded",),
    "behind": ("backend",),
    "_strange": ("_unexpected",),
}
"""What attributes are called in a later tree."""


def since(thing: Any, name: str) -> Any:
    """Return an attribute by the name that it had in the old tree."""
    for one in (name, *RENAMED[name]):
        if hasattr(thing, one):
            return getattr(thing, one)
    raise AttributeError(f"{type(thing).__name__} has no {name}")


@lru_cache(maxsize=256)
def fields(frozen: Any) -> tuple[Any, ...]:
    """Return what a frozen dataclass holds; those of two packages are not equal themselves."""
    return astuple(frozen)


def of_stimulator(node: Any, readers: Readers | None = None) -> State:
    """Return what a stimulator node knows beside its object dictionary."""
    readers = readers or READERS
    state = _of_supervisor(node.block.supervisor)
    state |= readers.of_watches(node.block.supervisor)
    state |= _of_bus(node._loop)
    # A fault of the matrix puts a broken cascade around the sound one.
    cascade = getattr(node.block.cascade, "cascade", node.block.cascade)
    state |= readers.of_controllers(cascade)
    state |= readers.of_commander(node)
    block = node.block
    state |= {
        "shown state": block._shown,
        "begun at 0 V": block._begun,
        "changed records": sorted(block._changed),
        "hint": block._hint,
        "textures": [table is not None for table in block._textures._tables.values()],
        "tare awaited": block._taring._awaited,
        "tare from cycle": block._taring._from,
        "told by EMCY": since(node._publishing, "_told"),
        "time": node.clock.now,
        "nmt": node.device.nmt_state,
        "unfit": node._unfit,
        "period reported": node._period._reported,
        "due tick": node._ticker.due,
        "missed ticks": node._ticker.missed,
    }
    state |= _of_missed_time(node._missed_time)
    if block._inside is not None:
        state |= of_plate_block(block._inside.plate, readers)
    return state


def _of_supervisor(s: Any) -> State:
    return {
        "state": s.machine.state,
        "present": s.present,
        "latched": s.latched,
        "commands held": since(s.machine, "_held"),
        "controlword seen": s._seen,
        "controlword stands": since(s, "_stands"),
        "operational": s.operational,
        "live": s.live,
        "tared": s.tared,
        "watched": since(s, "watched"),
        "refused": (s._refused, s._reason),
        "fault memory": s.memory.lines,
    }


def _of_masters(node: Any) -> State:
    masters = node._masters
    return {
        "masters late": sorted(masters._late),
        "masters gone": sorted(masters._gone),
        "masters seen": sorted(masters._seen),
        "masters resting": masters._resting,
        "next parameters": fields(node.block._parameters),
    }


def _of_watches(supervisor: Any) -> State:
    w = supervisor.watchdogs
    v = w.vibration
    return {
        "watch saturated": w._saturated._level,
        "watch gauges": w._odd._level,
        "watch gauges, zero": w._zero,
        "watch stuck": (tuple(w._rests), tuple(w._rests_at)),
        "watch tick": w._tick,
        "watch amplitude": v._above._level,
        "watch excess": v._excess._level,
        "watch silent": v._silent,
        "watch lack": v._lack._level,
        "watch resonance": v._detuned._level,
        "watch unseen": v._unseen._level,
        "watch vibration, most": (v._E, v.by_drive._W),
        "watch vibration, least": (v._E_least, v._least),
        "watch voltage": (v._V, v._V_most, v._V_most_before, v._V_least, v._V_least_before),
        "watch voltage held": (v._held_most, v._held_least, v._late),
        "watch frequency": (v._frequency, v._turning),
        "bound finger": (v.by_drive._D, v.by_drive._touching),
        "bound resonance": (v.by_drive._low, v.by_drive._high),
        "bound drive now": (v.by_drive._response, v.by_drive._voltage, v.by_drive._held),
        "bound serial": w._serial,
        "bound temperature": w._temperature_max,
        "bound forces": (w._Fn_max, w._Ft_max, w._mismatch),
        "bound vibration": (v._W_trip, v.by_drive._limit, v.by_drive._bare_limit),
        "bound model": (v._gain, v.by_drive._gain, v._tau, v.by_drive._tau, v._decay),
    }


def _of_bus(b: Any) -> State:
    pairing, sync, source, late = b._pairing, b._sync, b.source, b.late_answers
    return {
        "bus come": sorted(pairing._come),
        "bus begun": pairing._begun,
        "bus session": (pairing._session, pairing._next_session),
        "bus answered": pairing._answered,
        "bus sync counter": sync._counter,
        "bus sync drifts": sync._drifts,
        "bus sync window": _of_window(sync._window),
        "bus sync drift": _of_window(sync._long),
        "bus credits": (source._credits, source._owed),
        "bus source window": (source._syncs, source._measured, since(source, "_strange")),
        "bus heard": source._heard,
        "bus collision": source._collision,
        "bus late": (late._syncs, late._ahead, late._in_a_row, late._early, late._history),
        "due sync": (sync._silence.due, sync._silence.delay),
        "due answer": (b._unanswered.due, b._unanswered.delay),
        "due quiet": source._quiet.due,
    }


def _of_window(window: Any) -> tuple[int, ...]:
    if hasattr(window, "tolerance"):
        tolerance = window.tolerance
    else:
        tolerance = window._tolerance(window.deadline_ms) if window.deadline_ms else 0
    return window.count, tolerance, window._begun, window._timer.due


def _of_missed_time(m: Any) -> State:
    return {"missed time": (m._begun, m._awake, m._cycles, m._stood, since(m, "_told"))}


def _of_controllers(c: Any) -> State:
    inner, outer, t, i = c._inner, c._outer, c.tribometer, c.identification
    state = {
        "control mode": c.mode,
        "control reason": c.reason,
        "control contact": c.contact,
        "control amplitude": c.amplitude,
        "control W_ref": c.W_ref,
        "control friction": (c.mu_ref, c.E),
        "control drive": c.drive,
        "control limited": c.limited,
        "control voltage integrator": inner.amplitude.pi.state,
        "control frequency integrator": inner.resonance.pi.state,
        "control frequency": inner.resonance.frequency,
        "control cut": inner.resonance.limited,
        "control right": outer._boundary.right,
        "control texture": _of_texture(c.texture),
        "control samples": t._ring,
        "control oldest sample": t._head,
        "control zero": (t.tared, t._offsets),
        "control touch": t._touch,
        "control line": outer._textured.line,
        "control slide": outer._textured.touch,
        "control slide known": _known_of(outer._textured),
        "bound parameters": fields(c._parameters),
        "bound plate": fields(c._model),
        "bound gains": (inner._scheduled, inner._designed),
        "bound drive": (
            inner.amplitude.V_max, inner.resonance.f_min, inner.resonance.f_max,
            fields(inner._parameters),
        ),
        "bound friction": (
            outer._boundary._half, outer._ahead, outer._kind,
            outer._law._law, outer._law._slope, outer._law._step_max,
        ),
        "bound gauging": t._gauging,
    }  # fmt: skip
    if inner.predictive is not None:
        state["control predictive"] = inner.predictive.learned
        state["bound predictive"] = inner.predictive._prior
    if outer._by_map is not None:
        state["control map"] = _of_map(outer._by_map)
    if i is not None:
        model = None if i.model is None else fields(i.model)
        state["control identification"] = (i.state, i.failure, i.progress, i._started, model)
    return state


def _known_of(law: Any) -> Any:
    """Return what a law knows of a finger: of a touch that goes on, its state has it."""
    return law._known if law.touch is None else law.touch.known


def _of_texture(player: Any) -> Any:
    return None if player is None else (player._ticks, fields(player._table))


def _of_map(law: Any) -> tuple[Any, ...]:
    return _known_of(law), law.touch


def of_any(node: Any) -> State:
    """Return what a device knows that has nothing around it."""
    return {"time": node.clock.now, "nmt": node.nmt_state}


def of_device(d: Any) -> State:
    """Return what the services of a device know beside its object dictionary."""
    sync, guarding, watches = d._sync, d._guarding, d._watches
    return {
        "node-ID": d.node_id,
        "due": sorted([_of_timer(timer) for timer in d.clock._timers]),
        "identifiers": d.ids,
        "collision": d.collision,
        "emergencies": list(d._emergency._active),
        "emergencies waiting": d._emergency._queue,
        "pdo": [_of_pdo(pdo) for pdo in (*d._rpdos.values(), *d._tpdos.values())],
        "rpdo": [(pdo._late, pdo._latch, len(pdo._faults)) for pdo in d._rpdos.values()],
        "tpdo": [_of_tpdo(pdo) for pdo in d._tpdos.values()],
        "sync": (d.sync_counter, d.sync_own, sync._heard, sync._counter, sync._wrong_length),
        "sync parameters": (sync._produces, sync._period, sync._overflow, sync._window),
        "heartbeat": d._heartbeat._period,
        "watched nodes": [(m.parameter, m.in_time) for m in watches._monitors.values()],
        "absent": sorted(watches._absent),
        "guarding": (guarding._toggle, guarding._active, guarding._life_time, guarding._lost),
        "stored": d._storage._storage.read(),
    }


def _of_pdo(pdo: Any) -> tuple[Any, ...]:
    return pdo.cob_id, pdo.transmission, pdo.event_time, pdo.valid, pdo.alive


def _of_tpdo(t: Any) -> tuple[Any, ...]:
    timing = t._inhibit_time, t._start_value, t._awaits_start, t._count
    return timing, t._sends, t._pending, t._last, t._sampled


def _of_timer(timer: Any) -> tuple[int, ...]:
    return timer.due, timer.delay, timer._period, timer._spacing, timer._slip, timer.missed


def of_plate(node: Any, readers: Readers | None = None) -> State:
    """Return what a plate node knows beside its object dictionary."""
    sender, hardware = node._sender, node._hardware
    state = of_plate_block(node.block, readers)
    state |= (readers or READERS).of_counts(node)
    state |= _of_missed_time(node._missed_time)
    state |= {
        "time": node.clock.now,
        "nmt": node.device.nmt_state,
        "protecting": sorted(node._protecting),
        "reported": node._reported,
        "next session": node._next_session,
        "ticked": getattr(node, "_ticked", None),
        "period reported": node._period._reported,
        "due drive": (node._unanswered.due, node._unanswered.delay),
        "sender": (sender._node_id, getattr(sender, "_once_in", None)),
        "sender latched": sender.latched,
        "sender disturbed": (sender.disturbed, sender._undisturbed),
        "hardware": (
            hardware.cause,
            hardware.sources,
            hardware.reads_back,
            since(hardware, "_told"),
        ),
        "hardware rules": [entry.name for entry in (*hardware._inputs, *hardware._rules)],
    }
    return state


def of_plate_block(block: Any, readers: Readers | None = None) -> State:
    """Return what the function block of a plate knows beside its object dictionary."""
    behind = since(block, "behind")
    state = {
        "stage state": block.state.name,
        "stage": block._stage if hasattr(block, "_stage") else block._stage_shown.row,
        "stage told": since(block, "told"),
        "plate answered": (block._answered, block._answered_before),
        "plate moving": block._moving,
        "plate session": block.session,
        "plate instant": block.instant_us,
        "plate out": behind.stage,
    }
    if hasattr(behind, "plate"):
        state |= {
            "plate moves": behind._moving,
            "plate old drive": behind._old,
            "plate fault in": (behind._fault_in, getattr(behind, "_fault", None)),
            "plate stage stuck": behind._power_stage._stuck,
            "plate tick": behind.plate.tick,
            "plate finger": behind.plate.finger_state,
            "plate last drive": behind.plate._last,
        }
        state |= (readers or READERS).of_simulated(behind.plate)
    else:
        state |= {
            "front end": (behind.trouble, behind._sound_missing, behind._silent, behind._slowest),
            "front end told": since(behind, "_told"),
            "front end last": behind._last,
        }
    return state


def _of_simulated(plate: Any) -> State:
    sensors, fault = plate._sensors, plate._sensor_fault
    return {
        "plate state": plate._state,
        "plate pickup": plate._pickup,
        "plate making": plate._making,
        "plate noise": (sensors._block, sensors._drawn),
        "plate sensor fault": None if fault is None else (fault._held, fault._tick),
    }


def _of_counts(node: Any) -> State:
    sender, hardware = node._sender, node._hardware
    return {
        "watch wrong checks": sender._wrong._level,
        "watch read-back": (hardware._wrong, hardware._wrong_cycles._level),
    }


READERS: Final = Readers(_of_controllers, _of_simulated, _of_watches, _of_masters, _of_counts)
"""Of the old tree."""
