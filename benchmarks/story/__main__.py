"""``python -m benchmarks.story --out DIR --device cuda``: see ``story``."""

import sys

import tyro

from benchmarks.story.story import Story

if __name__ == "__main__":
    sys.exit(tyro.cli(Story).run())
