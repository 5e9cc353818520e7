r"""Other axes than those of a mission: vectors, attitudes and sigmas turned into north-east-down and ahead-right-down.

With v_NED = P v of the world and v_FRD = Q v of the body, an attitude R (body to world) and one of a sensor on the
body, R_s, become

    R_NED = P R Q',    R_s,FRD = Q R_s Q'
    P = [[0, 1, 0], [1, 0, 0], [0, 0, -1]] of ENU,  diag(1, -1, -1) of NWU;    Q = diag(1, -1, -1) of FLU

For ENU and FLU: roll stays, pitch changes its sign, yaw becomes pi/2 - yaw. Source: ROS REP 103 for ENU and FLU.
"""

import numpy as np
import numpy.typing as npt

from models.algebra import Array, wrap
from models.errors import OptionError
from models.manifolds.euler import angles_from_quaternion, quaternion_from_angles
from models.manifolds.so3 import quaternion_from_matrix, rotation3
from nls.missions.folder.columns import ANGLES, ARM, PLACE, VELOCITY, suffixed

WORLD = {"NED": np.eye(3), "ENU": np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]), "NWU": np.diag([1.0, -1, -1])}
BODY = {"FRD": np.eye(3), "FLU": np.diag([1.0, -1, -1])}
BODY_OF = {"NED": "FRD", "ENU": "FLU", "NWU": "FLU"}  # that goes with a world, unless said otherwise
FRAMES = (*WORLD, *BODY)
ON_BODY = ("sonar", "dvl_mount", "closures", "odometry")  # tables whose places and angles are in axes of the body
TO_PORT = ("bearing_rad", "elevation_rad", "azimuth_rad")  # to starboard and down in a mission


def axes(frame: str) -> tuple[str, str]:
    """World and body of a frame: a pair as it stands, a world with the body that goes with it, a body with NED.

    Raises
    ------
    OptionError
        A pair of another order.

    Examples
    --------
    >>> axes("ENU"), axes("ENU/FRD"), axes("FLU")
    (('ENU', 'FLU'), ('ENU', 'FRD'), ('NED', 'FLU'))
    """
    world, _, body = frame.partition("/")
    if not body:
        world, body = ("NED", world) if world in BODY else (world, BODY_OF[world])
    if world not in WORLD or body not in BODY:
        raise OptionError("frame", frame, "world/body, such as 'ENU/FLU'")
    return world, body


def turn(table: str, columns: dict[str, Array], frame: str) -> dict[str, Array]:
    """The columns of a table in the axes of a mission.

    Parameters
    ----------
    table : its name.
    columns : (n,) by name, in the axes of ``frame`` and with the units of the mission.
    frame : see `axes`.

    Raises
    ------
    OptionError
        A column that has no place without another one; an angle alone that these axes do not turn alone.

    Examples
    --------
    >>> turn("dvl", {"vx_m_s": [1.0], "vy_m_s": [0.2], "vz_m_s": [0.1]}, "FLU")
    {'vx_m_s': array([1.]), 'vy_m_s': array([-0.2]), 'vz_m_s': array([-0.1])}
    >>> turned = turn("ahrs", {"roll_rad": [0.1], "pitch_rad": [0.2], "yaw_rad": [0.3]}, "ENU")
    >>> {name: angle.round(4) for name, angle in turned.items()}
    {'roll_rad': array([0.1]), 'pitch_rad': array([-0.2]), 'yaw_rad': array([1.2708])}
    """
    world, body = axes(frame)
    if (world, body) == ("NED", "FRD"):
        return columns
    P, Q, out = WORLD[world], BODY[body], dict(columns)
    place = Q if table in ON_BODY else P
    for names, matrix in ((PLACE, place), (ARM, Q), (VELOCITY, Q)):
        out |= _vector(names, columns, matrix, frame)
        out |= _vector(suffixed(names), columns, np.abs(matrix), frame)
    out |= {name: -np.asarray(columns[name]) for name in TO_PORT if name in columns and body == "FLU"}
    if all(name in columns for name in ANGLES):
        R = rotation3(quaternion_from_angles(np.column_stack([columns[name] for name in ANGLES])))
        rpy = angles_from_quaternion(quaternion_from_matrix(place @ R @ Q.T))
        out |= dict(zip(ANGLES, rpy.T, strict=True))
    elif any(name in columns for name in ANGLES):
        out |= _some_angles(table, columns, world, body, frame)
    return out


def _vector(names: tuple[str, ...], columns: dict[str, Array], matrix: Array, frame: str) -> dict[str, Array]:
    """The components of a vector that are there, each by the one axis that it is in the other frame."""
    out = {}
    for name, row in zip(names, matrix, strict=True):
        if name not in columns and (np.array_equal(matrix, np.diag(np.diag(matrix))) or name == names[2]):
            continue
        k = int(np.argmax(np.abs(row)))
        if names[k] in columns:
            out[name] = row[k] * np.asarray(columns[names[k]])
        elif name in columns:
            raise OptionError("frame", frame, f"a {names[k]} beside {name}, which changes places with it")
    return out


def _some_angles(table: str, columns: dict[str, Array], world: str, body: str, frame: str) -> dict[str, Array]:
    """Pitch, roll or yaw where not all three are there."""
    yaw_alone = table in ON_BODY and body == "FLU"  # a turn about an axis that points the other way
    if not yaw_alone and BODY_OF[world] != body:
        raise OptionError("frame", frame, "roll, pitch and yaw together, as these axes do not turn one of them alone")
    out = {}
    if "pitch_rad" in columns:
        out["pitch_rad"] = -np.asarray(columns["pitch_rad"])
    if "yaw_rad" in columns:
        zero = np.pi / 2 if world == "ENU" and not yaw_alone else 0.0
        out["yaw_rad"] = wrap(zero - np.asarray(columns["yaw_rad"]))
    return out


@np.errstate(over="ignore", invalid="ignore")  # what overflows is no rotation
def angles_of(kind: str, parts: npt.ArrayLike) -> Array:
    """Roll, pitch and yaw (n, 3) of quaternions (n, 4), x y z w, or matrices (n, 9) row by row.

    Raises
    ------
    ValueError
        Numbers (row, sentence) that are no rotation.
    """
    numbers = np.asarray(parts, dtype=float)
    if kind == "quaternion":
        off = np.abs(np.linalg.norm(numbers, axis=1) - 1)
    else:
        M = numbers.reshape(-1, 3, 3)
        off = np.abs(M @ M.mT - np.eye(3)).max(axis=(1, 2)) + (np.linalg.det(M) < 0)
    if (bad := ~(off < 1e-2)).any():
        k = int(np.argmax(bad))
        raise ValueError(k, f"{kind} {numbers[k].tolist()} is no rotation")
    rotation = numbers if kind == "quaternion" else quaternion_from_matrix(numbers.reshape(-1, 3, 3))
    return angles_from_quaternion(rotation / np.linalg.norm(rotation, axis=1, keepdims=True))
