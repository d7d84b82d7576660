"""The CANopen nodes: a device with the function block of the plate, or of the stimulator."""
