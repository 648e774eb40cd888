"""``aerial-gym bench``: its keys and exit status; work that is not done gives no figure; every byte of memory counts once."""

import json
from dataclasses import replace

import pytest
import torch
import warp as wp

from aerial_gym.config.sensor import CameraCfg
from aerial_gym.control import CONTROLLERS
from aerial_gym.physics import BodyState, state_at_rest
from aerial_gym.sensors import RayCaster, SensorImages
from aerial_gym.sensors.mounts import Carrier
from aerial_gym.workloads.episodes import check_crashes, check_finite_step
from aerial_gym.workloads.flight import HoverFlight, check_flying, check_moved, make_flight
from aerial_gym.workloads.measure import WorkloadError, rate_figures, time_launches, torch_threads
from aerial_gym.workloads.memory import array_bytes
from aerial_gym.workloads.scenes import SceneMeshes, make_scene
from tests.integration.commands import run, run_bench
from tests.refusals import assert_refused
from tests.repetitions import frequent_values

QUICK = ("--device", "cpu", "--repeats", "2", "--repeat-time-s", "0.02", "--threads", "1")
CPU = torch.device("cpu")
SHARED_KEYS = {"case", "device", "num_envs", "threads", "versions", "commit", "load1", "settings"}


def small_flight(**changes: object) -> HoverFlight:
    law = {"robot": "base_quadrotor", "controller": "rotor_speed_control", "effects": ("rotor_drag",)}
    sizes = {"backend": "warp", "integrator": "euler", "num_envs": 8, "substeps": 50, "dt": 0.002, "device": CPU}
    return make_flight(**{**law, **sizes, **changes})


def hover_state(num_envs: int = 3) -> BodyState:
    return state_at_rest(num_envs, 4, device=CPU, dtype=torch.float32)


@pytest.mark.parametrize("backend", ["warp", "torch"])
def test_physics_gives_one_object_with_every_key(backend: str, capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "bench", "physics", "--backend", backend, "--num-envs", "8", "--json", *QUICK)
    assert status == 0
    (line,) = out.splitlines()
    result = json.loads(line)
    own = {"backend", "substeps", "integrator", "controller", "robot", "effects", "dt_s"}
    assert set(result) == SHARED_KEYS | own | {"steps_per_s", "steps_per_s_min", "steps_per_s_max", "launch_us"}
    assert (result["backend"], result["threads"]) == (backend, 1)
    assert set(result["versions"]) == {"torch", "warp", "python", "aerial_gym"}
    assert 0.0 < result["steps_per_s_min"] <= result["steps_per_s"] <= result["steps_per_s_max"]


def test_the_rate_is_that_of_the_launches(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("bench", "physics", "--num-envs", "8", "--substeps", "5", "--json", *QUICK)
    result = json.loads(run(capsys, *argv)[1])
    assert result["steps_per_s"] * result["launch_us"] * 1e-6 == pytest.approx(40.0)
    assert rate_figures("r", [0.5, 0.25, 1.0], 2.0) == {"r": 4.0, "r_min": 2.0, "r_max": 8.0}


def test_task_tells_its_parts_apart(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "bench", "task", "--num-envs", "16", "--parts", "--json", *QUICK)
    assert status == 0
    result = json.loads(out)
    parts = {"physics_us", "collision_us", "reset_us"}
    rates = {"env_steps_per_s", "env_steps_per_s_min", "env_steps_per_s_max", "step_us"}
    assert SHARED_KEYS | rates | parts | {"task", "captured", "backend"} <= set(result)
    assert isinstance(result["captured"], bool)
    assert "rendering_us" not in result
    assert all(0.0 < result[part] < 10.0 * result["step_us"] for part in parts)


def test_people_get_a_table_with_every_key(capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "bench", "physics", "--num-envs", "8", "--effects", *QUICK)
    assert status == 0
    assert "steps_per_s_min" in out
    assert "effects          none" in out


OFTEN = ("crazyflie_pid_control", "lee_position_control", "pid_attitude_control")
"""Of each kind one: an autopilot, a law, and a law with memory."""


@pytest.mark.parametrize(
    "controller", frequent_values((n for n in CONTROLLERS.names() if CONTROLLERS.get(n).law != "pose"), OFTEN)
)
def test_every_controller_keeps_flying_for_a_stretch(controller: str) -> None:
    """After 20 s with its hover action the batch still passes the checks; without effects, by kernels that others fly too."""
    flight = small_flight(controller=controller, effects=(), num_envs=2)
    for _ in range(flight.batches_per_stretch):
        flight.run_batch()
    flight.check(started=True)


def test_threads_and_a_stretch_are_put_back() -> None:
    flight = small_flight()
    start = [tensor.clone() for tensor in flight.state.tensors()]
    flight.run_batch()
    flight.restore()
    assert all(torch.equal(a, b) for a, b in zip(start, flight.state.tensors(), strict=True))
    before = torch.get_num_threads()
    with torch_threads(1) as threads:
        assert threads == torch.get_num_threads() == 1
    assert torch.get_num_threads() == before


@pytest.mark.parametrize(("name", "value", "message"), [
    ("position", float("nan"), "position is not finite in 1 environments"),
    ("rotor_speed", float("inf"), "rotor_speed is not finite in 1 environments"),
    ("position", 2000.0, "distance from the origin reached"),
    ("lin_vel", 200.0, "speed reached"),
    ("attitude", 0.6, "norm error of the quaternion reached"),
])  # fmt: skip
def test_a_broken_state_gives_no_figure(name: str, value: float, message: str) -> None:
    state = hover_state()
    check_flying(state)
    getattr(state, name)[1] = value
    assert_refused(WorkloadError, message, check_flying, state)


def test_a_workload_that_stays_or_breaks_gives_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    before, after = hover_state(), hover_state()
    after.position[:2, 2] = 1.0
    assert_refused(WorkloadError, "1 of 3 environments did not move", check_moved, before, after)
    check_moved(before, replace(after, position=after.position + 1.0))
    flight = small_flight()
    monkeypatch.setattr(flight, "run_batch", lambda: flight.state.position.fill_(float("nan")))
    assert_refused(WorkloadError, "position is not finite in 8", time_launches, flight, repeats=1, repeat_time_s=0.001)
    check_finite_step(torch.zeros(2, 13), torch.zeros(2))
    assert_refused(WorkloadError, "rewards", check_finite_step, torch.zeros(2, 13), torch.tensor([0.0, float("nan")]))
    assert_refused(WorkloadError, "observations", check_finite_step, torch.full((2, 13), float("inf")), torch.zeros(2))
    check_crashes(0.01)
    for share in (0.05, 1.0, float("nan")):
        assert_refused(WorkloadError, "of the steps ended in a crash", check_crashes, share)


def test_a_failed_check_ends_with_status_1(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("aerial_gym.workloads.flight.MAX_SPEED", 1e-6)
    status, out, err = run(capsys, "bench", "physics", "--num-envs", "8", "--json", *QUICK)
    assert (status, out) == (1, "")
    assert "speed reached" in err


@pytest.mark.skipif(not torch.cuda.is_available(), reason="this machine has no CUDA GPU")
@pytest.mark.parametrize("options", [("physics", "--backend", "warp"), ("physics", "--backend", "torch"), ("task",)])
def test_a_gpu_is_measured_too(options: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    status, out, _ = run(capsys, "bench", *options, *QUICK, "--num-envs", "64", "--device", "cuda", "--json")
    assert (status, json.loads(out)["device"]) == (0, torch.cuda.get_device_name(0))


@pytest.mark.parametrize(
    "scene", frequent_values(["boxes", "boxes_100", "clutter", "env_with_obstacles"], ["boxes", "env_with_obstacles"])
)
def test_rendering_gives_frames_rays_and_the_time_of_a_move(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("--scene", scene, "--num-envs", "4", "--width", "32", "--height", "24", "--segmentation", "--json")
    status, out, _ = run(capsys, "bench", "render", *argv, *QUICK)
    assert status == 0
    result = json.loads(out)
    assert result["rays_per_s"] == pytest.approx(result["frames_per_s"] * 32 * 24)
    assert result["image_s"] == pytest.approx(4 / result["frames_per_s"], rel=1e-6)
    assert result["move_s"] > 0.0


def test_rendering_measures_a_lidar_whose_columns_share_poses(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("--scene", "clutter", "--num-envs", "2", "--width", "64", "--height", "16", "--lidar", "--json")
    status, out, _ = run(capsys, "bench", "render", *argv, "--scan-columns", "16", *QUICK)
    assert status == 0
    result = json.loads(out)
    assert (result["lidar"], result["scan_columns"]) == (True, 16)
    assert result["frames_per_s"] > 0.0
    status, _, err = run(capsys, "bench", "render", "--scan-columns", "16", *QUICK)
    assert status == 2
    assert "--scan-columns 16: needs --lidar" in err


def test_merged_meshes_show_the_same_depths(capsys: pytest.CaptureFixture[str]) -> None:
    """The baseline sees what we see: boxes to round-off; the median leaves out pixels along edges."""
    scene = make_scene("boxes", 3, device=CPU)
    camera = CameraCfg(
        summary="test", width=32, height=32, hfov_deg=87.0, min_range=0.0, max_range=scene.max_range, segmentation=False,
        source="test",
    )  # fmt: skip
    depth = torch.zeros(3, 1, 32, 32)
    images = SensorImages(distance=depth)
    caster = RayCaster(camera, scene.build(), images, Carrier(position=scene.position, attitude=scene.attitude))
    caster.cast()
    merged = SceneMeshes(scene, caster.direction)
    merged.cast()
    error = (depth.flatten(1) - merged.depth).abs()
    assert error.median() < 1e-5
    assert (error < 1e-4).float().mean() > 0.99
    assert (depth > 0.0).float().mean() > 0.4


def test_an_empty_environment_or_an_unknown_scene_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    status, _, err = run(capsys, "bench", "render", "--scene", "empty_env", "--num-envs", "2", *QUICK)
    assert status == 1
    assert "0.0% of the cameras see something" in err
    status, _, err = run(capsys, "bench", "render", "--scene", "boxen", *QUICK)
    assert status == 2
    assert "no render scene 'boxen'. Known: boxes, boxes_100, boxes_1000, boxes_aligned, clutter" in err


def test_memory_is_counted_once_however_many_views_there_are() -> None:
    """100 and 40 floats, of which views, slices and Warp arrays take no more; functions and launches are looked into."""
    wide, own = torch.zeros(10, 10), wp.zeros(40, dtype=float, device="cpu")
    held = {"a": wide, "part": wide[2:, 1:], "as_warp": wp.from_torch(wide[:, 3:6], dtype=wp.vec3), "again": [own, own]}
    assert array_bytes(held, CPU) == {"a": 400, "again.0": 160}
    assert (sum(array_bytes(lambda: held, CPU).values()), array_bytes(held, torch.device("cuda"))) == (560, {})


def test_memory_of_a_simulator_is_that_of_its_images_and_of_91_obstacles(capsys: pytest.CaptureFixture[str]) -> None:
    """Distance and id of 240x135 pixels are 4 bytes each; 92 states of 13 floats, 91 views of 12 floats are among the rest."""
    status, out, _ = run_bench(capsys, "memory", "--num-envs", "8", "--device", "cpu", "--json", "--largest", "4")
    assert status == 0
    total, *arrays = map(json.loads, out.splitlines())
    assert total["images_bytes_per_env"] == 240 * 135 * 8
    assert total["arrays_bytes"] == pytest.approx(8 * (total["images_bytes_per_env"] + total["others_bytes_per_env"]))
    assert total["device_bytes"] is None
    sizes = {row["name"]: row["bytes_per_env"] for row in arrays}
    assert (len(sizes), sizes["gtd.depth_range_pixels"]) == (4, 240 * 135 * 4)
    argv = ("memory", "--num-envs", "8", "--device", "cpu", "--json", "--largest", "99")
    _, *arrays = map(json.loads, run_bench(capsys, *argv)[1].splitlines())
    sizes = {row["name"]: row["bytes_per_env"] for row in arrays}
    assert sizes["gtd.vec_root_tensor"] == 92 * 13 * 4
    assert sizes["sensor_manager.casters.base_depth_camera._view.rows"] == 91 * 12 * 4


def test_the_backend_that_is_named_is_measured(capsys: pytest.CaptureFixture[str]) -> None:
    plain = ("memory", "--env-name", "empty_env", "--robot", "base_quadrotor", "--num-envs", "2", "--device", "cpu")
    totals = {}
    for backend in ("torch", "warp"):
        status, out, _ = run_bench(capsys, *plain, "--json", "--largest", "0", "--backend", backend)
        assert status == 0
        total = json.loads(out)
        assert total["backend"] == backend
        totals[backend] = total["arrays_bytes"]
    assert totals["torch"] != totals["warp"]
    status, _, err = run_bench(capsys, *plain, "--backend", "warpp")
    assert status == 2
    assert "no physics backend 'warpp'. Did you mean 'warp'?" in err
