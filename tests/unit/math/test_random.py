"""Draws that are the same in torch and in kernels, and rows that have the same result in every batch, bit for bit."""

from itertools import pairwise

import numpy as np
import pytest
import torch
import warp as wp
from torch import Tensor

from aerial_gym.interop import start_warp
from aerial_gym.math.decay import sum_with_decay
from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness, normal_draws, state_of_count, uniform_draw
from aerial_gym.math.rows import atan2, make_batch_invariant, times


@wp.kernel(enable_backward=False)
def _draw(random: RandomArrays, purpose: int, out: wp.array2d[float]):
    env = wp.tid()
    state = substream(episode_stream(random, env, purpose), 7)
    uniform = state
    out[env, 0] = float(state >> wp.uint32(16))
    out[env, 1] = wp.randf(uniform)
    stream = substream(state, 2)
    for i in range(3):
        out[env, 2 + i] = wp.randn(stream)


def start_random(num_envs: int, *, seed: int = 3, episodes: int = 1, **numbers: int) -> Randomness:
    random = Randomness(num_envs, seed=seed, **numbers)
    for _ in range(episodes):
        random.begin(torch.ones(num_envs, dtype=torch.bool))
    return random


def test_kernels_and_torch_draw_the_same() -> None:
    """States and uniform draws are integer arithmetic and one exact division; normal ones differ by round-off of float32."""
    start_warp()
    random, out = start_random(500, seed=2**31 + 5, episodes=4), torch.full((500, 5), torch.nan)
    given = [random_arrays(random), int(Purpose.GOAL)]
    wp.launch(_draw, dim=500, inputs=given, outputs=[wp.from_torch(out)], device="cpu")
    state = state_of_count(random.stream(Purpose.GOAL), 7)
    assert torch.equal(out[:, 0], (state >> 16).float())
    assert torch.equal(out[:, 1], uniform_draw(state, dtype=torch.float32))
    torch.testing.assert_close(out[:, 2:], normal_draws(state, 2, 3, dtype=torch.float32), atol=3e-6, rtol=3e-6)


def test_a_draw_follows_from_its_numbers_alone() -> None:
    def draw(random: Randomness, purpose: Purpose = Purpose.START, *, index: int = 2) -> torch.Tensor:
        return uniform_draw(state_of_count(random.stream(purpose), index), dtype=torch.float64)

    many = draw(start_random(40, episodes=3))
    assert draw(start_random(1, first_env=17, first_episode=2))[0] == many[17]
    for other in (
        draw(start_random(40, episodes=4)),
        draw(start_random(40, episodes=3, seed=4)),
        draw(start_random(40, episodes=3), Purpose.GOAL),
        draw(start_random(40, episodes=3), index=3),
    ):
        assert (other != many).all()


def test_only_the_environments_of_a_mask_begin() -> None:
    random = Randomness(4, seed=1, first_episode=6)
    assert random.episode.tolist() == [5, 5, 5, 5]
    random.begin(torch.tensor([True, False, True, False]))
    random.begin(torch.tensor([True, False, False, False]))
    assert random.episode.tolist() == [7, 5, 6, 5]
    random.restart(2)
    assert random.episode.tolist() == [5, 5, 5, 5]


def test_no_two_purposes_share_numbers() -> None:
    """Correlations of all purposes with each other, with neighbours, and with the episode after: within 5 / sqrt(n)."""
    count, now, then = 20_000, start_random(20_000), start_random(20_000, episodes=2)
    columns = [uniform_draw(random.stream(p), dtype=torch.float64) for random in (now, then) for p in Purpose]
    table = torch.stack([*columns, *(column.roll(1) for column in columns[: len(Purpose)])])
    correlation = torch.corrcoef(table) - torch.eye(len(table), dtype=torch.float64)
    assert correlation.abs().max() < 5.0 / count**0.5
    assert (table.mean(1) - 0.5).abs().max() < 5.0 / (12.0 * count) ** 0.5


def test_episodes_that_meet_in_one_purpose_part_in_another() -> None:
    """In 2^32 states some of 300,000 episodes meet, about 10 pairs; none of them meets in two purposes."""
    random, num_envs = Randomness(3000), 3000
    states = {purpose: [] for purpose in (Purpose.START, Purpose.GOAL)}
    for _ in range(100):
        random.begin(torch.ones(num_envs, dtype=torch.bool))
        for purpose, result in states.items():
            result.append(random.stream(purpose))
    pairs = []
    for result in states.values():
        ordered, place = torch.cat(result).sort()
        meets = (ordered[1:] == ordered[:-1]).nonzero().flatten()
        pairs.append({tuple(sorted((int(place[i]), int(place[i + 1])))) for i in meets})
    assert all(0 < len(result) < 40 for result in pairs)
    assert all(not a & b for a, b in pairwise(pairs))


@pytest.mark.parametrize("kept", [0.0, 0.3, 0.999, 1.0])
@pytest.mark.parametrize("rows", [1, 2, 300])
def test_it_is_what_a_loop_over_rows_makes(rows: int, kept: float) -> None:
    """``y_n = kept y_(n-1) + x_n``, and the rows that were given stay as they are."""
    added = np.random.default_rng(0).normal(size=(rows, 2))
    before, expected = added.copy(), added[:1].copy()
    for row in added[1:]:
        expected = np.append(expected, (kept * expected[-1] + row)[None], axis=0)
    np.testing.assert_allclose(sum_with_decay(added, kept), expected, atol=1e-12)
    np.testing.assert_array_equal(added, before)


COUNTS = (*range(1, 20), 63, 64, 65, 127, 130, 1000, 33001)
NUM_ROWS = 40003
"""More than torch gives to one thread (32,768 elements), and no multiple of anything."""


def numbers(*shape: int, dtype: torch.dtype) -> Tensor:
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(0)).to(dtype)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_an_angle_does_not_depend_on_its_place(threads: int, dtype: torch.dtype) -> None:
    y, x = numbers(2, NUM_ROWS, dtype=dtype)
    whole = atan2(y, x)
    assert all(torch.equal(atan2(y[:n].clone(), x[:n].clone()), whole[:n]) for n in COUNTS)
    assert all(torch.equal(atan2(y[n:].clone(), x[n:].clone()), whole[n:]) for n in (1, 17, 35000))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(("num_terms", "width"), [(3, 3), (4, 3), (3, 12), (7, 32)])
def test_a_product_does_not_depend_on_the_number_of_rows(threads, num_terms, width, dtype) -> None:
    rows, matrix = numbers(NUM_ROWS, num_terms, dtype=dtype), numbers(num_terms, width, dtype=dtype)
    whole = times(rows, matrix)
    assert all(torch.equal(times(rows[:n].clone(), matrix), whole[:n]) for n in COUNTS)
    torch.testing.assert_close(whole, (rows.unsqueeze(-1) * matrix).sum(1))


def test_gradients_go_through_rows() -> None:
    y, x = numbers(2, 5, dtype=torch.float64).requires_grad_().unbind()
    assert torch.autograd.gradcheck(atan2, (y, x))
    rows, matrix = (numbers(*shape, dtype=torch.float64).requires_grad_() for shape in ((5, 3), (3, 4)))
    assert torch.autograd.gradcheck(times, (rows, matrix))


def test_a_function_of_others_is_given_whole_vectors() -> None:
    rows = numbers(192, dtype=torch.float32).abs()
    whole = torch.pow(rows, 1.3 * rows)
    for n in (1, 5, 63, 65):
        function = make_batch_invariant(lambda a: torch.pow(a, 1.3 * a), n, rows.device)
        assert torch.equal(function(rows[:n]), whole[:n])
