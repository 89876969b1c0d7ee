"""The PlayTable scene as a robosuite environment: a deck with three blocks, a drawer, a slider, a button and a lever.

    Seen from above. The robot stands at x = -0.56 and looks along +x: y > 0 is its left. The front camera looks
    back at it. The deck's top is at z = TABLE_Z; beyond its left edge the table is DEPTH lower.

         y   +0.38          o==========o         the drawer, open: it slides out from under the deck along +y,
                            |   tray   |         pulled by the post on its front; what is pushed over the
             +0.20  ===========================  edge falls into it
                    |  bay  |
             +0.12  |       |   +---------+
                    +-------+   |  free   |  * bulb
    robot ->        |slider |   |  for    |
                    |   o   |   |  blocks |  * led
             -0.18  +-------+   +---------+
                                                 the slider is a roof over one half of the bay; it runs along y
             -0.31        lever(     O button    on the rail behind, pulled by its post

               x = -0.25   -0.1  0.0     0.15

The lever is a weighted rod that falls to either side (along y); beyond its middle, to the left, the bulb is on.
"""

import xml.etree.ElementTree as ElementTree
from typing import Any

import numpy as np
from robosuite.environments.manipulation.manipulation_env import ManipulationEnv
from robosuite.models.arenas import TableArena
from robosuite.models.objects import BoxObject
from robosuite.models.tasks import ManipulationTask

TABLE_Z = 0.8
DEPTH = 0.075  # meters from the deck's top down to the table
TABLE_SIZE = (0.66, 0.94, 0.05)
EDGE_Y = 0.20  # where the deck ends
DECK_THICK = 0.010
BLOCKS = {
    "red": (0.85, 0.12, 0.12, 1.0),
    "blue": (0.12, 0.25, 0.85, 1.0),
    "pink": (0.90, 0.15, 0.60, 1.0),
}
BLOCK_HALF = (0.035, 0.02, 0.02)

DRAWER_TRAVEL = 0.17
TRAY_X = 0.03
TRAY_HALF = (0.09, 0.087)
TRAY_Y = EDGE_Y - TRAY_HALF[1] + 0.004  # of the closed tray's center; it moves along +y by the opening
TRAY_FLOOR = TABLE_Z - 0.055
TRAY_RIM = TABLE_Z - 0.035  # low, so that fingers pass over it; and below the deck, under which it slides
DRAWER_POST_XY = (TRAY_X, EDGE_Y + 0.019)  # of the closed drawer
DRAWER_POST_TOP = TABLE_Z + 0.055

BAY_CENTER = (-0.17, 0.0)
BAY_HALF = (0.065, 0.14)
SLIDER_HALF = (0.065, 0.05)
SLIDER_TRAVEL = 0.18  # its center runs from y = -0.09 to 0.09
SLIDER_Y = BAY_CENTER[1] - SLIDER_TRAVEL / 2  # at position 0
SLIDER_ROOF = TABLE_Z + 0.047  # its underside: a lying block passes under it
SLIDER_POST_TOP = TABLE_Z + 0.10
RAIL_X = -0.27
POST_RADIUS = 0.012

BUTTON_XY = (0.08, -0.30)
BUTTON_TOP = TABLE_Z + 0.040
BUTTON_TRAVEL = 0.012
LED_XY, LED_GEOM = (0.255, -0.12), "playtable_led"

LEVER_XY = (-0.07, -0.31)
LEVER_PIVOT = TABLE_Z + 0.015
LEVER_LENGTH = 0.065  # meters from the pivot to the knob's center
LEVER_RANGE = 0.45  # rad to either side of upright
BULB_XY, BULB_GEOM = (0.255, 0.09), "playtable_bulb"

FRONT_CAMERA = {"pos": "0.86 0.0 1.70", "xyaxes": "0 1 0 -0.71 0 0.71", "fovy": "29"}
WRIST_CAMERA = {"pos": "0 0.075 0.0", "xyaxes": "1 0 0 0 -1 -0.30", "fovy": "70"}

_VISUAL = 'contype="0" conaffinity="0" group="1" mass="0"'
# Fixtures touch the robot and the blocks (which ask for bit 1), never each other.
_SOLID = 'contype="1" conaffinity="0" group="0" friction="1 0.005 0.0001"'
_WOOD, _DARK, _STEEL = "0.62 0.45 0.28 1", "0.45 0.31 0.18 1", "0.75 0.75 0.78 1"
_TOP = "0.86 0.84 0.80 1"


def _geom(name: str, shape: str, size: tuple[float, ...], pos: tuple[float, ...], rgba: str, mass: float) -> str:
    """A geom to be touched, and the same to be looked at."""
    form = f'type="{shape}" size="{" ".join(map(str, size))}" pos="{" ".join(map(str, pos))}"'
    return (
        f'<geom name="{name}" {form} {_SOLID} mass="{mass}"/>'
        f'<geom name="{name}_visual" {form} rgba="{rgba}" {_VISUAL}/>'
    )


def _box(name: str, half: tuple[float, ...], pos: tuple[float, ...], rgba: str, mass: float = 0.05) -> str:
    return _geom(name, "box", half, pos, rgba, mass)


def _seen(name: str, half: tuple[float, ...], pos: tuple[float, ...], rgba: str) -> str:
    """A box that is only looked at."""
    size, where = " ".join(map(str, half)), " ".join(map(str, pos))
    return f'<geom name="{name}" type="box" size="{size}" pos="{where}" rgba="{rgba}" {_VISUAL}/>'


def _post(name: str, low: float, high: float, xy: tuple[float, float], base: float) -> str:
    """A post to be gripped from above, from z = low to high, in a body that stands at z = base."""
    form = f'type="cylinder" size="{POST_RADIUS} {(high - low) / 2}" pos="{xy[0]} {xy[1]} {(high + low) / 2 - base}"'
    return (
        f'<geom name="{name}" {form} contype="1" conaffinity="0" group="0" friction="1.5 0.05 0.001" condim="4"'
        f' mass="0.05"/><geom name="{name}_visual" {form} rgba="{_STEEL}" {_VISUAL}/>'
    )


def _deck() -> str:
    hx, low = TABLE_SIZE[0] / 2, -TABLE_SIZE[1] / 2
    y, hy = (low + EDGE_Y) / 2, (EDGE_Y - low) / 2
    skirt = (DEPTH - DECK_THICK) / 2
    z = TABLE_Z - DECK_THICK - skirt
    far, near = hx - TRAY_X - TRAY_HALF[0] - 0.006, hx + TRAY_X - TRAY_HALF[0] - 0.006  # beside the drawer
    return f"""
    <body name="deck" pos="0 0 0">
      {_box("deck_top", (hx, hy, DECK_THICK / 2), (0, y, TABLE_Z - DECK_THICK / 2), _TOP, 1.0)}
      {_seen("deck_front", (0.004, hy, skirt), (hx - 0.004, y, z), _DARK)}
      {_seen("deck_far", (far / 2, 0.004, skirt), (hx - far / 2, EDGE_Y - 0.004, z), _DARK)}
      {_seen("deck_near", (near / 2, 0.004, skirt), (near / 2 - hx, EDGE_Y - 0.004, z), _DARK)}
      {_seen("bay_floor", (*BAY_HALF, 0.0005), (*BAY_CENTER, TABLE_Z), "0.55 0.62 0.66 1")}
    </body>"""


def _drawer() -> str:
    hx, hy = TRAY_HALF
    rim = (TRAY_RIM - TRAY_FLOOR) / 2 + 0.003
    mid = TRAY_FLOOR - 0.006 + rim
    parts = (
        _box("tray_floor", (hx, hy, 0.003), (0, 0, TRAY_FLOOR - 0.003), _WOOD, 0.1),
        _box("tray_right", (0.004, hy, rim), (hx, 0, mid), _WOOD),
        _box("tray_left", (0.004, hy, rim), (-hx, 0, mid), _WOOD),
        _box("tray_back", (hx, 0.004, rim), (0, -hy, mid), _WOOD),
        _box("tray_front", (hx + 0.004, 0.004, rim), (0, hy, mid), _WOOD),
        _post("tray_post", TRAY_FLOOR, DRAWER_POST_TOP, (0.0, DRAWER_POST_XY[1] - TRAY_Y), 0.0),
    )
    return f"""
    <body name="drawer" pos="{TRAY_X} {TRAY_Y} 0">
      <joint name="drawer_slide" type="slide" axis="0 1 0" range="0 {DRAWER_TRAVEL}" limited="true"
             damping="8" frictionloss="1.5" armature="0.05"/>
      {"".join(parts)}
    </body>"""


def _slider() -> str:
    hx, hy = SLIDER_HALF
    x, y = BAY_CENTER
    rail = (SLIDER_ROOF - TABLE_Z) / 2
    reach = (hx + x - RAIL_X) / 2  # the roof reaches from its front edge back to the rail
    return f"""
    <body name="rail" pos="0 0 0">
      {_box("slider_rail", (0.005, BAY_HALF[1], rail), (RAIL_X, y, TABLE_Z + rail), _DARK)}
      <body name="slider" pos="{x} {SLIDER_Y} {SLIDER_ROOF}">
        <joint name="slider_slide" type="slide" axis="0 1 0" range="0 {SLIDER_TRAVEL}" limited="true"
               damping="8" frictionloss="1.5" armature="0.05"/>
        {_box("slider_roof", (reach, hy, 0.004), (hx - reach, 0, 0.004), _WOOD, 0.1)}
        {_post("slider_post", SLIDER_ROOF, SLIDER_POST_TOP, (0.0, 0.0), SLIDER_ROOF)}
      </body>
    </body>"""


def _button() -> str:
    x, y = BUTTON_XY
    base = BUTTON_TOP - TABLE_Z - BUTTON_TRAVEL - 0.016
    cap = 'type="cylinder" size="0.024 0.007" pos="0 0 -0.007"'
    return f"""
    <body name="button_base" pos="{x} {y} {TABLE_Z}">
      {_box("button_box", (0.036, 0.036, base / 2), (0, 0, base / 2), "0.25 0.25 0.28 1")}
      <body name="button" pos="0 0 {BUTTON_TOP - TABLE_Z}">
        <joint name="button_press" type="slide" axis="0 0 -1" range="0 {BUTTON_TRAVEL}" limited="true"
               stiffness="120" springref="-0.004" damping="4" armature="0.02"/>
        <geom name="button_cap" {cap} {_SOLID} mass="0.03"/>
        <geom name="button_cap_visual" {cap} rgba="0.1 0.7 0.25 1" {_VISUAL}/>
      </body>
    </body>"""


def _lever() -> str:
    """A heavy knob above its pivot: gravity makes it fall to either side, and stay there."""
    x, y = LEVER_XY
    rod = f'type="capsule" size="0.008" fromto="0 0 0 0 0 {LEVER_LENGTH}"'
    knob = f'type="sphere" size="0.015" pos="0 0 {LEVER_LENGTH}"'
    return f"""
    <body name="lever_base" pos="{x} {y} {TABLE_Z}">
      {_seen("lever_box", (0.020, 0.042, 0.006), (0, 0, 0.006), "0.25 0.25 0.28 1")}
      <body name="lever" pos="0 0 {LEVER_PIVOT - TABLE_Z}">
        <joint name="lever_hinge" type="hinge" axis="-1 0 0" range="-{LEVER_RANGE} {LEVER_RANGE}" limited="true"
               damping="0.01" frictionloss="0.006" armature="0.0005"/>
        <geom name="lever_rod" {rod} {_SOLID} mass="0.02"/>
        <geom name="lever_rod_visual" {rod} rgba="{_STEEL}" {_VISUAL}/>
        <geom name="lever_knob" {knob} {_SOLID} mass="0.25"/>
        <geom name="lever_knob_visual" {knob} rgba="0.95 0.55 0.10 1" {_VISUAL}/>
      </body>
    </body>"""


def _lamps() -> str:
    """Only looked at: they stand where neither gripper nor block comes."""
    (bx, by), (lx, ly) = BULB_XY, LED_XY
    return f"""
    <body name="lamps" pos="0 0 {TABLE_Z}">
      <geom name="bulb_foot" type="cylinder" size="0.016 0.010" pos="{bx} {by} 0.010" rgba="0.2 0.2 0.2 1" {_VISUAL}/>
      <geom name="{BULB_GEOM}" type="sphere" size="0.032" pos="{bx} {by} 0.045" rgba="0.3 0.3 0.25 1" {_VISUAL}/>
      {_seen("led_foot", (0.034, 0.034, 0.006), (lx, ly, 0.006), "0.2 0.2 0.2 1")}
      <geom name="{LED_GEOM}" type="cylinder" size="0.028 0.010" pos="{lx} {ly} 0.018" rgba="0.2 0.25 0.2 1" {_VISUAL}/>
    </body>"""


class PlayTable(ManipulationEnv):  # type: ignore[misc]
    """The scene as robosuite's own environment: `robosuite.make("PlayTable", robots="Panda")` works too.

    It has no reward: whether a goal is reached is decided by `playlearn.envs.playtable.env`.
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
        arena = TableArena(table_full_size=TABLE_SIZE, table_offset=(0, 0, TABLE_Z - DEPTH))
        arena.set_origin([0, 0, 0])
        for name in ("wall_left_visual", "wall_right_visual", "wall_rear_visual", "wall_front_visual"):
            arena.worldbody.remove(arena.worldbody.find(f"./geom[@name='{name}']"))
        arena.table_body.find("./geom[@name='table_visual']").attrib.pop("material")
        arena.table_body.find("./geom[@name='table_visual']").set("rgba", "0.70 0.68 0.64 1")
        for xml in (_deck(), _drawer(), _slider(), _button(), _lever(), _lamps()):
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
        # A full headlight beside robosuite's lamp bleaches the white table.
        ElementTree.SubElement(self.model.root.find("visual"), "headlight", {"diffuse": "0.25 0.25 0.25"})

    def _check_success(self) -> bool:
        return False


def tray_center(opening: float) -> np.ndarray[Any, Any]:
    """(2,) the x, y of the tray's center, in meters."""
    return np.array([TRAY_X, TRAY_Y + opening])


def slider_center(position: float) -> np.ndarray[Any, Any]:
    """(2,) the x, y of the slider's center, in meters."""
    return np.array([BAY_CENTER[0], SLIDER_Y + position])
