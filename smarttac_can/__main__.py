"""Run the command ``smarttac``, also as ``python -m smarttac_can``."""

import errno
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
        sys.exit(f"Error: stdout: {error.strerror}")  # of --help; commands report their own files


if __name__ == "__main__":
    run()
