"""Terms say in their signature what they read and take; whatever does not fit is told by name. A task of a user's own."""

import sys
from pathlib import Path

import pytest
import torch
import yaml
from torch import Tensor

from aerial_gym import task_registry
from aerial_gym.config import build
from aerial_gym.config.task import TaskCfg
from aerial_gym.config.task_terms import ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import ConfigError, DuplicateNameError, ShapeError, UnknownNameError
from aerial_gym.task import BUFFERS, OBSERVATIONS, REWARDS, TERMINATIONS
from aerial_gym.task.terms.term import Term, TermRegistry, bind_term
from tests.refusals import assert_refused
from tests.unit.task.hover import build_task, make


def stretch(robot_position: Tensor, *, by: float, axis: int = 0) -> Tensor:
    """Return a coordinate, stretched."""
    return by * robot_position[:, axis]


def test_a_signature_says_what_is_read_and_taken() -> None:
    term = Term(name="stretched", value=stretch)
    assert term.reads == ("robot_position",)
    assert term.summary == "Return a coordinate, stretched."
    bound = bind_term(term, {"by": "2e0", "axis": 1}, "it")
    assert bound.params == {"by": 2.0, "axis": 1}
    assert bound.evaluate({"robot_position": torch.tensor([[1.0, 3.0, 0.0]])}).tolist() == [6.0]
    registry = TermRegistry("term")
    assert_refused(ConfigError, "hides inputs and parameters", registry.term(), lambda *tensors: tensors[0])
    registry.term()(stretch)
    assert_refused(DuplicateNameError, "term 'stretch' is registered already", registry.term(), stretch)


@pytest.mark.parametrize(("params", "message"), [
    ({}, "it: parameter 'by' is missing. It takes by, axis"),
    ({"by": 1.0, "axes": 1}, "it: no parameter 'axes'. Did you mean 'axis'"),
    ({"by": "far"}, "it: by = 'far': must be a number"),
    ({"by": 1.0, "axis": 1.5}, "it: axis = 1.5: must be a whole number"),
])  # fmt: skip
def test_numbers_that_do_not_fit_are_told(params: dict[str, object], message: str) -> None:
    assert_refused(ConfigError, message, bind_term, Term(name="stretched", value=stretch), params, "it")


def test_one_message_names_all_wrong_terms_of_a_task() -> None:
    rewards = {"near": RewardCfg(term="distance_bel"), "up": RewardCfg(term="upright", params={"hight": 0.2})}
    ends = {"far": TerminationCfg(term="far_from_target", kind="crash", params={"distance": "far"})}
    words = (
        r"(?s)^6 faults:.*no reward term 'distance_bel'. Did you mean 'distance_bell'.*'up' \(upright\): no parameter 'hight'"
        r".*'height' is missing.*'offset' is missing.*'far' \(far_from_target\): distance = 'far': must be a number"
        r".*observation term 'attitude': no parameter 'x'"
    )
    observations = (ObservationCfg(term="attitude", params={"x": 1}),)
    assert_refused(ConfigError, words, make, 1, rewards=rewards, terminations=ends, policy=observations)


def test_what_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    assert_refused(UnknownNameError, "no observation term", make, 1, policy=(ObservationCfg(term="position_error"),))
    assert_refused(UnknownNameError, "no reward term 'hover'", make, 1, rewards={"hover": RewardCfg(term="hover")})
    with pytest.raises(UnknownNameError, match="no termination term 'kontact'. Did you mean 'contact'"):
        make(1, terminations={"touch": TerminationCfg(term="kontact", kind="crash")})
    lost = Term(name="lost", value=lambda robot_positon: robot_positon)
    monkeypatch.setitem(OBSERVATIONS._entries, "lost", lost)
    assert_refused(UnknownNameError, "'lost' reads 'robot_positon'", make, 1, policy=(ObservationCfg(term="lost"),))
    assert_refused(UnknownNameError, r"reward 'near'", make, 1, command=None, policy=(ObservationCfg(term="attitude"),))
    beyond = RewardCfg(term="action_size", params={"entry": 9, "height": 1.0, "width": 1.0})
    assert_refused(ConfigError, r"'size' \(action_size\): cannot be computed", make, 1, rewards={"size": beyond})
    yes = Term(name="yes", value=lambda robot_position: robot_position[:, 0])
    monkeypatch.setitem(TERMINATIONS._entries, "yes", yes)
    with pytest.raises(ConfigError, match=r"'end' \(yes\): returns \(1,\) torch.float32, needs .*torch.bool"):
        make(1, terminations={"end": TerminationCfg(term="yes", kind="crash")})


def test_keys_and_buffers_are_terms_by_their_own_name() -> None:
    task = make(2, policy=tuple(ObservationCfg(term=name) for name in ("robot_mass", "sim_steps", "previous_position")))
    obs, _ = task.reset()
    assert obs["observations"].shape == (2, 5)
    start = task.env.gtd["robot_position"].clone()
    obs, *_ = task.step(torch.zeros(2, 4))
    assert torch.equal(obs["observations"][:, 0], task.env.gtd["robot_mass"])
    assert obs["observations"][:, 1].tolist() == [1.0, 1.0]
    assert "previous_position" in str(task.values.own)
    assert torch.equal(obs["observations"][:, 2:], task.env.gtd["robot_position"])
    assert not torch.equal(start, task.env.gtd["robot_position"])


def test_a_buffer_of_ones_own_remembers(monkeypatch: pytest.MonkeyPatch) -> None:
    registry = type(BUFFERS)("task buffer")

    @registry.buffer("highest", unit="m")
    def highest(highest: Tensor, begun: Tensor, robot_position: Tensor) -> Tensor:
        height = robot_position[:, 2]
        return torch.where(begun, height, torch.maximum(highest, height))

    monkeypatch.setitem(BUFFERS._entries, "highest", registry.get("highest"))
    gained = Term(name="gained", value=lambda highest, robot_position: (robot_position[:, 2] - highest).clamp_min(0.0))
    monkeypatch.setitem(REWARDS._entries, "gained", gained)
    task = make(2, rewards={"gained": RewardCfg(term="gained")}, episode_len_steps=6)
    task.reset()
    best = task.env.gtd["robot_position"][:, 2].clone()
    for step in range(5):
        expected = best.clone()
        _, reward, *_ = task.step(torch.tensor([0.5 if step % 2 else -0.5, 0.0, 0.0, 0.0]).expand(2, 4))
        height = task.env.gtd["robot_position"][:, 2]
        best = torch.maximum(best, height)
        torch.testing.assert_close(reward, (height - expected).clamp_min(0.0))
    task.step(torch.zeros(2, 4))  # the next episode
    assert torch.equal(task.values["highest"], task.env.gtd["robot_position"][:, 2])


@pytest.mark.parametrize(("shape", "message"), [
    ((3,), r"returns \(2,\) torch.float32, needs a tensor of its declared shape \(E, 3\) = \(2, 3\)"),
    (("Q",), r"shape = \('Q',\): shape letter 'Q' has no size. Known: E"),
    (3, "shape = 3: must be a tuple of letters and whole numbers > 0"),
    ((0,), "shape = \\(0,\\): must be a tuple of letters and whole numbers > 0"),
])  # fmt: skip
def test_a_buffer_of_a_wrong_shape_is_named_with_its_place(shape: tuple, message: str, own_registries: None) -> None:
    """At the declaration or when the task is built, not in a later step."""

    def build() -> None:
        @BUFFERS.buffer(shape=shape, unit="m")
        def low_point(robot_position: Tensor) -> Tensor:
            return robot_position[:, 2]

        make(2, policy=(ObservationCfg(term="low_point"),))

    with pytest.raises((ConfigError, ShapeError), match=rf"task buffer 'low_point' \(test_term.py:\d+\): {message}"):
        build()


def test_a_buffer_whose_update_fails_is_named(own_registries: None) -> None:
    @BUFFERS.buffer(shape=(3,))
    def square(robot_position: Tensor) -> Tensor:
        return robot_position @ robot_position

    assert_refused(
        ConfigError, r"'square' \(test_term.py:\d+\): cannot be computed \(RuntimeError", make, 2,
        policy=(ObservationCfg(term="square"),),
    )  # fmt: skip


ROOT = Path(__file__).parents[4]
EXAMPLE = f"{ROOT / 'examples' / 'custom_task.py'}:FIGURE_EIGHT"


def test_the_example_flies_and_learns_from_its_own_terms() -> None:
    task = task_registry.make_task(EXAMPLE, num_envs=3, device="cpu", seed=0)
    assert "figure_eight_task" in task_registry
    obs, _ = task.reset()
    assert obs["observations"].shape == (3, 3 + 3 + 6 + 3 + 3 + 4)
    assert obs["critic"].shape == (3, 3 + 3 + 6 + 3 + 3 + 4 + 1)
    assert task.reward_names == ("near", "distance", "nose", "calm", "crash")
    for _ in range(3):
        obs, reward, *_ = task.step(torch.zeros(3, 4))
    assert reward.isfinite().all()
    assert all(rows.reason is None and not rows.apart for rows in (task._judge.rows, task._observer.rows))
    attitude, way = task.env.gtd["robot_orientation"], task.values["target_velocity"]
    x, y, z, w = attitude.unbind(-1)
    nose = torch.stack((1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)), dim=-1)
    cosine = ((nose * way).sum(-1) / way.norm(dim=-1)).clamp_min(0.0)
    result = task_registry.make_task(EXAMPLE, num_envs=3, device="cpu")._judge._rewards["nose"][0].evaluate(task.values)
    torch.testing.assert_close(result, cosine)


def test_a_file_is_run_once_and_one_that_fails_can_be_mended(tmp_path: Path) -> None:
    assert task_registry.get(EXAMPLE) is task_registry.get(EXAMPLE)
    assert_refused(UnknownNameError, "has no attribute", task_registry.get, EXAMPLE.replace("FIGURE_EIGHT", "SQUARE"))
    assert_refused(UnknownNameError, "nowhere.py: no such file. Give it", task_registry.get, "nowhere.py:TASK")
    path = tmp_path / "mine.py"
    path.write_text(
        "from aerial_gym.task import REWARDS as R\nR.term('still')(lambda robot_position: robot_position)\n"
    )
    assert_refused(DuplicateNameError, "reward term 'still' is registered already", task_registry.get, f"{path}:TASK")
    path.write_text("TASK = 3\n")
    assert_refused(ConfigError, "must be a TaskCfg, or a subclass of Task", task_registry.get, f"{path}:TASK")
    assert not [name for name in sys.modules if name == "mine"]


def test_the_task_of_the_page_flies() -> None:
    text = (ROOT / "docs" / "guides" / "own_task.md").read_text()
    block = text.split("```yaml\n")[1].split("```")[0]
    cfg = build(TaskCfg, yaml.safe_load(block), where="docs/guides/own_task.md")
    task = build_task(cfg, 2)
    obs, _ = task.reset()
    assert obs["observations"].shape == (2, 3 + 4 + 3 + 9)
    task.step(torch.zeros(2, 4))
