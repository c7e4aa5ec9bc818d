"""What the bench shows of steps: tables for the terminal, the table of docs/speed.md, the picture of the README."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from benchmarks.speed.step_scenes import BARE, OURS, SCENES, TIMESTEP
from benchmarks.speed.steps import Speed, growth, of, over_bare
from benchmarks.tables import table_of
from mjframes.base.files import replacing
from mjframes.base.packages import optional

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEAK, BEAM = "steak", "beam"
FEW, MANY = (3, 20), (20, 160)  # numbers of frames between which growth is told
RESOLUTION = 85  # [dots per inch]
COLORS = {"free": "tab:gray", "contact": "tab:blue", "stack": "tab:purple", "grasp": "tab:green"}
CONTENDERS = {OURS: "tab:blue", BARE: "0.6", "flex trilinear": "tab:orange", "flex quadratic": "tab:red"}

STEP_NOTE = (
    "\n".join(f"{scene}: {words}." for scene, words in SCENES.items())
    + f"""
× {BARE}: over the same MuJoCo bodies without the plugin, with as many contacts.
growth: exponent of the time in the number of frames.  –: left out, a run takes minutes, or not counted.
instr.: by valgrind, which knows no AVX-512; not in `--quick`."""
)


def step_table(speeds: Sequence[Speed], body: str) -> Table:
    """Return one row a number of frames and for each scene: the step, what it is over the bodies alone's, contacts,
    thousands of instructions; then how these times grow.
    """
    some = of(speeds, body=body)
    scenes = [scene for scene in SCENES if of(some, scene=scene)]
    columns = ["dofs"]
    for scene in scenes:
        columns += [f"{scene}\nµs", "bodies\nµs", "\n×", "con-\ntacts", "10³\ninstr."]
    table = table_of(f"Steps of {TIMESTEP * 1e3:g} ms of the {body}, on one core", *columns)
    for frames in sorted({speed.frames for speed in some}):
        cells = [str(min(speed.dofs for speed in of(some, frames=frames)))]
        for scene in scenes:
            mine, bare = (of(some, frames=frames, scene=scene, contender=name) for name in (OURS, BARE))
            ratio = over_bare(some, frames, scene, body)
            cells += [
                _microseconds(mine),
                _microseconds(bare),
                f"{ratio:.1f}" if ratio else "–",
                f"{mine[0].contacts:.0f}" if mine else "–",
                f"{mine[0].instructions / 1e3:,.0f}" if mine and mine[0].instructions else "–",
            ]
        table.add_row(f"{frames} frames", *cells)
    most = max(speed.frames for speed in some)
    for first, last in (FEW, (MANY[0], min(MANY[1], most))):
        if last <= first:  # a quick run has no bodies of many frames
            continue
        cells = [""]
        for scene in scenes:
            grown = [growth(of(some, scene=scene, contender=name), first, last) for name in (OURS, BARE)]
            cells += [*("–" if exponent is None else f"{exponent:.1f}" for exponent in grown), "", "", ""]
        table.add_row(f"growth {first}–{last}", *cells)
    return table


def flex_table(speeds: Sequence[Speed]) -> Table:
    """Return one row a scene of the beam: the steps of frames, of their bodies alone, of flexes, and how these are
    over that of frames.
    """
    some = of(speeds, body=BEAM)
    contenders = list(dict.fromkeys(speed.contender for speed in some))
    table = table_of(f"Steps of {TIMESTEP * 1e3:g} ms of a beam, µs", *contenders)
    for scene in SCENES:
        cells = []
        for contender in contenders:
            found, mine = (of(some, scene=scene, contender=name) for name in (contender, OURS))
            over = f" ({found[0].step / mine[0].step:.1f} ×)" if found and mine and contender != OURS else ""
            cells.append(_microseconds(found) + over)
        table.add_row(scene, *cells)
    return table


def contact_table(shares: Mapping[int, float]) -> Table:
    """Return the plugin's work on contacts, of the step in contact, one column a number of frames."""
    table = table_of("The plugin's contacts", *(f"{frames} frames" for frames in shares))
    table.add_row("of the step in contact", *(f"{share:.0%}" for share in shares.values()))
    return table


def readme_table(
    speeds: Sequence[Speed], builds: Mapping[int, float], papers: Mapping[int, tuple[float, float]]
) -> str:
    """Return the table of docs/speed.md, in Markdown.

    builds: seconds of all processors together, by frames.
    papers: seconds to initialize and frames a second, by frames.
    """
    lines = [
        "| frames | degrees of freedom | build, processor | paper | free | on an edge | × bodies alone |"
        " three stacked | grasped | steps per second | paper |",
        "| --- |" + " --- |" * 10,
    ]
    some = of(speeds, body=STEAK)
    for frames in sorted({speed.frames for speed in some}):
        own = {scene: of(some, frames=frames, scene=scene, contender=OURS) for scene in SCENES}
        ratio = over_bare(some, frames, "contact", STEAK)
        paper = papers.get(frames)
        cells = [
            str(frames),
            str(min(speed.dofs for speed in of(some, frames=frames))),
            f"{builds[frames]:.1f} s" if frames in builds else "–",
            f"{paper[0]:g} s" if paper else "–",
            _time(own["free"]),
            _time(own["contact"]),
            f"{ratio:.1f}" if ratio else "–",
            _time(own["stack"]),
            _time(own["grasp"]),
            _rate(own["contact"]),
            f"{paper[1]:g}" if paper else "–",
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw_steps(speeds: Sequence[Speed], path: str | os.PathLike[str]) -> None:
    """Draw times over frames of the steak, and those of the beam beside flex (.png).

    Raise MjframesError without matplotlib.
    """
    optional("matplotlib", "a plot", "plot")
    from matplotlib.figure import Figure

    widths = (3, 2) if of(speeds, body=BEAM) else (3,)
    figure = Figure(figsize=(2 * sum(widths), 4), layout="constrained")
    panels = figure.subplots(1, len(widths), sharey=True, width_ratios=widths, squeeze=False)[0]
    _draw_steak(panels[0], speeds)
    if len(panels) > 1:
        _draw_beam(panels[1], speeds)
    with replacing(path, "the plot") as partial:
        figure.savefig(Path(partial), dpi=RESOLUTION, format="png")


def _draw_steak(left: Axes, speeds: Sequence[Speed]) -> None:
    """Lines over frames, of the soft body and of its bodies alone."""
    from matplotlib.ticker import ScalarFormatter

    for scene, color in COLORS.items():
        for contender, line in ((OURS, "o-"), (BARE, "--")):
            some = of(speeds, body=STEAK, scene=scene, contender=contender)
            label = scene if contender == OURS else None
            left.plot([s.frames for s in some], [s.step * 1e6 for s in some], line, color=color, label=label)
    left.plot([], [], "--", color="0.3", label=BARE)
    left.set(xscale="log", yscale="log", xlabel="frames", ylabel="µs a step", title="steak")
    counts = sorted({speed.frames for speed in of(speeds, body=STEAK)})
    left.set_xticks(counts, labels=[str(count) for count in counts], minor=False)
    left.xaxis.set_minor_formatter("")
    left.yaxis.set_major_formatter(ScalarFormatter())
    left.grid(alpha=0.3, axis="y")
    left.legend()


def _draw_beam(right: Axes, speeds: Sequence[Speed]) -> None:
    """Bars, a group a scene."""
    width = 0.8 / len(CONTENDERS)
    for number, (contender, color) in enumerate(CONTENDERS.items()):
        for place, scene in enumerate(SCENES):
            found = of(speeds, body=BEAM, scene=scene, contender=contender)
            label = contender if scene == "free" else None
            height = found[0].step * 1e6 if found else 0.0
            right.bar(place + (number - 1.5) * width, height, width, color=color, label=label)
    right.set_xticks(range(len(SCENES)), labels=list(SCENES))
    right.set(title="beam, 3 frames, beside flex")
    right.grid(alpha=0.3, axis="y")
    right.legend()


def _microseconds(found: Sequence[Speed]) -> str:
    """Of a step, with three digits."""
    return f"{float(f'{found[0].step * 1e6:.3g}'):,g}" if found else "–"


def _time(found: Sequence[Speed]) -> str:
    """Of a step, with two digits."""
    if not found:
        return "–"
    micro = float(f"{found[0].step * 1e6:.2g}")
    return f"{micro:g} µs" if micro < 1000 else f"{micro / 1000:g} ms"


def _rate(found: Sequence[Speed]) -> str:
    """Steps a second, with two digits."""
    return f"{float(f'{1 / found[0].step:.2g}'):,.0f}" if found else "–"
