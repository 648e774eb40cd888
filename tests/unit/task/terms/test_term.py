"""Terms say in their signature what they read and take; whatever does not fit is told by name."""

import pytest
import torch
from torch import Tensor

from aerial_gym.config.task_terms import ObservationCfg, RewardCfg, TerminationCfg
from aerial_gym.errors import ConfigError, DuplicateNameError, UnknownNameError
from aerial_gym.task import BUFFERS, OBSERVATIONS, REWARDS, TERMINATIONS
from aerial_gym.task.terms.term import Term, TermRegistry, bind
from tests.unit.task.hover import make


def stretch(robot_position: Tensor, *, by: float, axis: int = 0) -> Tensor:
    return by * robot_position[:, axis]


def test_a_signature_says_what_is_read_and_taken() -> None:
    term = Term(name="stretched", value=stretch)
    assert term.reads == ("robot_position",)
    assert term.summary == "Return a coordinate, stretched."
    bound = bind(term, {"by": "2e0", "axis": 1}, "it")
    assert bound.params == {"by": 2.0, "axis": 1}
    assert bound.evaluate({"robot_position": torch.tensor([[1.0, 3.0, 0.0]])}).tolist() == [6.0]


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({}, "it: parameter 'by' is missing. It takes by, axis"),
        ({"by": 1.0, "axes": 1}, "it: no parameter 'axes'. Did you mean 'axis'"),
        ({"by": "far"}, "it: by = 'far': must be float"),
        ({"by": 1.0, "axis": 1.5}, "it: axis = 1.5: must be int"),
    ],
)
def test_numbers_that_do_not_fit_are_told(params: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        bind(Term(name="stretched", value=stretch), params, "it")


def test_a_signature_that_does_not_say_is_refused() -> None:
    registry = TermRegistry("term")
    with pytest.raises(ConfigError, match="hides inputs and parameters"):
        registry.term()(lambda *tensors: tensors[0])
    registry.term()(stretch)
    with pytest.raises(DuplicateNameError, match="term 'stretch' is registered already"):
        registry.term()(stretch)


def test_what_is_not_there_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnknownNameError, match="no observation term 'position_error'. Did you mean 'position_error_"):
        make(1, policy=(ObservationCfg(term="position_error"),))
    with pytest.raises(UnknownNameError, match="no reward term 'hover'"):
        make(1, rewards={"hover": RewardCfg(term="hover")})
    with pytest.raises(UnknownNameError, match="no termination term 'kontact'. Did you mean 'contact'"):
        make(1, terminations={"touch": TerminationCfg(term="kontact", kind="crash")})
    lost = Term(name="lost", value=lambda robot_positon: robot_positon)
    monkeypatch.setitem(OBSERVATIONS._entries, "lost", lost)
    with pytest.raises(
        UnknownNameError,
        match="'lost' reads 'robot_positon', which is neither a key of the GTD nor a task buffer. Did you mean 'robot_posi",
    ):
        make(1, policy=(ObservationCfg(term="lost"),))
    with pytest.raises(UnknownNameError, match=r"reward 'near' \(distance_bell\) reads 'target_position'"):
        make(1, command=None, policy=(ObservationCfg(term="attitude"),))
    beyond = RewardCfg(term="action_size", params={"entry": 9, "height": 1.0, "width": 1.0})
    with pytest.raises(
        ConfigError, match=r"reward 'size' \(action_size\): cannot be computed \(IndexError: index 9 is out"
    ):
        make(1, rewards={"size": beyond})
    yes = Term(name="yes", value=lambda robot_position: robot_position[:, 0])
    monkeypatch.setitem(TERMINATIONS._entries, "yes", yes)
    with pytest.raises(
        ConfigError, match=r"termination 'end' \(yes\): returns \(1,\) torch.float32, needs .*torch.bool"
    ):
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
