"""Comparison of flight logs with the simulator: residuals, their causes, and a corrected robot."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.sim2real.flight_replay import replay
    from aerial_gym.sim2real.judge.verdict import Verdict
    from aerial_gym.sim2real.logs.readers.flight_log import read_flight_log
    from aerial_gym.sim2real.logs.readers.mapping import LogMapping, find_mapping
    from aerial_gym.sim2real.logs.recording import FlightLog
    from aerial_gym.sim2real.loop import close_loop, judge_flights

__all__ = [
    "FlightLog", "LogMapping", "Verdict", "close_loop", "find_mapping", "judge_flights", "read_flight_log", "replay",
]  # fmt: skip

__getattr__, __dir__ = exports(__name__, __file__)
