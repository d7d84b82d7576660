"""The simulated plate: resonator, thermal node, finger, friction and sensors."""
