"""A pool of fresh examples: the latest are kept, in the order of the stream."""

import time
from collections.abc import Iterator

import pytest
import torch

from benchmarks.reconstruction.training import FreshPool
from gcd_dataset.errors import ConfigError
from tests.benchmarks.reconstruction.toys import Line, LineLearner


def numbered(*numbers: int) -> Line:
    values = torch.tensor(numbers, dtype=torch.float32)
    return Line(values[:, None].expand(-1, 2).clone(), values)


def pool(first: Line, *, fresh: int, room: int) -> FreshPool[Line]:
    def stream(begin: int) -> Iterator[tuple[int, Line]]:
        """Every third drape does not settle."""
        yield from ((k, numbered(100 + k)) for k in range(begin, fresh) if k % 3 != 2)

    return FreshPool(LineLearner(), first, stream, room=room)


def advance_to(found: FreshPool[Line], received: int) -> None:
    begun = time.monotonic()
    while found.received < received:
        assert time.monotonic() - begun < 60, f"received {found.received} of {received}"
        found.advance(0)
        time.sleep(0.001)


def contents(found: FreshPool[Line]) -> list[float]:
    return found.batch(torch.arange(len(found))).y.tolist()


def test_a_pool_begins_with_the_examples_given() -> None:
    assert contents(pool(numbered(0, 1, 2), fresh=0, room=5)) == [0, 1, 2]


def test_fresh_examples_fill_the_room_then_replace_the_oldest() -> None:
    found = pool(numbered(0, 1), fresh=5, room=4)
    advance_to(found, 4)
    assert contents(found) == [103, 104, 100, 101]


def test_a_first_example_without_room_is_refused() -> None:
    with pytest.raises(ConfigError, match="room 2: give room for the 3 examples"):
        pool(numbered(0, 1, 2), fresh=0, room=2)


def test_a_pool_continues_after_the_last_index_received() -> None:
    """Drapes that do not settle have indices, too: 100, 101, 103, 104 are followed by 106, not by 104."""
    stopped = pool(numbered(0), fresh=6, room=8)
    advance_to(stopped, 4)
    found = pool(numbered(0), fresh=8, room=8)
    found.load_state_dict(stopped.state_dict())
    advance_to(found, 6)
    assert contents(found) == [0, 106, 107]


def test_an_error_of_the_stream_is_raised() -> None:
    def stream(begin: int) -> Iterator[tuple[int, Line]]:
        yield 0, numbered(1)
        raise ValueError("no cloth")

    found = FreshPool(LineLearner(), numbered(0), stream, room=4)
    with pytest.raises(ValueError, match="no cloth"):
        advance_to(found, 2)
