"""Materials beside which others are nothing: a strain of theirs that is rounding has energy for any motion of these."""

from __future__ import annotations

import warnings
from dataclasses import replace

from mjframes.volume.volume import Volume

FIRM = 1e6  # [-] Young's modulus, to the softest material's, from which on a material counts as rigid


class RigidWarning(UserWarning):
    """A material is so much stiffer than the others that it was taken as rigid."""


def nearly_rigid_as_rigid(volume: Volume) -> Volume:
    """Return the volume with all that is FIRM times its softest material made rigid. Warn of it by a RigidWarning."""
    used = {label: material for label, material in volume.materials.items() if (volume.labels == label).any()}
    soft = min((material.young for material in used.values() if not material.is_rigid), default=0.0)
    firm = {
        label: material
        for label, material in used.items()
        if material.young > FIRM * soft > 0 and not material.is_rigid
    }
    for label, material in firm.items():
        warnings.warn(
            f"material {material.name or label!r} is {material.young / soft:.0e} times as stiff as the softest and is "
            "taken as rigid; the whole body's stiffness resolves a million times. To let it bend, "
            "choose method='paper'.",
            RigidWarning,
            stacklevel=5,  # beyond build, telling_memory and taking
        )
    rigid = {label: replace(material, is_rigid=True) for label, material in firm.items()}
    return replace(volume, materials={**volume.materials, **rigid}) if firm else volume
