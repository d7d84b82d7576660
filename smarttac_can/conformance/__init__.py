"""A conformance suite for CANopen devices: 127 cases, judged by the frames on the bus alone."""
