"""Traces with known answers, in the integers of the wire; no plant and no controller."""

import numpy as np

from smarttac_can.bench.traces import Trace
from smarttac_can.studies.paper.references import REFERENCES

PASS_MS = 400
NAMES = ("tick", "mu", "mu_ref", "W", "V", "f", "Ft", "Fn")
"""Of the integers of a row, as the symbols of the paper."""


def vibration(loops, time_constant, voltage, frequency, ticks=60, delay=5):
    """A first-order rise to 1 um from tick ``delay`` on, with constant final voltage."""
    t = np.arange(ticks) - delay
    on = t >= 0
    return trace(
        f"fig5.{loops}",
        0,
        W=1e4 * (1 - np.exp(-np.clip(t, 0, None) / time_constant)),
        V=on * 100 * voltage * (1 + 0.5 * np.exp(-np.clip(t, 0, None))),
        f=100 * (frequency - 140 * np.exp(-np.clip(t, 0, None) / time_constant)),
    )


def friction(subject, low, high, *, passes=12, wn=0.42, zeta=0.3, noise=0.0, seed=1, gain=1.0):
    """A friction run: the reference alternates each pass, mu answers in second order."""
    t = np.arange(PASS_MS)
    wd = wn * np.sqrt(1 - zeta**2)
    answer = 1 - np.exp(-zeta * wn * t) * (np.cos(wd * t) + zeta * wn / wd * np.sin(wd * t))
    random = np.random.default_rng(seed + 100 * subject)
    references, mu = [], []
    for k in range(passes):
        before, after = (low, high) if k % 2 else (high, low)
        references.append(np.full(PASS_MS, after))
        mu.append(before + gain * (after - before) * answer)
    mu = np.concatenate(mu)
    return trace(
        "table1",
        subject,
        mu=1e4 * (mu + noise * random.standard_normal(len(mu))),
        mu_ref=1e4 * np.concatenate(references),
        W=np.full(len(mu), 12_000),
        Ft=1e3 * 0.5 * mu,
        Fn=np.full(len(mu), 500),
    )


def amplitude_sweep(subject, mu0, w0, ticks=200):
    """The runs of Fig. 2 of one subject; the finger rests lifted for the first ticks."""
    runs = []
    for amplitude in (0.0, 0.5, 1.0, 1.5, 2.0):
        mu = np.full(ticks, mu0 * (0.25 + 0.75 * np.exp(-((amplitude / w0) ** 1.5))))
        mu[:20] = 0
        W = np.full(ticks, 1e4 * amplitude)
        runs.append(trace(f"fig2.{amplitude}", subject, mu=1e4 * mu, W=W))
    return runs


def trace(experiment, subject, **columns):
    ticks = len(next(iter(columns.values())))
    counts = np.zeros((ticks, len(NAMES)), dtype=int)
    for name, values in {"tick": np.arange(ticks), **columns}.items():
        counts[:, NAMES.index(name)] = np.rint(values)
    return Trace(experiment, subject, counts)


def all_experiments(noise=0.011):
    sweeps = zip((0.35, 0.45, 0.55, 0.65, 0.6), (1.0, 1.3, 0.8, 1.7, 1.1), strict=True)
    return [
        *(run for i, (mu0, w0) in enumerate(sweeps) for run in amplitude_sweep(i + 1, mu0, w0)),
        vibration("amplitude_only", 1.7, 26.0, 43_250.0),
        vibration("amplitude_and_frequency", 0.7, 20.0, 43_390.0),
        *(
            friction(i + 1, low, high, noise=noise, passes=24, zeta=0.25 + 0.03 * i)
            for i, (low, high) in enumerate(REFERENCES)
        ),
    ]
