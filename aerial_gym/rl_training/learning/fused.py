"""Proximal policy optimisation with fused network kernels, for two small multi-layer perceptrons on a GPU.

Letters: T steps, E environments, O entries of a network's input, U entries of an action, P weights, B blocks.
"""

import contextlib
import importlib.util
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from threading import Thread
from typing import Any

import torch
from torch import Tensor, nn

from aerial_gym.rl_training.learner_settings import PpoCfg
from aerial_gym.rl_training.learning.learner import BOUND
from aerial_gym.rl_training.learning.ppo import Ppo, RolloutSegment, Samples
from aerial_gym.rl_training.policies.actor_critic import ActorCritic
from aerial_gym.rl_training.ranks import ALONE, Ranks
from aerial_gym.rl_training.settings import TrainingCfg
from aerial_gym.task import Task

WIDTHS = (16, 32, 64)  # Widths of hidden layers whose tiles fit: 128 needs 308 kB of shared memory, an H200 has 232
MOST_INPUTS = 64  # Entries of a network's input, likewise

MOST_ACTIONS = 16

FORWARD_TILE, GRADIENT_TILE = {"tile": 64, "num_warps": 4}, {"tile": 32, "num_warps": 4}
"""Samples that a block takes at a time, and its warps. Of tiles of 32 and 64 with 4 and 8 warps the fastest on an H200: 92 us
for the gradient of 32,768 samples, two hidden layers of 64; 96 to 240 us with others."""

BLOCKS_EACH = 2  # Blocks of the gradient for each multiprocessor: 92 us, with one 100 us
POLICY, CRITIC = "policy", "critic"  # Input of each network as one vector
PRECISION, BACKWARD_PRECISION = "tf32x3", "tf32"  # Of products: forward passes must compare exactly, as in float32


def start_triton_early(device: torch.device) -> None:
    """Start Triton on a thread, so that it is ready when the networks are: it hashes its own files, which takes 0.4 s."""
    if device.type == "cuda" and importlib.util.find_spec("triton") is not None:
        Thread(target=_start_triton, args=(device,), name="triton", daemon=True).start()


def _start_triton(device: torch.device) -> None:
    from aerial_gym.rl_training.learning import kernels

    torch.cuda.set_device(device)
    with contextlib.suppress(Exception):  # the compilation of the networks reports errors
        kernels.write_zero.warmup(torch.float32, grid=(1,))


def _kernel_launcher(kernel: Any, grid: tuple[int, ...], *, compile_only: bool) -> Callable[..., object]:
    return partial(_load_kernel, kernel, grid=grid) if compile_only else kernel[grid]


def _load_kernel(kernel: Any, *arguments: object, grid: tuple[int, ...], **options: object) -> None:
    """Compile a kernel and its launcher, and load them on the GPU."""
    _ = kernel.warmup(*arguments, grid=grid, **options).run


def fusion_refusal(ppo: PpoCfg, network: ActorCritic, device: torch.device) -> str | None:
    """Return the reason against fused network kernels, None if they apply."""
    seen = _input_shapes(network)
    if device.type != "cuda":
        return "no GPU"
    if importlib.util.find_spec("triton") is None:
        return "the package triton is not installed"
    if any(len(shape) != 1 for shapes in seen for shape in shapes.values()):
        return "policy or critic see more than vectors"
    if ppo.sets:
        return "policy or critic see sets of entities"
    if ppo.memory or not ppo.separate_value_network:
        return "the networks have a memory, or share layers"
    if len(ppo.hidden_layers) != 2 or len(set(ppo.hidden_layers)) != 1 or ppo.hidden_layers[0] not in WIDTHS:
        return f"the hidden layers are not two of one width among {', '.join(str(width) for width in WIDTHS)}"
    if max(_count_inputs(shapes) for shapes in seen) > MOST_INPUTS or network.actor.num_actions > MOST_ACTIONS:
        return f"there are more than {MOST_INPUTS} observations or {MOST_ACTIONS} actions"
    return None


class FusedPpo(Ppo):
    """Proximal policy optimisation whose passes through both networks are single launches."""

    def __init__(self, cfg: TrainingCfg, task: Task, network: ActorCritic, ranks: Ranks = ALONE) -> None:
        super().__init__(cfg, task, network, ranks)
        from aerial_gym.rl_training.learning import kernels

        self._kernels, ppo = kernels, self._ppo
        seen = _input_shapes(network)
        self._keys, self._num_in = [list(shapes) for shapes in seen], [_count_inputs(shapes) for shapes in seen]
        assert network.own_body is not None
        self._places = [
            [self._adam.weight_offset(tensor) for linear in linears for tensor in (linear.weight, linear.bias)]
            for linears in (
                _linear_layers(network.actor.body.layers, network.actor.head),
                _linear_layers(network.own_body.layers, network.value_head),
            )
        ]
        self._log_std = self._adam.weight_offset(network.actor.log_std)
        self._sizes: dict[str, Any] = {
            "wide_in": max(16, 1 << (max(self._num_in) - 1).bit_length()),
            "hidden": ppo.hidden_layers[0],
            "wide_out": MOST_ACTIONS,
            "kind": {"elu": kernels.ELU, "relu": kernels.RELU, "tanh": kernels.TANH}[ppo.activation],
            "precision": PRECISION,
        }
        device = task.device
        processors = torch.cuda.get_device_properties(device).multi_processor_count if device.type == "cuda" else 2
        self._partial = torch.zeros(BLOCKS_EACH * processors, self._adam.weights.numel() + 3, device=device)
        self._compiling = self._compile() if device.type == "cuda" else []

    def _compile(self) -> list[Future[Any]]:
        """Start the compilation of kernels in parallel and return its futures; Triton caches the kernels."""
        ppo, envs, width = self._ppo, self._task.num_envs, self._task.num_actions
        seen = [self._partial.new_empty(ppo.horizon, envs, num_in) for num_in in self._num_in]
        action, row = self._partial.new_empty(ppo.horizon, envs, width), self._partial.new_empty(ppo.horizon, envs)
        chosen = torch.empty(-(-envs // ppo.num_minibatches), dtype=torch.int64, device=row.device)
        old: dict[str, Tensor] = {"action": action, "mean": action}
        old |= dict.fromkeys(("log_prob", "advantage", "value", "target"), row)
        samples = Samples(prepared=dict(zip((POLICY, CRITIC), seen, strict=True)), in_time=old, memory=row)
        forward, gradient = self._launch_forward, self._launch_gradient
        threads = ThreadPoolExecutor(3, "triton", initializer=torch.cuda.set_device, initargs=(row.device,))
        compiling = [
            threads.submit(forward, seen[0][0], 0, action[0], compile_only=True),
            threads.submit(forward, seen[1], 1, None, compile_only=True),
            threads.submit(gradient, samples, chosen, action[0, 0], compile_only=True),
        ]
        threads.shutdown(wait=False)
        return compiling

    def iterate(self) -> None:
        """Simulate one segment and update the networks."""
        while self._compiling:
            self._compiling.pop().result()
        super().iterate()

    def _network_outputs(
        self, seen: Tensor, network: int, noise: Tensor | None = None
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return outputs of network 0 or 1 for observations (..., O); with noise (..., U) also actions and commands."""
        return self._launch_forward(seen.contiguous(), network, noise)

    def _launch_forward(
        self, seen: Tensor, network: int, noise: Tensor | None, *, compile_only: bool = False
    ) -> tuple[Tensor, Tensor, Tensor]:
        width = self._task.num_actions if network == 0 else 1
        out = seen.new_empty(*seen.shape[:-1], width)
        action, command = (out, out) if noise is None else (torch.empty_like(out), torch.empty_like(out))
        samples = out.numel() // width
        grid = (-(-samples // FORWARD_TILE["tile"]),)
        _kernel_launcher(self._kernels.forward, grid, compile_only=compile_only)(
            self._adam.weights, seen, out if noise is None else noise, samples, *self._places[network], self._log_std,
            out, action, command, num_in=self._num_in[network], num_out=width, draws=noise is not None,
            **self._sizes, **FORWARD_TILE,
        )  # fmt: skip
        return out, action, command

    def _draw_action_and_command(
        self, seen: Mapping[str, Tensor], memory: Tensor, begins: Tensor, noise: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        mean, action, command = self._network_outputs(
            self._input_vector(self.network.actor.body.network_inputs(seen), 0), 0, noise
        )
        return mean, action, command, memory

    def _segment_values(
        self, prepared: Mapping[str, Tensor], final: Mapping[str, Tensor], flown: RolloutSegment
    ) -> tuple[Tensor, Tensor, Tensor]:
        values, finals = (
            self._network_outputs(self._input_vector(seen, 1), 1)[0].squeeze(-1) for seen in (prepared, final)
        )
        scale = self.network.scale
        return scale.inverse(values), scale.inverse(finals), flown.memory.expand(len(values), *flown.memory.shape)

    def _input_vector(self, prepared: Mapping[str, Tensor], network: int) -> Tensor:
        """Return the input vector of network 0 or 1, (..., O)."""
        parts = [prepared[key] for key in self._keys[network]]
        return torch.cat(parts, dim=-1) if len(parts) > 1 else parts[0]

    def _segment_samples(self, flown: RolloutSegment) -> Samples:
        return self._samples_as_vectors(super()._segment_samples(flown))

    def _samples_as_vectors(self, samples: Samples) -> Samples:
        """Return samples with one vector for each network, once for all minibatches."""
        vectors = {name: self._input_vector(samples.prepared, network) for network, name in enumerate((POLICY, CRITIC))}
        return replace(samples, prepared=vectors)

    def _loss_gradient(self, samples: Samples, chosen: Tensor, old_log_std: Tensor) -> tuple[Tensor, Tensor]:
        number = samples.in_time["log_prob"].shape[0] * chosen.numel()
        self._launch_gradient(samples, chosen.contiguous(), old_log_std)
        whole = self._partial.sum(0)
        return whole[:-3], whole[-3:] / number

    def _launch_gradient(
        self, samples: Samples, chosen: Tensor, old_log_std: Tensor, *, compile_only: bool = False
    ) -> None:
        ppo, old, out = self._ppo, samples.in_time, self._partial
        steps, envs = old["log_prob"].shape
        _kernel_launcher(self._kernels.gradient, (out.shape[0], 2), compile_only=compile_only)(
            self._adam.weights, chosen, samples.prepared[POLICY], samples.prepared[CRITIC],
            old["action"], old["mean"], old_log_std, old["log_prob"], old["advantage"], old["value"], old["target"],
            chosen.numel(), envs, steps * chosen.numel(), *self._places[0], self._log_std, *self._places[1],
            ppo.clip_range, ppo.value_coef, ppo.bound_coef, ppo.entropy_coef, BOUND, out.shape[1],
            out, num_in0=self._num_in[0], num_in1=self._num_in[1], num_actions=self._task.num_actions,
            clip_value=ppo.clip_value, backward_precision=BACKWARD_PRECISION, **self._sizes, **GRADIENT_TILE,
        )  # fmt: skip


def _input_shapes(network: ActorCritic) -> tuple[Mapping[str, tuple[int, ...]], Mapping[str, tuple[int, ...]]]:
    """Return the input shapes of policy and critic, by key."""
    return network.actor.shapes, (network.own_body or network.actor.body).cfg.shapes


def _count_inputs(shapes: Mapping[str, tuple[int, ...]]) -> int:
    return sum(size for (size,) in shapes.values())


def _linear_layers(layers: nn.Module, head: nn.Linear) -> list[nn.Linear]:
    return [*(layer for layer in layers.children() if isinstance(layer, nn.Linear)), head]
