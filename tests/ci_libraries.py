"""A hook of pytest: a run fails if a test skipped for want of a library that ``REQUIRED_LIBRARIES`` names. ``.ci/run``
names those that a wrong set-up would leave out unnoticed."""

import os
import re

import pytest


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Fail the run and print the reasons of such skips; they are known to the process with the terminal."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    libraries = os.environ.get("REQUIRED_LIBRARIES", "").split()
    if reporter is None or not libraries:
        return
    skips = {
        str(report.longrepr[2]) for report in reporter.stats.get("skipped", ()) if isinstance(report.longrepr, tuple)
    }
    for reason in sorted(skips):
        if any(library in re.sub("[- ]", "_", reason.lower()) for library in libraries):
            reporter.write_line(f"\nFAILED: a required library is missing: {reason}", red=True)
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
