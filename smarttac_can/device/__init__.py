"""A CiA 301 device that knows nothing of what it is used for: frames and time in, frames out."""
