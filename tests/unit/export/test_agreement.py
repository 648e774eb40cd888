"""Which exported files pass as the policy, and which do not."""

import ctypes
import json
from collections.abc import Callable
from dataclasses import replace
from math import inf, nan
from pathlib import Path
from shutil import which

import pytest
import torch
from torch import Tensor, nn

from aerial_gym.cli.export import ExportCmd
from aerial_gym.config.task_terms import ImageCfg
from aerial_gym.export import export, pilot
from aerial_gym.export.agreement import FACTOR, UNIT, Comparison
from aerial_gym.export.c99 import _ACTIVATIONS
from aerial_gym.export.encoder import compare_encoder, encoder_runner, write_encoder
from aerial_gym.export.export import FORMATS, Exported, compare_policy, write_policy
from aerial_gym.export.layout import Layout
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.pilot import COMPILER, load_exported
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.sensors.encoder.file import ACTIVATIONS, Autoencoder, AutoencoderCfg, Encoder, EncoderImageCfg
from tests.unit.export.policies import TRANSFORMS, layout, make_layout, random_policy
from tests.unit.export.test_export import IMAGE, OBSERVATIONS, image_layout, random_policy_of_images

NEEDS_C = pytest.mark.skipif(which("gcc") is None and which("cc") is None, reason="needs a C compiler")


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(export, "CHECKED", 5_000)


def compare_columns(exact: list[float], rounded: list[float], result: list[float]) -> Comparison:
    columns = (torch.tensor(exact, dtype=torch.float64), torch.tensor(rounded), torch.tensor(result))
    comparison = Comparison(["x"])
    comparison.add(*(column[:, None] for column in columns))
    return comparison


def test_the_limit_is_that_of_float32() -> None:
    """Error 0.02, rounding 0.001 and range 8: limit FACTOR (0.001 + 8 2^-23)."""
    worst = compare_columns([0.0, 8.0], [0.001, 8.0], [0.02, 8.0]).worst
    assert (worst.error, worst.rounding, worst.span) == pytest.approx((0.02, 0.001, 8.0))
    assert worst.limit == pytest.approx(FACTOR * (0.001 + 8.0 * UNIT), rel=1e-6)
    assert not worst.holds
    assert compare_columns([0.0, 8.0], [0.001, 8.0], [0.009, 8.0]).worst.holds
    assert compare_columns([0.0, 0.0], [0.0, 0.0], [0.0, 0.0]).worst.holds
    for exact, wrong in (([0.0, 8.0], nan), ([0.0, 8.0], inf), ([0.0, 0.0], 1e-9)):
        assert not compare_columns(exact, exact, [0.0, wrong]).worst.holds
    comparison = compare_columns([0.0, 8.0], [0.0, 8.0], [0.0, 8.0])
    comparison.add_not_finite(torch.tensor([[nan], [nan]]))
    assert comparison.worst.holds
    comparison.add_not_finite(torch.tensor([[nan], [0.3]]))
    assert not comparison.worst.holds


@pytest.mark.parametrize(("result", "status"), [(0.009, 0), (0.02, 1), (nan, 1)])
def test_the_command_ends_with_status_1_for_a_file_that_does_not_pass(
    result: float, status: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "hover.pt"
    file.write_bytes(b"")
    worst = compare_columns([0.0, 8.0], [0.001, 8.0], [result, 8.0]).worst
    written = [Exported(to="torchscript", file=file, largest_difference=result, agreement=worst)]
    monkeypatch.setattr(export, "export_policy", lambda *_, **__: written)
    assert ExportCmd(policy=tmp_path, json=True).run() == status
    out, err = capsys.readouterr()
    assert json.loads(out)["agrees"] is (status == 0)
    assert ("hover.pt" in err) == (status == 1)


def test_each_output_has_a_limit_of_its_own() -> None:
    comparison = Comparison(["speed", "angle"])
    exact = torch.tensor([[0.0, 0.0], [3000.0, 1e-4]], dtype=torch.float64)
    results = torch.tensor([[1e-4, 2e-5], [3000.0, 1e-4]])
    comparison.add(exact, exact.float(), results)
    assert (comparison.worst.output, comparison.worst.holds) == ("angle", False)
    comparison = Comparison(["speed", "angle"])
    comparison.add(exact, exact.float(), torch.tensor([[1e-4, 0.0], [3000.0, 1e-4]]))
    assert comparison.worst.holds


GOOD: dict[str, tuple[dict[str, object], float, str, dict[str, list[float]]]] = {
    "commands in rad/s": ({}, 1.0, "affine", {"low": [0.0] * 4, "high": [3000.0] * 4}),
    "roots of thrust shares": ({}, 1.0, "four_places", {"low": [0.0] * 4, "high": [3000.0] * 4}),
    "large weights": ({"activation": "relu"}, 10.0, "direct", {}),
    "large weights and a memory": ({"memory": 16}, 10.0, "direct", {}),
    "small commands": ({"activation": "tanh"}, 1.0, "affine", {"low": [0.0] * 4, "high": [1e-6] * 4}),
    "offset commands": ({}, 1.0, "affine", {"low": [1000.0] * 4, "high": [1000.1] * 4}),
}
"""Options of a policy, a factor of its weights (float32 itself is 1e-4 off by 10), transform of actions and its numbers."""


def make_good(name: str) -> tuple[Policy, Layout]:
    options, factor, transform, numbers = GOOD[name]
    policy = random_policy(**options)
    for layer in policy.body.layers:
        if isinstance(layer, nn.Linear):
            layer.weight.data *= factor
    return policy, make_layout(policy, transform, **numbers)


@NEEDS_C
@pytest.mark.parametrize("name", list(GOOD))
def test_good_files_pass(name: str, tmp_path: Path) -> None:
    policy, made = make_good(name)
    for each in write_policy(policy, made, tmp_path, ["c99", "torchscript"]):
        assert each.agrees, each


def _swap_columns(weight: Tensor) -> None:
    weight[:, [0, 1]] = weight[:, [1, 0]]


def _no_normalizer(policy: Policy) -> None:
    policy.body.normalizers["observations"].set_statistics(torch.zeros(13), torch.ones(13))


def _other_limit(policy: Policy) -> None:
    policy.body.normalizers["observations"].limit = 1e9


def _other_activation(policy: Policy) -> None:
    policy.body.layers[1], policy.body.cfg = nn.ReLU(), replace(policy.body.cfg, activation="relu")


WRONG: dict[str, Callable[[Policy], object]] = {
    "swapped inputs": lambda policy: _swap_columns(policy.body.layers[0].weight.data),
    "swapped weights of the head": lambda policy: _swap_columns(policy.head.weight.data),
    "no normaliser": _no_normalizer,
    "no limit behind the normaliser": _other_limit,
    "another activation": _other_activation,
    "one weight 1 % larger": lambda policy: policy.body.layers[2].weight.data[3, 5].mul_(1.01),
    "no bias of one action": lambda policy: policy.head.bias.data[3].zero_(),
    "weights of 16 bits": lambda policy: policy.head.weight.data.copy_(policy.head.weight.half().float()),
    "forgotten memory": lambda policy: policy.body.cell.weight_hh.data.zero_(),
}


@NEEDS_C
@pytest.mark.parametrize(("name", "to"), [(name, ("c99", "torchscript")[i % 2]) for i, name in enumerate(WRONG)])
def test_wrong_files_do_not_pass(name: str, to: str, tmp_path: Path) -> None:
    """A file of a policy that was changed after it, with commands up to 3000 rad/s."""
    memory = 8 if name == "forgotten memory" else 0
    wrong, right = random_policy(memory=memory), random_policy(memory=memory)
    made = make_layout(right, "affine", low=[0.0] * 4, high=[3000.0] * 4)
    WRONG[name](wrong)
    (written,) = write_policy(wrong, made, tmp_path, [to], check=False)
    worst = compare_policy(DeployablePolicy(right, made).eval(), made, written.file).worst
    assert not worst.holds, worst


@NEEDS_C
def test_an_activation_that_hides_nan_does_not_pass(tmp_path: Path) -> None:
    policy = random_policy(activation="relu", normalize=False)
    made = layout(policy)
    (written,) = write_policy(policy, made, tmp_path, ["c99"], check=False)
    text = written.file.read_text()
    assert _ACTIVATIONS["relu"] in text
    hiding = text.replace("if (!finite)", "if (0)").replace("x < 0.0f ? 0.0f : x", "x > 0.0f ? x : 0.0f")
    written.file.write_text(hiding)
    worst = compare_policy(DeployablePolicy(policy, made).eval(), made, written.file).worst
    assert worst.error == inf
    assert not worst.holds


ENCODERS = [(".pt", "elu"), *(pytest.param(".c", name, marks=NEEDS_C) for name in ("elu", "relu", "tanh"))]


@pytest.mark.parametrize(("ending", "activation"), [*ENCODERS, pytest.param(".onnx", "tanh", marks=pytest.mark.slow)])
def test_encoders(ending: str, activation: str, tmp_path: Path) -> None:
    """Of an image whose sides are no powers of two; C is compiled with -Wall -Wextra -Werror -pedantic."""
    torch.manual_seed(2)
    cfg = AutoencoderCfg(rows=21, columns=38, latents=5, channels=(4, 6, 8), activation=activation)
    seen = EncoderImageCfg(model="pinhole", kind="range", rows=21, columns=38, max_range=10.0, hfov_deg=87.0)
    encoder = Encoder(Autoencoder(cfg), seen, trained={})
    encoder.save(tmp_path / "small.pt")
    file = write_encoder(str(tmp_path / "small.pt"), tmp_path / f"small_encoder{ending}")
    assert compare_encoder(encoder, file).worst.holds
    other = Encoder(Autoencoder(replace(cfg, activation="elu" if activation == "relu" else "relu")), seen, trained={})
    other.load_state_dict(encoder.state_dict())
    assert not compare_encoder(other, file).worst.holds
    if ending == ".c":
        assert "malloc" not in file.read_text()
        text = file.with_suffix(".h").read_text()
        assert "#define SMALL_ENCODER_LATENTS 5" in text
        assert "image: 21 x 38 pixels, row by row from the top" in text
    for bad in BAD:
        images = torch.rand(3, 21, 38)
        images[0, 20, 37], images[1, 2, 3] = bad, bad
        latents = encoder_runner(encoder, file)(images)
        assert latents[:2].isnan().all()
        assert latents[2].isfinite().all()


BAD = (nan, inf, -inf)
QUICK = ("c99", "torchscript")


def make_rows(bad: float, width: int) -> Tensor:
    """Return observations (O + 1, O): in row i, entry i is ``bad``; the last row is finite."""
    rows = torch.randn(width + 1, width, generator=torch.Generator().manual_seed(1))
    rows[:width].diagonal().fill_(bad)
    return rows


def check_bad_entries(file: Path, policy: Policy, made: Layout) -> None:
    """Check that each bad entry, of the observation or the memory, makes its own row NaN and no other."""
    flown, step = DeployablePolicy(policy, made), load_exported(file).step
    for bad in BAD:
        seen = make_rows(bad, made.num_observations)
        result = step(seen, torch.zeros(len(seen), made.memory))
        assert all(out[:-1].isnan().all() for out in result)
        assert all(out[-1].isfinite().all() for out in result)
        expected = flown(seen, *((torch.zeros(len(seen), made.memory),) if made.memory else ()))
        for reference, out in zip(expected, result, strict=False):
            torch.testing.assert_close(out, reference, equal_nan=True, rtol=1e-4, atol=1e-4)
        if made.memory:
            remembered = make_rows(bad, made.memory)
            result = step(torch.zeros(len(remembered), made.num_observations), remembered)
            assert all(out[:-1].isnan().all() and out[-1].isfinite().all() for out in result)


@NEEDS_C
@pytest.mark.parametrize("memory", [0, 5])
@pytest.mark.parametrize("activation", list(ACTIVATIONS))
def test_every_activation(activation: str, memory: int, tmp_path: Path) -> None:
    policy = random_policy(activation=activation, memory=memory, normalize=activation != "elu")
    policy.body.layers[0].weight.data[:, 3] = 0.0  # torch: NaN * 0 = NaN, also of an entry that the network ignores
    made = layout(policy)
    for written in write_policy(policy, made, tmp_path, QUICK, check=False):
        check_bad_entries(written.file, policy, made)


@NEEDS_C
@pytest.mark.parametrize("name", list(TRANSFORMS))
def test_every_transform(name: str, tmp_path: Path) -> None:
    policy = random_policy(activation="relu")
    made = make_layout(policy, name)
    for written in write_policy(policy, made, tmp_path, QUICK, check=False):
        check_bad_entries(written.file, policy, made)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("activation", "memory", "name"), [("relu", 5, "forward_flight"), ("elu", 0, "four_places"), ("tanh", 0, "affine")]
)
def test_onnx(activation: str, memory: int, name: str, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnxscript")
    policy = random_policy(activation=activation, memory=memory)
    made = make_layout(policy, name)
    (written,) = write_policy(policy, made, tmp_path, ["onnx"], check=False)
    check_bad_entries(written.file, policy, made)


def test_every_format_is_tested_here_or_in_the_engine_of_a_firmware() -> None:
    slow = Path(__file__).parents[2] / "slow"
    engines = {path.name.removeprefix("test_").removesuffix("_engine.py") for path in slow.glob("test_*_engine.py")}
    assert set(FORMATS) == {*QUICK, "onnx", *engines}


@NEEDS_C
def test_fast_math_does_not_remove_the_check(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Firmware is often compiled with -Ofast, under which ``isnan`` and comparisons with NaN mean nothing."""
    monkeypatch.setattr(pilot, "COMPILER", (*COMPILER, "-Ofast"))
    policy = random_policy(activation="relu", memory=5)
    made = layout(policy)
    (written,) = write_policy(policy, made, tmp_path, ["c99"], check=False)
    check_bad_entries(written.file, policy, made)


@NEEDS_C
def test_the_c_function_returns_an_error_until_the_memory_is_reset(tmp_path: Path) -> None:
    policy = random_policy(memory=5)
    (written,) = write_policy(policy, layout(policy), tmp_path, ["c99"], check=False)
    driver = """#include "hover.h"
int codes(float bad, int *out);
int codes(float bad, int *out) {
    static hover_state state, before;
    float seen[HOVER_NUM_OBSERVATIONS] = {0.0f}, command[HOVER_NUM_COMMANDS];
    hover_reset(&state);
    out[0] = hover_step(&state, seen, command);
    before = state;
    seen[7] = bad;
    out[1] = hover_step(&state, seen, command);
    seen[7] = 0.0f;
    out[2] = hover_step(&state, seen, command);
    state = before;
    out[3] = hover_step(&state, seen, command);
    hover_reset(&state);
    out[4] = hover_step(&state, seen, command);
    return command[0] == command[0];
}
"""
    codes = pilot.compile_library(written.file, driver).codes
    for bad in BAD:
        out = (ctypes.c_int * 5)()
        assert codes(ctypes.c_float(bad), out)
        assert list(out) == [0, 1, 1, 0, 0]


@NEEDS_C
def test_an_overflow_inside_is_no_command(tmp_path: Path) -> None:
    policy = random_policy(activation="relu", normalize=False)
    made = layout(policy)
    seen = torch.full((1, made.num_observations), 3e38) * torch.tensor([1.0, -1.0] * 7)[: made.num_observations]
    for written in write_policy(policy, made, tmp_path, QUICK, check=False):
        command, action, _ = load_exported(written.file).step(seen, torch.zeros(1, 0))
        assert command.isnan().all()
        assert action.isnan().all()


@NEEDS_C
def test_pixels(tmp_path: Path) -> None:
    policy = random_policy_of_images({"observations": OBSERVATIONS, "depth": IMAGE}, activation="relu")
    made = image_layout(policy, {"depth": ImageCfg(dtype="float32")})
    for written in write_policy(policy, made, tmp_path, QUICK, check=False):
        step = load_exported(written.file).step
        for bad in BAD:
            images = torch.rand(3, *IMAGE)
            images[0, 0, -1, -1], images[1, 0, 3, 7] = bad, bad
            command, action, _ = step(torch.zeros(3, *OBSERVATIONS), torch.zeros(3, 0), images)
            for out in (command, action):
                assert out[:2].isnan().all()
                assert out[2].isfinite().all()
