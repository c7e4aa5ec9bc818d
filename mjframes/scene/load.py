"""Scenes from MJCF and their initial states, with MuJoCo's reason in one line where there is none."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import mujoco

from mjframes.base.errors import MjframesError
from mjframes.scene import plugin

PLUGIN_WARNING = "mjframes: "  # what the plugin's warnings begin with (plugin/soft_body.cc)
DIVERGED = [  # MuJoCo's warnings of a state that is not finite or huge
    int(mujoco.mjtWarning.mjWARN_BADQPOS),
    int(mujoco.mjtWarning.mjWARN_BADQVEL),
    int(mujoco.mjtWarning.mjWARN_BADQACC),
]


def load_scene(path: str | os.PathLike[str]) -> tuple[mujoco.MjModel, mujoco.MjSpec]:
    """Load a scene from MJCF, with the plugin if the scene asks for it.

    Parameters
    ----------
    path
        MJCF file.

    Returns
    -------
    tuple
        The compiled model and its spec.

    Raises
    ------
    MjframesError
        If the scene cannot be loaded, with MuJoCo's reason.
    """
    if not os.path.isfile(path):
        raise MjframesError(f"{path}: there is no such scene; give the path of an MJCF file (.xml).")
    with mujoco_warnings() as warnings:
        try:
            try:
                spec = mujoco.MjSpec.from_file(os.fspath(path))
            except ValueError as error:
                if plugin.NAME not in str(error) or plugin.is_loaded():
                    raise
                plugin.load()
                spec = mujoco.MjSpec.from_file(os.fspath(path))
            if any(other.plugin_name == plugin.NAME for other in spec.plugins) and (
                why := changed_masses(spec.compiler)
            ):
                raise MjframesError(f"{path}: the scene has soft bodies, and {why}.")
            return spec.compile(), spec
        except MjframesError:
            raise
        except (ValueError, mujoco.FatalError) as error:
            raise MjframesError(f"{path}: MuJoCo cannot load the scene ({sentence(error, warnings)}).") from error


def require_model(model: object) -> None:
    """Raise MjframesError for what is no compiled model."""
    if not isinstance(model, mujoco.MjModel):
        raise MjframesError(f"model is a {type(model).__name__}; give the MjModel that spec.compile() returns.")


def require_state(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Raise MjframesError for what is no compiled model with a state of it; a copy of the model has the same states."""
    require_model(model)
    if not isinstance(data, mujoco.MjData):
        raise MjframesError(f"data is a {type(data).__name__}; give the MjData of the model.")
    sizes = {
        "bodies": (len(data.xpos), model.nbody),
        "qpos": (len(data.qpos), model.nq),
        "qvel": (len(data.qvel), model.nv),
    }
    for what, (found, expected) in sizes.items():
        if found != expected:
            raise MjframesError(
                f"data is of another model: it has {found} {what}, the model {expected}; give mujoco.MjData(model)."
            )


def start(model: mujoco.MjModel, warnings: list[str]) -> mujoco.MjData:
    """Return the scene's initial state.  warnings: what MuJoCo warned of, see `mujoco_warnings`.

    Raise MjframesError for a scene that the plugin refuses.
    """
    try:
        return mujoco.MjData(model)
    except mujoco.FatalError as error:
        raise MjframesError(f"MuJoCo cannot start the scene ({sentence(error, warnings)}).") from error


def reset_to(model: mujoco.MjModel, data: mujoco.MjData, keyframe: str | int) -> None:
    """Set the state of a keyframe, by its name or number. Raise MjframesError where the scene has none such."""
    names = [model.key(k).name for k in range(model.nkey)]
    if isinstance(keyframe, str) and keyframe in names:
        number = names.index(keyframe)
    elif str(keyframe).isdecimal() and int(keyframe) < model.nkey:
        number = int(keyframe)
    else:
        known = ", ".join(repr(name) if name else str(k) for k, name in enumerate(names)) or "none"
        raise MjframesError(f"keyframe is {keyframe!r}, but those of the scene are: {known}.")
    mujoco.mj_resetDataKeyframe(model, data, number)


def changed_masses(compiler: mujoco.MjsCompiler) -> str:
    """Return what in a scene's compiler changes the masses of its bodies, and so those of soft ones; "" for nothing."""
    for option in ("settotalmass", "boundmass", "boundinertia"):
        if (value := getattr(compiler, option)) > 0:
            return f'its <compiler {option}="{value:g}"/> would change the masses of a soft body; take it out'
    return ""


@contextmanager
def mujoco_warnings() -> Iterator[list[str]]:
    """Catch what MuJoCo warns of, instead of a file MUJOCO_LOG.TXT in the working directory."""
    caught: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(caught.append)
    try:
        yield caught
    finally:
        mujoco.set_mju_user_warning(before)


def sentence(error: Exception, warnings: list[str]) -> str:
    """Return the reason in one line: the plugin's own words where it has some, else MuJoCo's."""
    lines = [*warnings, *str(error).splitlines()]
    own = [line for line in lines if line.startswith(PLUGIN_WARNING)]
    text = own[-1].removeprefix(PLUGIN_WARNING) if own else (warnings or [str(error)])[-1]
    return " ".join(text.split()).rstrip(".")
