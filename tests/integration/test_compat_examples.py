"""Scripts in the manner of the Aerial Gym Simulator run with only their ``isaacgym`` imports removed."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from aerial_gym.compat.script import run_script, without_isaacgym

EXAMPLES = Path(__file__).parents[2] / "examples" / "coming_from_aerial_gym"


def run(name: str, *arguments: object) -> dict[str, Any]:
    """Run an example on the CPU; return its global names."""
    return run_script(EXAMPLES / name, [*map(str, arguments), "--sim_device", "cpu"])


def test_only_isaacgym_is_taken_out() -> None:
    """Every line of every example stays, but for those that import ``isaacgym``."""
    for path in EXAMPLES.glob("*.py"):
        source = path.read_text(encoding="utf-8").splitlines()
        pairs = list(zip(source, without_isaacgym("\n".join(source)).splitlines(), strict=True))
        taken = [line for line, left in pairs if line != left]
        assert taken
        assert all("isaacgym" in line.split("#")[0] for line in taken), path


def test_position_control() -> None:
    """After 5 s at a set point, every robot is there: the slowest mode of the loop has decayed to a few per mille."""
    names = run("position_control_example.py", "--num_envs", 4, "--num_steps", 500)
    assert names["position_error"].max() < 0.05
    assert names["yaw_error"].abs().max() < 0.05


def test_rendering(tmp_path: Path) -> None:
    """Normals have length 1 or 0, and faces are -1 just where nothing is seen."""
    names = run("rendering_example.py", "--num_envs", 2, "--num_steps", 3, "--out", tmp_path)
    assert len(list(tmp_path.glob("*.png"))) == 6
    length = np.linalg.norm(names["normals"], axis=-1)
    assert names["normals"].shape == (54, 96, 3)
    np.testing.assert_allclose(length, names["faces"] >= 0, atol=1e-5)
    assert length.mean() > 0.05


def test_camera(tmp_path: Path) -> None:
    from PIL import Image

    names = run("camera_example.py", "--num_envs", 2, "--num_steps", 12, "--out", tmp_path / "stream.gif")
    depth = names["tensors"]["depth_range_pixels"]
    assert depth.shape == (2, 1, 54, 96)
    near = depth == -1.0
    assert ((depth[~near] > 0.0) & (depth[~near] <= 1.0)).all()
    assert {9, 10, 11, 12, 13, 14} & names["seen"]
    assert Image.open(tmp_path / "stream.gif").n_frames == 12


def test_custom_task() -> None:
    """Episodes end by their length in step 61, flags outlive the reset, and the script's own classes were left as they were."""
    names = run("custom_task_example.py", "--num_envs", 4, "--num_steps", 62)
    ended = names["ended"]
    assert ended["truncations"] + ended["terminations"] >= 4  # each environment at least once
    assert names["obs"]["observations"].isfinite().all()
    assert names["task_config"].num_envs == 32
    assert names["task_config"].reward_parameters == {"distance": 1.0, "collision": -10.0}


def test_two_environments() -> None:
    names = run("two_environments_example.py", "--num_envs", 2, "--num_steps", 500)
    assert names["distance"].shape == (2,)
    assert names["drift"].shape == (4,)
    assert names["distance"].max() < 0.05
    assert names["drift"].max() < 0.05
    assert names["acceleration"].mean() == pytest.approx(9.81, abs=0.2)


def test_rl_env_loop() -> None:
    names = run("rl_env_example.py", "--num_envs", 4, "--num_steps", 20)
    obs, info = names["obs"], names["info"]
    assert obs["observations"].shape == (4, 13)
    assert torch.equal(obs["rewards"], names["reward"])
    assert {"final_observation", "time_outs"} <= set(info)


def test_a_script_runs_from_the_command_line(tmp_path, monkeypatch, capsys) -> None:
    script = tmp_path / "script.py"
    script.write_text(
        "import isaacgym\nimport sys\nfrom aerial_gym.registry.sim_registry import sim_config_registry\n"
        "from aerial_gym.config.sim_config.base_sim_config import BaseSimConfig\n"
        "class Own(BaseSimConfig):\n    my_note = 3\n"
        "sim_config_registry.register('own', Own)\nsim_config_registry.native_config('own')\n"
        "if __name__ == '__main__':\n    print(sim_config_registry.get_sim_names(), sys.argv[1:])\n"
    )
    monkeypatch.setattr("sys.argv", ["compat", str(script), "--flag"])
    with pytest.raises(SystemExit) as ended:
        runpy.run_module("aerial_gym.compat", run_name="__main__")
    assert ended.value.code == 0
    out, err = capsys.readouterr()
    assert "sim Own: without effect here: my_note (an attribute of its own)" in err
    assert "base_sim_headless" in out
    assert "['--flag']" in out
