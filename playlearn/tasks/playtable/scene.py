"""The PlayTable scene as a robosuite environment: a table, three blocks, a drawer, a button and its lamp.

    robot at x = -0.56, looking along +x; the front camera looks back at it. Table top at z = TABLE_Z.

              y = +0.42  +-----------+
                         |  cabinet  |   the drawer slides out of it along -y,
                         +--=====o---+   pulled by the post `o` on its front
                            | tray |
     robot ->   x = -0.12 .. blocks .. x = +0.18
              y = -0.28     (button)   * lamp

Room is left for a sliding door along the far edge (x > 0.25) and a lever switch beside the lamp.
"""

import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.objects import BoxObject
from robosuite.models.tasks import ManipulationTask

TABLE_Z = 0.8
TABLE_SIZE = (0.66, 0.94, 0.05)
BLOCKS = {
    "red": (0.85, 0.12, 0.12, 1.0),
    "blue": (0.12, 0.25, 0.85, 1.0),
    "pink": (0.90, 0.15, 0.60, 1.0),
}
BLOCK_HALF = (0.035, 0.02, 0.02)
DRAWER_TRAVEL = 0.16
TRAY_CENTRE = (0.0, 0.347)  # of the closed tray; it moves along -y by the opening
TRAY_HALF = (0.09, 0.075)
TRAY_FLOOR = TABLE_Z + 0.008
POST_XY = (0.072, 0.258)  # of the closed drawer
POST_TOP = TABLE_Z + 0.10
POST_RADIUS = 0.012
BUTTON_XY = (0.02, -0.29)
BUTTON_TOP = TABLE_Z + 0.048
BUTTON_TRAVEL = 0.012
LAMP_XY = (0.14, -0.31)
LAMP_GEOM = "playtable_lamp_bulb"

FRONT_CAMERA = {"pos": "0.86 0.03 1.70", "xyaxes": "0 1 0 -0.71 0 0.71", "fovy": "29"}
WRIST_CAMERA = {"pos": "0 0.075 0.0", "xyaxes": "1 0 0 0 -1 -0.30", "fovy": "70"}

_VISUAL = 'contype="0" conaffinity="0" group="1" mass="0"'
_SOLID = 'group="0" friction="1 0.005 0.0001"'


def _box(name: str, half: tuple[float, ...], pos: tuple[float, ...], rgba: str, mass: float = 0.05) -> str:
    size, where = " ".join(map(str, half)), " ".join(map(str, pos))
    return (
        f'<geom name="{name}" type="box" size="{size}" pos="{where}" {_SOLID} mass="{mass}"/>'
        f'<geom name="{name}_visual" type="box" size="{size}" pos="{where}" rgba="{rgba}" {_VISUAL}/>'
    )


def _drawer() -> str:
    wood, dark, steel = "0.62 0.45 0.28 1", "0.45 0.31 0.18 1", "0.75 0.75 0.78 1"
    (x, y), (hx, hy) = TRAY_CENTRE, TRAY_HALF
    z = TABLE_Z
    cabinet = "".join(
        (
            _box("cabinet_left", (0.006, 0.09, 0.028), (x - hx - 0.018, y, z + 0.028), dark),
            _box("cabinet_right", (0.006, 0.09, 0.028), (x + hx + 0.018, y, z + 0.028), dark),
            _box("cabinet_back", (hx + 0.024, 0.006, 0.028), (x, y + 0.096, z + 0.028), dark),
            _box("cabinet_roof", (hx + 0.024, 0.089, 0.003), (x, y + 0.013, z + 0.059), dark),
        )
    )
    post_x, post_y = POST_XY[0] - x, POST_XY[1] - y
    height = (POST_TOP - TABLE_Z) / 2
    post_size, post_at = f"{POST_RADIUS} {height}", f"{post_x} {post_y} {height + 0.001}"
    tray = "".join(
        (
            _box("tray_floor", (hx, hy, 0.003), (0, 0, 0.005), wood, 0.1),
            _box("tray_left", (0.004, hy, 0.018), (-hx, 0, 0.020), wood),
            _box("tray_right", (0.004, hy, 0.018), (hx, 0, 0.020), wood),
            _box("tray_back", (hx, 0.004, 0.018), (0, hy, 0.020), wood),
            _box("tray_front", (hx + 0.004, 0.004, 0.022), (0, -hy, 0.024), wood),
            (
                f'<geom name="tray_post" type="cylinder" size="{post_size}" pos="{post_at}" group="0"'
                ' friction="1.5 0.05 0.001" condim="4" mass="0.05"/>'
                f'<geom name="tray_post_visual" type="cylinder" size="{post_size}" pos="{post_at}"'
                f' rgba="{steel}" {_VISUAL}/>'
            ),
        )
    )
    return f"""
    <body name="cabinet" pos="0 0 0">{cabinet}
      <body name="drawer" pos="{x} {y} {z}">
        <joint name="drawer_slide" type="slide" axis="0 -1 0" range="0 {DRAWER_TRAVEL}" limited="true"
               damping="8" frictionloss="1.5" armature="0.05"/>
        {tray}
      </body>
    </body>"""


def _button() -> str:
    x, y = BUTTON_XY
    base = BUTTON_TOP - TABLE_Z - BUTTON_TRAVEL - 0.016  # clear of the cap: it would collide with a fixed parent
    return f"""
    <body name="button_base" pos="{x} {y} {TABLE_Z}">
      {_box("button_box", (0.045, 0.04, base / 2), (0, 0, base / 2), "0.25 0.25 0.28 1")}
      <body name="button" pos="0 0 {BUTTON_TOP - TABLE_Z}">
        <joint name="button_press" type="slide" axis="0 0 -1" range="0 {BUTTON_TRAVEL}" limited="true"
               stiffness="120" springref="-0.004" damping="4" armature="0.02"/>
        <geom name="button_cap" type="cylinder" size="0.024 0.007" pos="0 0 -0.007" {_SOLID} mass="0.03"/>
        <geom name="button_cap_visual" type="cylinder" size="0.024 0.007" pos="0 0 -0.007"
              rgba="0.1 0.7 0.25 1" {_VISUAL}/>
      </body>
    </body>"""


def _lamp() -> str:
    x, y = LAMP_XY
    return f"""
    <body name="lamp" pos="{x} {y} {TABLE_Z}">
      <geom name="lamp_foot" type="cylinder" size="0.012 0.03" pos="0 0 0.03" {_SOLID} mass="0.2"/>
      <geom name="lamp_foot_visual" type="cylinder" size="0.012 0.03" pos="0 0 0.03" rgba="0.2 0.2 0.2 1" {_VISUAL}/>
      <geom name="{LAMP_GEOM}" type="sphere" size="0.034" pos="0 0 0.085" rgba="0.3 0.3 0.25 1" {_VISUAL}/>
    </body>"""


class PlayTable(ManipulationEnv):  # type: ignore[misc]
    """robosuite's own door to the scene: `robosuite.make("PlayTable", robots="Panda")` works too.

    It has no reward: reaching goals is judged by `playlearn.tasks.playtable.world`.
    """

    def __init__(self, robots: str = "Panda", **kwargs: Any) -> None:
        self.blocks: dict[str, BoxObject] = {}
        super().__init__(robots=robots, **kwargs)

    def reward(self, action: Any = None) -> float:
        return 0.0

    def _load_model(self) -> None:
        super()._load_model()
        robot = self.robots[0].robot_model
        robot.set_base_xpos(robot.base_xpos_offset["table"](0.8))
        arena = TableArena(table_full_size=TABLE_SIZE, table_offset=(0, 0, TABLE_Z))
        arena.set_origin([0, 0, 0])
        for name in ("wall_left_visual", "wall_right_visual", "wall_rear_visual", "wall_front_visual"):
            arena.worldbody.remove(arena.worldbody.find(f"./geom[@name='{name}']"))
        arena.table_body.find("./geom[@name='table_visual']").attrib.pop("material")
        arena.table_body.find("./geom[@name='table_visual']").set("rgba", "0.86 0.84 0.80 1")
        for xml in (_drawer(), _button(), _lamp()):
            arena.worldbody.append(ElementTree.fromstring(xml))
        ElementTree.SubElement(arena.worldbody, "camera", {"name": "front", "mode": "fixed", **FRONT_CAMERA})
        hand = robot.worldbody.find(".//body[@name='gripper0_right_right_gripper']")
        if hand is None:  # grippers of other robots: the body that carries the grip site
            hand = next(body for body in robot.worldbody.iter("body") if "gripper" in body.get("name", ""))
        ElementTree.SubElement(hand, "camera", {"name": "wrist", "mode": "fixed", **WRIST_CAMERA})
        self.blocks = {
            name: BoxObject(
                name=name, size=BLOCK_HALF, rgba=rgba, density=400, friction=(1.2, 0.02, 0.001), solref=(0.01, 1.0)
            )
            for name, rgba in BLOCKS.items()
        }
        self.model = ManipulationTask(
            mujoco_arena=arena,
            mujoco_robots=[self.robots[0].robot_model],
            mujoco_objects=list(self.blocks.values()),
        )

    def _check_success(self) -> bool:
        return False


def tray_centre(opening: float) -> np.ndarray[Any, Any]:
    """(2,) the x, y of the tray's centre, in metres."""
    return np.array([TRAY_CENTRE[0], TRAY_CENTRE[1] - opening])
