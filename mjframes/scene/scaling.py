"""How stiff and how damped a soft body is in one model, to what it was built with, without building it again.

Two numerics of the model say it, `steak:stiffness` with a factor of the moduli of each material that deforms, in the
order of their labels, which the text `steak:materials` names, and `steak:damping` with those of Rayleigh's α and β. The
plugin reads `numeric_data` in every step, so that whatever gives each world a model of its own, or a `numeric_data` of
its own, gives it a material of its own. A body's forces and stiffness are homogeneous of degree one in its moduli
together: a common factor is exact, for every law; others are exact to first order (elasticity/shares.py).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol
from urllib.parse import quote, unquote

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from mjframes.base.errors import MjframesError
from mjframes.scene.plugin_text import SEPARATOR
from mjframes.volume.material import Material

STIFFNESS, DAMPING, MATERIALS, MODULI = "stiffness", "damping", "materials", "moduli"
BETWEEN, NAMED, WITH = ", ", "=", "/"  # in the texts that name the materials and tell their moduli


class Batch(Protocol):
    """What is used of a `mujoco.batch.Batch`."""

    model: mujoco.MjModel

    def expand(self, name: str, /) -> NDArray[Any]:
        """Return the values (nsim, …) of a model's field."""
        ...


Factor = ArrayLike  # one number, or one for each world
Factors = Mapping[int, Factor] | Mapping[str, Factor] | Mapping[int | str, Factor]


def scale(
    model: mujoco.MjModel | Batch,
    name: str,
    factor: Factor | None = None,
    *,
    materials: Factors | None = None,
    damping: ArrayLike | None = None,
    worlds: ArrayLike | None = None,
) -> None:
    """Make a soft body of a compiled model stiffer, softer, or differently damped, from now on.

    Factors are relative to what was built and do not add up: 1 restores it. What is not given stays as it is.

    Parameters
    ----------
    model
        The compiled model, or a `mujoco.batch.Batch`, in which each world may have its own factors. Each factor below
        is then one number for all worlds, or one for each.
    name
        Name of the soft body.
    factor
        Factor of the moduli of all materials [-].
    materials
        Factor of the moduli of single materials [-], by the name or the label of the material. Materials that are not
        in it have `factor`, or 1.
    damping
        Factors of Rayleigh's α and β [-], (2,), or (worlds, 2) for a batch.
    worlds
        Numbers of the worlds of a batch to change. The default is all of them.

    Raises
    ------
    MjframesError
        If the model has no such soft body or the body no such material, if several materials have that name, and for
        factors that are not positive and finite and numbers of no world.
    """
    compiled = model if isinstance(model, mujoco.MjModel) else getattr(model, "model", None)
    if not isinstance(compiled, mujoco.MjModel):
        raise MjframesError(f"model is a {type(model).__name__}; give a compiled MjModel or a mujoco.batch.Batch.")
    found = {key: _entries(compiled, name, key) for key in (STIFFNESS, DAMPING)}
    if None in found.values():
        known = ", ".join(map(repr, _known(compiled))) or "none"
        raise MjframesError(f"name is {name!r} but the soft bodies that the model can scale are: {known}.")
    data = _worlds(model, worlds)
    given: dict[str, NDArray[np.float64]] = {}
    if factor is not None or materials is not None:
        given[STIFFNESS] = _factors(compiled, name, factor, materials or {}, data.shape[:-1])
    if damping is not None:
        given[DAMPING] = _damping(damping, data.shape[:-1])
    for key, values in given.items():
        data[..., found[key]] = values
    _put(model, worlds, data)


def materials(model: mujoco.MjModel, name: str) -> dict[int, str]:
    """Return the names, by label, of the materials whose factors `name`:stiffness has, in their order."""
    return {label: unquote(called) for label, called in _told(model, name, MATERIALS).items()}


def moduli(model: mujoco.MjModel, name: str) -> dict[int, tuple[float, float]]:
    """Return Young's modulus [Pa] and Poisson's ratio, as built, of these materials that deform, by label.

    Models written before these were kept have none.
    """
    parts = {label: pair.split(WITH) for label, pair in _told(model, name, MODULI).items()}
    return {label: (float(young), float(poisson)) for label, (young, poisson) in parts.items()}


def _told(model: mujoco.MjModel, name: str, key: str) -> dict[int, str]:
    """What a text of the model says of each label."""
    for text, names in _named(model, mujoco.mjtObj.mjOBJ_TEXT, key):
        if name in names:
            data = model.text_data[model.text_adr[text] :].split(b"\0", 1)[0].decode()
            parts = [some.partition(NAMED) for some in data.split(BETWEEN)]
            return {int(label): value for label, _, value in parts}
    return {}


def add_scaling(
    spec: mujoco.MjSpec, name: str, deformable: Mapping[int, str], known: Mapping[int, Material] | None = None
) -> None:
    """Give soft body `name` of a spec its numerics, all of them 1, and the names of its deformable materials.

    known: the materials by label, whose moduli are told too.
    """
    for key, size in ((STIFFNESS, len(deformable)), (DAMPING, 2)):
        spec.add_numeric(name=_own(name, key), size=size, data=np.ones(size))
    parts = [f"{label}{NAMED}{quote(called, safe=' ')}" for label, called in deformable.items()]
    spec.add_text(name=_own(name, MATERIALS), data=BETWEEN.join(parts))
    told = {label: known[label] for label in deformable if not known[label].is_rigid} if known else {}
    if told:
        pairs = [f"{label}{NAMED}{some.young:.6g}{WITH}{some.poisson:.6g}" for label, some in told.items()]
        spec.add_text(name=_own(name, MODULI), data=BETWEEN.join(pairs))


def stiffness(model: mujoco.MjModel, name: str, count: int) -> NDArray[np.float64]:
    """Return the factors (count,) of the moduli as the plugin takes them: 1 for what is no positive factor."""
    return _numeric(model, name, STIFFNESS, count)


def damping(model: mujoco.MjModel, name: str) -> NDArray[np.float64]:
    """Return the factors (2,) of Rayleigh's α and β as the plugin takes them: 1 for what is no positive factor."""
    return _numeric(model, name, DAMPING, 2)


def _numeric(model: mujoco.MjModel, name: str, key: str, count: int) -> NDArray[np.float64]:
    entries = _entries(model, name, key)
    values = np.ones(count) if entries is None else np.array(model.numeric_data[entries])
    return np.where(_are_factors(values), values, 1.0)


def _factors(
    model: mujoco.MjModel, name: str, common: Any, single: Factors, worlds: tuple[int, ...]
) -> NDArray[np.float64]:
    """(…, M) of each world and material."""
    if isinstance(common, Mapping):
        raise MjframesError(
            f"factor is {_short(common)}; it must be one for all materials, single ones go to materials=."
        )
    if not isinstance(single, Mapping):
        raise MjframesError(
            f"materials is {_short(single)}; it must map names or labels to factors, as {{'flesh': 2}}."
        )
    known = materials(model, name)
    entries = _entries(model, name, STIFFNESS)
    assert entries is not None
    values = np.ones((*worlds, entries.stop - entries.start))
    if common is not None:
        values[:] = _checked("factor", common, worlds)[..., None]
    for key, factor in single.items():
        values[..., _place(name, known, key)] = _checked(f"the factor of material {key!r}", factor, worlds)
    return values


def _place(name: str, known: Mapping[int, str], key: Any) -> int:
    """Which factor a label or a name means."""
    places = [i for i, (label, called) in enumerate(known.items()) if called == key or label == key]
    if len(places) == 1 and not isinstance(key, bool):
        return places[0]
    which = ", ".join(f"{label} ({called!r})" for label, called in known.items())
    wrong = "is the name of several materials; give their labels" if len(places) > 1 else "is no material that deforms"
    raise MjframesError(f"{key!r} {wrong}: {name!r} has {which}.")


def _checked(what: str, value: Any, worlds: tuple[int, ...]) -> NDArray[np.float64]:
    """One factor, or one for each world, for all of them. Raise MjframesError for other values."""
    array = np.asarray(value)
    if array.shape not in ((), worlds) or not _are_factors(array).all():
        each = f", or {worlds[0]} of them, one a world" if worlds else ""
        raise MjframesError(f"{what} is {_short(value)}; give a positive factor of the moduli that the body has{each}.")
    return np.broadcast_to(array.astype(np.float64), worlds)


def _damping(value: Any, worlds: tuple[int, ...]) -> NDArray[np.float64]:
    array = np.asarray(value)
    if array.shape not in ((2,), (*worlds, 2)) or not _are_factors(array).all():
        each = f", or {worlds[0]} times two, one pair a world" if worlds else ""
        raise MjframesError(f"damping is {_short(value)}; give two positive factors, of α and of β{each}.")
    return np.broadcast_to(array.astype(np.float64), (*worlds, 2))


def _short(value: Any) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}…"


def _are_factors(values: NDArray[Any]) -> NDArray[np.bool_]:
    if values.dtype.kind not in "iuf":
        return np.zeros(values.shape, bool)
    return np.isfinite(values) & (values > 0)


def _worlds(model: Any, worlds: ArrayLike | None) -> NDArray[np.float64]:
    """(…, n) a copy of the numeric data, of the worlds of a batch that are asked for."""
    if isinstance(model, mujoco.MjModel):
        if worlds is not None:
            raise MjframesError("worlds is given, but the model is that of one; give a mujoco.batch.Batch.")
        return model.numeric_data.copy()
    every = _expanded(model)
    if worlds is None:
        return every.copy()
    numbers = np.asarray(worlds)
    if numbers.dtype.kind not in "iu" or numbers.ndim > 1 or not ((numbers >= 0) & (numbers < len(every))).all():
        raise MjframesError(f"worlds is {_short(worlds)}; give numbers of worlds from 0 to {len(every) - 1}.")
    return every[numbers].copy()


def _put(model: Any, worlds: ArrayLike | None, data: NDArray[np.float64]) -> None:
    if isinstance(model, mujoco.MjModel):
        model.numeric_data[:] = data
    elif worlds is None:
        _expanded(model)[:] = data
    else:
        _expanded(model)[np.asarray(worlds)] = data


def _expanded(batch: Batch) -> NDArray[Any]:
    """The live `numeric_data` (nsim, n) of a batch's worlds."""
    try:
        return batch.expand("numeric_data")
    except (ValueError, mujoco.FatalError) as error:
        raise MjframesError(f"the batch cannot have a material a world ({error}); scale its own models.") from error


def _own(name: str, key: str) -> str:
    return f"{name}{SEPARATOR}{key}"


def _entries(model: mujoco.MjModel, name: str, key: str) -> slice | None:
    """Where `numeric_data` has the factors, None for models that were written without."""
    for numeric, names in _named(model, mujoco.mjtObj.mjOBJ_NUMERIC, key):
        if name in names:
            start = int(model.numeric_adr[numeric])
            return slice(start, start + int(model.numeric_size[numeric]))
    return None


def _known(model: mujoco.MjModel) -> list[str]:
    """Return the names of the soft bodies that have numerics."""
    return [names[0] for _, names in _named(model, mujoco.mjtObj.mjOBJ_NUMERIC, STIFFNESS)]


def _named(model: mujoco.MjModel, kind: mujoco.mjtObj, key: str) -> Iterator[tuple[int, tuple[str, str]]]:
    """Yield the numerics or texts for a key, and what their soft bodies may be called.

    MuJoCo puts suffixes behind the names of both, and behind the separator that names of one letter have.
    """
    count = model.nnumeric if kind == mujoco.mjtObj.mjOBJ_NUMERIC else model.ntext
    for i in range(count):
        before, found, behind = (mujoco.mj_id2name(model, kind, i) or "").rpartition(_own("", key))
        if found:
            yield i, (before + behind, before + SEPARATOR + behind)
