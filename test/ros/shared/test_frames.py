"""Rigid transforms against matrices, and which frames lead to the organ."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from helpers.turns import random_turns
from tissue_sim.contact.quaternions import rotate, rotate_back, unit_quaternion
from tissue_sim.ros.shared.frames import Frames, Transform, UnknownFrame

RANDOM = np.random.default_rng(1)


def random_pose() -> list[float]:
    return [*RANDOM.normal(size=3), *random_turns(1, RANDOM)[0].as_quat()]


def matrix(pose) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return found


@pytest.mark.parametrize("_", range(5))
def test_transforms_are_those_of_matrices(_):
    first, second, pose = random_pose(), random_pose(), random_pose()
    a, b = Transform.of_pose(first), Transform.of_pose(second)
    assert matrix(a.of(pose)) == pytest.approx(matrix(first) @ matrix(pose))
    assert matrix(a.after(b).of(pose)) == pytest.approx(matrix(first) @ matrix(second) @ matrix(pose))
    assert matrix(a.inverse().of(pose)) == pytest.approx(np.linalg.inv(matrix(first)) @ matrix(pose))
    turned = rotate(a.rotation, (1.0, 2.0, 3.0))
    assert turned == pytest.approx(matrix(first)[:3, :3] @ [1.0, 2.0, 3.0])
    assert rotate_back(a.rotation, turned) == pytest.approx((1.0, 2.0, 3.0))


def test_scale_is_applied_to_positions_alone_and_first():
    base, pose = random_pose(), random_pose()
    slow = [*(0.25 * np.array(pose[:3])), *pose[3:]]
    assert Transform.of_pose(base).scaled(0.25).of(pose) == pytest.approx(Transform.of_pose(base).of(slow))


def test_identity_is_known_as_such():
    assert Transform().is_identity
    assert Transform().inverse().after(Transform()).is_identity
    assert not Transform(scale=0.5).is_identity
    assert not Transform((0.0, 0.0, 1e-9)).is_identity


@pytest.mark.parametrize(
    "pose", [[0.0] * 6, [0.0] * 7, [math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0, 0.0, math.inf, 1.0]]
)
def test_bad_poses_are_refused(pose):
    with pytest.raises(ValueError, match=r"must be|has a zero quaternion"):
        Transform.of_pose(pose)


def test_a_quaternion_gets_length_1():
    assert unit_quaternion([0.0, 0.0, 3.0, 4.0]) == pytest.approx((0.0, 0.0, 0.6, 0.8))
    with pytest.raises(ValueError, match="four finite"):
        unit_quaternion([1.0])


def test_known_frames_come_first_and_others_are_looked_up():
    asked = []

    def lookup(frame_id):
        asked.append(frame_id)
        if frame_id == "moon":
            raise UnknownFrame("too far")
        return Transform((0.0, 0.0, 1.0))

    frames = Frames({"organ": Transform(), "arm": Transform((1.0, 0.0, 0.0))}, 0.5, lookup)
    assert frames.to_organ("arm") == Transform((1.0, 0.0, 0.0), scale=0.5)
    assert asked == []
    assert frames.to_organ("camera") == Transform((0.0, 0.0, 1.0), scale=0.5)
    with pytest.raises(UnknownFrame, match="too far"):
        frames.to_organ("moon")
    with pytest.raises(UnknownFrame, match="tf2_ros"):
        Frames({}).to_organ("camera")
