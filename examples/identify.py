"""The moduli of a post's two layers from recorded pokes, found by MuJoCo's own system identification.

A post stands on the ground, a firm layer below a soft one; two balls push it sideways, one after the other, where the
layers meet and at the top, and the record is how far they come. `mujoco.sysid` fits the two factors of the numeric
`post:stiffness`, which are exact to first order, so the post is built anew with what a fit found and fitted again: a
factor of nine between the layers is off by half at first, and by a thousandth after three fits.
Noise is added to the record. Three fits are made. In the first, the post that is poked has the voxels and frames of the
post that is fitted: the moduli come out within 1 %, which says that the search works and nothing about real records. In
the other two the record is of a post of 25,600 voxels and 40 frames. One of 400 voxels and 4 frames finds moduli that
are wrong by 1 %, one of 3,200 voxels and 5 frames by 4 %. That is luck: with 3 to 20 frames they are wrong by 2 to
20 %, for how far a body of few frames gives way where balls press depends on where its frames are. A real record adds
errors of shape, law and contact to it.
Run `python examples/identify.py --out out`; it needs `pip install "mjframes[identify]"`.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import mujoco
import numpy as np
from mujoco import rollout, sysid
from numpy.typing import NDArray

import mjframes as mf

Array = NDArray[np.float64]

LAYERS = ("base", "top")
TRUE = np.array([6e4, 2e4])  # [Pa] Young's moduli of the layers
GUESS = TRUE * [3, 1 / 3]  # [Pa] where the search starts
HEIGHT, WIDTH, SPACING = 16, 5, 0.01  # [voxels] of both layers together, [m]
ROUNDS = 3
FORCE = np.array([0.8, 0.25])  # [N] of the lower and the upper ball, where it is most
DURATION, POKE, STARTS = 1.0, 0.4, (0.05, 0.55)  # [s] of the record, of a poke, and when these start
NOISE = 2e-5  # [m] of the balls' places
REACH = np.log(10)  # [-] of a fit: factors from 0.1 to 10
STEP, ENOUGH = 1e-3, 1e-4  # [-] of the logarithms of factors: for differences, and to end with
BALL, APART = 0.01, 0.003  # [m] radius, and of its start from the voxels, which the smooth surface leaves by 2 mm
GIVES = 0.03  # [s] of its contact: with a stiffer one the record jumps as the factors change
PLACES = SPACING * np.array([HEIGHT / 2, HEIGHT - 2])  # [m] heights at which they push
SOFT = f'priority="1" solref="{GIVES} 1"'
SIDE = f'type="slide" axis="1 0 0" damping="0.2"/><geom type="sphere" size="{BALL}" mass="0.02" {SOFT}/></body>'
SCENE = f"""<mujoco><option gravity="0 0 0" timestep="0.004"/><worldbody>
<body pos="{-BALL - APART} {SPACING * WIDTH / 2} {PLACES[0]}"><joint name="lower" {SIDE}
<body pos="{-BALL - APART} {SPACING * WIDTH / 2} {PLACES[1]}"><joint name="upper" {SIDE}
</worldbody><actuator><motor joint="lower"/><motor joint="upper"/></actuator>
<sensor><jointpos name="low" joint="lower"/><jointpos name="high" joint="upper"/></sensor></mujoco>"""


@dataclass(frozen=True)
class Post:
    """How finely a post is resolved: voxels along SPACING [-], frames [-]."""

    refined: int
    frames: int


COARSE, FINE, REAL = Post(1, 4), Post(2, 5), Post(4, 40)
FITS = {  # which post is poked, and which is fitted to that
    "same body": (COARSE, COARSE),
    "400 voxels, 4 frames": (REAL, COARSE),
    "3,200 voxels, 5 frames": (REAL, FINE),
}


@dataclass(frozen=True, eq=False)
class Identified:
    """young: (rounds + 1, 2) [Pa] of base and top, the guess and what each round found.

    time: (n,) [s], recorded and fitted: (n, 2) [m] how far the balls come, in the record and at last.
    """

    young: Array
    time: Array
    recorded: Array
    fitted: Array

    @property
    def error(self) -> Array:
        """Return that of each modulus (2,), relative to the true one [-]."""
        return np.abs(self.young[-1] / TRUE - 1)


def scene(young: Array, post: Post) -> mujoco.MjSpec:
    """Return the post with these moduli (2,) [Pa] and the balls that poke it."""
    k = post.refined
    labels = np.ones((k * WIDTH, k * WIDTH, k * HEIGHT), int)
    labels[:, :, k * HEIGHT // 2 :] = 2
    materials = {i + 1: mf.Material(young[i], 0.4, 1000, name=name) for i, name in enumerate(LAYERS)}
    ground = np.zeros(labels.shape, bool)
    ground[:, :, :k] = True
    volume = mf.Volume.from_labels(labels, SPACING / k, materials)
    body = mf.build(volume, post.frames, supports=mf.Fixed(ground), damping=(0.0, 0.01))
    spec = mujoco.MjSpec.from_string(SCENE)
    mf.attach(spec, body, "post")
    return spec


def pokes(time: Array) -> Array:
    """Return the forces (n, 2) [N] of both balls."""
    since = time[:, None] - STARTS
    return FORCE * np.where((since > 0) & (since < POKE), np.sin(np.pi * since / POKE) ** 2, 0)


def poked(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Return time (n,) [s] and how far the balls come (n, 2) [m]."""
    data = mujoco.MjData(model)
    start = sysid.create_initial_state(model, data.qpos, data.qvel, data.act)
    times = model.opt.timestep * np.arange(round(DURATION / model.opt.timestep))
    states, sensors = rollout.rollout(model, data, start, pokes(times)[:-1])
    return states[0, :, 0], sensors[0]


def fit(young: Array, time: Array, recorded: Array, post: Post) -> tuple[Array, Array]:
    """Return the moduli (2,) [Pa] that fit a record best, by factors of a post built with others; and the fit."""
    spec = scene(young, post)
    model = spec.compile()
    data = mujoco.MjData(model)
    times = model.opt.timestep * np.arange(len(time) + 1)

    def scaled(some: mujoco.MjSpec, parameter: sysid.Parameter) -> None:
        some.numeric("post:stiffness").data = np.exp(parameter.value)

    parameters = sysid.ParameterDict()
    parameters.add(sysid.Parameter("factors", np.zeros(2), np.full(2, -REACH), np.full(2, REACH), modifier=scaled))
    record = sysid.ModelSequences(
        "post",
        spec,
        "pokes",
        sysid.create_initial_state(model, data.qpos, data.qvel, data.act),
        sysid.TimeSeries(times, pokes(times)),
        sysid.TimeSeries.from_names(time, recorded, model),
    )
    misses = sysid.build_residual_fn(models_sequences=[record])
    # where noise leaves nothing to be gained the search ends after a few trials, not after a hundred
    quiet = {"verbose": False, "eps": STEP, "xtol": ENOUGH, "max_iters": 20, "mu_factor": 10.0}
    found, _ = sysid.optimize(parameters, misses, optimizer="mujoco", **quiet)
    factors = np.exp(found["factors"].value)
    mf.scale(model, "post", materials=dict(zip(LAYERS, factors, strict=True)))
    return young * factors, poked(model)[1]


@cache
def true_record(post: Post) -> tuple[Array, Array]:
    """Return time and record of a post with the true moduli, without noise."""
    return poked(scene(TRUE, post).compile())


def identify(poked_post: Post, fitted_post: Post) -> Identified:
    """Return what fits of one post to the record of another find.

    Raise ModuleNotFoundError without what `mujoco.sysid` needs.
    """
    if not hasattr(sysid, "optimize"):
        raise ModuleNotFoundError('mujoco.sysid lacks packages: pip install "mjframes[identify]"')
    time, exact = true_record(poked_post)
    recorded = exact + NOISE * np.random.default_rng(0).normal(size=exact.shape)
    young, fitted = [GUESS], exact
    for _ in range(ROUNDS):
        better, fitted = fit(young[-1], time, recorded, fitted_post)
        young.append(better)
    return Identified(np.array(young), time, recorded, fitted)


def run(out: Path) -> dict[str, Identified]:
    """Write identify.png to `out`: the record and the last fit, and the moduli of all of FITS, which are returned."""
    from matplotlib.figure import Figure

    out.mkdir(parents=True, exist_ok=True)
    results = {name: identify(*posts) for name, posts in FITS.items()}
    *_, found = results.values()
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    for name, record, curve in zip(("lower", "upper"), found.recorded.T, found.fitted.T, strict=True):
        (points,) = left.plot(found.time, 1e3 * record, ".", markersize=2, label=f"{name}, recorded")
        left.plot(found.time, 1e3 * curve, color=points.get_color(), label=f"{name}, fitted")
    left.set(xlabel="time [s]", ylabel="way of the ball [mm]")
    left.legend()
    for style, (title, result) in zip(("o:", "s--", "^-"), results.items(), strict=True):
        for color, name, row in zip(("C0", "C1"), LAYERS, (result.young / TRUE).T, strict=True):
            right.semilogy(row, style, color=color, label=f"{name}, {title}")
    right.axhline(1, color="k", linewidth=0.8)
    right.set(xlabel="builds", ylabel="Young's modulus / the true one")
    right.set_xticks(range(len(found.young)))
    right.legend()
    figure.savefig(out / "identify.png", dpi=110)
    return results


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder of identify.png")
    for title, result in run(parser.parse_args().out).items():
        base, top = result.young[-1]
        print(f"{title}: base {base:.4g} Pa, top {top:.4g} Pa; true ones {TRUE[0]:.4g}, {TRUE[1]:.4g}")
        print(f"    errors: base {result.error[0]:.1%}, top {result.error[1]:.1%}")
