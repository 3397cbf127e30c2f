"""Slices, teams of threads, and launches captured once and replayed."""

# pyright: reportArgumentType=false, reportAttributeAccessIssue=false, reportIndexIssue=false, reportOperatorIssue=false
# pyright: reportFunctionMemberAccess=false
# Kernels: Warp compiles and checks them, and its types mean other things to it than to Python.

from __future__ import annotations

import itertools
import threading
from functools import partial

import numpy as np
import pytest
import warp as wp

from echelon.warp_kernels.atomics import atomic_exchange, atomic_increase
from echelon.warp_kernels.replay import LAST_SLICES, Graphs, Replay, Share, Team, dealt, side_by_side, slices


@wp.kernel
def count_up(first: int, numbers: wp.array[wp.int32], total: wp.array[wp.int32]):
    item = first + wp.tid()
    numbers[item] = numbers[item] + 1
    atomic_increase(total, 0, 1)


@wp.kernel
def put_in_list(first: int, heads: wp.array[wp.int32], nexts: wp.array[wp.int32]):
    item = first + wp.tid()
    nexts[item] = atomic_exchange(heads, item % heads.shape[0], item)


def test_slices_cover_a_range_once_and_are_whole_multiples() -> None:
    for count in (1, 5, 255, 256, 1000):
        for parts in (1, 2, 3, 7):
            for multiple in (1, 16, 256):
                found = slices(count, parts, first=10, multiple=multiple)
                items = [item for first, length in found for item in range(first, first + length)]
                assert items == list(range(10, 10 + count))
                assert len(found) <= parts
                assert all(length % multiple == 0 for _, length in found[:-1])


def test_dealt_slices_cover_a_range_once_and_become_smaller() -> None:
    for count in (1, 5, 255, 10_000):
        assert dealt(count, 1, first=10) == [(10, count)]
        for threads in (2, 3, 16):
            found = dealt(count, threads, first=10)
            assert [item for first, length in found for item in range(first, first + length)] == [
                *range(10, 10 + count)
            ]
            sizes = [length for _, length in found]
            assert sizes == sorted(sizes, reverse=True)
            assert sizes[0] <= max(count / (2 * threads), 1)
            assert sizes[-1] <= -(-count // (LAST_SLICES * threads))
    assert min(length for _, length in dealt(1000, 2, least=100)[:-1]) == 100
    assert dealt(0, 2) == [(0, 0)]


def test_shares_of_parts_cover_the_crowd_once_and_each_has_what_is_beyond() -> None:
    for parts in (1, 2, 3):
        owned: list[int] = []
        bounds = [7 * i // parts for i in range(parts + 1)]
        for a, b in itertools.pairwise(bounds):
            share = Share(7, a, b - a, Team(1), beyond=1)
            mine: list[int] = []
            for launch in share.own(lambda first, count, found=mine: found.extend(range(first, first + count))):
                launch()
            assert mine.count(7) == 1
            owned += [agent for agent in mine if agent < 7]
        assert owned == list(range(7))


def test_work_of_a_team_is_done_side_by_side() -> None:
    team = Team(3)
    meeting = threading.Barrier(3, timeout=10.0)  # nobody leaves it before all are there
    for _ in range(3):
        team.run([meeting.wait] * 3)  # type: ignore[list-item]
    team.close()
    team.close()


def test_who_is_done_takes_what_others_have_not_begun() -> None:
    team, rest = Team(2), threading.Semaphore(0)

    def slow() -> None:
        for _ in range(5):
            assert rest.acquire(timeout=10.0)  # until the other thread has done all the rest

    for _ in range(3):
        team.run([slow, *[lambda: rest.release()] * 5])
        team.run([lambda: rest.release(), slow, *[lambda: rest.release()] * 4])
    team.close()


def test_work_that_is_done_before_anybody_wakes_up_is_done_once() -> None:
    team, done = Team(3), []
    for turn in range(3000):
        team.run([partial(done.append, (turn, piece)) for piece in range(4)])
        assert len(done) == 4 * (turn + 1)
    assert sorted(done) == [(turn, piece) for turn in range(3000) for piece in range(4)]
    team.close()


def test_what_one_of_a_team_raises_is_raised_and_the_team_works_on() -> None:
    team, done = Team(2), []

    def fail() -> None:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        team.run([lambda: done.append("first"), fail])
    team.run([lambda: done.append("first"), lambda: done.append("second")])
    assert sorted(done) == ["first", "first", "second"]
    team.close()


@pytest.mark.parametrize("threads", [1, 2, 4])
def test_replayed_slices_do_what_they_did_when_captured(threads: int) -> None:
    wp.load_module(count_up.module, device="cpu")
    count = 10_000
    numbers, total = (wp.zeros(size, dtype=wp.int32, device="cpu") for size in (count, 1))

    def launch(first: int, size: int) -> None:
        wp.launch(count_up, size, inputs=[first, numbers, total], device="cpu")

    team = Team(threads)
    phase = [partial(launch, *part) for part in slices(count, threads)]
    graphs = Graphs([phase, [lambda: None], side_by_side(phase, phase[:1])], "cpu")
    numbers.zero_()
    total.zero_()
    for _ in range(5):
        graphs.replay(team)
    first = slices(count, threads)[0][1]
    assert np.all(numbers.numpy()[:first] == 15)
    assert np.all(numbers.numpy()[first:] == 10)
    assert total.numpy()[0] == 10 * count + 5 * first
    team.close()


def test_between_stages_is_called_in_each_frame() -> None:
    number = wp.zeros(1, dtype=wp.int32, device="cpu")
    total = wp.zeros(1, dtype=wp.int32, device="cpu")
    wp.load_module(count_up.module, device="cpu")
    count = partial(wp.launch, count_up, 1, inputs=[0, number, total], device="cpu")
    replay, team, found = Replay((), "cpu"), Team(1), []
    stages = [[[count]], [[count], [count]]]
    replay((number,), lambda: stages, team, lambda: found.append(int(number.numpy()[0])))
    before = int(number.numpy()[0])
    replay((number,), lambda: stages, team, lambda: found.append(int(number.numpy()[0])))
    assert found[1:] == [before + 1]
    assert number.numpy()[0] == before + 3
    replay((number,), lambda: stages, team)
    assert len(found) == 2


def test_lists_that_threads_make_together_hold_everybody() -> None:
    wp.load_module(put_in_list.module, device="cpu")
    count = 100_000
    heads, nexts = wp.full(13, -1, dtype=wp.int32, device="cpu"), wp.zeros(count, dtype=wp.int32, device="cpu")

    def launch(first: int, size: int) -> None:
        wp.launch(put_in_list, size, inputs=[first, heads, nexts], device="cpu")

    team = Team(4)
    Graphs([[partial(launch, *part) for part in slices(count, 4)]], "cpu").replay(team)
    heads.fill_(-1)
    graphs = Graphs([[partial(heads.fill_, -1)], [partial(launch, *part) for part in slices(count, 4)]], "cpu")
    graphs.replay(team)
    found: list[int] = []
    following = nexts.numpy()
    for head in heads.numpy().tolist():
        while head >= 0:
            found.append(head)
            head = int(following[head])
    assert sorted(found) == list(range(count))
    team.close()


def test_they_compile_for_cuda(tmp_path) -> None:
    wp.compile_aot_module(put_in_list.module, arch=80, module_dir=tmp_path, use_ptx=True)
    assert list(tmp_path.glob("*.ptx"))
