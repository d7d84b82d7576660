"""Run the command ``smarttac`` as ``python -m smarttac_can``."""

from smarttac_can.cli import main

main(prog_name="smarttac")
