"""Registry of log formats. A reader decodes one format and finds the vehicle's quantities in it; one file each."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path

from aerial_gym.registry.registry import Registry
from aerial_gym.sim2real.logs.raw_log import Channel, RawLog


class LogReader(ABC):
    """Decoder of one log format."""

    name: str  # Name in ``LOG_READERS``
    summary: str  # One line for ``aerial-gym list``

    @abstractmethod
    def recognises(self, head: bytes) -> bool:
        """Return whether a file has this format, from its first 4096 bytes; the suffix does not count."""

    @abstractmethod
    def read(self, path: Path) -> RawLog:
        """Return the content of a file; raise ``DataError`` if nothing can be decoded."""

    @abstractmethod
    def channels(self, log: RawLog) -> Sequence[Channel]:
        """Return the vehicle's quantities, the best source first where several topics hold one quantity."""


LOG_READERS: Registry[LogReader] = Registry("log format")
