"""Materials: Hooke's constants and the ranges they are held to."""

from __future__ import annotations

import math
from typing import Any

import pytest

from mjframes.base.errors import MjframesError
from mjframes.volume.material import Material


def test_lame_constants_reproduce_uniaxial_tension() -> None:
    """σ = λ tr(ε) + 2 μ ε with ε = (1, −ν, −ν) has to give (E, 0, 0)."""
    material = Material(young=2e4, poisson=0.45, density=1050)
    lam, mu = material.lame
    trace = 1 - 2 * 0.45
    assert lam * trace + 2 * mu == pytest.approx(2e4)
    assert lam * trace - 2 * mu * 0.45 == pytest.approx(0, abs=1e-9)


def test_rigid_has_no_compliance_and_a_finite_stiffness() -> None:
    bone = Material.rigid(density=1900, name="bone", rgba=(1, 1, 1, 1))
    assert bone.is_rigid
    assert bone.compliance == 0
    assert (bone.young, bone.poisson, bone.density, bone.name, bone.rgba) == (1e10, 0.3, 1900, "bone", (1, 1, 1, 1))
    assert Material(young=2e4, poisson=0.45, density=1050).compliance == pytest.approx(5e-5)


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("young", 0.0),
        ("young", -1.0),
        ("young", math.inf),
        ("young", math.nan),
        ("poisson", 0.5),
        ("poisson", -0.1),
        ("poisson", math.nan),
        ("density", 0.0),
        ("density", math.inf),
        ("young", "1e4"),
        ("young", True),
        ("young", 1e300),
        ("young", 1e-300),
        ("poisson", "0.4"),
        ("density", None),
        ("density", 1e300),
        ("density", 1e-300),
        ("rgba", (1, 0, 0)),
        ("rgba", "red"),
        ("rgba", ("1", 0, 0, 1)),
        ("rgba", (1, 0, 0, 2)),
    ],
)
def test_values_out_of_range_are_named(argument: str, value: Any) -> None:
    arguments: dict[str, Any] = {"young": 2e4, "poisson": 0.45, "density": 1050, "name": "flesh", argument: value}
    with pytest.raises(MjframesError, match=f"^{argument} of material 'flesh' is .*must"):
        Material(**arguments)


def test_limits_that_are_allowed() -> None:
    assert Material(young=1, poisson=0, density=1e-3).lame == (0, 0.5)
