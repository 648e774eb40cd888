"""``python -m aerial_gym.compat SCRIPT.py ...``: run a script of the Aerial Gym Simulator without its ``isaacgym`` imports."""

import logging
import sys
from collections.abc import Sequence
from pathlib import Path

from aerial_gym.compat.script import run_script
from aerial_gym.config.console import accept_any_console


def main(argv: Sequence[str]) -> int:
    """Run the script; return the exit status."""
    if not argv or not Path(argv[0]).is_file():
        print("usage: python -m aerial_gym.compat SCRIPT.py [arguments of the script]", file=sys.stderr)
        return 2
    logger = logging.getLogger("aerial_gym.compat")  # names fields without effect
    logger.setLevel(logging.INFO)
    logger.addHandler(logging.StreamHandler())
    run_script(argv[0], argv[1:])
    return 0


if __name__ == "__main__":
    accept_any_console()
    sys.exit(main(sys.argv[1:]))
