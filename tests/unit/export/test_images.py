"""Exported policies that see images, against torch."""

from dataclasses import replace
from math import prod
from pathlib import Path
from shutil import which

import pytest
import torch

from aerial_gym import Task, task_registry
from aerial_gym.config.task_terms import ImageCfg
from aerial_gym.errors import ConfigError
from aerial_gym.export import export
from aerial_gym.export.export import write_policy
from aerial_gym.export.layout import Layout, policy_layout
from aerial_gym.export.pilot import load_exported
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.policy import Policy
from tests.refusals import assert_refused
from tests.unit.export.policies import training
from tests.unit.task.hover import build_task

NAME, OBSERVATIONS, IMAGE = "pixel_navigation_task", (17,), (1, 24, 40)
TOLERANCE = 1e-5  # Of commands and actions, as for vectors: sums of some thousand products that are much smaller than 1
COMPILER = pytest.mark.skipif(which("gcc") is None and which("cc") is None, reason="needs a C compiler")


def random_policy(shapes: dict[str, tuple[int, ...]], *, activation: str = "elu", memory: int = 0) -> Policy:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(5)
        body = NetworkBodyCfg(shapes=shapes, hidden_layers=(24, 17), activation=activation, memory=memory)
        policy = Policy(body, 4)
    policy.head.weight.data *= 5.0
    return policy.requires_grad_(False).eval()


def image_task(images: dict[str, ImageCfg] | None = None, num_envs: int = 1) -> Task:
    task = task_registry.get(NAME)
    return build_task(task if images is None else replace(task, images=images), num_envs)


def image_layout(policy: Policy, images: dict[str, ImageCfg] | None = None) -> Layout:
    with image_task(images) as task:
        return policy_layout(policy, training(), task, name="pixels", source="nowhere")


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "CHECKED_WITH_IMAGES", 1_000)


@COMPILER
@pytest.mark.usefixtures("few")
@pytest.mark.parametrize(
    ("shapes", "activation", "memory", "dtype"),
    [
        pytest.param({"observations": OBSERVATIONS, "depth": IMAGE}, "elu", 0, "uint8", marks=pytest.mark.slow),
        ({"depth": IMAGE, "observations": OBSERVATIONS}, "relu", 6, "uint8"),
        pytest.param({"observations": OBSERVATIONS, "depth": IMAGE}, "tanh", 0, "float32", marks=pytest.mark.slow),
    ],
    ids=["bytes", "image first and memory", "floats"],
)
def test_c_and_torchscript_give_what_torch_gives(shapes, activation, memory, dtype, tmp_path) -> None:
    policy = random_policy(shapes, activation=activation, memory=memory)
    made = image_layout(policy, {"depth": ImageCfg(dtype=dtype)})
    result = write_policy(policy, made, tmp_path, ["c99", "torchscript"])
    for each in result:
        assert each.largest_difference < TOLERANCE, each


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("memory", [pytest.param(0, marks=pytest.mark.slow), 6])
def test_onnx_gives_what_torch_gives(memory: int, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    policy = random_policy({"observations": OBSERVATIONS, "depth": IMAGE}, memory=memory)
    (result,) = write_policy(policy, image_layout(policy), tmp_path, ["onnx"])
    assert result.largest_difference < TOLERANCE


@pytest.mark.slow
@COMPILER
@pytest.mark.usefixtures("few")
def test_two_images_of_two_frames_go_in_by_name(tmp_path: Path) -> None:
    images = {"depth": ImageCfg(history=2), "far": ImageCfg(dtype="float32", largest=20.0)}
    policy = random_policy({"far": (1, 24, 40), "observations": OBSERVATIONS, "depth": (2, 24, 40)})
    made = image_layout(policy, images)
    assert [(image.key, image.shape, image.largest, image.without) for image in made.images] == [
        ("far", (1, 24, 40), 20.0, 1.0),
        ("depth", (2, 24, 40), 10.0, 1.0),
    ]
    (result,) = write_policy(policy, made, tmp_path, ["c99"])
    assert result.largest_difference < TOLERANCE
    assert Layout.read(tmp_path) == replace(made, params=dict(made.params))


@COMPILER
def test_what_a_task_shows_goes_in_as_it_is(tmp_path: Path) -> None:
    policy = random_policy({"observations": OBSERVATIONS, "depth": IMAGE})
    file = write_policy(policy, image_layout(policy), tmp_path, ["c99"], check=False)[0].file
    text = (tmp_path / "pixels.h").read_text()
    assert "depth: 1 x 24 x 40 pixels, row by row from the top, each as a share of 10 m, 1 at most" in text
    assert f"const unsigned char depth[{prod(IMAGE)}]" in text
    pilot = load_exported(file)
    with image_task(num_envs=5) as task:
        observation, _ = task.reset()
        for _ in range(3):
            assert int(observation["depth"].unique().numel()) > 20
            action = policy(observation)
            torch.testing.assert_close(pilot(observation), action, atol=TOLERANCE, rtol=0.0)
            observation, *_ = task.step(action)


@pytest.mark.usefixtures("few")
def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    blind = random_policy({"depth": IMAGE})
    assert_refused(ConfigError, r"sees nothing but depth; .* Let it see observations too", image_layout, blind)
    half = random_policy({"observations": OBSERVATIONS, "depth": IMAGE})
    made = image_layout(half, {"depth": ImageCfg(dtype="float16")})
    assert_refused(ConfigError, r"image 'depth': float16 has no type", write_policy, half, made, tmp_path, ["c99"])
    (result,) = write_policy(half, made, tmp_path, ["torchscript"])
    assert result.largest_difference == 0.0


def test_latents_are_a_vector_whose_encoder_is_a_second_file(tmp_path: Path) -> None:
    policy = random_policy({"observations": (81,)})
    with task_registry.make_task("dce_navigation_task", num_envs=1, device="cpu") as task:
        made = policy_layout(policy, training(), task, name="latents", source="nowhere")
    assert made.encoder == "collision_40x24"
    assert made.images == ()
    last = made.observation[-1]
    assert (last.term, last.first, last.count) == ("image_latents", 17, 64)
    policy_file, encoder_file = write_policy(policy, made, tmp_path, ["torchscript"])
    assert (policy_file.file.name, encoder_file.file.name) == ("latents.pt", "latents_encoder.pt")
    assert encoder_file.largest_difference == 0.0
    files = [each.file.name for each in write_policy(policy, made, tmp_path, ["c99"], check=False)]
    assert files == ["latents.c", "latents_encoder.c"]
