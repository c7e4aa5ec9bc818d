"""Random programs that do to scenes with soft bodies whatever MuJoCo allows.

A program is made of its seed: it builds a scene and edits it, sizes, options, flags, states, copies, resets, rays,
picks, pictures, recompiles, threads. It runs in a process of its own, so that even a crash is told, with its seed. What
may come of an edit is a sentence, as MuJoCo's errors are; numbers that are not finite only with MuJoCo's own warning
of them.

python -m benchmarks.stability.abuse 10000 --seed 0
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from benchmarks.stability.apart import Report, reports, told
from benchmarks.stability.edits import EDITS, World
from benchmarks.tables import advancing
from mjframes.base.errors import MjframesError
from mjframes.base.texts import count, seed
from mjframes.body.build import build
from mjframes.body.soft_body import SoftBody
from mjframes.cli.arguments import Parser
from mjframes.cli.commands import exit_code
from mjframes.frames.supports import Attached, Fixed
from mjframes.scene.attach import attach
from mjframes.scene.sensors import add_sensor
from mjframes.volume.material import Material
from mjframes.volume.volume import Volume

LENGTH = 25  # [edits] of a program
SHAPE, SPACING = (8, 4, 4), 0.01  # voxels, [m]
OURS = "mjframes:"  # how warnings of ours begin; each mjData tells each of them once
RECOVERED = ("Nan, Inf or huge value", "Arena memory", "stack overflow", "constraint buffer", "contact buffer")

SCENE = """<mujoco>
<option timestep="0.002"/>
<asset><mesh name="wedge" vertex="0 0 0 .1 0 0 0 .1 0 .1 .1 0 0 0 .05 .1 0 .05"/></asset>
<worldbody>
  <light pos="0 0 2"/><camera name="eye" pos="0 -.6 .3" xyaxes="1 0 0 0 .4 1"/>
  <geom name="floor" type="plane" size="1 1 .1"/>
  <site name="above" pos="0 0 .5" zaxis="0 0 -1"/>
  <body name="box" pos=".05 0 .3"><freejoint/><geom name="box" type="box" size=".02 .03 .02" mass=".1"/></body>
  <body name="ball" pos="-.04 .02 .3"><freejoint/><geom name="ball" size=".025" mass=".1"/></body>
  <body name="capsule" pos="0 .1 .3"><freejoint/><geom name="capsule" type="capsule" size=".01 .04" mass=".1"/></body>
  <body name="egg" pos="0 -.1 .3"><freejoint/><geom name="egg" type="ellipsoid" size=".02 .03 .02" mass=".1"/></body>
  <body name="wedge" pos=".1 .1 .3"><freejoint/><geom name="wedge" type="mesh" mesh="wedge" mass=".1"/></body>
  <body name="arm" pos="-.2 0 .2"><joint name="arm" axis="0 1 0" damping=".01"/>
    <geom name="arm" type="capsule" fromto="0 0 0 -.1 0 0" size=".01" mass=".1"/></body>
  <body name="hand" mocap="true" pos="0 0 .6"><geom name="hand" type="cylinder" size=".02 .02"/></body>
</worldbody>
<equality><weld name="weld" body1="box" body2="ball" active="false"/></equality>
<actuator><motor name="arm" joint="arm" gear=".1"/></actuator>
<sensor><rangefinder name="range" site="above"/><e_kinetic/><e_potential/></sensor>
</mujoco>"""

CLOTHS = (  # flexes other than of triangles do not touch soft bodies
    '<flexcomp name="cloth" type="grid" dim="2" count="5 5 1" {}><edge equality="true"/></flexcomp>',
    '<flexcomp name="cloth" type="grid" dim="1" count="5 1 1" {}><contact contype="0" conaffinity="0"/>'
    '<edge equality="true"/></flexcomp>',
    '<flexcomp name="cloth" type="grid" dim="3" count="3 3 3" {}><contact contype="0" conaffinity="0"/>'
    '<elasticity young="1e3" poisson="0.3" damping="0.001"/></flexcomp>',
)
CLOTH = 'spacing=".03 .03 .03" pos="-.06 0 .26" mass=".03" radius=".002"'


def main(argv: Sequence[str] | None = None) -> int:
    """Run programs with as many edits as asked for, print what became of them; return the exit code, 1 for any
    failure.
    """
    parser = Parser(
        prog="python -m benchmarks.stability.abuse",
        description="Edit scenes at random: sizes, options, states, copies, rays, threads.",
    )
    parser.add_argument(
        "edits", type=count, nargs="?", default=10_000, metavar="EDITS", help="how many (default %(default)s)"
    )
    parser.add_argument("--seed", type=seed, default=0, help="of the first of these scenes (default %(default)s)")
    arguments = parser.parse_args(argv)
    edits, first = arguments.edits, arguments.seed
    with advancing("editing scenes", edits) as (_, advance):
        report = abused(edits, first, advance)
    last = first - 1 + -(-edits // LENGTH)
    return told(report, f"{report.done} edits of scenes with the seeds {first} to {last}")


def abused(edits: int, seed: int, advance: Callable[[int], object] = lambda edits: None) -> Report:
    """Return what becomes of random programs with as many edits in all, of the seeds from `seed` on.

    advance: is called with the edits of each program that ends.
    """
    total = Report()
    for report in reports(program, range(seed, seed + -(-edits // LENGTH)), LENGTH):
        total += report
        advance(report.done)
    return total


def program(seed: int) -> Report:
    """Run the program of a seed in this process."""
    rng = np.random.default_rng(seed)
    heard: list[str] = []
    lock = threading.Lock()

    def hear(message: str) -> None:
        with lock:
            heard.append(message)

    mujoco.set_mju_user_warning(hear)
    names = list(EDITS)
    said: Counter[str] = Counter()
    failures: list[str] = []
    done: list[str] = []
    world = World(scene(rng))
    for _ in range(LENGTH):
        name = names[rng.integers(len(names))]
        done.append(name)
        try:
            EDITS[name](world, rng)
        except (mujoco.FatalError, MjframesError, ValueError) as error:
            said[_first(str(error))] += 1
            world = World(scene(rng))
        except Exception as error:
            failures.append(f"{type(error).__name__}: {error}")
        with lock:
            some = heard.copy()
            heard.clear()
        said.update(map(_first, some))
        finite = np.isfinite(world.data.qpos).all() and np.isfinite(world.data.qvel).all()
        if not finite and not any(known in message for message in some for known in RECOVERED):
            failures.append("numbers that are not finite, without a warning")
        repeated = [text for text, count in Counter(some).items() if count > world.datas and text.startswith(OURS)]
        failures.extend(f"told {some.count(text)} times: {text}" for text in repeated)
        if failures:
            break
    trail = ", ".join(done)
    return Report(len(done), tuple(f"seed {seed}: {text} (after {trail})" for text in failures), said)


def _first(text: str) -> str:
    """A warning's first words, which are the same whatever its numbers."""
    return " ".join(text.split())[:60]


def scene(rng: np.random.Generator) -> mujoco.MjSpec:
    """Return a scene with one to three soft bodies among rigid ones, in every other one a cloth, a cord or a flexible
    block.
    """
    cloth = str(rng.choice(CLOTHS, p=(0.6, 0.2, 0.2))).format(CLOTH) if rng.random() < 0.5 else ""
    spec = mujoco.MjSpec.from_string(SCENE.replace("</worldbody>", f"{cloth}</worldbody>"))
    for number in range(rng.integers(1, 4)):
        kind = int(rng.integers(len(_KINDS)))
        place = (0.12 * number - 0.12, 0.0, 0.1 + 0.1 * number)
        name = f"soft_{number}" if number else "soft"
        body = soft_body(kind)
        attach(spec, body, name, pos=place)
        add_sensor(spec, body, name, "elastic_energy")
    return spec


_KINDS: tuple[dict[str, object], ...] = (
    {},
    {"law": "neo_hookean"},
    {"frame_type": "rigid"},
    {"frame_type": ("rigid", "affine", "quadratic")},
    {"method": "paper"},
    {"fixed": True},
    {"attached": True},
    {"mode": "explicit", "young": 1e4},
)
_BODIES: dict[int, SoftBody] = {}


def soft_body(kind: int) -> SoftBody:
    """Return one of a few bars, built once a process."""
    if kind not in _BODIES:
        options = dict(_KINDS[kind])
        materials = {1: Material(float(options.pop("young", 3e4)), 0.4, 1000), 2: Material(1e6, 0.3, 1000)}  # pyright: ignore[reportArgumentType]
        labels = np.ones(SHAPE, int)
        labels[3:5, 1:3, 1:3] = 2
        end = np.arange(SHAPE[0])[:, None, None] * np.ones(SHAPE, int) < 1
        if options.pop("fixed", False):
            options["supports"] = [Fixed(end)]
        if options.pop("attached", False):
            options["supports"] = [Attached("arm", end)]
        _BODIES[kind] = build(Volume.from_labels(labels, SPACING, materials), 3, **options)  # pyright: ignore[reportArgumentType]
    return _BODIES[kind]


if __name__ == "__main__":
    raise SystemExit(exit_code(main))
