"""What ends a process of ``benchmarks.robustness.kill_runs``, and what is said of one that goes on."""

import signal
import sys
import time
from collections.abc import Iterator

import pytest

from benchmarks.robustness.fuzz.__main__ import Fuzz
from benchmarks.robustness.kill_runs import await_exit, start_process

SLEEP = [sys.executable, "-c", "import time; time.sleep(60)"]


@pytest.fixture
def ignore_interrupts() -> Iterator[None]:
    kept = signal.signal(signal.SIGINT, signal.SIG_IGN)
    yield
    signal.signal(signal.SIGINT, kept)


@pytest.mark.usefixtures("ignore_interrupts")
def test_sigint_ends_a_process_that_was_begun_in_the_background() -> None:
    process = start_process(SLEEP)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    assert await_exit(process, 10.0)


def test_a_process_that_goes_on_is_told_and_killed() -> None:
    process = start_process(SLEEP)
    assert not await_exit(process, 0.2)
    assert process.returncode == -signal.SIGKILL


def test_a_few_mutated_inputs_of_each_kind_work_or_are_refused(tmp_path, capsys) -> None:
    pytest.importorskip("yourdfpy")
    status = Fuzz(count=88, seed=7, out=tmp_path).run()
    assert status == 0, capsys.readouterr().out
