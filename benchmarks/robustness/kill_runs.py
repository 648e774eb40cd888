"""Kill trainings at random moments and go on with each: ``python -m benchmarks.robustness.kill_runs --count 50``.

All trainers in turn, half of the kills with SIGKILL, a quarter each with SIGTERM and SIGINT. A third of the moments counts
from the start of the process, and so falls into its start-up; the others from the first checkpoint, and the settings save every
0.2 s, so that many fall into a save. A run has resumed if ``train --resume`` ends well, has gone on from the newest checkpoint
and not from an earlier one, and if one signal that can be caught left a checkpoint of the moment. A run that was killed
before its folder held settings is started anew in the same folder. Exit status 1 if any run did not.
"""

import json
import random
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import tyro

from aerial_gym.config import dump_yaml
from aerial_gym.config.storage import read_archive
from aerial_gym.rl_training import load_settings, settings_for
from aerial_gym.rl_training.run.run_folder import RunFolder

TRAINERS = ("ppo", "rl_games", "sample_factory")
SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGKILL, signal.SIGINT)
NUM_ENVS, HORIZON = 32, 16
LONGEST_END_S = 60.0
"""A training that was told to end saves and ends in seconds; that it does not at all is a finding [s]."""


@dataclass(frozen=True, kw_only=True)
class KillRuns:
    """Kill trainings at random moments and resume them."""

    count: int = 50  # Trainings killed
    seed: int = 0  # Of the moments

    longest_s: float = 12.0
    """The last moment of a kill after the start of the process [s], or half of it after the first checkpoint."""

    def run(self) -> int:
        """Print one line per kill and a summary; return the exit status."""
        draw, bad, seen = random.Random(self.seed), 0, dict.fromkeys(("no settings", "no checkpoint", "checkpoint"), 0)
        with tempfile.TemporaryDirectory() as folder:
            for index in range(self.count):
                trainer, number = TRAINERS[index % len(TRAINERS)], SIGNALS[index // len(TRAINERS) % len(SIGNALS)]
                early = draw.random() < 1 / 3
                moment = draw.uniform(0.2, self.longest_s) if early else draw.uniform(0.0, 0.5 * self.longest_s)
                results, told = kill_and_resume(Path(folder), index, trainer, number, moment, early=early)
                seen[results] += 1
                bad += told != "resumed"
                when = f"{moment:.1f} s after its {'start' if early else 'first checkpoint'}"
                print(f"{index + 1}/{self.count} {trainer} {number.name} {when}: {results}; {told}", flush=True)
        print(f"{self.count - bad} of {self.count} resumed; found {seen}")
        return 1 if bad else 0


def kill_and_resume(
    folder: Path, index: int, trainer: str, number: signal.Signals, moment: float, *, early: bool
) -> tuple[str, str]:
    """Return the state of the run folder after the kill, and ``resumed`` or the error of the resumed run."""
    out, settings = folder / f"run{index}", folder / f"{trainer}.yaml"
    cfg = load_settings(settings_for(trainer, "position_setpoint_task"))
    ppo = replace(cfg.ppo, hidden_layers=(16,), horizon=HORIZON, num_minibatches=1)
    settings.write_text(dump_yaml(replace(cfg, ppo=ppo, num_envs=NUM_ENVS, device="cpu", checkpoint_every_s=0.2)))
    start = ["train", "--trainer", trainer, "--out", str(out), "--config", str(settings), "--max-time-s", "120"]
    process = start_process(command_line(*start))
    while not early and process.poll() is None and not RunFolder(out).checkpoints():
        time.sleep(0.02)
    time.sleep(moment)
    process.send_signal(number)
    left = "checkpoint" if RunFolder(out).checkpoints() else "no checkpoint"
    if not await_exit(process):
        return left, f"had not ended {LONGEST_END_S:g} s later"
    if not (out / "config.yaml").exists():
        return "no settings", resume_verdict(command_line(*start, "--max-env-steps", "1"), out, 0)
    newest = RunFolder(out).newest_readable_checkpoint()
    steps = 0 if newest is None else int(newest[1]["run"]["env_steps"])
    resume = command_line("train", "--out", str(out), "--resume", "--max-env-steps", "1", "--max-time-s", "120")
    return "no checkpoint" if newest is None else "checkpoint", resume_verdict(resume, out, steps)


def start_process(line: list[str]) -> subprocess.Popen[bytes]:
    """Start a process that SIGINT ends, also from a shell's background, where it is ignored and children inherit that."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    return subprocess.Popen(line, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def await_exit(process: subprocess.Popen[bytes], longest_s: float = LONGEST_END_S) -> bool:
    """Wait for the end of a process and return whether it came; one that goes on is killed."""
    try:
        process.wait(timeout=longest_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return False
    return True


def command_line(*arguments: str) -> list[str]:
    """Return the command line of a subcommand of the package."""
    return [sys.executable, "-m", "aerial_gym.cli.main", *arguments, "--json"]


def resume_verdict(line: list[str], out: Path, steps: int) -> str:
    """Run one update more and return ``resumed`` if it went on from so many steps."""
    done = subprocess.run(line, capture_output=True, text=True, check=False, timeout=180)
    if done.returncode != 0:
        return f"status {done.returncode}: {done.stderr[-300:]}"
    result = json.loads(done.stdout)
    last = read_archive(result["checkpoint"], "checkpoint")["run"]["env_steps"]
    if not steps < last <= steps + 4 * NUM_ENVS * HORIZON or RunFolder(out).last_checkpoint().name.find(str(last)) < 0:
        return f"{steps} steps before, {last} after one update more"
    return "resumed"


if __name__ == "__main__":
    sys.exit(tyro.cli(KillRuns, description=__doc__).run())
