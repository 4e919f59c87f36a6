from __future__ import annotations

import numpy as np
import pytest

from planewise import scenes

SIZE = (120, 160)
MAKERS = {
    "staircase": scenes.staircase,
    "corner": scenes.corner,
    "flatness": scenes.flatness,
    "two_planes": lambda **options: scenes.two_planes(60, **options),
    "t_junction": scenes.t_junction,
}


def residuals(scene, label):
    """Orthogonal distance of the readings of one true plane, in metres."""
    z = scene.depth * (scene.sensor.resolution if scene.depth.dtype.kind == "u" else 1.0)
    points = scene.camera.rays(scene.depth.shape)[scene.labels == label]
    points = points * z[scene.labels == label][:, None]
    return points @ scene.planes[label - 1, :3] + scene.planes[label - 1, 3]


@pytest.mark.parametrize("name", MAKERS)
def test_exact_depth_lies_on_the_true_planes(name):
    relief = {"amplitude": 0.0} if name == "flatness" else {}
    scene = MAKERS[name](sigma=0.0, size=SIZE, quantise=False, **relief)
    assert np.allclose(np.linalg.norm(scene.planes[:, :3], axis=1), 1)
    assert (scene.planes[:, 3] > 0).all()
    assert set(np.unique(scene.labels)) == set(range(1, len(scene.planes) + 1))
    for label in range(1, len(scene.planes) + 1):
        assert np.abs(residuals(scene, label)).max() < 1e-12


@pytest.mark.parametrize("name", MAKERS)
def test_noise_is_seeded_and_of_the_stated_size(name):
    first, same, other = (MAKERS[name](sigma=0.005, size=SIZE, rng=rng) for rng in (1, 1, 2))
    assert first.depth.dtype == np.uint16
    assert np.array_equal(first.depth, same.depth)
    assert not np.array_equal(first.depth, other.depth)
    exact = MAKERS[name](sigma=0.0, size=SIZE, quantise=False)
    error = first.depth * 0.001 - exact.depth
    assert error.std() == pytest.approx(0.005, rel=0.03)
    assert error.mean() == pytest.approx(-0.0005, abs=0.0002)  # rounded down


def test_staircase_is_that_of_the_paper():
    scene = scenes.staircase(sigma=0.0, quantise=False)
    assert scene.depth.shape == (480, 640)
    assert np.allclose(scene.planes[:, 3], np.array((1.63, 1, 1, 1.63)) / np.sqrt(2))
    tilt = np.degrees(np.arctan2(scene.planes[:, 1], -scene.planes[:, 2]))
    assert np.allclose(np.abs(tilt), 45)
    assert np.allclose(np.diff(np.sign(tilt)), (-2, 2, -2))
    assert scene.depth[240, 320] == pytest.approx(1.0)
    assert np.array_equal(np.unique(scene.labels, return_counts=True)[1], [120 * 640] * 4)
    # Neighbouring faces meet, as stairs do.
    assert abs(scene.depth[119] - scene.depth[120]).max() < 0.01
    assert scene.sensor.range == pytest.approx(np.ptp(scene.depth))


def test_readings_on_a_ridge_of_the_corner_are_all_of_one_face():
    """Both faces are as deep there: which is deeper was decided by rounding."""
    labels = scenes.corner(sigma=0.0, quantise=False).labels
    assert (labels[240, 321:] == labels[239, 321:]).all()
    assert set(labels[240, 321:]) == {2}


def test_corner_stands_out_of_its_background():
    scene = scenes.corner(sigma=0.0, quantise=False)
    assert np.allclose(scene.planes[:3, 3], 0.7)
    assert scene.depth.max() == pytest.approx(1.5)
    assert scene.depth[240, 320] == pytest.approx(0.7 * np.sqrt(2))
    between = scene.planes[:3, :3] @ scene.planes[:3, :3].T
    assert np.allclose(between[~np.eye(3, dtype=bool)], 0.25)


def test_flatness_has_waves_of_the_stated_amplitude():
    scene = scenes.flatness(quantise=False)
    spread = [np.abs(residuals(scene, label)).max() for label in (1, 2, 3, 4)]
    assert spread == pytest.approx([0, 0.005, 0.005, 0.005], rel=1e-3)


@pytest.mark.parametrize("angle", [60, 90, 150])
def test_two_planes_meet_at_the_angle(angle):
    scene = scenes.two_planes(angle, sigma=0.0, size=SIZE, quantise=False)
    between = np.degrees(np.arccos(scene.planes[0, :3] @ scene.planes[1, :3]))
    assert 180 - between == pytest.approx(angle)
    assert scene.depth[60, 80] == pytest.approx(1.0)


def test_t_junction_planes_cross_only_where_the_first_is_seen():
    scene = scenes.t_junction(sigma=0.0, size=SIZE, quantise=False)
    gap = scene.depth[60][scene.labels[60] == 2][0] - scene.depth[60][scene.labels[60] == 1][-1]
    assert gap > 0.2
    on_first = scene.camera.rays(SIZE)[scene.labels == 1]
    side = on_first @ scene.planes[1, :3] + scene.planes[1, 3]
    assert side.min() < 0 < side.max()


@pytest.mark.parametrize("bad", [{"sigma": -1}, {"sigma": float("nan")}])
def test_bad_noise_is_refused(bad):
    with pytest.raises(ValueError, match="sigma"):
        scenes.staircase(size=SIZE, **bad)


@pytest.mark.parametrize("quantise", [False, True])
@pytest.mark.parametrize("sigma", [0.5, 50.0])
def test_what_noise_puts_out_of_sight_is_no_reading(sigma, quantise):
    scene = scenes.corner(sigma=sigma, size=SIZE, quantise=quantise)
    lost = scene.depth == 0
    assert lost.any()
    assert np.array_equal(scene.labels == 0, lost)
    z = scene.depth[~lost] * (0.001 if quantise else 1.0)
    assert z.min() > 0
    assert scene.sensor.max_depth == pytest.approx(z.max(), abs=0.0021)
    assert scene.sensor.range == pytest.approx(np.ptp(z))
    if sigma < 1:  # nothing has come from behind the camera to its other end
        assert z.max() < 1.5 + 6 * sigma
        kept = scenes.corner(sigma=0.0, size=SIZE).labels[~lost]
        assert np.array_equal(scene.labels[~lost], kept)


def test_noise_that_leaves_no_reading_is_refused():
    with pytest.raises(ValueError, match=r"^no pixel of the scene .* give less noise$"):
        scenes.corner(sigma=1e9, size=(1, 1))


@pytest.mark.parametrize("quantise", [False, True])
def test_scenes_of_one_depth_have_a_range(quantise):
    options = {"sigma": 0.0, "quantise": quantise}
    for scene in (
        scenes.two_planes(179.9, **options),
        scenes.corner(size=(1, 1), **options),
        scenes.flatness(size=(480, 1), **options),
    ):
        assert np.ptp(scene.depth) * (0.001 if quantise else 1.0) < 0.001
        assert scene.sensor.range == 0.002
        assert (scene.labels > 0).all()


def test_a_wave_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="amplitude must be a number of metres, got nan"):
        scenes.flatness(amplitude=float("nan"))


@pytest.mark.parametrize("bad", [(0, 0), (48,), (4.5, 6), 48, (48, -64)])
def test_bad_size_is_refused(bad):
    for make in (scenes.staircase, scenes.corner, scenes.room):
        with pytest.raises(ValueError, match=r"size must be \(height, width\)"):
            make(size=bad)


@pytest.mark.parametrize("angle", [30, 180, float("nan")])
def test_bad_angle_is_refused(angle):
    with pytest.raises(ValueError, match="angle"):
        scenes.two_planes(angle)


@pytest.mark.parametrize("seed", range(4))
def test_rooms_are_varied_and_their_labels_true(seed):
    room = scenes.room(seed, size=SIZE)
    assert room.depth.dtype == np.uint16
    assert room.rgb.shape == (*SIZE, 3)
    assert 8 <= len(room.planes) <= 21
    assert set(np.unique(room.labels)) == set(range(len(room.planes) + 1))
    assert not room.labels[room.depth == 0].any()
    assert 0.001 < (room.depth == 0).mean() < 0.1
    assert (room.planes[:, 3] > 0).all()
    sigma = room.sensor.sigma(room.depth / 1000)
    for label in range(1, len(room.planes) + 1):
        off = np.abs(residuals(room, label)) / sigma[room.labels == label]
        assert np.median(off) < 1.2


def test_every_face_of_a_room_can_be_labelled():
    """The same image; what is clutter otherwise has a plane, but for what is curved."""
    room, faces = scenes.room(1, size=SIZE), scenes.room(1, size=SIZE, every_face=True)
    assert np.array_equal(room.depth, faces.depth)
    assert len(faces.planes) > len(room.planes)
    assert (faces.labels[room.labels > 0] > 0).all()
    more = (faces.labels > 0) & (room.labels == 0)
    assert more.any()
    assert ((faces.labels == 0) & (faces.depth > 0)).any()
    sigma = faces.sensor.sigma(faces.depth / 1000)
    for label in np.unique(faces.labels[more]):
        off = np.abs(residuals(faces, label)) / sigma[faces.labels == label]
        assert np.median(off) < 2 or off.size < 20


def test_room_is_seeded_and_its_noise_can_be_set():
    assert np.array_equal(scenes.room(5, size=SIZE).depth, scenes.room(5, size=SIZE).depth)
    assert not np.array_equal(scenes.room(5, size=SIZE).depth, scenes.room(6, size=SIZE).depth)
    quiet = scenes.room(5, size=SIZE, sigma=0.001, holes=False)
    assert quiet.depth.all()
    assert quiet.sensor.sigma([1.0, 4.0]) == pytest.approx(0.001)
    with pytest.raises(ValueError, match="sigma"):
        scenes.room(5, size=SIZE, sigma=0.0)


def test_depth_of_a_room_falls_into_disparity_steps():
    room = scenes.room(0, size=SIZE)
    far = np.unique(room.depth[room.depth > 3000])
    assert np.diff(far).min() > 15  # a Kinect's step at 3 m is 26 mm


def test_found_counts_true_planes_once():
    scene = scenes.staircase(size=SIZE)
    assert scene.found(scene.labels).all()
    assert scene.found(5 - scene.labels).all()  # other numbers, same regions
    assert not scene.found(np.zeros(SIZE, np.uint16)).any()
    assert not scene.found(np.ones(SIZE, np.uint16)).any()
    merged = np.where(scene.labels == 2, 1, scene.labels)
    assert scene.found(merged).tolist() == [False, False, True, True]
