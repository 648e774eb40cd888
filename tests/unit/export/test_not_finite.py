"""NaN and infinity in an observation come out of every exported file as NaN, never as a command."""

import ctypes
from math import inf, nan
from pathlib import Path
from shutil import which

import pytest
import torch
from torch import Tensor

from aerial_gym.config.task_terms import ImageCfg
from aerial_gym.export import pilot
from aerial_gym.export.encoder import encoder_runner, write_encoder
from aerial_gym.export.export import FORMATS, write_policy
from aerial_gym.export.layout import Layout
from aerial_gym.export.module import DeployablePolicy
from aerial_gym.export.pilot import COMPILER, load_exported
from aerial_gym.rl_training.policies.policy import Policy
from aerial_gym.sensors.encoder.file import ACTIVATIONS, Autoencoder, AutoencoderCfg, Encoder, EncoderImageCfg
from tests.unit.export.policies import TRANSFORMS, layout, make_layout, random_policy
from tests.unit.export.test_images import IMAGE, OBSERVATIONS, image_layout
from tests.unit.export.test_images import random_policy as drawn_image_policy

NEEDS_C = pytest.mark.skipif(which("gcc") is None and which("cc") is None, reason="needs a C compiler")
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


def test_every_format_is_tested_here() -> None:
    assert set(FORMATS) == {*QUICK, "onnx"}


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
    policy = drawn_image_policy({"observations": OBSERVATIONS, "depth": IMAGE}, activation="relu")
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


@NEEDS_C
@pytest.mark.parametrize("activation", ["relu", pytest.param("tanh", marks=pytest.mark.slow)])
def test_latents(activation: str, tmp_path: Path) -> None:
    cfg = AutoencoderCfg(rows=21, columns=38, latents=5, channels=(4, 6), activation=activation)
    seen = EncoderImageCfg(model="pinhole", kind="range", rows=21, columns=38, max_range=10.0, hfov_deg=87.0)
    encoder = Encoder(Autoencoder(cfg), seen, trained={})
    encoder.save(tmp_path / "small.pt")
    endings = [".c", ".pt", *([".onnx"] if activation == "tanh" else [])]
    for ending in endings:
        file = write_encoder(str(tmp_path / "small.pt"), tmp_path / f"small_encoder{ending}")
        for bad in BAD:
            images = torch.rand(3, 21, 38)
            images[0, 20, 37], images[1, 2, 3] = bad, bad
            latents = encoder_runner(encoder, file)(images)
            assert latents[:2].isnan().all()
            assert latents[2].isfinite().all()
