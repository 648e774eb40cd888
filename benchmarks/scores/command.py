"""Scores of the undeclared plant from the command line."""

import sys

import tyro

from aerial_gym.errors import AerialGymError
from benchmarks.scores.score_loggers import LoggerScoreCmd
from benchmarks.scores.score_pairs import PairScoreCmd


def run_score(arguments: list[str], *, pairs: bool, description: str | None) -> int:
    """Score flights of one vehicle or of pairs; return the exit status, 2 with a message for wrong settings."""
    command = PairScoreCmd if pairs else LoggerScoreCmd
    try:
        return tyro.cli(command, args=arguments, description=description).run()
    except AerialGymError as error:
        print(f"benchmarks.undeclared: {error}", file=sys.stderr)
        return 2
