"""Measure the cycle time against the size of its problem, print it, and draw it into docs/images.

A cycle is that of `our_cycle.py`. Each series varies one size, with its cases in turn, and fits cost = a nᵇ to the
medians. Requires Matplotlib::

    pip install matplotlib
    python benchmarks/sizes.py
"""

import gc
import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import scenes
from our_cycle import Cycle, make_model, parse_settings
from timing import exponent, summary

from wbc_controller.controller.build.collision_model import build_collision_model
from wbc_controller.controller.check.preflight import stance
from wbc_controller.records import Array, Reference, References
from wbc_controller.settings.resources import folder_of

PICTURE = Path(__file__).resolve().parents[1] / "docs" / "images" / "cost-against-size.svg"
#: Cycles of a block, and blocks of each case.
CYCLES, BLOCKS = 100, 15
#: Untimed cycles at the beginning of a block.
FILLING = 10
#: Amplitude of the centre of mass, m.
SWAY = (0.005, 0.01, 0.0)
GAINS = {"stiffness": scenes.STIFFNESS, "damping": scenes.DAMPING, "setpoint_duration": 0.0}
#: Links of Talos for additional tasks and contacts, in order.
LINKS = (
    "gripper_left_base_link", "gripper_right_base_link", "torso_2_link", "head_2_link", "arm_left_4_link",
    "arm_right_4_link", "leg_left_4_link", "leg_right_4_link",
)  # fmt: skip


@dataclass
class Series:
    """A series with one varying size."""

    title: str  # name of the size
    cases: dict[int, dict[str, Any]]  # our settings as plain values, by size

    def __post_init__(self) -> None:
        self.seconds: dict[int, list[Array]] = {size: [] for size in self.cases}  # times of each case, in blocks

    def measure(self) -> None:
        """Time all cases in turn."""
        made = {size: _ready(content) for size, content in self.cases.items()}
        gc.collect()
        gc.freeze()
        for block in range(BLOCKS):
            for size, (cycle, references, states) in made.items():
                times = []
                for i in range(block * CYCLES, (block + 1) * CYCLES):
                    state = cycle.state(*states[i])
                    started = time.perf_counter()
                    cycle.step(state, references[i])
                    times.append(time.perf_counter() - started)
                self.seconds[size].append(np.array(times[FILLING:]))
        gc.unfreeze()

    def medians(self) -> tuple[Array, Array]:
        """Return sizes and medians, s, of all cases."""
        return np.array(list(self.seconds)), np.array([summary(blocks).median for blocks in self.seconds.values()])

    def fit(self) -> tuple[float, float]:
        """Return exponent and factor of the sizes above 0."""
        sizes, medians = self.medians()
        return exponent(sizes[sizes > 0], medians[sizes > 0])


def _ready(content: Mapping[str, Any]) -> tuple[Cycle, list[References], list[tuple[Array, Array]]]:
    """Return a cycle and its inputs, with a swaying centre of mass."""
    settings = parse_settings(content, "sizes.py")
    cycle = Cycle(settings, make_model(settings))
    model = cycle.controller.model
    soles = [name for name, contact in settings.contacts.items() if contact.type == "surface"]
    q = stance(model, cycle.controller, soles)
    rows = scenes.swaying(Cycle(settings, model), q, SWAY, CYCLES * BLOCKS)
    rest = cycle.start(q)
    parts = [np.split(row, [model.nq, model.nq + model.nv]) for row in rows]
    coms = [Reference(*np.split(reference, 3)) for _, _, reference in parts]
    return cycle, [scenes.with_com(rest, com) for com in coms], [(q, v) for q, v, _ in parts]


def _talos(tasks: Mapping[str, Any]) -> dict[str, Any]:
    return scenes.content_of("talos", tasks, {})


def degrees_of_freedom(folder: Path) -> Series:
    """Vary the number of Talos' joints; the others are locked."""
    content = _talos(scenes.tasks("base_link"))
    robot = scenes.every_joint(content["robot"], folder)
    groups = (("leg_",), ("torso_",), ("arm_left",), ("arm_right", "head_"), ("gripper_left",), ("gripper_right",))
    posture = dict(zip(robot["joints"], robot["posture"], strict=True))
    cases = {}
    for count in range(1, len(groups) + 1):
        chosen = [name for name in robot["joints"] if name.startswith(sum(groups[:count], ()))]
        own_joints = {"joints": chosen, "posture": [posture[name] for name in chosen]}
        cases[6 + len(chosen)] = {**content, "robot": {**robot, **own_joints}}
    return Series("degrees of freedom", cases)


def contacts() -> Series:
    """Vary the number of contacts: Talos on its feet, and points of its arms."""
    content = _talos(scenes.tasks("base_link"))
    touching = dict(content["contacts"])
    cases = {len(touching): content}
    point = {"type": "point", "radius": scenes.POINT, "max_normal_force": 1000.0}
    for link in (LINKS[0], LINKS[1], LINKS[4], LINKS[5]):
        touching = {**touching, link: {**point, "frame": link}}
        cases[len(touching)] = {**content, "contacts": touching}
    return Series("contacts", cases)


def tasks() -> Series:
    """Vary the number of tasks: the three tasks of Talos, and positions and orientations of links."""
    own_tasks = scenes.tasks("base_link")
    cases = {len(own_tasks): _talos(own_tasks)}
    kinds = ("frame_position", "frame_orientation")
    for i, link in enumerate((*LINKS, *LINKS)):
        kind = kinds[i // len(LINKS)]
        own_tasks = {**own_tasks, f"{kind}_{link}": {"type": kind, "frame": link, "weight": 0.1, **GAINS}}
        if len(own_tasks) in (5, 7, 11, 15, 19):
            cases[len(own_tasks)] = _talos(own_tasks)
    return Series("tasks", cases)


def levels() -> Series:
    """Vary the number of strict priority levels of four tasks of Talos."""
    hand = {"hand": {"type": "frame_pose", "frame": LINKS[0], "weight": 1.0, **GAINS}}
    own_tasks = scenes.tasks("base_link") | hand
    assigned = {1: {}, 2: {"posture": 1}, 3: {"hand": 1, "posture": 2}, 4: {"waist": 1, "hand": 2, "posture": 3}}
    cases = {
        count: _talos({name: task | {"level": level.get(name, 0)} for name, task in own_tasks.items()})
        for count, level in assigned.items()
    }
    return Series("levels", cases)


def collision_pairs() -> Series:
    """Vary the number of collision pairs of G1."""
    plain = scenes.content_of("g1", scenes.tasks("pelvis"), {})
    settings = parse_settings(plain, "sizes.py")
    margin, folder = settings.limits.self_collision.margin, folder_of(settings.robot.urdf)
    geometry = build_collision_model(make_model(settings), margin=margin, folder=folder).geometry
    links = [shape.name for shape in geometry.geometryObjects]
    names = [f"{links[pair.first]}/{links[pair.second]}" for pair in geometry.collisionPairs]
    np.random.default_rng(0).shuffle(names)
    counts = (25, 50, 100, 200)
    cases = {0: plain} | {count: _apart(plain, pairs=names[:count]) for count in counts} | {len(names): _apart(plain)}
    return Series("collision pairs", cases)


def _apart(content: Mapping[str, Any], **changes: Any) -> dict[str, Any]:
    limits = content.get("limits", {})
    return {**content, "limits": {**limits, "self_collision": {"enabled": True, **changes}}}


def plotting() -> Any:
    """Return Matplotlib's pyplot with reproducible output: no dates, no random names."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams.update(
        {
            "svg.hashsalt": "sizes",
            "svg.fonttype": "none",  # text elements keep the file small
            "font.family": "sans-serif",
            "font.size": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
            "axes.grid": True,
            "grid.alpha": 0.3,
            "savefig.facecolor": "white",
        }
    )
    import matplotlib.pyplot as plt

    return plt


def draw(plt: Any, found: list[Series]) -> None:
    """Write the picture."""
    from matplotlib.ticker import FixedLocator, NullLocator

    figure, panels = plt.subplots(1, len(found), figsize=(2.1 * len(found), 2.6), sharey=True)
    for panel, series in zip(panels, found, strict=True):
        sizes, medians = series.medians()
        fitted = sizes > 0
        power, factor = series.fit()
        panel.plot(sizes[fitted], 1e6 * factor * sizes[fitted] ** power, color="tab:orange", linewidth=1.0)
        panel.plot(sizes[fitted], 1e6 * medians[fitted], "o", color="tab:blue", markersize=3.5)
        for without in 1e6 * medians[~fitted]:
            panel.axhline(without, color="tab:blue", linewidth=0.8, linestyle=":")
        panel.set(xscale="log", yscale="log", xlabel=series.title, title=f"exponent {power:.2f}")
        panel.xaxis.set(major_locator=FixedLocator(sizes[fitted]), minor_locator=NullLocator())
        panel.set_xticklabels([str(size) for size in sizes[fitted]], fontsize=7)
    ticks = (50, 70, 100, 150, 200, 300, 500, 700, 1000, 1500, 2000, 3000, 5000)
    panels[0].yaxis.set(major_locator=FixedLocator(ticks), minor_locator=NullLocator())
    panels[0].set_yticklabels([str(tick) for tick in ticks])
    panels[0].set_ylabel("median of a cycle, µs")
    figure.tight_layout()
    figure.savefig(PICTURE, metadata={"Date": None})
    plt.close(figure)
    print(f"{PICTURE.name}: {PICTURE.stat().st_size / 1000:.0f} kB")


def main() -> None:
    """Measure all series, and draw them."""
    plt = plotting()  # before half a minute of measurements
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with TemporaryDirectory() as folder:
        found = [degrees_of_freedom(Path(folder)), contacts(), tasks(), levels(), collision_pairs()]
        for series in found:
            series.measure()
            sizes, medians = series.medians()
            cost = ", ".join(f"{size}: {1e6 * median:.0f}" for size, median in zip(sizes, medians, strict=True))
            print(f"{series.title:20} exponent {series.fit()[0]:5.2f}; µs by size {cost}", flush=True)
    draw(plt, found)


if __name__ == "__main__":
    main()
