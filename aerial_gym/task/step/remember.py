"""Values for the next step: the command's next target and buffers, in one kernel.

Letters: E environments.
"""

from collections.abc import Mapping

from torch import Tensor

from aerial_gym.task.commands.command import Command
from aerial_gym.task.step.by_row import NamedRows
from aerial_gym.task.values import Values


def make_memory(command: Command, values: Values) -> NamedRows | None:
    """Return the kernel, None without buffers. Make it last, after all inputs are declared."""
    updates = dict(values.updates)

    def remembered(given: Mapping[str, Tensor]) -> dict[str, Tensor]:
        found = command.next_values(given)
        for name, term in updates.items():
            found[name] = term.evaluate({**given, **found})
        return found

    names = (*command.next_values(values), *updates)
    if not names:
        return None
    reads = {name: values.find(name, "the command") for name in ("sim_steps", "begun", *command.reads)}
    reads |= values.read_by(*updates.values())
    writes = {name: values[name] for name in names}
    return NamedRows(remembered, "the buffers for the next step", reads=reads, writes=writes, graph=values.graph)
