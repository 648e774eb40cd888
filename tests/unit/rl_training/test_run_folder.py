"""What a session leaves in a run folder."""

import time
from pathlib import Path

from aerial_gym.rl_training import load_settings, settings_for
from aerial_gym.rl_training.run.run_folder import RunFolder


def test_a_session_keeps_the_curves_of_one_of_the_same_second(tmp_path: Path) -> None:
    while time.time() % 1.0 > 0.5:
        time.sleep(0.05)
    now = int(time.time())
    before = tmp_path / "ppo" / "summaries" / f"events.out.tfevents.{now}.host"
    before.parent.mkdir(parents=True)
    before.touch()
    RunFolder(tmp_path).add_session(load_settings(settings_for("ppo", "position_setpoint_task")), "cpu")
    assert time.time() >= now + 1
    assert (tmp_path / "versions.json").exists()
