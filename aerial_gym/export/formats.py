"""A torch module as ONNX or TorchScript, and sessions of ONNX files."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from aerial_gym.errors import CapabilityError


def onnx_bytes(
    module: nn.Module, given: tuple[Tensor, ...], inputs: list[str], outputs: list[str], dynamic: tuple[Any, ...]
) -> bytes:
    """Return a module as ONNX with ``dynamic`` dimensions (``torch.export``); raise ``CapabilityError`` without its package."""
    try:
        import onnx  # noqa: F401
        import onnxscript  # noqa: F401
    except ImportError as error:
        raise CapabilityError(f"{error.name} is not installed. Run: pip install 'aerial-gym[export]'") from None
    program = torch.onnx.export(
        module, given, input_names=inputs, output_names=outputs, dynamic_shapes=dynamic, dynamo=True, verbose=False
    )
    assert program is not None
    return program.model_proto.SerializeToString()


def onnx_session(file: Path) -> Any:
    """Return the session of an ONNX file on the CPU; raise ``CapabilityError`` without onnxruntime."""
    try:
        import onnxruntime
    except ImportError:
        raise CapabilityError("onnxruntime is not installed. Run: pip install 'aerial-gym[export]'") from None
    return onnxruntime.InferenceSession(str(file), providers=["CPUExecutionProvider"])


def torchscript_bytes(module: nn.Module, given: tuple[Tensor, ...]) -> bytes:
    """Return a module as TorchScript, traced with inputs of the right shapes."""
    traced = torch.jit.trace(module, given)
    return traced.save_to_buffer()  # pyright: ignore[reportAttributeAccessIssue, reportFunctionMemberAccess]
