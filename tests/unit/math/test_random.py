"""Draws from (seed, environment, episode, purpose): the same in torch and in kernels, and of no use to guess another by."""

from itertools import pairwise

import torch
import warp as wp

from aerial_gym.interop import start_warp
from aerial_gym.math.draws import RandomArrays, episode_stream, random_arrays, substream
from aerial_gym.math.random import Purpose, Randomness, normal_draws, split_state, uniform_draw


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
    state = split_state(random.stream(Purpose.GOAL), 7)
    assert torch.equal(out[:, 0], (state >> 16).float())
    assert torch.equal(out[:, 1], uniform_draw(state, dtype=torch.float32))
    torch.testing.assert_close(out[:, 2:], normal_draws(state, 2, 3, dtype=torch.float32), atol=3e-6, rtol=3e-6)


def test_a_draw_follows_from_its_numbers_alone() -> None:
    def draw(random: Randomness, purpose: Purpose = Purpose.START, *, index: int = 2) -> torch.Tensor:
        return uniform_draw(split_state(random.stream(purpose), index), dtype=torch.float64)

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
