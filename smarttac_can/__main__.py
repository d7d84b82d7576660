"""Run the command ``smarttac``, also as ``python -m smarttac_can``."""

import errno
import os
import sys


def run() -> None:
    """Run the command; Ctrl-C while its modules are loaded ends it as later on."""
    try:
        from smarttac_can.cli import main  # noqa: PLC0415 - takes up to a second

        main(prog_name="smarttac")
    except KeyboardInterrupt:
        sys.exit("\nAborted!")
    except OSError as error:
        if error.errno != errno.ENOSPC or error.filename is not None:
            raise
        # Of --help: commands report their own files. What is left to write has no room either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(f"Error: stdout: {error.strerror}")


if __name__ == "__main__":
    run()
