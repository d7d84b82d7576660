"""Watch a stimulator with python-can and a DBC alone: no CANopen stack, no EDS.

    smarttac eds dbc stimulator --node-id 32 --output stimulator-32.dbc
    python examples/with_cantools.py stimulator-32.dbc --interface socketcan --channel can0

Starts node 32 by NMT and prints what its PDOs say, in the units of the DBC, for a second.
"""

import argparse
import time

import can
import cantools

NMT, START = 0, 1


def main() -> None:
    """Start the node, listen, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("dbc")
    parser.add_argument("--interface", default="socketcan")
    parser.add_argument("--channel", default="can0")
    parser.add_argument("--node-id", type=int, default=32)
    parser.add_argument("--seconds", type=float, default=1.0)
    options = parser.parse_args()
    try:
        database = cantools.database.load_file(options.dbc)
        connection = can.Bus(interface=options.interface, channel=options.channel)
    except (OSError, can.CanError, cantools.Error) as error:
        parser.error(f"{error}")
    known = {message.frame_id: message for message in database.messages}
    with connection as bus:
        data = bytes((START, options.node_id))
        bus.send(can.Message(arbitration_id=NMT, data=data, is_extended_id=False))
        end = time.monotonic() + options.seconds
        while (left := end - time.monotonic()) > 0:
            frame = bus.recv(left)
            if frame is None or frame.arbitration_id not in known:
                continue
            message = known[frame.arbitration_id]
            if len(frame.data) == message.length:
                print(message.name, message.decode(frame.data))


if __name__ == "__main__":
    main()
