"""``FreshGarments``: order, replay, resuming, and the end of its workers."""

import contextlib
import gc
import multiprocessing
import weakref
from collections import Counter
from collections.abc import Sequence
from itertools import islice
from typing import Any

import pytest
from torch.utils.data import DataLoader

from gcd_dataset.errors import ConfigError, TransformError
from gcd_dataset.generator.pipeline import prepare
from gcd_dataset.loaders import (
    Augmented,
    FakeGarments,
    FreshGarments,
    GarmentLoader,
    GeneratedGarments,
    MixedDataset,
    PointNoise,
)
from tests.loaders.test_shards import assert_all_same


def fresh(n: int = 20, **options: Any) -> FreshGarments:
    return FreshGarments(FakeGarments(n, fields=["meta"]), **options)


def numbers(garments: FreshGarments) -> list[int]:
    return [item["meta"]["index"] for item in garments]


@pytest.mark.parametrize(("replay", "times"), [(1, {1}), (3, {3}), (2.5, {2, 3})])
def test_each_garment_is_used_replay_times(replay: float, times: set[int]) -> None:
    garments = fresh(replay=replay, room=6)
    given = numbers(garments)
    assert len(given) == len(garments) == 20 * replay
    assert set(Counter(given)) == set(range(20))
    assert set(Counter(given).values()) == times


def test_epochs_and_seeds_differ_in_order_and_augmentation_and_workers_change_nothing() -> None:
    garments = FreshGarments(FakeGarments(6), replay=2, room=4, augment=PointNoise(1.0))
    epochs = [list(garments) for _ in range(3)]
    orders = [[item["meta"]["index"] for item in epoch] for epoch in epochs]
    assert [sorted(order) for order in orders] == 3 * [sorted(2 * list(range(6)))]
    orders.append(numbers(FreshGarments(FakeGarments(6), replay=2, room=4, seed=1)))
    assert len({tuple(order) for order in orders}) == 4
    points = [item["points"] for epoch in epochs for item in epoch]
    assert len({tuple(each[0].tolist()) for each in points}) == len(points)  # no two augmentations are equal
    garments.set_epoch(1)
    assert_all_same(garments, epochs[1])
    assert_all_same(garments, epochs[2])
    shared = FreshGarments(FakeGarments(6), replay=2, room=4, augment=PointNoise(1.0), workers=2)
    shared.set_epoch(2)
    assert_all_same(shared, epochs[2])


def test_an_endless_data_set_continues_in_the_next_epoch() -> None:
    whole = MixedDataset([FakeGarments(3, fields=["meta"]), FakeGarments(2, seed=1, fields=["meta"])], [2, 1])
    garments = FreshGarments(whole, room=1)
    assert [item["meta"]["index"] for _ in range(3) for item in garments] == [
        whole[index]["meta"]["index"] for index in range(3 * len(whole))
    ]


class Counting(FakeGarments):
    """Records the indices of the garments made."""

    def __init__(self, count: int) -> None:
        super().__init__(count, fields=["meta", "points"])
        self.made: list[int] = []

    def _load(self, position: int) -> Any:
        self.made.append(position)
        return super()._load(position)


def test_the_first_item_needs_one_garment_only() -> None:
    ds = Counting(50)
    given = iter(FreshGarments(ds, replay=4, room=20))
    next(given)
    assert ds.made == [0]
    for count in range(2, 60):
        next(given)
        assert len(ds.made) <= min(count, 20) + (count - 1) // 4


def refused(item: dict[str, Any]) -> dict[str, Any]:
    raise ValueError("no such thing")


def test_an_error_has_the_same_message_with_and_without_workers() -> None:
    """One line; the worker's traceback is a note."""
    messages = []
    for workers in (0, 1):
        with pytest.raises(TransformError) as raised:
            list(FreshGarments(FakeGarments(3, fields=["meta"], transform=refused), workers=workers))
        messages.append(str(raised.value))
        with pytest.raises(TransformError) as raised:
            list(GarmentLoader(FakeGarments(1, fields=["meta"], transform=refused), 1, num_workers=workers))
        messages.append(str(raised.value))
    assert len(set(messages)) == 1
    assert any("in refused" in note for note in raised.value.__notes__)
    del raised
    gc.collect()  # the error's traceback held the workers


def refused_first(item: dict[str, Any]) -> dict[str, Any]:
    return refused(item) if item["meta"]["index"] == 0 else item


def test_an_error_of_a_worker_keeps_no_workers_alive() -> None:
    ds = FakeGarments(99, fields=["meta"], transform=refused_first)
    loader = GarmentLoader(ds, 1, shuffle=False, num_workers=2)
    others = set(multiprocessing.active_children())
    gc.disable()
    try:
        with contextlib.suppress(TransformError):
            next(iter(loader))
        del loader
        assert set(multiprocessing.active_children()) <= others
    finally:
        gc.enable()


@pytest.mark.parametrize(
    ("replay", "room", "stop", "workers"), [(1, 1, 7, 0), (2.5, 4, 3, 0), (3, 4, 14, 2), (2, 9, 23, 0), (2, 4, 30, 0)]
)
def test_resuming_makes_no_earlier_garments(replay: float, room: int, stop: int, workers: int) -> None:
    options: dict[str, Any] = {"replay": replay, "room": room, "augment": PointNoise(1.0)}
    given = FakeGarments(12, fields=["meta", "points"])
    whole, begun = FreshGarments(given, **options), FreshGarments(given, **options)
    items = [item for _ in range(2) for item in whole]
    assert_all_same(islice(begun, stop), items[: min(stop, len(begun))])
    state = begun.state_dict()
    assert state["position"] == min(stop, len(begun))

    ds = Counting(12)
    on = FreshGarments(ds, workers=workers, **options)
    on.load_state_dict(state)
    rest = [item["meta"]["index"] for item in on]
    end = len(begun) * (state["position"] // len(begun) + 1)
    assert rest == [item["meta"]["index"] for item in items[state["position"] : end]]
    if not workers:
        assert sorted(ds.made) == sorted(set(rest))  # each garment once, and no others
    assert [item["meta"]["index"] for item in on] != rest  # the next epoch


def test_only_the_last_iterator_moves_the_position() -> None:
    garments = fresh()
    first, second = iter(garments), iter(garments)
    next(second)
    for _ in range(5):
        next(first)
    assert garments.state_dict()["position"] == len(garments) + 1


def test_resuming_makes_each_design_of_the_buffer_once(designed: list[int]) -> None:
    """Also for a state taken between the bodies of a design."""
    whole = GeneratedGarments(8, seed=5, bodies="both", stage="pattern", fields=["panels", "body"])
    items = list(FreshGarments(whole, room=6, replay=2))
    for stop in (5, 7):
        on = FreshGarments(whole, room=6, replay=2)
        on.load_state_dict({**on.state_dict(), "position": stop})
        designed.clear()
        assert_all_same(on, items[stop:])
        assert 0 < len(designed) <= len(set(designed)) + 1  # within a design: one body buffered, the other not


def test_the_buffer_holds_at_most_room_garments() -> None:
    given: set[int] = set()
    counts: Counter[int] = Counter()
    for number in numbers(fresh(30, replay=4, room=5)):
        given.add(number)
        counts[number] += 1
        # Of the garments made so far at most five have uses left.
        assert sum(counts[n] < 4 for n in range(max(given) + 1)) <= 5


def test_workers_of_the_loader_are_refused() -> None:
    with pytest.raises(ConfigError, match="num_workers=0"):
        next(iter(DataLoader(fresh(), batch_size=None, num_workers=1)))
    for options in ({"replay": 0.5}, {"replay": float("nan")}, {"room": 0}):
        with pytest.raises(ConfigError):
            fresh(**options)


def test_items_in_the_buffer_hold_no_shared_memory() -> None:
    made = list(FreshGarments(FakeGarments(4, fields=["meta", "verts"]), room=4, workers=1))
    assert [item["verts"].is_shared() for item in made] == 4 * [False]  # type: ignore[no-untyped-call]


def test_an_item_is_freed_after_its_last_use() -> None:
    tensors: list[weakref.ref] = []

    def recorded(item: dict[str, Any]) -> dict[str, Any]:
        tensors.append(weakref.ref(item["panels"]))
        return item

    whole = FakeGarments(16, fields=["meta", "panels"], transform=recorded)
    for _ in FreshGarments(whole, room=4):
        # The items in the buffer, and the item made last.
        assert sum(tensor() is not None for tensor in tensors) <= 4 + 1
    assert len(tensors) == 16


@pytest.mark.long
def test_one_worker_makes_a_design_for_all_its_bodies(monkeypatch: pytest.MonkeyPatch) -> None:
    """For any number of workers: else one worker would make the neutral bodies and another the random ones."""
    designs = multiprocessing.Value("i", 0)

    def counted(*options: Any) -> Any:
        with designs.get_lock():
            designs.value += 1
        return prepare(*options)

    monkeypatch.setattr("gcd_dataset.generator.maker.prepare", counted)
    whole = GeneratedGarments(5, seed=5, bodies="both", stage="pattern", fields=["panels", "body"])
    made = list(FreshGarments(whole, room=1, workers=2))
    assert designs.value == 3
    assert_all_same(made, [whole[index] for index in range(5)])


@pytest.mark.parametrize(
    ("chosen", "garments"),
    [
        (range(2, 6), 2),
        (range(2, 5), 2),
        ([4, 5, 0, 1], 2),
        ([5, 4], 2),
        (range(1, 5), 1),
        (range(0, 6, 2), 1),
        ([0, 1, 2, 4], 1),
        ([], 1),
    ],
)
def test_selected_garments_of_whole_designs_are_made_together(chosen: Sequence[int], garments: int) -> None:
    whole = GeneratedGarments(6, seed=5, bodies="both", stage="pattern", fields=["meta"])
    assert whole.garments_per_design == 2
    assert whole.select(chosen).garments_per_design == garments
    assert Augmented(whole.select(chosen), PointNoise(1.0)).garments_per_design == garments
