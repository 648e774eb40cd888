"""Values for the next step: the command's next target and buffers, in one kernel.

Letters: E environments.
"""

from collections.abc import Mapping

from torch import Tensor

from aerial_gym.task.commands.command import Command
from aerial_gym.task.step.row_kernels import StepKernel
from aerial_gym.task.values import Values


def make_memory(command: Command, values: Values) -> StepKernel | None:
    """Return the kernel, None without buffers. Make it last, after all inputs are declared."""
    updates = dict(values.updates)

    def next_buffers(given: Mapping[str, Tensor]) -> dict[str, Tensor]:
        buffers = command.next_values(given)
        for name, term in updates.items():
            buffers[name] = term.evaluate({**given, **buffers})
        return buffers

    names = (*command.next_values(values), *updates)
    if not names:
        return None
    reads = {name: values.find(name, "the command") for name in ("sim_steps", "begun", *command.reads)}
    reads |= values.term_inputs(*updates.values())
    writes = {name: values[name] for name in names}
    return StepKernel(next_buffers, "the buffers for the next step", reads=reads, writes=writes, graph=values.graph)
