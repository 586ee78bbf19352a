"""``prefetch``: items made ahead by a thread."""

import contextlib
import gc
import threading
import weakref
from collections.abc import Iterator

import pytest

from gcd_dataset.workers import prefetch


def test_the_thread_makes_no_more_items_than_the_queue_holds() -> None:
    taken, ahead = 0, []

    def items() -> Iterator[int]:
        for number in range(50):
            ahead.append(number + 1 - taken)
            yield number

    for number, item in enumerate(prefetch(items(), 3)):
        assert item == number
        taken = number + 1
    assert taken == 50
    assert max(ahead) <= 3 + 1  # taking an item has freed a slot


def test_items_are_made_before_they_are_taken() -> None:
    third = threading.Event()

    def items() -> Iterator[int]:
        yield from (0, 1)
        third.set()
        yield 2

    ahead = prefetch(items(), 3)
    assert next(ahead) == 0
    assert third.wait(60)
    assert list(ahead) == [1, 2]


def test_an_error_comes_after_the_items_before_it() -> None:
    def items() -> Iterator[int]:
        yield from (0, 1)
        raise ValueError("the third")

    ahead = prefetch(items(), 8)
    assert [next(ahead), next(ahead)] == [0, 1]
    with pytest.raises(ValueError, match="the third"):
        next(ahead)


@pytest.mark.parametrize("wait", [False, True])
def test_closing_the_iterator_ends_the_thread(wait: bool) -> None:
    threads: list[threading.Thread] = []

    def items() -> Iterator[int]:
        threads.append(threading.current_thread())
        while True:
            yield 0

    ahead = prefetch(items(), 2, wait=wait)
    next(ahead)
    ahead.close()
    if not wait:
        threads[0].join(60)
    assert not threads[0].is_alive()


def test_an_exit_in_the_thread_reaches_the_caller() -> None:
    """``KeyboardInterrupt`` and the like are no ``Exception``."""

    def items() -> Iterator[int]:
        yield 0
        raise SystemExit("the second")

    ended: list[BaseException] = []

    def take() -> None:
        try:
            list(prefetch(items(), 2))
        except SystemExit as end:
            ended.append(end)

    thread = threading.Thread(target=take, daemon=True)
    thread.start()
    thread.join(60)
    assert [str(end) for end in ended] == ["the second"]


def test_a_caught_error_keeps_no_object_alive() -> None:
    """The frames of its traceback refer to objects such as a loader with its workers."""

    class Held:
        pass

    def failing(held: Held) -> None:
        assert held
        for _ in prefetch(map(int, ["no number"]), 1):
            pass

    held = Held()
    kept = weakref.ref(held)
    gc.disable()
    try:
        with contextlib.suppress(ValueError):
            failing(held)
        del held
        assert kept() is None
    finally:
        gc.enable()


def test_begin_runs_in_the_thread() -> None:
    begun = []
    assert list(prefetch(iter("ab"), 1, begin=lambda: begun.append(threading.current_thread()))) == ["a", "b"]
    assert begun != [threading.current_thread()]


def test_an_error_in_begin_reaches_the_caller() -> None:
    with pytest.raises(ZeroDivisionError):
        next(prefetch(iter("ab"), 1, begin=lambda: 1 / 0))  # type: ignore[arg-type]
