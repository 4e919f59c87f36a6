"""What is worked out by level instead of by reading."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import planewise as pw
from planewise.kernels.images import mark_levels
from planewise.spatial.frame import frame_of

SIGMA, RESOLUTION = 0.002, 0.001


@pytest.mark.parametrize(("power", "slack"), [(0, 4), (1, 2), (2, 0)])
def test_readings_in_metres_have_nearly_the_variance_of_their_depth(camera, power, slack):
    """Off by a part of |2 power - 4| times a level over the depth."""
    depth = np.random.default_rng(0).uniform(0.5, 6, (48, 64))
    noise = pw.Sensor(
        max_depth=10, resolution=RESOLUTION, noise=lambda z: SIGMA * np.asarray(z) ** power
    )
    seen = pw.observe(depth, camera, noise)
    frame = frame_of(seen)
    assert_array_equal(frame.w, (1 / depth).astype(np.float32))
    of_level = np.searchsorted(seen.image.levels, np.floor(seen.image.per_metre * depth + 0.5))
    step = seen.image.steps()[of_level]
    variance = (SIGMA**2 * depth ** (2 * power) + step**2 / 12) / depth**4
    # Quantisation is a variance of depth, as constant noise is.
    slack = slack * SIGMA**2 * depth ** (2 * power) + 4 * step**2 / 12
    bound = 0.1 * RESOLUTION / depth * slack / (variance * depth**4)
    assert (np.abs(frame.p * variance - 1) < 1.01 * bound + 3e-7).all()


def test_readings_in_units_have_the_variance_of_their_depth(camera):
    raw = np.random.default_rng(0).integers(500, 6000, (48, 64)).astype(np.uint16)
    sensor = pw.Sensor(max_depth=10, resolution=RESOLUTION, noise=pw.noise.constant(SIGMA))
    seen = pw.observe(raw, camera, sensor)
    frame = frame_of(seen)
    step = np.interp(raw, seen.image.levels, seen.image.steps())
    z = raw * RESOLUTION
    assert_allclose(frame.p * (SIGMA**2 + step**2 / 12) / z**4, 1, rtol=3e-7)


@pytest.mark.parametrize(("step", "told"), [(1e-5, False), (0.02, True)])
def test_gaps_between_readings_that_hardly_meet_are_no_steps(camera, step, told):
    z = np.random.default_rng(0).uniform(1, 3, (48, 64))
    sensor = pw.Sensor(max_depth=10, resolution=RESOLUTION, noise=pw.noise.constant(SIGMA))
    steps = pw.observe(np.round(z / step) * step, camera, sensor).image.steps()
    assert_allclose(steps, step if told else 0, atol=0.1 * RESOLUTION)


@pytest.mark.parametrize("far", [2_000.0, 65_504.0])
def test_levels_that_are_coarse_for_a_far_reading_are_no_steps(camera, far):
    """One pixel of the sky says nothing of the others."""
    z = np.random.default_rng(0).normal(2, SIGMA, (48, 64))
    sensor = pw.Sensor(max_depth=1e5, resolution=RESOLUTION, noise=pw.noise.constant(SIGMA))
    model = pw.detect_planes(z, camera, sensor)
    z[5, 5] = far
    seen = pw.observe(z, camera, sensor)
    assert 1 / seen.image.per_metre > RESOLUTION
    assert not seen.image.steps().any()
    assert not seen.image.without(z > 2).steps().any()
    with_it = pw.detect_planes(z, camera, sensor)
    assert_allclose(with_it.planes[0].coefficients, model.planes[0].coefficients, atol=1e-4)
    assert_allclose(with_it.settings["frame_error"]["seen"], 1, atol=0.25)


def test_infinity_in_half_precision_is_no_reading_however_far_the_sensor_sees(camera):
    z = np.random.default_rng(0).normal(2, 0.005, (48, 64)).astype(np.float16)
    z[0, 0] = np.inf
    for limit in (5e4, 1e5):
        seen = pw.observe(z, camera, pw.Sensor(max_depth=limit, noise=0.005))
        assert seen.count == z.size - 1
        assert len(pw.detect_planes(z, camera, pw.Sensor(max_depth=limit, noise=0.005))) == 1


@pytest.mark.parametrize(("low", "high"), [(1, 65_535), (700, 9_000), (9_000, 700), (70_000, 9)])
def test_which_levels_occur_and_how_often(low, high):
    raw = np.random.default_rng(0).integers(0, 65_536, (150, 170)).astype(np.uint16)
    raw[40:60, 20:] = 0
    seen = np.zeros(65_536, np.bool_)
    count, present = mark_levels(raw.reshape(-1), low, high, seen)
    assert_array_equal(np.flatnonzero(seen), np.unique(raw))
    assert count == ((low <= raw) & (raw <= high)).sum()
    assert present == np.count_nonzero(raw)


LIMITS = pytest.mark.parametrize(
    ("least", "most"), [(500, 5460), (900, 3200), (1300, 4100), (1400, 65_535)]
)


@LIMITS
@pytest.mark.parametrize("how", ["divided", "multiplied"])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_readings_at_the_limits_are_readings_however_they_are_rounded(
    camera, least, most, dtype, how
):
    units = np.random.default_rng(0).integers(least, most + 1, (48, 64)).astype(np.uint16)
    units[0, :4] = least, most, least - 1, min(most + 1, 65_535)
    metres = units.astype(dtype)
    metres = metres / dtype(1000) if how == "divided" else metres * dtype(0.001)
    sensor = pw.Sensor(min_depth=least / 1000, max_depth=most / 1000, noise=SIGMA)
    seen, told = pw.observe(metres, camera, sensor), pw.observe(units, camera, sensor)
    assert seen.count == len(seen.index) == told.count
    assert_array_equal(seen.index, told.index)
    assert_allclose(seen.depth, told.depth, rtol=4e-7)
    assert_array_equal(frame_of(seen).w > 0, frame_of(told).w > 0)


def test_one_reading_at_the_limit_in_single_precision(camera):
    units = np.full((48, 64), 2000, np.uint16)
    units[0, 0] = 5460
    sensor = pw.sensors.AZURE_KINECT
    for options in ({}, {"objective": "paper"}, {"search": "sequential"}):
        found, told = (
            pw.detect_planes(image, camera, sensor, **options)
            for image in (units.astype(np.float32) / 1000, units)
        )
        assert found.readings == told.readings == units.size
        assert_array_equal(found.labels, told.labels)


@pytest.mark.parametrize("limit", [2.2, 2.4, 3.0])
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint16])
def test_depth_that_was_clipped_at_the_limit_is_no_reading(limit, kind):
    room = pw.scenes.room(3, size=(120, 160))
    units = 1000 if kind is np.uint16 else 1
    z = np.asarray(room.depth * (1e-3 * units)).round(0 if kind is np.uint16 else 9).astype(kind)
    sensor = replace(room.sensor, max_depth=limit)
    far = z >= kind(units * limit)
    assert 0.01 < np.mean(far) < 0.99
    cut, clipped = np.where(far, kind(0), z), np.minimum(z, kind(units * limit))
    told, found = (pw.detect_planes(image, room.camera, sensor) for image in (cut, clipped))
    assert found.readings == told.readings == np.count_nonzero(cut)
    assert found.information == told.information
    assert_array_equal(found.labels, told.labels)


def test_few_readings_at_the_limit_are_readings_and_so_are_all(camera):
    sensor = pw.Sensor(max_depth=2.0, noise=SIGMA)
    z = np.random.default_rng(0).uniform(1.0, 1.9, (48, 64))
    z.flat[: z.size // 101] = 2.0
    assert pw.observe(z, camera, sensor).count == z.size
    z.flat[: z.size // 99] = 2.0
    assert pw.observe(z, camera, sensor).count == z.size - z.size // 99
    assert pw.observe(np.full_like(z, 2.0), camera, sensor).count == z.size
