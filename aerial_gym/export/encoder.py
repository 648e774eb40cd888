"""The encoder of a policy that sees latents, beside the policy: from an image to what goes into ``image_latents``.

Letters: B images, H x W pixels, L latents.
"""

from collections.abc import Callable
from pathlib import Path

import torch
from torch import Tensor

from aerial_gym.config.storage import write_whole
from aerial_gym.export.formats import onnx_bytes, torchscript_bytes
from aerial_gym.sensors.encoder.file import Encoder, load_encoder

INPUT, OUTPUT = "image", "latents"
"""Names: shares of the largest distance (B, H, W), 0 to 1, to latents (B, L)."""

CHECKED = 1_000
"""Random images with which a file is compared."""


def write_encoder(encoder: str, file: Path) -> Path:
    """Write an encoder as ONNX or TorchScript, by the ending of the file; return the file."""
    module = load_encoder(encoder)
    given = (torch.zeros(2, module.seen.rows, module.seen.columns),)
    if file.suffix == ".onnx":
        write_whole(file, onnx_bytes(module, given, [INPUT], [OUTPUT], ({0: torch.export.Dim("rows")},)))
    else:
        write_whole(file, torchscript_bytes(module, given))
    return file


def _runner(file: Path) -> Callable[[Tensor], Tensor]:
    if file.suffix == ".onnx":
        import onnxruntime

        session = onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])
        return lambda images: torch.from_numpy(session.run(None, {INPUT: images.numpy()})[0])
    return torch.jit.load(str(file))


@torch.no_grad()
def difference_of_encoder(encoder: Encoder, file: Path) -> float:
    """Return how far latents of a file are from those of torch at most, over ``CHECKED`` random images."""
    images = torch.rand(CHECKED, encoder.seen.rows, encoder.seen.columns, generator=torch.Generator().manual_seed(0))
    return float((encoder(images) - _runner(file)(images)).abs().max())
