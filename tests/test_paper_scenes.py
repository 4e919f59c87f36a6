"""The paper's synthetic scenes, as design and paper state them: 640 x 480, sigma = 5 mm."""

import numpy as np
import pytest

import planewise as pw
from planewise import scenes


@pytest.mark.parametrize(
    ("search", "objective"), [("joint", "paper"), ("sequential", "paper"), ("joint", "spatial")]
)
@pytest.mark.parametrize("name", ["staircase", "corner"])
def test_four_planes_at_every_seed(name, search, objective):
    for seed in range(20):
        scene = getattr(scenes, name)(rng=seed)
        model = pw.detect_planes(
            scene.depth,
            scene.camera,
            scene.sensor,
            search=search,
            objective=objective,
            confidence=0.99,
            inlier_ratio=0.25,
            max_planes=8,
        )
        assert len(model) == 4
        normals = np.array([plane.normal for plane in model.planes])
        cosine = np.clip(scene.planes[:, :3] @ normals.T, -1, 1).max(axis=1)
        assert np.degrees(np.arccos(cosine)).max() < 0.2


@pytest.mark.parametrize("search", ["joint", "sequential"])
def test_flatness_ranks_the_bands_by_frequency(search):
    scene = scenes.flatness()
    model = pw.detect_planes(scene.depth, scene.camera, scene.sensor, search=search)
    assert len(model) == 4
    bands = [np.bincount(scene.labels[model.labels == j + 1]).argmax() for j in range(4)]
    assert bands == [1, 2, 3, 4]


@pytest.mark.parametrize("seed", range(3))
def test_the_joint_search_is_never_above_the_sequential_one(seed):
    scene = scenes.room(seed)
    observation = pw.observe(scene.depth, scene.camera, scene.sensor)
    phi = {}
    for search in ("joint", "sequential"):
        model = pw.detect_planes(
            scene.depth, scene.camera, scene.sensor, search=search, objective="paper"
        )
        phi[search] = pw.information(observation, model.planes, model.labels)
        assert model.information == pytest.approx(phi[search], rel=1e-9)
    assert phi["joint"] <= phi["sequential"]


def test_planes_may_pay_only_together():
    """Of 8 x 8 squares, each at a depth of its own, the first thirty planes raise Phi."""
    side, rng = 160, np.random.default_rng(0)
    y, x = np.mgrid[:side, :side] * 8 // side
    depth = (2 + 0.11 * rng.permutation(64))[8 * y + x] + rng.normal(0, 0.005, (side, side))
    camera = pw.PinholeCamera(fx=side, fy=side, cx=side / 2, cy=side / 2)
    sensor = pw.Sensor(noise=0.005, max_depth=10)
    model = pw.detect_planes(depth, camera, sensor, objective="paper")
    assert len(model) >= 60
    assert model.information < 0.8 * model.curve[0]
    assert min(list(model.curve)[1:30]) > model.curve[0]


@pytest.mark.parametrize(
    ("folder", "name"),
    [
        ("nyu_dpd", "nyu_0002"),
        ("mosd_boxes", "learn11"),
        ("mosd_boxes", "learn22"),
        ("rgbd_misc", "rs_D43502"),
        ("kinect_7scenes", "7s_py_000000"),
    ],
)
def test_the_same_on_real_frames(real_frames, folder, name):
    depth, camera, scale = real_frames(folder, name)
    phi = {
        search: pw.detect_planes(
            depth, camera, pw.sensors.KINECT_V1, depth_scale=scale, search=search, objective="paper"
        ).information
        for search in ("joint", "sequential")
    }
    assert phi["joint"] <= phi["sequential"] * (1 + 1e-12)
