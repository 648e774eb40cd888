"""Export of trained policies to ONNX, TorchScript and C99, each with a description of inputs and outputs."""

from typing import TYPE_CHECKING

from aerial_gym.lazy import exports

if TYPE_CHECKING:
    from aerial_gym.export.export import FORMATS, Exported, export_policy
    from aerial_gym.export.layout import Layout
    from aerial_gym.export.pilot import ExportedPilot, load_exported

__all__ = ["FORMATS", "Exported", "ExportedPilot", "Layout", "export_policy", "load_exported"]

__getattr__, __dir__ = exports(__name__, __file__)
