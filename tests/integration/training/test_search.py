"""The example that searches settings with Ray Tune, on a CPU; in a process of its own, as Ray starts servers."""

import subprocess
import sys
from pathlib import Path

import pytest

from aerial_gym.rl_training.run.run_folder import RunFolder

EXAMPLE = Path(__file__).parents[3] / "examples" / "search_with_ray_tune.py"


@pytest.mark.parametrize("more", [(), ("--population",)], ids=["random", "population"])
def test_a_search_leaves_a_policy(more: tuple[str, ...], tmp_path: Path) -> None:
    reason = "Ray Tune is not installed: pip install 'aerial-gym[tune]'"
    pytest.importorskip("ray.tune", reason=reason, exc_type=ImportError)
    size = ("--device", "cpu", "--num-envs", "64", "--samples", "2", "--slices", "2", "--slice-steps", "4096")
    command = [sys.executable, str(EXAMPLE), *size, "--out", str(tmp_path / "search"), *more]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    [said] = [line for line in done.stdout.splitlines() if line.startswith("evaluate it:")]
    kept = RunFolder(said.split("--policy ")[1]).newest_readable_checkpoint()
    assert kept[1]["env_steps"] >= 2 * 4096
