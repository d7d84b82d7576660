"""Send set-points and events as markers of the Lab Streaming Layer, beside EEG or video.

LSL stamps a marker when it is pushed: push it right after the set-point. Here all is simulated:
with hardware, connect instead. Tried by hand with pylsl 1.18, without a receiver.
"""

from pylsl import StreamInfo, StreamOutlet

from smarttac_can.bench import Stimulator

markers = StreamOutlet(StreamInfo("SMARTTAC", "Markers", 1, 0, "string", "smarttac-32"))
with Stimulator.simulate() as bench, bench.events() as events:
    bench.mode = "friction"
    for cof in (0.3, 0.4):
        bench.cof = cof
        markers.push_sample([f"cof {cof}"])
        for event in events.within(0.5):
            markers.push_sample([f"{event.kind} {event.text}"])
