"""Whether observation terms and rewards return what they say. Letters: E environments."""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from aerial_gym.config.task import TaskCfg
from aerial_gym.errors import ConfigError
from aerial_gym.task.observations import OBSERVATIONS, TaskState


@torch.no_grad()
def check_shapes(cfg: TaskCfg, state: TaskState, widths: Sequence[int], reward: Callable[[TaskState], Tensor]) -> None:
    """Call every observation term and the reward once.

    Args:
        cfg: Names them.
        state: Any states.
        widths: Entries that each term says it has.
        reward: Takes the state.

    Raises:
        ConfigError: If one returns another shape or whole numbers; (E, 1) would be spread to (E, E) in silence.
    """
    rows = state.position.shape[0]
    for entry, width in zip(cfg.observations, widths, strict=True):
        _check(f"observation term {entry.term!r}", OBSERVATIONS[entry.term].value(state), (rows, width), "(E, width)")
    _check(f"reward {cfg.reward!r}", reward(state), (rows,), "(E,)")


def _check(what: str, value: object, expected: tuple[int, ...], letters: str) -> None:
    if not isinstance(value, Tensor):
        raise ConfigError(f"{what}: returns a {type(value).__name__}, needs a tensor {letters}")
    if tuple(value.shape) != expected or not value.is_floating_point():
        raise ConfigError(
            f"{what}: returns {tuple(value.shape)} {value.dtype}, needs {letters} = {expected} of floating point numbers"
        )
