"""Bags of both generations of ROS, written by `rosbags` and read back equal; a topic as a table."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nls import GraphFileError
from nls.missions.importing import Mapping, draft, import_logs
from nls.missions.importing.bags import Bag
from tests.combinations import for_all
from tests.nls.missions.importing.logs import table

pytest.importorskip("rosbags", reason="bags need the extra ros")
ZERO = 1733436754
YAW = np.array([0.3, 0.5, 3.1])  # of ENU
V = np.array([[1.25, 0.1, -0.2], [1.5, 0.2, 0.3], [1.75, -0.1, 0.0]])  # of FLU
MAPPING = """
time_s = "header.stamp"
[dvl]
topic = "/dvl"
velocity = ["twist.twist.linear.x", "twist.twist.linear.y", "twist.twist.linear.z"]
frame = "FLU"
[ahrs]
topic = "/imu"
quaternion = "orientation"
frame = "ENU"
[fixes]
topic = "/gps"
lat_deg = "latitude"
lon_deg = "longitude"
sigma_x_m = 2
sigma_y_m = 2
"""


def message(store: Any, kind: str, **given: Any) -> Any:
    """A message of a type; fields that are not given are zero."""
    zeros = {}
    for name, (node, of) in store.fielddefs[kind][1]:
        if node.name == "NAME":
            given[name] = message(store, of, **given.get(name, {}))
        zeros[name] = np.zeros(9) if node.name == "ARRAY" else "" if of[0] == "string" else 0
    return store.types[kind](**zeros | given)


def messages(store: Any) -> Iterator[tuple[str, str, int, Any]]:
    """Topic, type, time and message, three of each."""
    for k in range(3):
        twist = {"twist": {"linear": dict(zip("xyz", V[k].tolist(), strict=True))}, "covariance": np.arange(36.0)}
        half = float(YAW[k]) / 2
        for topic, kind, fields in (
            ("/dvl", "geometry_msgs/msg/TwistWithCovarianceStamped", {"twist": twist}),
            ("/imu", "sensor_msgs/msg/Imu", {"orientation": {"z": float(np.sin(half)), "w": float(np.cos(half))}}),
            ("/gps", "sensor_msgs/msg/NavSatFix", {"latitude": 54.1 + 1e-5 * k, "longitude": 10.2}),
        ):
            stamp = {"sec": ZERO + k, "nanosec": 250_000_001}
            yield topic, kind, k, message(store, kind, header={"stamp": stamp}, **fields)


def write(folder: Path, form: str) -> Path:
    """A bag of these messages."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    ros1 = form == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    path = folder / ("dive.bag" if ros1 else form)
    plugin = rosbag2.StoragePlugin.MCAP if form == "mcap" else rosbag2.StoragePlugin.SQLITE3
    writer: Any = rosbag1.Writer(path) if ros1 else rosbag2.Writer(path, version=9, storage_plugin=plugin)
    with writer:
        connections: dict[str, Any] = {}
        for topic, kind, k, message in messages(store):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            raw = store.serialize_ros1(message, kind) if ros1 else store.serialize_cdr(message, kind)
            writer.write(connections[topic], (ZERO + k) * 10**9, raw)
    return next(path.glob("*.mcap")) if form == "mcap" else path


@for_all(form=["ros1", "sqlite", "mcap"])
def test_a_bag_is_read_back_equal(form: str, tmp_path: Path) -> None:
    path = write(tmp_path, form)
    bag = Bag(path)
    assert {name: count for name, (_, count) in bag.topics.items()} == {"/dvl": 3, "/gps": 3, "/imu": 3}
    log = bag.log("/dvl")
    assert np.array_equal(np.column_stack([log.numbers(f"twist.twist.linear.{a}") for a in "xyz"]), V)
    assert log.numbers("twist.covariance.35").tolist() == [35.0] * 3
    stamps = log.whole("header.stamp")
    assert stamps is not None
    assert stamps.tolist() == [(ZERO + k) * 10**9 + 250_000_001 for k in range(3)]

    result = import_logs([path], Mapping(MAPPING, "mapping.toml"))
    dvl, ahrs, fixes = (table(result, name) for name in ("dvl", "ahrs", "fixes"))
    assert np.array_equal(np.column_stack([dvl[f"v{a}_m_s"] for a in "xyz"]), V * [1, -1, -1])
    assert dvl["time_s"].tolist() == [0.250000001, 1.250000001, 2.250000001]
    assert ahrs["yaw_rad"] == pytest.approx(np.pi / 2 - YAW)
    assert fixes["lat_deg"].tolist() == [54.1, 54.1 + 1e-5, 54.1 + 2e-5]


def test_the_draft_of_a_bag_is_a_mapping_of_it(tmp_path: Path) -> None:
    path = write(tmp_path, "ros1")
    text = draft([path])
    assert "# topic '/imu', 3 messages of sensor_msgs/msg/Imu: 'header.seq', 'header.stamp'" in text
    result = import_logs([path], Mapping(text, "mapping.toml"))
    assert {"dvl", "ahrs", "fixes"} <= set(result.rows)


@for_all(
    case=[
        ('[dvl]\nvx_m_s = "x"', r"dive\.bag is a bag; write topic = one of '/dvl', '/gps', '/imu'"),
        ('[dvl]\ntopic = "/dvll"\nvx_m_s = "x"', "has no topic '/dvll'; did you mean '/dvl'"),
        ('[depth]\ntopic = "/gps"\ntime_s = "header.stamp"\nz_m = "altitud"', 'write z_m = "altitude"'),
    ]
)
def test_refusals_of_a_bag(case: tuple[str, str], tmp_path: Path) -> None:
    path = tmp_path / "dive.bag" if (tmp_path / "dive.bag").exists() else write(tmp_path, "ros1")
    with pytest.raises(GraphFileError, match=case[1]):
        import_logs([path], Mapping(case[0], "mapping.toml"))


def test_no_bag_and_no_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("dive.bag", "dive.mcap", "dive.db3"):
        (tmp_path / name).write_bytes(b"nothing of a bag" * 9)
        with pytest.raises(GraphFileError, match=rf"{name}: cannot be read as a bag"):
            Bag(tmp_path / name)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(GraphFileError, match=r'pip install "leadline\[ros\]"'):
        Bag(tmp_path / "dive.bag")
