"""Sensor faults of observation terms, each with a random start and duration per episode.

Letters: E environments, F faults, W entries of the widest term that has a fault.
"""

from collections.abc import Iterable, Mapping

import torch
from torch import Tensor

from aerial_gym.config.task_terms import FaultCfg, ObservationCfg, steps_range
from aerial_gym.math.random import Purpose, Randomness
from aerial_gym.task.kernels.uniform import UniformDraws
from aerial_gym.task.values import Values

STEPS, DRAWS = "fault_steps", "fault_draws"
"""Begin and duration of each fault, (E, 2 F); a share and offsets of each, (E, F (1 + W))."""


class Faults:
    """Sensor faults of a task: draws at reset and their effect on a term."""

    def __init__(
        self,
        terms: Iterable[tuple[object, ObservationCfg, int]],
        cfgs: Mapping[str, FaultCfg],
        values: Values,
        random: Randomness,
    ) -> None:
        """Declare the draws of the faults of observation terms, each with its width."""
        widths: dict[str, int] = {}  # of the widest term with each fault
        for _, cfg, width in terms:
            if cfg.fault is not None:
                widths[cfg.fault] = max(width, widths.get(cfg.fault, 0))
        self._cfgs = {name: cfgs[name] for name in widths}
        self._first: dict[str, int] = {}
        ranges, shares = [], []
        for name, width in widths.items():
            cfg = self._cfgs[name]
            self._first[name] = len(shares)
            ranges += [steps_range(cfg.begin_steps), steps_range(cfg.duration_steps)]
            shares += [(0.0, 1.0), *[(-cfg.size, cfg.size)] * width]
        self._draws: list[UniformDraws] = []
        self.reads: dict[str, Tensor] = {}  # Inputs of `apply_fault`
        if not ranges:
            return
        steps = values.declare(STEPS, (len(ranges),), unit="steps", meaning="when faults begin, how long they last")
        draws = values.declare(DRAWS, (len(shares),), meaning="which episodes have faults, and offsets of jumps")
        self._draws.append(UniformDraws(steps, ranges, purpose=Purpose.FAULT_STEPS, random=random, whole=True))
        self._draws.append(UniformDraws(draws, shares, purpose=Purpose.FAULT, random=random))
        self.reads = {STEPS: steps, DRAWS: draws, "sim_steps": values.gtd["sim_steps"]}

    def draw(self, mask: Tensor) -> None:
        """Draw the faults of new episodes, bool (E,)."""
        for each in self._draws:
            each.draw(mask)

    def apply_fault(self, cfg: ObservationCfg, values: Mapping[str, Tensor], value: Tensor) -> Tensor:
        """Return a term's value, (E, width), with its sensor fault where that acts; a pure function."""
        if cfg.fault is None:
            return value
        fault, first = self._cfgs[cfg.fault], self._first[cfg.fault]
        number = list(self._cfgs).index(cfg.fault)
        since = values["sim_steps"].float() - values[STEPS][:, 2 * number]
        lasts = (since >= 0.0) & (since < values[STEPS][:, 2 * number + 1])
        acts = (lasts & (values[DRAWS][:, first] < fault.share)).unsqueeze(-1)
        if fault.how == "lost":
            return torch.where(acts, cfg.dropout_value, value)
        offsets = values[DRAWS][:, first + 1 : first + 1 + value.shape[-1]]
        return torch.where(acts, value + offsets, value)
