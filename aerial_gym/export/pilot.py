"""Exported policy files as pilots in the simulator.

Letters: E environments, O entries of an observation, C x H x W an image, U entries of a command, V of an action, M numbers of
memory.
"""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from math import prod
from pathlib import Path
from shutil import which
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from aerial_gym.errors import CapabilityError, ConfigError
from aerial_gym.export.c99_images import PIXELS
from aerial_gym.export.layout import Layout
from aerial_gym.export.module import onnx_session
from aerial_gym.export.targets.tflm_engine import tflite_step
from aerial_gym.interop import usual_settings

if TYPE_CHECKING:
    from aerial_gym.rl_training.settings import TrainingCfg

Step = Callable[..., tuple[Tensor, Tensor, Tensor]]
"""Observation (E, O), memory (E, M) and images (E, C, H, W) to command (E, U), action (E, V) and the memory after it, on the
CPU."""

COMPILER = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-pedantic")  # Compiler options for the source


class ExportedPilot:
    """Flies an exported policy, as ``evaluate`` wants it."""

    def __init__(self, layout: Layout, step: Step) -> None:
        self.layout, self.step = layout, step
        scale = [torch.full((seen.count,), seen.scale) for seen in layout.observation]
        self._scale, self._keys = torch.cat(scale), list(dict.fromkeys(seen.key for seen in layout.observation))
        self._memory: Tensor | None = None

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of its inputs for one environment, by observation key."""
        counts = {key: sum(s.count for s in self.layout.observation if s.key == key) for key in self._keys}
        return {key: (count,) for key, count in counts.items()} | {each.key: each.shape for each in self.layout.images}

    @property
    def num_actions(self) -> int:
        """Entries of an action, V."""
        return self.layout.num_actions

    def __call__(self, observation: Mapping[str, Tensor]) -> Tensor:
        """Return actions (E, V) of the observations of a task, by key."""
        given = torch.cat([observation[key] for key in self._keys], dim=-1)
        if self._memory is None or len(self._memory) != len(given):
            self._memory = torch.zeros(len(given), self.layout.memory)
        images = (observation[each.key].cpu() for each in self.layout.images)
        _, action, self._memory = self.step(given.cpu() / self._scale, self._memory, *images)
        return action.to(given.device)

    def reset(self, mask: Tensor | None = None) -> None:
        """Clear the memory of the environments in ``mask``, bool (E,), or of all."""
        if mask is None or self._memory is None:
            self._memory = None
        else:
            self._memory = self._memory.masked_fill(mask.cpu().unsqueeze(-1), 0.0)


@usual_settings
def load_exported(file: str | Path) -> ExportedPilot:
    """Return the pilot of an exported file: ``.onnx``, ``.pt``, ``.c`` or ``.tflite``, beside ``policy.json``.

    Raises:
        ConfigError: If the format is unknown, or ``policy.json`` is missing.
        CapabilityError: If its runtime is missing: onnxruntime, gcc, or TensorFlow Lite Micro.
    """
    file = Path(file)
    layout = Layout.read(file.parent)
    if file.suffix not in STEPS or not file.is_file():
        raise ConfigError(
            f"{file}: is no exported policy. Give the {', '.join(STEPS)} file that aerial-gym export wrote"
        )
    return ExportedPilot(layout, STEPS[file.suffix](file, layout))


def load_pilot(source: Path, device: str) -> tuple[Any, "Layout | TrainingCfg"]:
    """Return the policy of an exported file, run folder or checkpoint, and the task, robot and controller that it flies."""
    from aerial_gym.rl_training.policies.load import load_policy

    if source.suffix not in STEPS:
        return load_policy(source, device=device)
    pilot = load_exported(source)
    return pilot, pilot.layout


def torchscript_step(file: Path, layout: Layout) -> Step:
    """Return the step of a TorchScript file."""
    module = torch.jit.load(str(file))

    @torch.no_grad()
    def step(observation: Tensor, memory: Tensor, *images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        if layout.memory:
            return module(observation, *images, memory)
        return (*module(observation, *images), memory)

    return step


def onnx_step(file: Path, layout: Layout) -> Step:
    """Return the step of an ONNX file, in onnxruntime on the CPU."""
    session = onnx_session(file)

    def step(observation: Tensor, memory: Tensor, *images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        given = {"observation": observation.numpy()} | ({"memory": memory.numpy()} if layout.memory else {})
        given |= {each.key: image.numpy() for each, image in zip(layout.images, images, strict=True)}
        command, action, *after = (torch.from_numpy(np.array(out)) for out in session.run(None, given))
        return command, action, after[0] if after else memory

    return step


def compile_library(file: Path, driver: str) -> ctypes.CDLL:
    """Compile a C file with its driver into a shared library for this machine."""
    compiler = which("gcc") or which("cc")
    if compiler is None:
        raise CapabilityError("no C compiler here (gcc, cc): the source was written, and cannot be flown here")
    with tempfile.TemporaryDirectory() as folder:
        more, library = Path(folder) / "rows.c", Path(folder) / "rows.so"
        more.write_text(driver, encoding="utf-8")
        options = [*COMPILER, "-fPIC", "-shared", f"-I{file.parent}"]
        command = [compiler, *options, str(file), str(more), "-o", str(library), "-lm"]
        done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False)
        if done.returncode:
            raise CapabilityError(f"{file}: does not compile: {done.stderr.strip()[:500]}")
        return ctypes.CDLL(str(library))


def c99_step(file: Path, layout: Layout) -> Step:
    """Return the step of a C file, compiled for this machine."""
    n, seen, given = layout.name, layout.num_observations, len(layout.command)
    acts, memory = layout.num_actions, layout.memory
    types = {each.key: PIXELS[each.dtype][0] for each in layout.images}
    images = "".join(f", const {kind} *{key}" for key, kind in types.items())
    looks = "".join(f"{each.key} + r * {prod(each.shape)}, " for each in layout.images)
    rows = f"""#include "{n}.h"
void {n}_rows(int rows, const float *observation, float *command, float *action, float *memory{images}) {{
    static {n}_state state;
    for (int r = 0; r < rows; ++r) {{
        {n}_reset(&state);
        {f"for (int i = 0; i < {memory}; ++i) state.memory[i] = memory[r * {memory} + i];" if memory else "(void)memory;"}
        {n}_step(&state, observation + r * {seen}, {looks}command + r * {given});
        for (int i = 0; i < {acts}; ++i) action[r * {acts} + i] = state.action[i];
        {f"for (int i = 0; i < {memory}; ++i) memory[r * {memory} + i] = state.memory[i];" if memory else ""}
    }}
}}
"""
    call = getattr(compile_library(file, rows), f"{n}_rows")

    def step(observation: Tensor, memory: Tensor, *images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        pixels = [image.contiguous() for image in images]
        observation, after = observation.float().contiguous(), memory.float().clone().contiguous()
        out, action = torch.empty(len(observation), given), torch.empty(len(observation), acts)
        places = (ctypes.c_void_p(each.data_ptr()) for each in (observation, out, action, after, *pixels))
        call(ctypes.c_int(len(observation)), *places)
        return out, action, after

    return step


STEPS: dict[str, Callable[[Path, Layout], Step]] = {
    ".onnx": onnx_step, ".pt": torchscript_step, ".c": c99_step, ".tflite": tflite_step,
}  # fmt: skip
"""Runners of exported files by their ending."""
