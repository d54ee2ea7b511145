"""Entry point of `python -m wbc_controller`."""

from wbc_controller.cli import main

if __name__ == "__main__":
    main(prog_name="wbc")
