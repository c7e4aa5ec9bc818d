"""mjDatas of a model and of its copies share what never changes."""

from __future__ import annotations

import copy
import ctypes
import gc
from collections.abc import Callable, Iterator

import mujoco
import numpy as np
import pytest
from builders.scenes import FLOOR, beam, compiled, lump

from mjframes.body.soft_body import SoftBody


class Usage(ctypes.Structure):
    """glibc's struct mallinfo2."""

    _fields_ = [
        (name, ctypes.c_size_t)
        for name in [
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        ]
    ]


def used() -> int:
    """Bytes that are allocated in this process."""
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "mallinfo2"):
        pytest.skip("the C library does not count allocations")
    libc.mallinfo2.restype = Usage
    usage = libc.mallinfo2()
    return usage.uordblks + usage.hblkhd


@pytest.fixture(autouse=True)
def counted() -> Iterator[None]:
    gc.collect()
    gc.disable()
    yield
    gc.enable()


def growth(model: mujoco.MjModel, held: list[mujoco.MjData]) -> int:
    """Bytes that another mjData takes but for MuJoCo's own arrays."""
    before = used()
    held.append(mujoco.MjData(model))
    return used() - before - held[-1].nbuffer - held[-1].narena


def stepped(model: mujoco.MjModel, data: mujoco.MjData) -> np.ndarray:
    for _ in range(30):
        mujoco.mj_step(model, data)
    return data.qpos.copy()


@pytest.mark.parametrize("make", [beam, lump])
def test_a_second_data_shares_what_the_first_has(make: Callable[[], SoftBody]) -> None:
    body = make()
    model, first = compiled(FLOOR, (body, (0, 0, 0.01), (1, 0, 0, 0)))
    held = [first]
    growth(model, held)
    more = growth(model, held)
    rigid = mujoco.MjModel.from_xml_string(FLOOR)
    alone = [mujoco.MjData(rigid)]
    growth(rigid, alone)
    own = growth(rigid, alone)
    # what it shares is more: the nodes, their weights, the stiffness; of the last it has a copy for factors of its own.
    # That is 0.46 to 0.5 MB as malloc rounds, and 1.4 to 1.8 MB if nothing is shared
    assert more - own < 600_000
    assert growth(copy.copy(model), held) < more + 50_000
    expected = stepped(model, first)
    for data in held[1:]:
        np.testing.assert_array_equal(stepped(model, data), expected)


def test_shared_parts_go_with_their_last_holder() -> None:
    model, data = compiled(FLOOR, (beam(), (0, 0, 0.01), (1, 0, 0, 0)))
    copied = copy.copy(model)
    before = used()
    del data
    freed = before - used()
    other = mujoco.MjData(copied)
    assert used() - (before - freed) > 200_000 + other.nbuffer + other.narena  # made again
    assert np.isfinite(stepped(copied, other)).all()


def test_a_model_that_was_changed_is_not_taken_for_the_first() -> None:
    """A joint that was turned is none of the soft body's, whoever has what they shared."""
    model, data = compiled(FLOOR, (beam(), (0, 0, 0.01), (1, 0, 0, 0)))
    model.jnt_axis[-1] = (0.6, 0.8, 0)
    with pytest.raises(mujoco.FatalError, match="plugin->init failed"):
        mujoco.MjData(model)
    assert np.isfinite(data.qpos).all()
