"""The desktop window: ``python app.py [PROJECT]`` is ``shapeforge view [PROJECT]``."""

import sys

from shapeforge.cli import run_command

if __name__ == "__main__":
    sys.exit(run_command(["view", *sys.argv[1:]]))
