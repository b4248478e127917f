"""Where the cameras of the four kinds of captures stand, and what is written of them.

The object is in the unit ball around the origin, z points up. Poses map the camera's frame (OpenGL axes: x right, y up,
z backward) to the object's.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT = 640, 480
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Between the axes of OpenGL's cameras and those of OpenCV's."""
FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Half a turn about x. An object whose box is centred stands on the same floor afterwards."""

Pose = Float64[np.ndarray, "4 4"]
Point = Float64[np.ndarray, " 3"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Shot:
    """One photograph."""

    pose: Pose
    turn: float = 0.0
    """Radians by which the object, and the camera's pose with it, has been turned about z in the room."""
    flipped: bool = False
    """Whether the object stands on its head in the room."""

    @property
    def stand(self) -> Pose:
        """From the object's frame to the room's."""
        return turned(self.turn) @ FLIP if self.flipped else turned(self.turn)


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """All photographs of a capture, through one lens that looks at the middle of the image."""

    focal: float
    """Pixels."""
    shots: tuple[Shot, ...]
    region: tuple[Point, float] | None = None
    """Middle and radius of the ball that is meant to be looked at; None: all of the object."""


def looking(place: Point, target: Point, roll: float = 0.0) -> Pose:
    """The pose of a camera at ``place`` with ``target`` in the middle of its image; ``roll`` in radians."""
    back = place - target
    back = back / np.linalg.norm(back)
    right = np.cross([0, 0, 1], back)
    right = right / np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1) @ Rotation.from_euler("z", roll).as_matrix()
    pose[:3, 3] = place
    return pose


def around(distance: float, azimuth: float, elevation: float) -> Point:
    """On a sphere around the origin; angles in degrees, azimuth 0 is in front of the object, at -y."""
    turn, rise = math.radians(azimuth - 90), math.radians(elevation)
    return distance * np.array([math.cos(turn) * math.cos(rise), math.sin(turn) * math.cos(rise), math.sin(rise)])


def lab() -> Rig:
    """An arm with a camera, 7 x 7 places on a part of a sphere, near enough for the borders to cut the object."""
    chance = np.random.default_rng(11)
    region = (np.array([0.0, -0.1, 0.05]), 0.75)
    shots = []
    for row, elevation in enumerate(np.linspace(62, 8, 7)):
        azimuths = np.linspace(-46, 46, 7)
        # The arm goes back and forth.
        for azimuth in azimuths if row % 2 == 0 else azimuths[::-1]:
            place = region[0] + around(2.9 * region[1], azimuth + chance.normal(0, 1), elevation + chance.normal(0, 1))
            shots.append(Shot(pose=looking(place, region[0] + chance.normal(0, 0.07, 3))))
    return Rig(focal=1100.0, shots=tuple(shots), region=region)


def phone() -> Rig:
    """Two rings and some from above, held by hand."""
    chance = np.random.default_rng(12)
    shots = []
    for count, elevation, distance in ((20, 16, 2.7), (16, 40, 2.6), (6, 68, 2.5)):
        for i in range(count):
            azimuth, rise = 360 * i / count + chance.normal(0, 4), elevation + chance.normal(0, 3)
            place = around(distance * chance.uniform(0.9, 1.12), azimuth, rise)
            shots.append(Shot(pose=looking(place, chance.normal(0, 0.06, 3), chance.normal(0, 0.05))))
    return Rig(focal=545.0, shots=tuple(shots))


def turntable() -> Rig:
    """Two cameras that stand still, before an object that is turned thirty times."""
    shots = []
    for elevation, distance in ((14, 3.4), (42, 3.3)):
        still = looking(around(distance, 0, elevation), np.zeros(3))
        for i in range(30):
            turn = 2 * math.pi * i / 30
            shots.append(Shot(pose=turned(-turn) @ still, turn=turn))
    return Rig(focal=760.0, shots=tuple(shots))


def twice() -> Rig:
    """A turntable with cameras 26 degrees apart in height, and all of it again with the object on its head."""
    shots = []
    for flipped in (False, True):
        for elevation, count in ((10, 24), (36, 18)):
            still = looking(around(3.3, 0, elevation), np.zeros(3))
            for i in range(count):
                shot = Shot(pose=still, turn=2 * math.pi * i / count, flipped=flipped)
                shots.append(replace(shot, pose=np.linalg.inv(shot.stand) @ still))
    return Rig(focal=760.0, shots=tuple(shots))


def museum() -> Rig:
    """Two rings around a showcase."""
    chance = np.random.default_rng(13)
    shots = []
    for count, elevation in ((26, 12), (20, 36)):
        for i in range(count):
            place = around(3.1 + chance.normal(0, 0.08), 360 * i / count + chance.normal(0, 1.5), elevation)
            shots.append(Shot(pose=looking(place, chance.normal(0, 0.03, 3))))
    return Rig(focal=700.0, shots=tuple(shots))


def forest() -> Rig:
    """By hand, from one side, too near for all of a tree."""
    chance = np.random.default_rng(14)
    shots = []
    for count, elevation, distance in ((9, -6, 1.9), (8, 10, 1.75), (6, 27, 1.9)):
        for azimuth in np.linspace(-58, 58, count):
            place = around(distance * chance.uniform(0.88, 1.1), azimuth + chance.normal(0, 4), elevation)
            target = np.array([0, -0.2, 0.02]) + chance.normal(0, 0.06, 3)
            shots.append(Shot(pose=looking(place, target, chance.normal(0, 0.05))))
    return Rig(focal=560.0, shots=tuple(shots))


def shelf() -> Rig:
    """By hand, in three bows from one side to the other."""
    chance = np.random.default_rng(15)
    shots = []
    for count, elevation, distance in ((15, 4, 2.4), (15, 20, 2.3), (10, 40, 2.3)):
        for azimuth in np.linspace(-70, 70, count):
            place = around(distance * chance.uniform(0.9, 1.1), azimuth + chance.normal(0, 3), elevation)
            shots.append(Shot(pose=looking(place, chance.normal(0, 0.05, 3), chance.normal(0, 0.05))))
    return Rig(focal=560.0, shots=tuple(shots))


def turned(angle: float) -> Pose:
    """About z, in radians."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", angle).as_matrix()
    return pose


def as_if_found(rig: Rig, error: float, seed: int) -> Rig:
    """Poses as structure from motion finds them: points near the object are off by ``error`` pixels, root mean square.

    Half of the square comes of turning the camera, half of moving it.
    """
    chance = np.random.default_rng(seed)
    angle = 0.5 * error / rig.focal
    shots = []
    for shot in rig.shots:
        pose = shot.pose.copy()
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_rotvec(chance.normal(0, angle, 3)).as_matrix()
        pose[:3, 3] += chance.normal(0, angle * np.linalg.norm(pose[:3, 3]), 3)
        shots.append(replace(shot, pose=pose))
    return replace(rig, shots=tuple(shots))


def projected(points: Float64[np.ndarray, "n 3"], pose: Pose, focal: float) -> Float64[np.ndarray, "n 2"]:
    """Columns and rows of points, pixel centres at halves; NaN for what is behind the camera."""
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    depth = np.where(local[:, 2] < 0, -local[:, 2], np.nan)
    return np.stack([WIDTH / 2 + focal * local[:, 0] / depth, HEIGHT / 2 - focal * local[:, 1] / depth], axis=1)


def idr_matrices(rig: Rig) -> dict[str, Float64[np.ndarray, "4 4"]]:
    """``world_mat`` and ``scale_mat`` of each shot; pixel centres are whole numbers there."""
    inner = np.eye(4)
    inner[0, 0] = inner[1, 1] = rig.focal
    inner[:2, 2] = WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5
    middle, radius = rig.region or (np.zeros(3), 1.0)
    scale = np.diag([radius, radius, radius, 1.0])
    scale[:3, 3] = middle
    matrices = {}
    for index, shot in enumerate(rig.shots):
        matrices[f"world_mat_{index}"] = inner @ np.linalg.inv(shot.pose @ OPENGL)
        matrices[f"scale_mat_{index}"] = scale
    return matrices
