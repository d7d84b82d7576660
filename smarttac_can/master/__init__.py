"""What every master needs to talk to a device, whatever the device does."""
