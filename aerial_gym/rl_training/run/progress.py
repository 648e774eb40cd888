"""Progress of a training: a bar on stderr, or lines where stderr is no terminal; the learning curve, and the decision to end.

All trainers call ``Progress.update`` after each of their updates. Time counts from the start of the command, in rank 0.
"""

import csv
import io
import sys
import time
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from aerial_gym.config.storage import write_atomic
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.rl_training.settings import TrainingCfg

if TYPE_CHECKING:
    from aerial_gym.task import Task

CURVE_COLUMNS = ("time_s", "env_steps", "reward_per_step", "episode_return", "episode_length", "env_steps_per_s")
"""Columns of ``curve.csv``: time [s] in all sessions, steps in all sessions, means over the episodes that ended since."""

LINE_INTERVAL_S = 10.0  # Least time between two lines on a stderr that is no terminal [s]
REPORT_INTERVAL_S = 1.0  # Least time between two lines of the learning curve [s]


@dataclass(frozen=True, kw_only=True)
class Report:
    """Numbers of a trainer after an update."""

    env_steps: int  # Environment steps in all sessions
    episode_return: float | None  # Mean return of recent episodes; None before the first has ended
    episode_length: float | None  # Mean length of them [steps]


class TrainingObserver(Protocol):
    """A part of the program that watches the task of a training; it must not wait for the device in the training's thread."""

    def follow(self, task: "Task") -> AbstractContextManager[None]:
        """Return the context in which the training uses the task."""
        ...

    def report(self) -> None:
        """Take notice of a report; the first one comes after the CUDA graphs are recorded."""
        ...


class Progress:
    """Bar, curve and limits of one session; a context manager."""

    def __init__(
        self, cfg: TrainingCfg, curve_file: Path, *, started: float, show: bool, resumed_steps: int = 0,
        ranks: Ranks = ALONE, observer: TrainingObserver | None = None,
    ) -> None:  # fmt: skip
        """Take the limits of ``cfg``, the file of the curve, the time of ``time.perf_counter`` at the start, all processes.
        Lines of the curve beyond ``resumed_steps`` environment steps, which no checkpoint holds, are dropped."""
        self._cfg, self._started, self._ranks, self._observer = cfg, started, ranks, observer
        self._first_steps: int | None = None
        self._first_time = self._last_line = 0.0
        self.env_steps, self.steps_per_s, self.share = 0, 0.0, 0.0
        self.time_share = 0.0  # Share of `max_time_s` at the last update; 0 without that limit
        self.last: Report | None = None
        self.non_finite = 0
        lines = _read_curve_lines(curve_file, resumed_steps)
        self._past_s = float(lines[-1][0]) if lines else 0.0
        text = io.StringIO()
        csv.writer(text).writerows([CURVE_COLUMNS, *lines])
        write_atomic(curve_file, text.getvalue())
        self._file = curve_file.open("a", encoding="utf-8", newline="", buffering=1)
        self._curve = csv.writer(self._file)
        shown = "{task.description} return {task.fields[reward]} {task.fields[rate]} steps/s {task.fields[left]} left"
        self._bar = Bar(
            TextColumn("{task.fields[name]}"), BarColumn(), TextColumn(shown), console=Console(file=sys.stderr),
            disable=not show or not sys.stderr.isatty(), redirect_stdout=False, redirect_stderr=False,
            refresh_per_second=2,
        )  # fmt: skip
        self._lines = sys.stderr if show and not sys.stderr.isatty() else None
        self._last_shown = -LINE_INTERVAL_S
        self._task = self._bar.add_task("", total=1.0, name=cfg.trainer, reward="-", rate="-", left="-")

    def session_time_s(self) -> float:
        """Return the time since the start of this session [s]."""
        return time.perf_counter() - self._started

    def update(self, report: Report) -> bool:
        """Show and record a report; return whether the training must end now."""
        now = self.session_time_s()
        if self._observer is not None:
            self._observer.report()
        if self._first_steps is None:
            self._first_steps, self._first_time = report.env_steps, now
        self.env_steps, self.last = report.env_steps, report
        self.steps_per_s = (report.env_steps - self._first_steps) / max(now - self._first_time, 1e-9)
        self.time_share = (
            0.0 if self._cfg.max_time_s is None else self._ranks.broadcast_number(now / self._cfg.max_time_s)
        )
        share = self.share = max(self.time_share, report.env_steps / (self._cfg.max_env_steps or 1e18))
        self._show_bar(report, share, now)
        if now - self._last_line >= REPORT_INTERVAL_S or share >= 1.0:
            self._last_line = now
            self._write_curve_line(report, now)
        return share >= 1.0

    def _show_bar(self, report: Report, share: float, now: float) -> None:
        seconds = self._seconds_left(report, now)
        reward = "-" if report.episode_return is None else f"{report.episode_return:.0f}"
        rate, left = f"{self.steps_per_s:,.0f}", f"{int(seconds) // 60}:{int(seconds) % 60:02d}"
        self._bar.update(self._task, completed=min(share, 1.0), reward=reward, rate=rate, left=left)
        if self._lines is not None and (now - self._last_shown >= LINE_INTERVAL_S or share >= 1.0):
            self._last_shown = now
            done = f"{self._cfg.trainer} {min(share, 1.0):4.0%}  {report.env_steps:,} steps  return {reward}"
            print(f"{done}  {rate} steps/s  {left} left", file=self._lines, flush=True)

    def _seconds_left(self, report: Report, now: float) -> float:
        times = []
        if self._cfg.max_time_s is not None:
            times.append(self._cfg.max_time_s - now)
        if self._cfg.max_env_steps is not None and self.steps_per_s > 0.0:
            times.append((self._cfg.max_env_steps - report.env_steps) / self.steps_per_s)
        return max(min(times, default=0.0), 0.0)

    def _write_curve_line(self, report: Report, now: float) -> None:
        per_step = ""
        if report.episode_return is not None and report.episode_length:
            per_step = f"{report.episode_return / report.episode_length:.5g}"
        values = ("" if v is None else f"{v:.6g}" for v in (report.episode_return, report.episode_length))
        time_s, rate = f"{self._past_s + now:.2f}", f"{self.steps_per_s:.0f}"
        self._curve.writerow([time_s, report.env_steps, per_step, *values, rate])

    def __enter__(self) -> "Progress":
        self._bar.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.stop()
        self._file.close()


def _read_curve_lines(curve_file: Path, resumed_steps: int) -> list[list[str]]:
    """Return the complete lines of a learning curve up to a number of steps."""
    if not curve_file.exists():
        return []
    with curve_file.open(encoding="utf-8", newline="", errors="replace") as file:
        rows = [row for row in csv.reader(file) if len(row) == len(CURVE_COLUMNS) and row[1].isdecimal()]
    return [row for row in rows if int(row[1]) <= resumed_steps]
