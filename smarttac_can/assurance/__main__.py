"""Run the command for evidence, ``python -m smarttac_can.assurance``."""

from smarttac_can.cli.evidence import main

if __name__ == "__main__":
    main(prog_name="python -m smarttac_can.assurance")
