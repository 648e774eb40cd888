"""Command lines of scripts."""

import pytest

from aerial_gym.compat.arguments import get_args, parse_arguments


def test_own_flags_and_devices() -> None:
    flags = [{"name": "--num_envs", "type": int, "default": 3}, {"name": "--train", "action": "store_true"}]
    argv = ["--sim_device", "cuda:1", "--headless"]
    args = parse_arguments("A script", headless=True, custom_parameters=flags, argv=argv)
    assert (args.num_envs, args.train, args.headless) == (3, False, True)
    assert (args.sim_device, args.rl_device) == ("cuda:1", "cuda:1")
    assert (args.sim_device_type, args.compute_device_id) == ("cuda", 1)


def test_a_script_s_flag_takes_the_place_of_ours(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.argv", ["script.py", "--headless", "False", "--use_warp", "true"])
    args = get_args([{"name": "--num_envs", "type": int, "default": 7, "help": "how many"}])
    assert (args.num_envs, args.headless, args.use_warp) == (7, False, True)
