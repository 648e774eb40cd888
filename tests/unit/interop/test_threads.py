"""Independent calls on threads."""

from threading import current_thread

import pytest
import torch

from aerial_gym.interop import map_in_threads, one_thread


@pytest.fixture
def two_threads():
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)


def name_of_thread(number: int) -> tuple[int, str, int]:
    return number, current_thread().name, torch.get_num_threads()


def test_calls_use_the_threads_that_one_thread_leaves(two_threads: None) -> None:
    """In the order of the items, with torch on one thread in each; nested calls stay on their thread."""
    own = current_thread().name
    assert {name for _, name, _ in map_in_threads(name_of_thread, range(4))} == {own}
    with one_thread(), one_thread():
        results = map_in_threads(name_of_thread, range(4))
        assert [number for number, *_ in results] == [0, 1, 2, 3]
        assert own not in {name for _, name, _ in results}
        assert {threads for *_, threads in results} == {1}
        nested = map_in_threads(lambda _: map_in_threads(name_of_thread, range(4)), range(4))
        assert all(len({name for _, name, _ in part}) == 1 for part in nested)
    torch.set_num_threads(1)
    with one_thread():
        assert {name for _, name, _ in map_in_threads(name_of_thread, range(4))} == {own}


def test_an_error_of_a_call_is_raised(two_threads: None) -> None:
    with one_thread(), pytest.raises(ZeroDivisionError):
        map_in_threads(lambda number: 1 // number, (1, 0))
