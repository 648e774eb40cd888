"""Registry of log formats. It is here, not in ``sim2real``, so that its names load without torch."""

from typing import Any

from aerial_gym.lazy import ImportPath
from aerial_gym.registry.plugins import instance_converter
from aerial_gym.registry.registry import Registry

LOG_READERS: Registry[Any] = Registry("log format")  # Readers of binary logs, each a `LogReader`

READERS: dict[str, tuple[str, tuple[bytes, ...]]] = {
    "blackbox": ("blackbox:BlackboxReader", (b"H Product:Blackbox",)),
    "log_export": ("exports:LogExportReader", (b'"aerial_gym_log"', b"aerial_gym")),
    "crazyflie": ("crazyflie:CrazyflieReader", (b"\xbc",)),
    "dataflash": ("dataflash:DataflashReader", (b"\xa3\x95", b"FMT,")),
    "ros": ("ros:RosReader", (b"#ROSBAG", b"SQLite format 3", b"\x89MCAP", b"rosbag2_bagfile_information")),
    "ulog": ("ulog:UlogReader", (b"ULog\x01",)),
    "mavlink": ("mavlink:MavlinkReader", (b"\xfd", b"\xfe")),  # last, as its bytes are in other files too
}
"""Module and class of each reader of this package, and bytes of which a file of its format begins with at least one.

Only a reader whose bytes are found is imported, and the first that recognises the file reads it: an MCAP file of this package
is one of ``log_export``, not of ``ros``.
"""

for _name, (_place, _marks) in READERS.items():
    _home = ImportPath(f"aerial_gym.sim2real.logs.readers.{_place}")
    LOG_READERS.register_later(_name, _home.make, summary=_home.summary)

LOG_READERS.accept_plugins(log_reader=instance_converter("aerial_gym.sim2real.logs.readers.log_readers:LogReader"))


def reader_names(head: bytes) -> list[str]:
    """Return the names of the readers that may know a file by its first bytes; those of users are all among them."""
    return [name for name in LOG_READERS if name not in READERS or any(mark in head for mark in READERS[name][1])]
