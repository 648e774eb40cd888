"""``aerial-gym bench memory``: every byte is counted, and counted once."""

import json

import pytest
import torch
import warp as wp

from aerial_gym.workloads.memory import array_bytes
from tests.integration.commands import run_bench as run

CPU = torch.device("cpu")


def test_memory_is_counted_once_however_many_views_there_are() -> None:
    """100 and 40 floats, of which views, slices and Warp arrays take no more; functions and launches are looked into."""
    wide, own = torch.zeros(10, 10), wp.zeros(40, dtype=float, device="cpu")
    held = {"a": wide, "part": wide[2:, 1:], "as_warp": wp.from_torch(wide[:, 3:6], dtype=wp.vec3), "again": [own, own]}
    assert array_bytes(held, CPU) == {"a": 400, "again.0": 160}
    assert (sum(array_bytes(lambda: held, CPU).values()), array_bytes(held, torch.device("cuda"))) == (560, {})


def test_memory_of_a_simulator_is_that_of_its_images_and_of_91_obstacles(capsys: pytest.CaptureFixture[str]) -> None:
    """Distance and id of 240x135 pixels are 4 bytes each; 92 states of 13 floats, 91 views of 12 floats are among the rest."""
    status, out, _ = run(capsys, "memory", "--num-envs", "8", "--device", "cpu", "--json", "--largest", "4")
    assert status == 0
    total, *arrays = map(json.loads, out.splitlines())
    assert total["images_bytes_per_env"] == 240 * 135 * 8
    assert total["arrays_bytes"] == pytest.approx(8 * (total["images_bytes_per_env"] + total["others_bytes_per_env"]))
    assert total["device_bytes"] is None
    sizes = {row["name"]: row["bytes_per_env"] for row in arrays}
    assert (len(sizes), sizes["gtd.depth_range_pixels"]) == (4, 240 * 135 * 4)
    argv = ("memory", "--num-envs", "8", "--device", "cpu", "--json", "--largest", "99")
    _, *arrays = map(json.loads, run(capsys, *argv)[1].splitlines())
    sizes = {row["name"]: row["bytes_per_env"] for row in arrays}
    assert sizes["gtd.vec_root_tensor"] == 92 * 13 * 4
    assert sizes["sensor_manager.casters.base_depth_camera._view.rows"] == 91 * 12 * 4


def test_the_backend_that_is_named_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    plain = ("memory", "--env-name", "empty_env", "--robot", "base_quadrotor", "--num-envs", "2", "--device", "cpu")
    totals = {}
    for backend in ("torch", "warp"):
        status, out, _ = run(capsys, *plain, "--json", "--largest", "0", "--backend", backend)
        assert status == 0
        total = json.loads(out)
        assert total["backend"] == backend
        totals[backend] = total["arrays_bytes"]
    assert totals["torch"] != totals["warp"]
    status, _, err = run(capsys, *plain, "--backend", "warpp")
    assert status == 2
    assert "no physics backend 'warpp'. Did you mean 'warp'?" in err
