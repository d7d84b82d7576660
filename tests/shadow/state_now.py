"""What the nodes of this tree know, by the names of `state_before`.

So far both trees keep it in the same places. Who moves something writes here where it is now; the
names, and what they stand for, stay.
"""

from state_before import of_any, of_device, of_plate, of_plate_block, of_stimulator

__all__ = ["of_any", "of_device", "of_plate", "of_plate_block", "of_stimulator"]
