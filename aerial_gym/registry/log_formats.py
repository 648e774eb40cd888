"""Registry of log formats. It is here, not in ``sim2real``, so that its names load without torch."""

from typing import Any

from aerial_gym.lazy import ImportPath
from aerial_gym.registry.registry import Registry

LOG_READERS: Registry[Any] = Registry("log format")  # Readers of binary logs, each a `LogReader`

READERS = {
    "blackbox": ImportPath("aerial_gym.sim2real.logs.readers.blackbox:BlackboxReader"),
    "crazyflie": ImportPath("aerial_gym.sim2real.logs.readers.crazyflie:CrazyflieReader"),
    "dataflash": ImportPath("aerial_gym.sim2real.logs.readers.dataflash:DataflashReader"),
    "ros": ImportPath("aerial_gym.sim2real.logs.readers.ros:RosReader"),
    "ulog": ImportPath("aerial_gym.sim2real.logs.readers.ulog:UlogReader"),
}
"""Readers of this package. Each format has other first bytes, so that their order does not count."""

for _name, _home in READERS.items():
    LOG_READERS.register_later(_name, _home.make, summary=_home.summary)
