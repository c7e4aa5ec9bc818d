from __future__ import annotations

import numpy as np

from mjframes.base.sampling import farthest_points


def test_each_point_is_the_farthest_from_those_before() -> None:
    points = np.random.default_rng(0).normal(size=(200, 3))
    chosen = farthest_points(points, [7, 3], 20)
    assert chosen[:2].tolist() == [7, 3]
    for k in range(2, 20):
        away = np.linalg.norm(points[:, None] - points[chosen[:k]], axis=2).min(axis=1)
        assert away[chosen[k]] == away.max()


def test_no_point_is_taken_twice() -> None:
    points = np.repeat(np.eye(3), 2, axis=0)
    assert len(farthest_points(points, [0], 6)) == 3
    assert farthest_points(points, [4, 2, 0], 2).tolist() == [4, 2]
    assert farthest_points(points[:2], [0], 9).tolist() == [0]
