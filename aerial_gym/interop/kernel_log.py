"""Log of Warp's compilations through ``logging``, because the first ones on a machine take seconds."""

import logging
import re
import warnings

import warp as wp

_log = logging.getLogger(__name__)
_COMPILED = re.compile(
    r"Module (?P<module>\S+) \S+ load on device '(?P<device>[^']*)' took (?P<ms>[\d.]+) ms\s+\(compiled\)"
)


class KernelLog:
    """A logger for Warp (``wp.set_logger``) that reports compilations only."""

    def __init__(self) -> None:
        self._told = False

    def info(self, message: str) -> None:
        """Log a compiled module; drop Warp's banner and modules from the cache."""
        match = _COMPILED.search(message)
        if match is None:
            return
        summary = f"{match['module']} for {match['device']} in {float(match['ms']) / 1000.0:.1f} s"
        kept = "" if self._told else f"; once for this machine, kept in {wp.config.kernel_cache_dir}"
        self._told = True
        _log.warning("compiled %s%s", summary, kept)

    def debug(self, message: str) -> None:
        """Log debug messages of Warp, which ``wp.config.log_level`` enables."""
        _log.debug(message)

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        """Issue a warning of Warp."""
        warnings.warn(message, category, stacklevel=stacklevel + 1)

    def error(self, message: str) -> None:
        """Log an error."""
        _log.error(message)
