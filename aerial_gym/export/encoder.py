"""Export of the image encoder of a policy that observes ``image_latents``.

Letters: B images, H x W pixels, L latents.
"""

import ctypes
from collections.abc import Callable
from copy import deepcopy
from pathlib import Path

import torch
from torch import Tensor, nn

from aerial_gym.config.storage import write_atomic
from aerial_gym.export import c99
from aerial_gym.export.agreement import Comparison, inputs_not_finite
from aerial_gym.export.module import finite_rows, nan_where_not_finite, onnx_bytes, onnx_session, torchscript_bytes
from aerial_gym.export.pilot import compile_library
from aerial_gym.sensors.encoder.file import Encoder, load_encoder

INPUT, OUTPUT = "image", "latents"  # Names: shares of the largest distance (B, H, W), 0 to 1, to latents (B, L)
CHECKED = 1_000  # Random images with which a file is compared


class DeployableEncoder(nn.Module):
    """An encoder that gives NaN for an image with a pixel that is NaN or infinite."""

    def __init__(self, encoder: Encoder) -> None:
        super().__init__()
        self.encoder = encoder

    def forward(self, shares: Tensor) -> Tensor:
        """Return latents (B, L) of images (B, H, W) of shares of the largest distance."""
        latents = self.encoder(shares)
        return nan_where_not_finite(finite_rows(shares, latents), latents)


def write_encoder(encoder: str, file: Path) -> Path:
    """Write an encoder as ONNX, TorchScript or C99, by the ending of the file; return the file."""
    module = load_encoder(encoder)
    if file.suffix == ".c":
        write_atomic(file.with_suffix(".h"), c99.encoder_header(module, file.stem))
        write_atomic(file, c99.encoder_source(module, file.stem))
        return file
    flown, given = DeployableEncoder(module).eval(), (torch.zeros(2, module.seen.rows, module.seen.columns),)
    if file.suffix == ".onnx":
        content = onnx_bytes(flown, given, [INPUT], [OUTPUT], ({0: torch.export.Dim("rows")},))
    else:
        content = torchscript_bytes(flown, given)
    write_atomic(file, content)
    return file


def _c_runner(encoder: Encoder, file: Path) -> Callable[[Tensor], Tensor]:
    name, pixels = file.stem, encoder.seen.rows * encoder.seen.columns
    driver = f"""#include "{name}.h"
void rows(int rows, const float *images, float *latents) {{
    static {name}_space space;
    for (int r = 0; r < rows; ++r) {name}_encode(&space, images + r * {pixels}, latents + r * {encoder.num_latents});
}}
"""
    call = compile_library(file, driver).rows

    def run(images: Tensor) -> Tensor:
        images, out = images.contiguous(), torch.empty(len(images), encoder.num_latents)
        call(ctypes.c_int(len(images)), ctypes.c_void_p(images.data_ptr()), ctypes.c_void_p(out.data_ptr()))
        return out

    return run


def encoder_runner(encoder: Encoder, file: Path) -> Callable[[Tensor], Tensor]:
    """Return the function of an encoder file, images (B, H, W) to latents (B, L)."""
    if file.suffix == ".c":
        return _c_runner(encoder, file)
    if file.suffix == ".onnx":
        session = onnx_session(file)
        return lambda images: torch.from_numpy(session.run(None, {INPUT: images.numpy()})[0])
    return torch.jit.load(str(file))


@torch.no_grad()
def compare_encoder(encoder: Encoder, file: Path) -> Comparison:
    """Return the comparison of a file's latents with torch, on ``CHECKED`` random images and some with NaN or infinity."""
    rows, columns = encoder.seen.rows, encoder.seen.columns
    run, result = encoder_runner(encoder, file), Comparison([f"{OUTPUT} {i}" for i in range(encoder.num_latents)])
    images = torch.rand(CHECKED, rows, columns, generator=torch.Generator().manual_seed(0))
    result.add(deepcopy(encoder).double()(images.double()), encoder(images), run(images))
    pixels = rows * columns
    bad = inputs_not_finite(pixels, (0, pixels // 2, pixels - 1)).unflatten(-1, (rows, columns))
    result.add_not_finite(run(bad))
    return result
