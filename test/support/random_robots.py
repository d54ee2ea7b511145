"""Random robots written as URDFs: trees, names, limits, mimic joints, bases and shapes, some of them with a mistake."""

import itertools
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin

GRAVITY = 9.81
#: Sides of a sole's outline, as shares of its half length and half width: a mesh with slanted sides.
_OUTLINE = ((1.0, 0.6), (0.6, 1.0), (-0.8, 1.0), (-1.0, 0.7), (-1.0, -0.7), (-0.8, -1.0), (0.6, -1.0), (1.0, -0.6))
_BAD_VISUALS = (
    "<visual/>",
    "<visual><geometry><sphere/></geometry></visual>",
    '<visual><geometry><box size="9 9 9"/></geometry><material><color rgba="1 0 0 1"/></material></visual>',
    '<visual><geometry><mesh filename="absent.dae"/></geometry><material name="none"/></visual>',
    '<visual><geometry><torus radius="1"/></geometry></visual>',
)


def _renamed(**names: str):
    return lambda name: names.get(name, name), lambda name: f"{name}_joint"


#: Ways of naming links and joints, from the readable name of a link.
_NAMES = {
    "plain": (lambda name: name, lambda name: f"{name}_joint"),
    "same": (lambda name: name, lambda name: name),
    "dashes": (lambda name: name.replace("_", "-"), lambda name: name.replace("_", ".")),
    "slashes": (lambda name: name.replace("_", "/"), lambda name: f"{name}/joint"),
    "digits": (lambda name: f"1{name}", lambda name: f"2{name}"),
    "spaces": (lambda name: name.replace("_", " "), lambda name: name.replace("_", " ") + " joint"),
    "umlauts": (lambda name: f"Fuß_{name}", lambda name: f"Gelenk_{name}"),
    "quoted": (lambda name: f"{name}&<'>", lambda name: f"{name}: {{}}#"),
    "tasks": _renamed(left_foot="com", right_foot="posture", torso="base"),
    "colliding": _renamed(left_foot="a-b", right_foot="a_b", left_hand="a b", right_hand="a.b"),
    "worlds": _renamed(torso="world", left_foot="universe", link2="world"),
}


class RandomRobot:
    """Writes one robot; its URDF is `text`, and its meshes are in a folder."""

    def __init__(self, seed: int, folder: Path) -> None:
        """Write the robot of a seed."""
        self.rng, self._folder, self.parts = np.random.default_rng(seed), folder, []
        self.size = float(np.exp(self.rng.uniform(np.log(0.3), np.log(2.0))))  # as a share of a man's
        self._density = 60.0 * self.size**3 * self.rng.uniform(0.5, 1.5)
        self._strength = float(self.rng.choice([0.15, 0.5, 1.5], p=[0.15, 0.6, 0.25]))
        self._link_name, self._joint_name = _NAMES[str(self._chosen(list(_NAMES), plain=0.4))]
        self._turned = self.rng.random() < 0.3  # frames have axes of their own, as Denavit and Hartenberg's
        self._limits = str(self._chosen(["good", "absent", "none", "slow", "fast", "away", "narrow", "endless"], 0.6))
        self._clutter = self.rng.random() < 0.3
        self._axes: dict[str, np.ndarray] = {}  # by link, its axes in the robot's at zero
        kinds = {
            "biped": self._biped, "quadruped": self._quadruped, "arm": self._arm, "tree": self._tree,
            "arms": self._arms_on_a_post, "hexapod": self._hexapod, "monoped": self._monoped,
        }  # fmt: skip
        self.kind = str(self.rng.choice(list(kinds), p=[0.35, 0.25, 0.18, 0.08, 0.06, 0.05, 0.03]))
        kinds[self.kind]()
        self.text = f'<robot name="random">\n{"".join(self._mistaken())}</robot>\n'

    def _chosen(self, names: list[str], plain: float) -> str:
        """Choose the first one with a probability, and the others alike."""
        rest = (1.0 - plain) / (len(names) - 1)
        return str(self.rng.choice(names, p=[plain] + [rest] * (len(names) - 1)))

    def _maybe(self, probability: float) -> bool:
        return bool(self.rng.random() < probability)

    # Links and joints; positions are in the axes of the robot, which all links have at zero unless frames are turned.

    def link(self, name: str, share: float = 0.0, at=(0.0, 0.0, 0.0), shapes=(), turned: bool = True) -> None:
        """Add a link with a share of the robot's mass; `shapes` are (XML, position, roll-pitch-yaw or axes)."""
        turn = pin.exp3(self.rng.uniform(-2.0, 2.0, 3)) if self._turned and turned else np.eye(3)
        self._axes[name] = turn
        mass, inertial = self._density * share, ""
        if share:
            i = mass * (0.12 * self.size * share ** (1.0 / 3.0)) ** 2
            moments = (i * self.rng.uniform(0.8, 1.2, 3) * ([3.0, 1.0, 1.0] if self._maybe(0.02) else 1.0)).tolist()
            inertial = (
                f"<inertial>{_origin(turn.T @ np.array(at))}<mass value='{mass!r}'/><inertia ixx='{moments[0]!r}' "
                f"iyy='{moments[1]!r}' izz='{moments[2]!r}' ixy='0' ixz='0' iyz='0'/></inertial>"
            )
        elements = [
            f"<collision>{_origin(turn.T @ np.array(place), turn.T @ _turn(axes))}<geometry>{shape}</geometry>"
            "</collision>"
            for shape, place, axes in shapes
        ]
        if self._clutter and (elements or not share):
            elements.insert(0, str(self.rng.choice(_BAD_VISUALS)))
            elements.append(str(self.rng.choice(_BAD_VISUALS)))
        self.parts.append(f"<link name={quoteattr(self._link_name(name))}>{inertial}{''.join(elements)}</link>\n")

    def joint(self, name: str, parent: str, child: str, at=(0.0, 0.0, 0.0), axis=(0.0, 1.0, 0.0), kind="revolute",
              lower=-2.0, upper=2.0, effort=1.0, mimic="") -> None:  # fmt: skip
        """Add a joint above a link; `effort` is a share of weight times size."""
        above, own = self._axes[parent], self._axes[child]
        axis = own.T @ np.array(axis) * self.rng.choice([1.0, 2.0])
        if kind != "fixed" and self._maybe(0.2):
            axis, lower, upper = -axis, -upper, -lower
        limit, kind = self._limit(kind, lower, upper, effort)
        self.parts.append(
            f"<joint name={quoteattr(self._joint_name(name))} type='{kind}'>"
            f"{_origin(above.T @ np.array(at), above.T @ own)}"
            f"<parent link={quoteattr(self._link_name(parent))}/><child link={quoteattr(self._link_name(child))}/>"
            f"<axis xyz='{_numbers(axis)}'/>{limit if kind not in ('fixed', 'floating') else ''}{mimic}</joint>\n"
        )

    def _limit(self, kind: str, lower: float, upper: float, effort: float) -> tuple[str, str]:
        """Return a ``<limit>``, and the type of the joint."""
        most = self._density * GRAVITY * (self.size if kind != "prismatic" else 1.0)
        effort, velocity = max(self._strength * effort * most, 1.0e-3), self.rng.uniform(4.0, 25.0)
        if kind == "prismatic":
            velocity = self.rng.uniform(0.2, 2.0)
        odd = self._maybe(0.3)  # of the joints of a robot whose limits are not good
        if self._limits == "absent":
            return ("", kind) if odd else (f"<limit effort='{effort!r}' lower='{lower!r}' upper='{upper!r}'/>", kind)
        if odd and self._limits == "none":
            effort = 0.0
        if odd and self._limits == "slow":
            velocity = 0.0
        if odd and self._limits == "fast":
            velocity, effort = 1.0e4, 1.0e4 * most
        if odd and self._limits == "away":
            lower = 0.3 * upper
        if odd and self._limits == "narrow":
            middle = 0.5 * (lower + upper)
            lower, upper = middle - 0.015, middle + 0.015
        if odd and self._limits == "endless" and kind == "revolute":
            kind = "continuous"
        return f"<limit effort='{effort!r}' velocity='{velocity!r}' lower='{lower!r}' upper='{upper!r}'/>", kind

    # Bases.

    def _base(self, name: str, share: float, shapes) -> None:
        """Add the trunk with something above it: nothing, a frame, the world, or virtual joints."""
        above = str(self._chosen(["nothing", "frame", "bolted", "floating", "six", "footprint"], 0.6))
        self.link(name, share, (0.0, 0.0, 0.05 * self.size), shapes, turned=False)
        if above in ("frame", "footprint"):
            self.link("base_frame", turned=False)
            at = (0.0, 0.0, 0.3 * self.size if above == "footprint" else 0.0)
            self.joint("base_frame_fixed", "base_frame", name, at, kind="fixed")
        elif above in ("bolted", "floating"):
            self._axes["world"] = np.eye(3)
            self.parts.append("<link name='world'/>\n")
            kind = "fixed" if above == "bolted" else "floating"
            child = quoteattr(self._link_name(name))
            self.parts.append(
                f"<joint name='rooted' type='{kind}'><parent link='world'/><child link={child}/></joint>\n"
            )
        elif above == "six":
            links = [f"virtual{i}" for i in range(6)] + [name]
            for link in links[:6]:
                self.link(link, turned=False)
            for i, (upper, lower) in enumerate(itertools.pairwise(links)):
                self.joint(f"virtual{i}_joint", upper, lower, axis=np.eye(3)[i % 3], lower=-100.0, upper=100.0,
                           kind="prismatic" if i < 3 else "continuous")  # fmt: skip

    # Robots.

    def _biped(self) -> None:
        s, waist, arms = self.size, self._maybe(0.3), self._maybe(0.5)
        self._base("torso", 0.4, [(_box(0.15 * s, 0.25 * s, 0.35 * s), (0.0, 0.0, 0.15 * s), None)])
        hip = "torso"
        if waist:
            self.link("pelvis", 0.08)
            self.joint("waist", "torso", "pelvis", (0.0, 0.0, -0.05 * s), (0.0, 0.0, 1.0), lower=-1.5, upper=1.5)
            hip = "pelvis"
        joints, length = int(self.rng.integers(4, 7)), self.rng.uniform(0.25, 0.42) * s
        sole = self._sole(0.12 * s, 0.055 * s)
        bend = 1.0 if self._maybe(0.85) else -1.0
        for side, y in (("left", 0.1 * s), ("right", -0.1 * s)):
            self._leg(side, hip, y, joints, length, bend, sole)
        if arms:
            joints = int(self.rng.integers(2, 8))
            for side, y in (("left", 0.2 * s), ("right", -0.2 * s)):
                self._chain(side, "torso", (0.0, y, 0.3 * s), joints, 0.5 * s / joints, 0.06, "hand", down=True)
        if self._maybe(0.3):
            self.link("head", 0.04)
            self.joint("neck", "torso", "head", (0.0, 0.0, 0.4 * s), (0.0, 0.0, 1.0), lower=-1.0, upper=1.0, effort=0.1)

    def _leg(self, side, hip, y, joints, length, bend, sole) -> None:
        """Add a leg of four to six joints; with fewer, yaw and the ankle's roll are absent."""
        parts = ("yaw", "hip", "thigh", "shank", "ankle", "foot")
        yaw, hip_roll, thigh, shank, ankle, foot = (f"{side}_{part}" for part in parts)
        at, above, s = (0.0, y, -0.08 * self.size), hip, self.size
        if joints == 6:
            self.link(yaw, 0.01)
            self.joint(yaw, above, yaw, at, (0.0, 0.0, 1.0), lower=-1.0, upper=1.0)
            above, at = yaw, (0.0, 0.0, 0.0)
        self.link(hip_roll, 0.02)
        self.joint(hip_roll, above, hip_roll, at, (1.0, 0.0, 0.0), lower=-0.6, upper=0.6)
        self.link(thigh, 0.09, (0.0, 0.0, -0.5 * length))
        self.joint(thigh, hip_roll, thigh, lower=-2.0, upper=2.0)
        self.link(shank, 0.06, (0.0, 0.0, -0.5 * length))
        low, high = sorted((0.0, 2.3 * bend))
        self.joint(shank, thigh, shank, (0.0, 0.0, -length), lower=low, upper=high)
        if joints == 4:
            self.link(foot, 0.03, (0.03 * s, 0.0, -0.03 * s), sole)
            self.joint(foot, shank, foot, (0.0, 0.0, -length), lower=-1.0, upper=1.0)
            return
        self.link(ankle, 0.01)
        self.joint(ankle, shank, ankle, (0.0, 0.0, -length), lower=-self.rng.uniform(0.4, 1.2), upper=1.0)
        self.link(foot, 0.03, (0.03 * s, 0.0, -0.03 * s), sole)
        self.joint(foot, ankle, foot, axis=(1.0, 0.0, 0.0), lower=-0.5, upper=0.5)

    def _sole(self, half_length, half_width):
        """Return the shapes of a foot."""
        s = self.size
        at = (0.03 * s, 0.0, -0.04 * s)
        kind = self._chosen(["box", "mesh", "rolls", "points", "none", "ball", "flat", "two"], 0.4)
        box = (_box(2.0 * half_length, 2.0 * half_width, 0.03 * s), at, None)
        if kind == "mesh":
            return [(self._mesh(half_length, half_width, 0.03 * s), at, None)]
        if kind == "rolls":  # capsules along the sole
            roll = f"<capsule radius='{0.02 * s!r}' length='{2.0 * half_length!r}'/>"
            return [(roll, (at[0], side * half_width, at[2]), (0.0, np.pi / 2.0, 0.0)) for side in (1.0, -1.0)]
        if kind == "points":
            points = [(half_length * x, half_width * y) for x in (1, -1) for y in (1, -1)]
            radius = float(self.rng.choice([0.0, 0.004]))
            return [box] * self._maybe(0.5) + [
                (f"<sphere radius='{radius}'/>", (at[0] + x, y, at[2] - 0.015 * s), None) for x, y in points
            ]
        if kind == "ball":
            return [(f"<sphere radius='{0.03 * s!r}'/>", (0.0, 0.0, -0.03 * s), None)]
        if kind == "flat":
            return [(_box(2.0 * half_length, 2.0 * half_width, 0.0), at, None)]
        if kind == "two":  # heel and toe
            return [(_box(0.5 * half_length, 2.0 * half_width, 0.03 * s), (at[0] + x, 0.0, at[2]), None)
                    for x in (0.7 * half_length, -0.7 * half_length)]  # fmt: skip
        return [] if kind == "none" else [box]

    def _mesh(self, half_length, half_width, height) -> str:
        """Write a prism as a mesh, one corner of which may be on an edge."""
        outline = [(half_length * x, half_width * y) for x, y in _OUTLINE]
        if self._maybe(0.5):
            outline.insert(3, (-0.1 * half_length, half_width * (1.0 + self.rng.choice([0.0, 2.0e-4]))))
        n = len(outline)
        lines = [f"v {x} {y} {z}\n" for z in (-0.5 * height, 0.5 * height) for x, y in outline]
        lines += [f"f {n} " + " ".join(str(i) for i in range(n - 1, 0, -1)) + "\n"]
        lines += ["f " + " ".join(str(n + i + 1) for i in range(n)) + "\n"]
        lines += [f"f {i + 1} {(i + 1) % n + 1} {n + (i + 1) % n + 1} {n + i + 1}\n" for i in range(n)]
        (self._folder / "sole.obj").write_text("".join(lines), encoding="utf-8")
        return "<mesh filename='sole.obj'/>"

    def _quadruped(self, sides=((0.3, 0.15), (0.3, -0.15), (-0.3, 0.15), (-0.3, -0.15))) -> None:
        s = self.size
        self._base("torso", 0.5, [(_box(0.6 * s, 0.2 * s, 0.12 * s), (0.0, 0.0, 0.0), None)])
        names = ("left", "right", "rear_left", "rear_right", "mid_left", "mid_right")
        foot = self._chosen(["ball", "wheel", "none", "tip", "sole"], 0.6)
        abduct, length, ankles = self._maybe(0.8), self.rng.uniform(0.2, 0.35) * s, self._maybe(0.1)
        fixed, coupled = self._maybe(0.5), self._maybe(0.1)
        outward = self._maybe(0.5)
        for name, (x, y) in zip(names, sides, strict=False):
            above, at = "torso", (x * s, y * s, 0.0)
            if abduct:
                self.link(f"{name}_hip", 0.02)
                self.joint(f"{name}_hip", above, f"{name}_hip", at, (1.0, 0.0, 0.0), lower=-0.8, upper=0.8, effort=0.5)
                above, at = f"{name}_hip", (0.0, 0.03 * s * np.sign(y), 0.0)
            bend = 1.0 if outward and x > 0.0 else -1.0
            low, high = sorted((0.1 * bend, 2.6 * bend))
            self.link(f"{name}_thigh", 0.04, (0.0, 0.0, -0.5 * length))
            self.joint(f"{name}_thigh", above, f"{name}_thigh", at, lower=-2.0, upper=2.0, effort=0.5)
            shank = f"{name}_shank" if fixed or foot == "wheel" else f"{name}_foot"
            ball = {
                "ball": [(f"<sphere radius='{0.025 * s!r}'/>", (0.0, 0.0, 0.0), None)],
                "wheel": [(f"<cylinder radius='{0.08 * s!r}' length='{0.04 * s!r}'/>", (0.0, 0.0, 0.0),
                           (np.pi / 2.0, 0.0, 0.0))],
                "tip": [(f"<cylinder radius='{0.02 * s!r}' length='{0.05 * s!r}'/>", (0.0, 0.0, 0.025 * s), None)],
                "sole": [(_box(0.1 * s, 0.08 * s, 0.02 * s), (0.0, 0.0, 0.0), None)],
            }.get(foot, [])  # fmt: skip
            end = [(shape, (p[0], p[1], p[2] - length), turn) for shape, p, turn in ball]
            self.link(shank, 0.03, (0.0, 0.0, -0.5 * length), [] if shank.endswith("shank") else end)
            self.joint(f"{name}_knee", f"{name}_thigh", shank, (0.0, 0.0, -length), lower=low, upper=high, effort=0.5)
            if shank.endswith("shank"):
                kind = "continuous" if foot == "wheel" else "revolute" if ankles else "fixed"
                mimic = ""
                if coupled and kind == "revolute":
                    knee = quoteattr(self._joint_name(f"{name}_knee"))
                    mimic = f"<mimic joint={knee} multiplier='-0.5' offset='0.1'/>"
                self.link(f"{name}_foot", 0.012, shapes=ball)
                self.joint(f"{name}_foot", shank, f"{name}_foot", (0.0, 0.0, -length), kind=kind, effort=0.2,
                           mimic=mimic)  # fmt: skip

    def _hexapod(self) -> None:
        self._quadruped(((0.3, 0.2), (0.3, -0.2), (-0.3, 0.2), (-0.3, -0.2), (0.0, 0.25), (0.0, -0.25)))

    def _monoped(self) -> None:
        self._base("torso", 0.7, [])
        self._leg("left", "torso", 0.0, 6, 0.3 * self.size, 1.0, self._sole(0.15 * self.size, 0.1 * self.size))

    def _chain(self, side, above, at, joints, step, share, end, *, down=False) -> str:
        """Add an arm, with a gripper or not; return its last link."""
        axes = [(0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 1.0, 0.0)]
        way = -1.0 if down else 1.0
        for i in range(joints):
            name = f"{side}_{end}" if i == joints - 1 else f"{side}_arm{i}"
            kind = "prismatic" if self._maybe(0.05) else "revolute"
            low, high = (-0.3 * self.size, 0.3 * self.size) if kind == "prismatic" else (-2.4, 2.4)
            self.link(name, share / joints, (0.0, 0.0, 0.5 * way * step))
            self.joint(name, above, name, at, axes[i % 4], kind, low, high, effort=0.4)
            above, at = name, (0.0, 0.0, way * step)
        if self._maybe(0.5):
            self._gripper(side, above, at, share)
        return above

    def _gripper(self, side, above, at, share) -> None:
        """Add two or three fingers: heavy or light ones, which slide or turn, of their own or coupled."""
        heavy, slides, coupled = self._maybe(0.4), self._maybe(0.5), self._maybe(0.6)
        names = [f"{side}_finger{i}" for i in range(int(self.rng.integers(1, 4)))]
        mass = (0.4 if heavy else 0.02) * share / len(names)
        for i, name in enumerate(names):
            mimic = ""
            if i and coupled:
                leader = quoteattr(self._joint_name(names[0]))
                mimic = f"<mimic joint={leader} multiplier='{self.rng.choice([1.0, -1.0, 0.5])}'/>"
            self.link(name, mass, (0.0, 0.0, 0.02 * self.size))
            kind, low, high = ("prismatic", 0.0, 0.04 * self.size) if slides else ("revolute", -0.1, 0.8)
            self.joint(name, above, name, at, (0.0, 1.0, 0.0), kind, low, high, effort=0.05, mimic=mimic)

    def _arm(self) -> None:
        root = str(self.rng.choice(["base", "world"]))
        self.link(root, 0.0 if root == "world" else float(self.rng.choice([0.0, 0.3])), turned=False)
        joints = int(self.rng.integers(1, 8))
        self._chain("tool", root, (0.0, 0.0, 0.1), joints, 0.8 * self.size / joints, 0.5, "hand")

    def _arms_on_a_post(self) -> None:
        self._base("torso", 0.5, [(_box(0.2, 0.4, 0.5), (0.0, 0.0, 0.0), None)])
        for side, y in (("left", 0.25), ("right", -0.25)):
            self._chain(side, "torso", (0.0, y, 0.2), int(self.rng.integers(3, 8)), 0.1 * self.size, 0.2, "hand")

    def _tree(self) -> None:
        self.link("link0", float(self.rng.choice([0.0, 0.3])), turned=False)
        types = ["revolute", "revolute", "revolute", "continuous", "prismatic", "fixed", "planar", "floating"]
        for i in range(1, int(self.rng.integers(3, 12))):
            kind = str(self.rng.choice(types, p=[0.25, 0.25, 0.2, 0.1, 0.1, 0.06, 0.02, 0.02]))
            shapes = [(f"<sphere radius='{0.05 * self.size!r}'/>", (0.0, 0.0, 0.0), None)] * self._maybe(0.5)
            self.link(f"link{i}", 0.1 * float(self.rng.choice([1.0, 0.1, 0.0], p=[0.85, 0.1, 0.05])), shapes=shapes)
            at, axis = 0.3 * self.size * self.rng.uniform(-1.0, 1.0, 3), self.rng.normal(size=3)
            parent = f"link{self.rng.integers(max(0, i - 3), i)}"
            mimic = ""
            if i > 2 and kind == "revolute" and self._maybe(0.15):
                mimic = f"<mimic joint={quoteattr(self._joint_name('link1'))} multiplier='0.7'/>"
            self.joint(f"link{i}", parent, f"link{i}", at, axis, kind, -1.2, 1.5, mimic=mimic)

    def _mistaken(self) -> list[str]:
        """Return the parts, shuffled as the order of a URDF is free, and rarely with a mistake."""
        parts = list(self.parts)
        if self._maybe(0.2):
            self.rng.shuffle(parts)
        if self._maybe(0.06):
            index = int(self.rng.integers(len(parts)))
            mistake = int(self.rng.integers(3))
            if mistake == 0:
                parts.append(parts[index])  # a second link or joint of one name
            elif mistake == 1:
                del parts[index]
            else:
                parts[index] = parts[index].replace("xyz='", "xyz='x", 1)
        return parts


def _turn(axes) -> np.ndarray:
    return np.eye(3) if axes is None else pin.rpy.rpyToMatrix(np.array(axes, dtype=float))


def _origin(at: np.ndarray, turn: np.ndarray | None = None) -> str:
    rpy = "" if turn is None else f" rpy='{_numbers(pin.rpy.matrixToRpy(turn))}'"
    return f"<origin xyz='{_numbers(at)}'{rpy}/>"


def _numbers(values: np.ndarray) -> str:
    return " ".join(repr(float(value)) for value in values)


def _box(*sides: float) -> str:
    return f"<box size='{_numbers(np.array(sides))}'/>"
