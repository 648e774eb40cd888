"""A policy and its critic, which may see more than the policy does.

Letters: T steps, E environments, M numbers of memory.
"""

from collections.abc import Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache

import torch
from torch import Tensor, nn

from aerial_gym.rl_training.policies.body import OUTLIER, NetworkBody, NetworkBodyCfg, RunningNormalizer
from aerial_gym.rl_training.policies.policy import Gaussian, Policy
from aerial_gym.rl_training.ranks import ALONE, Ranks


@cache
def _second_stream(device: torch.device) -> torch.cuda.Stream:
    return torch.cuda.Stream(device)


@contextmanager
def _parallel_stream(device: torch.device) -> Iterator[AbstractContextManager[object]]:
    """Yield a context that runs on a second CUDA stream, in parallel to the rest of the block. Autograd uses the same streams
    backward. On a CPU both run in sequence."""
    if device.type != "cuda":
        yield nullcontext()
        return
    now, other = torch.cuda.current_stream(device), _second_stream(device)
    other.wait_stream(now)
    yield torch.cuda.stream(other)
    now.wait_stream(other)


class ActorCritic(nn.Module):
    """A policy with a value head, on a body of its own or on the policy's.

    Values are normalised like their target returns; ``scale`` has the statistics of these.
    """

    def __init__(self, actor: Policy, critic: NetworkBodyCfg | None) -> None:
        """Take a policy and the critic's body; None shares the policy's body and memory. Initial values are 0."""
        super().__init__()
        self.actor = actor
        self.own_body = None if critic is None else NetworkBody(critic, beside=actor.body)
        self.value_head = nn.Linear((self.own_body or actor.body).num_features, 1)
        nn.init.zeros_(self.value_head.weight)
        nn.init.zeros_(self.value_head.bias)
        self.scale = RunningNormalizer(limit=float("inf"), outlier=OUTLIER)
        self.memory_sizes = (actor.body.memory_size, 0 if self.own_body is None else self.own_body.memory_size)
        """Memory sizes of policy and critic, which are concatenated in the joint memory (E, M)."""

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the inputs of policy and critic for one environment, by observation key."""
        return {**({} if self.own_body is None else self.own_body.cfg.shapes), **self.actor.shapes}

    def empty_memory(self, num_envs: int) -> Tensor:
        """Return the initial memory (E, M)."""
        return self.value_head.weight.new_zeros(num_envs, sum(self.memory_sizes))

    def network_inputs(self, observation: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the keys that both see, vectors normalised."""
        prepared = self.actor.body.network_inputs(observation)
        if self.own_body is not None:
            more = {key: value for key, value in observation.items() if key not in prepared}
            prepared |= self.own_body.network_inputs(more)
        return prepared

    def update_normalizers(self, observation: Mapping[str, Tensor], ranks: Ranks = ALONE) -> None:
        """Update the normalisers by observations (..., O) of all processes."""
        bodies = (self.actor.body,) if self.own_body is None else (self.actor.body, self.own_body)
        for key, normalizer in {key: value for body in bodies for key, value in body.normalizers.items()}.items():
            assert isinstance(normalizer, RunningNormalizer)
            normalizer.update(observation[key].flatten(0, -2), ranks)

    def sequence_outputs(
        self, prepared: Mapping[str, Tensor], memory: Tensor, begins: Tensor
    ) -> tuple[Gaussian, Tensor]:
        """Return the distributions of actions (T, E, U) and the normalised values (T, E) along a sequence. Arguments as for
        ``NetworkBody.sequence_outputs``, with the joint memory of both."""
        acting, judging = memory.split(self.memory_sizes, dim=-1)
        if self.own_body is None:
            features, _ = self.actor.body.sequence_outputs(prepared, acting, begins)
            return Gaussian(self.actor.head(features), self.actor.log_std), self.value_head(features).squeeze(-1)
        with _parallel_stream(memory.device) as critics:
            with critics:
                features, _ = self.own_body.sequence_outputs(prepared, judging, begins)
                value = self.value_head(features).squeeze(-1)
            features, _ = self.actor.body.sequence_outputs(prepared, acting, begins)
            distribution = Gaussian(self.actor.head(features), self.actor.log_std)
        return distribution, value

    def values(self, prepared: Mapping[str, Tensor], memory: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Return values in units of the return (T, E) along a sequence, and the memory of the critic after each step."""
        acting, judging = memory.split(self.memory_sizes, dim=-1)
        body, own = (self.actor.body, acting) if self.own_body is None else (self.own_body, judging)
        features, after = body.sequence_outputs(prepared, own, begins)
        return self.scale.inverse(self.value_head(features).squeeze(-1)), after

    def next_values(self, prepared: Mapping[str, Tensor], memory: Tensor) -> Tensor:
        """Return values in units of the return, (T, E), of one observation each, seen with the critic's memory (T, E, M)."""
        body = self.own_body or self.actor.body
        flat = {key: value.flatten(0, 1) for key, value in prepared.items()}
        features, _ = body(flat, memory.flatten(0, 1))
        return self.scale.inverse(self.value_head(features).squeeze(-1)).unflatten(0, memory.shape[:2])

    def join_memory(self, acting: Tensor, judging: Tensor) -> Tensor:
        """Return the joint memory (E, M) of policy and critic."""
        return acting if self.own_body is None else torch.cat((acting, judging), dim=-1)
