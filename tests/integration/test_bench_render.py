"""``aerial-gym bench render --against``: others must draw what we draw, or give no figure."""

import json
import math
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch

from aerial_gym.config.environment import ShapeCfg
from aerial_gym.errors import ConfigError, UnknownNameError
from aerial_gym.workloads import peers
from aerial_gym.workloads.measure import WorkloadError, absence_reason, interpreters
from aerial_gym.workloads.peers import RENDER_PEERS, mismatch_share, renderer_names, run_peer, scene_arrays
from aerial_gym.workloads.scenes import RenderScene, make_scene
from tests.integration.commands import run_bench as run
from tests.refusals import assert_refused

CPU = torch.device("cpu")
QUICK = ("--device", "cpu", "--repeats", "2", "--repeat-time-s", "0.01", "--width", "32", "--height", "24")
PEER_FOLDER = Path(peers.__file__).parent / "renderers"


def test_others_stand_below_ours_in_one_run(capsys: pytest.CaptureFixture[str]) -> None:
    names = ("merged", "shared_mesh", "mujoco")
    argv = ("--scene", "boxes_aligned", "--num-envs", "2", "--json", "--against", *names)
    status, out, err = run(capsys, "render", *QUICK, *argv)
    assert status == 0, err
    actual, *rest = map(json.loads, out.splitlines())
    assert (actual["name"], actual["threads"], tuple(row["name"] for row in rest)) == ("aerial_gym", 1, names)
    for row in rest:
        assert row["ratio"] == pytest.approx(actual["frames_per_s"] / row["frames_per_s"])
        assert row["image_s"] == pytest.approx(2 / row["frames_per_s"])
        assert 0.0 <= row["differing_pixels_share"] <= 0.002
    assert rest[0]["triangles"] == rest[1]["triangles"] == 252
    assert set(rest[2]["versions"]) == {"mujoco"}


def test_each_of_several_vehicles_takes_a_frame(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("--scene", "env_with_obstacles", "--num-envs", "2", "--vehicles", "3", "--json")
    status, out, err = run(capsys, "render", *QUICK, *argv)
    assert status == 0, err
    figures = json.loads(out)
    assert figures["vehicles"] == 3
    assert figures["frames_per_s"] == pytest.approx(6 / figures["image_s"])
    status, _, err = run(capsys, "render", *QUICK, "--scene", "boxes", "--vehicles", "2")
    assert status == 2
    assert "--vehicles 2 with --scene boxes: a scene without vehicles. Use an environment" in err


@pytest.mark.parametrize("scene", [pytest.param("boxes", marks=pytest.mark.slow), "clutter"])
def test_mujoco_sees_the_same_depths_and_ids(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("--scene", scene, "--num-envs", "3", "--segmentation", "--json", "--against", "mujoco")
    status, out, err = run(capsys, "render", *QUICK, *argv)
    assert status == 0, err
    assert json.loads(out.splitlines()[1])["differing_pixels_share"] <= 0.002


def test_what_cannot_be_measured_is_skipped_with_the_way_out(capsys: pytest.CaptureFixture[str]) -> None:
    argv = ("--scene", "boxes", "--num-envs", "2", "--json", "--against", "all", "--peer-python", "/bin/false")
    status, out, err = run(capsys, "render", *QUICK, *argv)
    assert (status, [json.loads(line)["name"] for line in out.splitlines()]) == (0, ["aerial_gym", "merged"])
    assert "shared_mesh is skipped: the environments of this scene differ. Use --scene boxes_aligned." in err
    assert "newton is skipped: /bin/false does not have it." in err
    assert "VENV/bin/pip install newton, then --peer-python newton=VENV/bin/python" in err
    reason = partial(absence_reason, "mujoco", RENDER_PEERS.get("mujoco"), flag="--peer-python")
    assert reason(sys.executable, "cuda") == "mujoco is skipped: it runs on cpu only."
    assert "does not start" in str(reason("/nowhere/python", "cpu"))
    assert reason(sys.executable, "cpu") is None
    argv = ("--scene", "env_with_obstacles", "--num-envs", "2", "--against", "mujoco")
    status, _, err = run(capsys, "render", *QUICK, *argv)
    assert "mujoco is skipped: it needs a scene of its own kind, such as --scene boxes" in err


def test_wrong_requests_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    status, _, err = run(capsys, "render", *QUICK, "--against", "newtn")
    assert status == 2
    assert "--against 'newtn': no such renderer. Known: all, merged, shared_mesh, newton, mujoco, mujoco_warp" in err
    status, _, err = run(capsys, "render", *QUICK, "--against", "merged", "--threads", "2")
    assert status == 2
    assert "--threads 2 with --against: others draw with one thread. Use --threads 1" in err
    chosen = partial(interpreters, peers=RENDER_PEERS, default="python", flag="--peer-python")
    assert_refused(ConfigError, "must be PYTHON or NAME=PYTHON", chosen, ("newton=",))
    assert_refused(UnknownNameError, "no render peer 'newtn'. Did you mean 'newton'", chosen, ("newtn=python",))
    assert renderer_names(("all",)) == ["merged", "shared_mesh", *RENDER_PEERS]
    result = chosen(("venv/bin/python", "newton=python3"))
    assert (result["newton"], result["mujoco"]) == ("python3", str(Path.cwd() / "venv/bin/python"))


def test_other_images_give_no_figure() -> None:
    """3 of 1000 pixels are more than edges explain; a miss is a miss, whatever number stands for it."""
    depth, ids = torch.full((1000,), 2.0), torch.zeros(1000, dtype=torch.int32)
    depth[500:] = -1.0
    other = depth.clone()
    other[500:] = -7.0
    other[:2] += 0.01
    assert mismatch_share("peer", depth, other, identity=ids, other_identity=ids) == pytest.approx(0.002)
    seen = ids.clone()
    seen[3] = 1
    with pytest.raises(WorkloadError, match=r"peer shows something else in 0.30% of the pixels"):
        mismatch_share("peer", depth, other, identity=ids, other_identity=seen)
    other[3] = float("nan")
    assert_refused(WorkloadError, r"peer shows something else in 0.30%", mismatch_share, "peer", depth, other)


def test_a_run_with_other_images_ends_with_status_1(monkeypatch, capsys) -> None:
    monkeypatch.setattr(peers, "_is_floor", lambda *_: True)  # every box becomes a rectangle
    argv = ("--scene", "boxes", "--num-envs", "2", "--json", "--against", "mujoco")
    status, out, err = run(capsys, "render", *QUICK, *argv)
    assert (status, len(out.splitlines())) == (1, 1)
    assert "mujoco shows something else in" in err


def test_the_words_of_a_failed_peer_are_kept() -> None:
    with pytest.raises(WorkloadError, match="nobody failed: ModuleNotFoundError: No module named 'peer_nobody'"):
        run_peer("nobody", sys.executable, {}, device="cpu", threads=1, repeats=1, repeat_time_s=0.01)


def test_only_a_level_box_below_every_camera_is_a_floor() -> None:
    """The camera stands at 1 m over a slab whose top is at 0: a peer may draw the rectangle there."""
    direction = torch.zeros(1, 1, 3)
    scene = make_scene("boxes", 2, device=CPU)

    def kinds(camera: tuple[float, float, float], turn: float = 0.0) -> np.ndarray:
        state = scene.state.clone()
        state[1, 20, 3], state[1, 20, 6] = math.sin(turn), math.cos(turn)
        position = torch.tensor([[0.0, 0.0, 1.0], camera])
        shapes = (*scene.shapes[:20], ShapeCfg(kind="box", size=(40.0, 40.0, 0.2)))
        places = {"position": position, "attitude": scene.attitude}
        changed = RenderScene(shapes=shapes, state=state, max_range=50.0, **places)
        result = scene_arrays(changed, direction, vfov_deg=87.0, segmentation=False)
        height = 0.0 if result["kind"][20] == "floor" else -0.1
        assert (result["position"][:, 20, 2], set(result["kind"][:20])) == (pytest.approx(height), {"box"})
        return result["kind"][20]

    assert (kinds((0.0, 0.0, 0.5)), kinds((0.0, 0.0, -0.05))) == ("floor", "box")
    assert (kinds((0.0, 21.0, 1.0)), kinds((0.0, 0.0, 1.0), turn=0.01)) == ("box", "box")


def test_what_runs_in_the_interpreter_of_a_peer_imports_nothing_of_ours() -> None:
    peers = {path.stem.removeprefix("peer_"): path for path in PEER_FOLDER.glob("peer_*.py")}
    assert set(peers) == set(RENDER_PEERS)
    for path in (*peers.values(), PEER_FOLDER / "worker.py", PEER_FOLDER / "mujoco_scene.py"):
        assert "aerial_gym" not in path.read_text(encoding="utf-8")
