"""What Warp compiles, told through ``logging``: the first time on a machine it takes seconds, and nobody should wonder."""

import logging
import re
import warnings

import warp as wp

_log = logging.getLogger(__name__)
_COMPILED = re.compile(
    r"Module (?P<module>\S+) \S+ load on device '(?P<device>[^']*)' took (?P<ms>[\d.]+) ms\s+\(compiled\)"
)


class KernelLog:
    """A logger for Warp (``wp.set_logger``) that tells of compilations alone."""

    def __init__(self) -> None:
        self._told = False

    def info(self, message: str) -> None:
        """Tell of a module that was compiled; drop the banner and what was in the cache."""
        found = _COMPILED.search(message)
        if found is None:
            return
        what = f"{found['module']} for {found['device']} in {float(found['ms']) / 1000.0:.1f} s"
        kept = "" if self._told else f"; once for this machine, kept in {wp.config.kernel_cache_dir}"
        self._told = True
        _log.warning("compiled %s%s", what, kept)

    def debug(self, message: str) -> None:
        """Pass on what a user asked for by ``wp.config.log_level``."""
        _log.debug(message)

    def warning(self, message: str, category: type[Warning] | None = None, stacklevel: int = 1) -> None:
        """Warn as Warp would."""
        warnings.warn(message, category, stacklevel=stacklevel + 1)

    def error(self, message: str) -> None:
        """Tell of an error."""
        _log.error(message)
