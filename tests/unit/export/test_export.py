"""Exported policies against torch: numbers entry by entry, flights in the simulator, what is refused.
Exported policies that see images, against torch.
"""

from dataclasses import replace
from itertools import product
from math import prod
from pathlib import Path
from shutil import which

import pytest
import torch

from aerial_gym import Task, task_registry
from aerial_gym.config.task_terms import ActionCfg, ImageCfg, ObservationCfg
from aerial_gym.errors import ConfigError
from aerial_gym.export import export
from aerial_gym.export.c99 import _TRANSFORMS
from aerial_gym.export.export import export_policy, write_policy
from aerial_gym.export.layout import Layout, policy_layout
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.pilot import load_exported
from aerial_gym.physics import rotor_state_for_thrust
from aerial_gym.rl_training.evaluation import evaluate
from aerial_gym.rl_training.policies.body import NetworkBodyCfg
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.robots import ROBOTS
from aerial_gym.task import ACTIONS
from tests.refusals import assert_refused
from tests.repetitions import rare_values
from tests.unit.export.policies import HOVER, TRANSFORMS, hover, hover_policy, layout, random_policy, training
from tests.unit.task.hover import build_task

COMPILER = pytest.mark.skipif(which("gcc") is None and which("cc") is None, reason="needs a C compiler")
TOLERANCE = 1e-5  # Of commands and actions: some ulps of sums of a few dozen products of order 1 to 10


KINDS = [("elu", 0, True), ("relu", 16, False), ("relu", 0, False), ("tanh", 0, True), ("elu", 16, True)]


@COMPILER
@pytest.mark.parametrize(("activation", "memory", "normalize"), rare_values(KINDS, KINDS[:2]))
def test_c_and_torchscript_give_what_torch_gives(activation: str, memory: int, normalize: bool, tmp_path: Path) -> None:
    policy = random_policy(activation=activation, memory=memory, normalize=normalize)
    result = write_policy(policy, layout(policy), tmp_path, ["c99", "torchscript"])
    for each in result:
        assert each.not_checked is None, each
        assert each.largest_difference < TOLERANCE, each
        assert each.agrees, each
    text = (tmp_path / "hover.c").read_text()
    assert "alloc" not in text
    assert max(map(len, text.splitlines())) < 140


@pytest.mark.parametrize("memory", [pytest.param(0, marks=pytest.mark.slow), 16])
def test_onnx_gives_what_torch_gives(memory: int, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    policy = random_policy(memory=memory)
    (result,) = write_policy(policy, layout(policy), tmp_path, ["onnx"])
    assert result.largest_difference < TOLERANCE
    assert result.agrees


@COMPILER
@pytest.mark.parametrize(("action", "controller"), list(TRANSFORMS.values()), ids=list(TRANSFORMS))
def test_commands_are_those_of_the_task(action: ActionCfg, controller: str, tmp_path: Path) -> None:
    cfg = replace(HOVER, action=action, controller=controller)
    policy = random_policy()
    policy.head.weight.data *= 0.1  # most actions then lie within the limits
    with build_task(cfg, 200) as task:
        made = policy_layout(policy, training(), task, name="hover", source="nowhere")
        pilot_file = write_policy(policy, made, tmp_path, ["c99"], check=False)[0].file
        observation, _ = task.reset()
        step = load_exported(pilot_file).step
        assert (policy(observation).abs() < 1.0).float().mean() > 0.5
        command, given, _ = step(observation["observations"], torch.zeros(200, 0))
        torch.testing.assert_close(given, policy(observation), atol=TOLERANCE, rtol=0.0)
        task.step(policy(observation))
        torch.testing.assert_close(command, task.env.gtd["robot_actions"], atol=TOLERANCE, rtol=0.0)


def test_every_transform_of_actions_has_a_form_in_c() -> None:
    assert {ACTIONS.get(name).value for name in ACTIONS.names()} <= set(_TRANSFORMS)


FLIGHTS = list(product(("c99", "onnx", "torchscript"), (False, True), (50, 100, 250)))


@COMPILER
@pytest.mark.parametrize(("form", "memory", "rate_hz"), rare_values(FLIGHTS, FLIGHTS[1:]))
def test_an_exported_policy_flies(form: str, memory: bool, rate_hz: int, tmp_path: Path) -> None:
    """At three rates, with commands that are 20 ms late and noise: it hovers, and each flight is that of torch.
    Differences of rounding grow along a flight as the closed loop lets them: it is stable, so that they stay small.
    ``-s`` prints the figures of ``docs/results/export.md``."""
    if form == "onnx":
        pytest.importorskip("onnxruntime")
        pytest.importorskip("onnxscript")
    policy = hover_policy(memory=memory)
    file = write_policy(policy, layout(policy), tmp_path, [form])[0].file
    with hover(rate_hz, delay=rate_hz // 50, noise=0.01) as task:
        actual = evaluate(policy, task)
    with hover(rate_hz, delay=rate_hz // 50, noise=0.01) as task:
        reference = evaluate(load_exported(file), task)
    assert reference.crash_rate == 0.0
    assert reference.final_error_mean_m < 0.1
    assert reference.final_error_max_m == pytest.approx(actual.final_error_max_m, abs=1e-4)
    off, difference = reference.final_error_mean_m, abs(reference.final_error_max_m - actual.final_error_max_m)
    print(f"{form}, memory {memory}, {rate_hz} Hz: {off:.4f} m off, {difference:.1e} m from torch")


def test_observations_are_taken_in_their_own_units(tmp_path: Path) -> None:
    terms = (
        ObservationCfg(term="position_error_world", scale=0.1, noise_std=0.02, delay_steps=(1, 2)),
        ObservationCfg(term="lin_vel_body", history=2, dropout=0.1, dropout_value=-1.0),
    )
    cfg = replace(HOVER, observations={"policy": terms})
    policy = random_policy(9)
    with build_task(cfg, 4) as task:
        made = policy_layout(policy, training(), task, name="p", source="nowhere")
    assert [(s.term, s.first, s.count, s.history, s.scale, s.delay_steps) for s in made.observation] == [
        ("position_error_world", 0, 3, 1, 0.1, (1, 2)),
        ("lin_vel_body", 3, 6, 2, 1.0, (0, 0)),
    ]
    assert [(s.noise_std, s.dropout, s.dropout_value) for s in made.observation] == [(0.02, 0.0, 0.0), (0.0, 0.1, -1.0)]
    assert (made.observation[0].meaning, made.command[1]) == ("target minus position [m], world", "roll [rad]")
    seen = torch.randn(5, 9)
    command, _ = DeployablePolicy(policy, made)(seen)
    scaled = torch.cat((0.1 * seen[:, :3], seen[:, 3:]), dim=-1)
    torch.testing.assert_close(command, policy({"observations": scaled}))
    made.write(tmp_path)
    assert Layout.read(tmp_path) == replace(made, params=dict(made.params))


def test_a_policy_of_many_vehicles_is_written_for_one_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with task_registry.make_task("any_quadrotor_task", num_envs=1, device="cpu") as task:
        (width,) = task.observation_space["observations"].shape
    policy, cfg = random_policy(width), replace(training(), task="any_quadrotor_task", controller=None)
    policy.head.bias.data = torch.full((4,), 100.0)  # all as fast as they can
    monkeypatch.setattr("aerial_gym.export.export.load_policy", lambda source: (policy, cfg))
    for robot, rotors in (("x500", 4), ("typhoon_hexarotor", 6)):
        (result,) = export_policy("nowhere", tmp_path / robot, ["torchscript"], robot=robot, check=False)
        made = Layout.read(tmp_path / robot)
        assert (made.robot, len(made.command)) == (robot, rotors)
        command, _, _ = load_exported(result.file).step(torch.zeros(1, width), torch.zeros(1, 0))
        fastest = rotor_state_for_thrust(ROBOTS.get(robot).rotor, ROBOTS.get(robot).rotor.thrust_range[1])
        assert command.max() == pytest.approx(fastest, rel=1e-5)
        assert command.min() > 0.99 * fastest  # without torque not all of a hexarotor are equal


def test_what_cannot_be_exported_is_refused(tmp_path: Path) -> None:
    policy = random_policy()
    with (
        build_task(HOVER, 1) as task,
        pytest.raises(ConfigError, match="name '2nd try': C allows letters, digits and _"),
    ):
        policy_layout(policy, training(), task, name="2nd try", source="")
    assert_refused(ConfigError, "format 'tflite': must be onnx", export_policy, tmp_path, tmp_path, ["tflite"])
    assert_refused(ConfigError, r"no policy.json in it. Make it with aerial-gym", load_exported, tmp_path / "a.onnx")
    layout(policy).write(tmp_path)
    assert_refused(ConfigError, r"is no exported policy. Give the .onnx, .pt,", load_exported, tmp_path / "a.onnx")


NAME, OBSERVATIONS, IMAGE = "pixel_navigation_task", (17,), (1, 24, 40)


def random_policy_of_images(shapes: dict[str, tuple[int, ...]], *, activation: str = "elu", memory: int = 0) -> Policy:
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
def test_c_and_torchscript_give_what_torch_gives_with_images(shapes, activation, memory, dtype, tmp_path) -> None:
    policy = random_policy_of_images(shapes, activation=activation, memory=memory)
    made = image_layout(policy, {"depth": ImageCfg(dtype=dtype)})
    result = write_policy(policy, made, tmp_path, ["c99", "torchscript"])
    for each in result:
        assert each.largest_difference < TOLERANCE, each


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("memory", [pytest.param(0, marks=pytest.mark.slow), 6])
def test_onnx_gives_what_torch_gives_with_images(memory: int, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    policy = random_policy_of_images({"observations": OBSERVATIONS, "depth": IMAGE}, memory=memory)
    (result,) = write_policy(policy, image_layout(policy), tmp_path, ["onnx"])
    assert result.largest_difference < TOLERANCE


@pytest.mark.slow
@COMPILER
@pytest.mark.usefixtures("few")
def test_two_images_of_two_frames_go_in_by_name(tmp_path: Path) -> None:
    images = {"depth": ImageCfg(history=2), "far": ImageCfg(dtype="float32", largest=20.0)}
    policy = random_policy_of_images({"far": (1, 24, 40), "observations": OBSERVATIONS, "depth": (2, 24, 40)})
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
    policy = random_policy_of_images({"observations": OBSERVATIONS, "depth": IMAGE})
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
def test_images_that_cannot_be_exported_are_refused(tmp_path: Path) -> None:
    blind = random_policy_of_images({"depth": IMAGE})
    assert_refused(ConfigError, r"sees nothing but depth; .* Let it see observations too", image_layout, blind)
    half = random_policy_of_images({"observations": OBSERVATIONS, "depth": IMAGE})
    made = image_layout(half, {"depth": ImageCfg(dtype="float16")})
    assert_refused(ConfigError, r"image 'depth': float16 has no type", write_policy, half, made, tmp_path, ["c99"])
    (result,) = write_policy(half, made, tmp_path, ["torchscript"])
    assert result.largest_difference == 0.0


def test_latents_are_a_vector_whose_encoder_is_a_second_file(tmp_path: Path) -> None:
    policy = random_policy_of_images({"observations": (81,)})
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
