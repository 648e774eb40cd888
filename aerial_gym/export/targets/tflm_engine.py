"""Run of an exported ``.tflite`` file by TensorFlow Lite Micro, the engine of PX4's ``mc_nn_control``.

Its package is in an environment of its own in the user's cache folder, which ``make firmware-tools`` makes.
Letters: B rows, O entries of an observation.
"""

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from aerial_gym.config.storage import user_cache_folder
from aerial_gym.errors import CapabilityError
from aerial_gym.export.layout import Layout
from aerial_gym.export.targets import requirements, tflm

ENVIRONMENT = "engines"  # Folder of the environment in the cache

PROGRAM = """import sys
import numpy as np
from tflite_micro import runtime
engine, rows = runtime.Interpreter.from_file(sys.argv[1]), np.frombuffer(sys.stdin.buffer.read(), "<f4")
for row in rows.reshape(-1, 1, int(sys.argv[2])):
    engine.set_input(row, 0)
    engine.invoke()
    sys.stdout.buffer.write(engine.get_output(0).astype("<f4").tobytes())
"""
"""Writes the actions of rows of inputs."""


def tflite_step(file: Path, layout: Layout) -> Callable[..., tuple[Tensor, Tensor, Tensor]]:
    """Return the step of a ``.tflite`` file, which starts the engine for each batch of rows."""
    python = user_cache_folder(ENVIRONMENT) / "bin" / "python"
    if not python.is_file():
        raise CapabilityError(f"no TensorFlow Lite Micro in {python.parents[1]}: install it with make firmware-tools")
    command = [str(python), "-c", PROGRAM, str(file), str(tflm.NUM_INPUTS)]
    places = requirements.input_places(layout, tflm.INPUTS)

    def step(observation: Tensor, memory: Tensor, *_: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        inputs = requirements.engine_inputs(observation.float(), *places, tflm.NUM_INPUTS)
        done = subprocess.run(command, input=inputs.numpy().tobytes(), capture_output=True, check=False)
        if done.returncode:
            raise CapabilityError(
                f"TensorFlow Lite Micro refuses {file}: {done.stderr.decode(errors='replace')[-500:]}"
            )
        return *tflm.commands(layout, torch.from_numpy(np.frombuffer(done.stdout, "<f4").reshape(-1, 4).copy())), memory

    return step
