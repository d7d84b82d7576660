"""A CANopen kit that knows no haptics: dictionary, device, buses, master, conformance, DCF, LSS.

It is named after its subject, the word that a reader looks for. The library of the same name is not
in its way: imports of this project are absolute, so ``import canopen`` is always the library and
``smarttac_can.canopen`` always this package. Texts call the library python-canopen.
"""
