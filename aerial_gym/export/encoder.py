"""The encoder of a policy that sees latents, beside the policy: from an image to what goes into ``image_latents``.

Letters: B images, H x W pixels, L latents.
"""

import ctypes
from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.config.storage import write_whole
from aerial_gym.export import c99
from aerial_gym.export.formats import onnx_bytes, torchscript_bytes
from aerial_gym.export.pilot import compiled
from aerial_gym.sensors.encoder.file import Encoder, load_encoder

INPUT, OUTPUT = "image", "latents"
"""Names: shares of the largest distance (B, H, W), 0 to 1, to latents (B, L)."""

CHECKED = 1_000
"""Random images with which a file is compared."""


def write_encoder(encoder: str, file: Path) -> Path:
    """Write an encoder as ONNX, TorchScript or C99, by the ending of the file; return the file."""
    module = load_encoder(encoder)
    if file.suffix == ".c":
        write_whole(file.with_suffix(".h"), c99.encoder_header(module, file.stem))
        write_whole(file, c99.encoder_source(module, file.stem))
        return file
    given = (torch.zeros(2, module.seen.rows, module.seen.columns),)
    if file.suffix == ".onnx":
        write_whole(file, onnx_bytes(module, given, [INPUT], [OUTPUT], ({0: torch.export.Dim("rows")},)))
    else:
        write_whole(file, torchscript_bytes(module, given))
    return file


def _compiled(encoder: Encoder, file: Path) -> Callable[[Tensor], Tensor]:
    name, pixels = file.stem, encoder.seen.rows * encoder.seen.columns
    driver = f"""#include "{name}.h"
void rows(int rows, const float *images, float *latents) {{
    static {name}_space space;
    for (int r = 0; r < rows; ++r) {name}_encode(&space, images + r * {pixels}, latents + r * {encoder.num_latents});
}}
"""
    call = compiled(file, driver).rows

    def run(images: Tensor) -> Tensor:
        images, out = images.contiguous(), torch.empty(len(images), encoder.num_latents)
        call(ctypes.c_int(len(images)), ctypes.c_void_p(images.data_ptr()), ctypes.c_void_p(out.data_ptr()))
        return out

    return run


def _runner(encoder: Encoder, file: Path) -> Callable[[Tensor], Tensor]:
    if file.suffix == ".c":
        return _compiled(encoder, file)
    if file.suffix == ".onnx":
        import onnxruntime

        session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        return lambda images: torch.from_numpy(session.run(None, {INPUT: images.numpy()})[0])
    return torch.jit.load(str(file))


@torch.no_grad()
def difference_of_encoder(encoder: Encoder, file: Path) -> float:
    """Return how far latents of a file are from those of torch at most, over ``CHECKED`` random images.

    As a share of the largest latent, if that is above 1: all are sums of terms of its size.

    Raises:
        CapabilityError: If what runs the file is missing.
    """
    images = torch.rand(CHECKED, encoder.seen.rows, encoder.seen.columns, generator=torch.Generator().manual_seed(0))
    latents = encoder(images)
    off = (latents - _runner(encoder, file)(images)).abs().max()
    return float(off / latents.abs().max().clamp_min(1.0))
