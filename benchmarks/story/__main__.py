"""``python -m benchmarks.story --out DIR --device cuda``: see ``story``."""

import sys

import tyro

from aerial_gym.errors import AerialGymError
from benchmarks.story.story import Story

if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(Story).run())
    except AerialGymError as error:
        print(f"story: {error}", file=sys.stderr)
        sys.exit(2)
